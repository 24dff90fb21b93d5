//! Table 2 and Figure 12: trainings, their records, and what is shown of them.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use miette::{IntoDiagnostic, Result, WrapErr, miette};
use serde::Serialize;
use serde::de::DeserializeOwned;
use tiltline::dataset::{Dataset, Item, line_mask};
use tiltline::export::png::write_grey;
use tiltline::figures::foil::probability_canvas;
use tiltline::figures::losses::{self, COMBINATIONS};
use tiltline::figures::low_contrast::{self, PixelScore, STATES, State};
use tiltline::figures::page::{Section, picture};
use tiltline::figures::sheet::{self, Panel, Size};
use tiltline::io::read_micrograph;
use tiltline::micrograph::Micrograph;
use tiltline::simulate::geometry::Split;
use tiltline_nets::figures::{Trained, dense_scores, fine_tuning, loss_settings, probability, trained};
use tiltline_nets::infer::Named;
use tiltline_nets::train::{Event, TrainSettings};

use super::{Made, Work};
use crate::interrupt;
use crate::progress::Count;

const LOSSES: &str = "losses.json";
const LOW_CONTRAST: &str = "low-contrast.json";

fn records(work: &Work<'_>) -> PathBuf {
    work.flags.output.join("records")
}

fn read<T: DeserializeOwned>(path: &Path) -> Result<Option<T>> {
    if !path.is_file() {
        return Ok(None);
    }
    let text = std::fs::read_to_string(path).into_diagnostic()?;
    let record = serde_json::from_str(&text).into_diagnostic();
    record
        .map(Some)
        .wrap_err_with(|| format!("{} is no record of a training: make it again with --retrain", path.display()))
}

fn json<T: Serialize>(record: &T) -> Result<Vec<u8>> {
    Ok((serde_json::to_string_pretty(record).into_diagnostic()? + "\n").into_bytes())
}

/// Trains everything again and writes the records.
pub fn retrain(work: &Work<'_>) -> Result<()> {
    let mut files = vec![(LOSSES.to_owned(), json(&loss_record(work)?)?)];
    files.extend(low_contrast_files(work)?);
    std::fs::create_dir_all(records(work)).into_diagnostic()?;
    super::write(&records(work), &files)?;
    interrupt::stop_at_once();
    // Trained once more, they begin from nothing.
    std::fs::remove_dir_all(work.folder.join("trainings")).into_diagnostic()
}

fn training(work: &Work<'_>, name: &str, settings: TrainSettings, from: &Named) -> Result<Trained> {
    let folder = work.folder.join("trainings").join(name);
    std::fs::create_dir_all(&folder).into_diagnostic()?;
    work.say(&format!("training {name}, {} steps", settings.steps));
    let steps = settings.steps;
    let count = Count::new("steps", work.flags.verbosity);
    let stop = interrupt::ask_to_stop();
    let mut done = 0;
    let mut report = |event: &Event<'_>| {
        if let Event::Line { line, .. } = event {
            done = line.step;
            count.show(done as usize, steps as usize);
        }
        !stop.load(Ordering::Relaxed)
    };
    let result = trained(settings, &folder, from, &mut report).into_diagnostic();
    count.clear();
    result
}

fn loss_record(work: &Work<'_>) -> Result<losses::Record> {
    let detector = Named::built_in_detector().into_diagnostic()?;
    let pairs = work.dataset(&work.plan.pairs)?;
    let scored = |matcher: &Named, name: &str| {
        let count = Count::new("pairs", work.flags.verbosity);
        let key = format!("{} {}", pairs.manifest.content_hash(), matcher.weights.sha256);
        let scores = work.cache.taken(&format!("dense-{name}"), &key, || {
            work.say(&format!("Table 2: scoring {name}"));
            dense_scores(&detector, matcher, &pairs, &|done, of| count.show(done, of)).into_diagnostic()
        });
        count.clear();
        scores
    };
    let mut trainings = Vec::new();
    for (terms, weights) in COMBINATIONS {
        let name = terms.to_lowercase().replace('+', "-");
        let settings = loss_settings(weights, &work.plan.budget);
        let steps = settings.steps;
        let Trained { weights, settings, seconds, curve } = training(work, &name, settings, &detector)?;
        let scores = scored(&weights, &name)?;
        let weights_sha256 = weights.weights.sha256.clone();
        trainings.push(losses::Training {
            terms: terms.into(),
            settings,
            steps,
            seconds,
            weights_sha256,
            curve,
            scores,
        });
    }
    Ok(losses::Record {
        version: env!("CARGO_PKG_VERSION").into(),
        detector_sha256: detector.weights.sha256.clone(),
        set: pairs.manifest.name.clone().unwrap_or_default(),
        data_sha256: pairs.manifest.content_hash(),
        trainings,
        shipped: scored(&Named::built_in_matcher().into_diagnostic()?, "shipped")?,
    })
}

/// The detector that a record was made with, and whether it is still the program's.
fn detector_of(sha256: &str) -> Result<String> {
    let own = Named::built_in_detector().into_diagnostic()?.weights.sha256;
    let name = sha256.get(..16).unwrap_or(sha256);
    Ok(if sha256 == own {
        format!("detector {name}")
    } else {
        format!("with the detector {name}, another than the program's now")
    })
}

/// Table 2, from its record.
pub fn losses(work: &Work<'_>) -> Result<Made> {
    let heading = "Table 2: terms of the loss".to_owned();
    let Some(record) = read::<losses::Record>(&records(work).join(LOSSES))? else { return Ok(missing(work, heading)) };
    let caption = format!(
        "The shipped matcher's network, trained from random weights with the paper's losses only, on mixed simulated pairs of the training split; weights \
         of the terms are 1 (disparity), 1 (warp), 0.1 (variance). {} Scored on `{}` (SHA-256 {}): disparities of the dense matcher alone at all true \
         line pixels, no refinement, no free offset; {} of the set's {} pairs, the rest cannot be rectified. Intervals of all terms overlap: so few steps do \
         not separate them. The last row of each family is the matcher that is part of the program (more steps, cross-entropy \
         instead of variance and warp). Record: `records/{LOSSES}` (version {}; {}).",
        losses::budget(&record),
        record.set,
        record.data_sha256.get(..16).unwrap_or_default(),
        record.shipped.len(),
        work.plan.pairs.items.len(),
        record.version,
        detector_of(&record.detector_sha256)?
    );
    Ok(Made { section: Section { heading, caption, body: losses::table(&record) }, files: Vec::new() })
}

fn missing(work: &Work<'_>, heading: String) -> Made {
    let folder = records(work);
    work.say(&format!("{heading}: there is no record in {}; --retrain makes one", folder.display()));
    let body = "Left out: there is no record of its trainings (`--retrain` makes one).".to_owned();
    Made { section: Section { heading, caption: String::new(), body }, files: Vec::new() }
}

/// Left image of an item and its mask.
fn left(dataset: &Dataset, item: &Item) -> Result<(Micrograph, ndarray::Array2<u8>)> {
    let truth = dataset.truth(item).into_diagnostic()?;
    let view = &truth.views[item.pair[0]];
    let image = read_micrograph(&dataset.path(item, &view.name).to_string_lossy()).into_diagnostic()?;
    Ok((image, line_mask(&truth, view)))
}

fn scores(detector: &Named, dataset: &Dataset, items: &[&Item]) -> Result<Vec<PixelScore>> {
    let score = |item: &&Item| {
        let (image, mask) = left(dataset, item)?;
        let map = probability(detector, &image.normalised()).into_diagnostic()?;
        Ok(PixelScore::of(&item.name, &map, &mask))
    };
    items.iter().map(score).collect()
}

/// The items that are looked at; the first is shown.
fn looked_at(dataset: &Dataset) -> Vec<&Item> {
    dataset.manifest.items.iter().filter(|item| item.split != Split::Train).collect()
}

/// The record and the line probabilities of the image that is shown, in each state.
fn low_contrast_files(work: &Work<'_>) -> Result<Vec<(String, Vec<u8>)>> {
    let foils = work.dataset(&work.plan.low_contrast)?;
    let pairs = work.dataset(&work.plan.pairs)?;
    let shipped = Named::built_in_detector().into_diagnostic()?;
    let (looked_at, others) = (looked_at(&foils), pairs.manifest.items.iter().collect::<Vec<_>>());
    let shown = looked_at.first().ok_or_else(|| miette!("no image of low contrast is looked at"))?;
    let (image, _) = left(&foils, shown)?;
    let mut files = Vec::new();
    let mut states = Vec::new();
    for (index, name) in STATES.into_iter().enumerate() {
        // Other foils are another training.
        let of_foils = format!("low-contrast-with-{}", foils.manifest.content_hash().get(..12).unwrap_or_default());
        let folder = if index == 2 { of_foils.as_str() } else { "low-contrast-without" };
        let extra = (index == 2).then_some(foils.folder.as_path());
        let (weights, training) = if index == 0 {
            (shipped.clone(), None)
        } else {
            let settings = fine_tuning(extra, &work.plan.budget);
            let steps = settings.steps;
            let Trained { weights, settings, seconds, curve } = training(work, folder, settings, &shipped)?;
            (weights, Some((settings, steps, seconds, curve)))
        };
        work.say(&format!("Figure 12: scoring the detector {name}"));
        let map = probability(&weights, &image.normalised()).into_diagnostic()?;
        let mut png = Vec::new();
        write_grey(&map.mapv(|value| (255.0 * value).round() as u8), &mut png).into_diagnostic()?;
        files.push((map_name(index), png));
        let (settings, steps, seconds, curve) = match training {
            Some((settings, steps, seconds, curve)) => (Some(settings), steps, seconds, curve),
            None => (None, 0, 0.0, Vec::new()),
        };
        states.push(State {
            name: name.into(),
            weights_sha256: weights.weights.sha256.clone(),
            settings,
            steps,
            seconds,
            curve,
            low_contrast: scores(&weights, &foils, &looked_at)?,
            others: scores(&weights, &pairs, &others)?,
        });
    }
    let record = low_contrast::Record {
        version: env!("CARGO_PKG_VERSION").into(),
        data_sha256: foils.manifest.content_hash(),
        others: pairs.manifest.name.clone().unwrap_or_default(),
        states,
    };
    files.push((LOW_CONTRAST.into(), json(&record)?));
    Ok(files)
}

fn map_name(state: usize) -> String {
    format!("low-contrast-{state}.png")
}

/// Figure 12, from its record.
pub fn low_contrast(work: &Work<'_>) -> Result<Made> {
    let heading = "Figure 12: one image of low contrast".to_owned();
    let folder = records(work);
    let Some(record) = read::<low_contrast::Record>(&folder.join(LOW_CONTRAST))? else {
        return Ok(missing(work, heading));
    };
    let foils = work.dataset(&work.plan.low_contrast)?;
    if foils.manifest.content_hash() != record.data_sha256 {
        return Err(miette!(
            "{} is of other foils than this program makes: make it again with --retrain",
            folder.join(LOW_CONTRAST).display()
        ));
    }
    let shipped =
        record.states.first().ok_or_else(|| miette!("{LOW_CONTRAST} has no detector: make it again with --retrain"))?;
    let looked_at = looked_at(&foils);
    let shown = looked_at.first().ok_or_else(|| miette!("no image of low contrast is looked at"))?;
    let added = foils.manifest.items.iter().find(|item| item.split == Split::Train);
    let added = added.ok_or_else(|| miette!("no image of low contrast is trained on"))?;
    let picture_of = |item: &Item, caption: &str| -> Result<Panel> {
        let (image, _) = left(&foils, item)?;
        Ok(Panel { caption: caption.into(), canvas: sheet::drawn(&image.normalised(), Size::Full, &[], 1.0) })
    };
    let (_, mask) = left(&foils, shown)?;
    let truth = mask.mapv(|value| f32::from(value) / 255.0);
    let mut panels = vec![
        picture_of(shown, "(a) image")?,
        Panel { caption: "(b) true lines".into(), canvas: probability_canvas(&truth, Size::Full) },
        picture_of(added, "(c) added to training")?,
    ];
    for (index, words) in ["(d) as shipped", "(e) without (c)", "(f) with (c)"].into_iter().enumerate() {
        let path = folder.join(map_name(index));
        let map = read_micrograph(&path.to_string_lossy()).into_diagnostic()?.pixels / 255.0;
        panels.push(Panel { caption: words.into(), canvas: probability_canvas(&map, Size::Full) });
    }
    let canvas = sheet::sheet(&panels, 3);
    let steps = record.states.iter().map(|state| state.steps).max().unwrap_or(0);
    let minutes: Vec<String> =
        record.states.iter().skip(1).map(|state| format!("{:.1}", state.seconds / 60.0)).collect();
    let caption = format!(
        "(a) An image of low contrast and (b) its true lines (grey: hidden in noise). (d) Line probability as the detector is shipped; (e) after {steps} more \
         steps of its usual training, (f) after as many with (c), one labelled pair of low contrast of another foil, in place of half of the usual examples ({} minutes of wall \
         time). (e) tells what the steps do from what the image does, which the paper's figure does not. {} Scores are \
         those of pixels, found from the probability on from which tracing takes them for line ({}), over {} images of low contrast that are not trained on, and over the left images of `{}`. Record: `records/{LOW_CONTRAST}` (version {}; {}).",
        minutes.join(" and "),
        low_contrast::verdict(&record),
        work.config.settings.trace.low,
        looked_at.len(),
        record.others,
        record.version,
        detector_of(&shipped.weights_sha256)?
    );
    let body = format!(
        "{}\n{}",
        picture("figure-12", "The detector before and after one image of low contrast"),
        low_contrast::table(&record)
    );
    let files = vec![("figure-12.png".into(), sheet::png(&canvas).into_diagnostic()?)];
    Ok(Made { section: Section { heading, caption, body }, files })
}

//! Figure 12: what one image of low contrast in the training data does for the detector. The foils, the score, the record and the table.

use std::fmt::Write;

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use super::losses::CurvePoint;
use super::pool::{pooled, with_interval};
use crate::dataset::{Item, Manifest};
use crate::simulate::geometry::{Range, Split};
use crate::simulate::{Family, SimulateSettings};
use crate::trace::TraceSettings;

/// Seed of the foils.
const SEED: u64 = 12;
/// Foils that are looked at; one more is trained on.
const LOOKED_AT: u32 = 6;

/// States of the detector, with their words.
pub const STATES: [&str; 3] = ["as shipped", "trained further without the image", "trained further with the image"];

/// Foils of low contrast, `size_px` a side: one to train on, the others (of another split) to look at.
pub fn foils(size_px: usize) -> Manifest {
    let mut settings =
        SimulateSettings { size_px, tilts_deg: vec![-4.0, 4.0], ..SimulateSettings::of_family(Family::Tial) };
    // One series' look, as in the paper: weak lines in noise, and little else that could be taken for one.
    let look = &mut settings.look;
    look.line_contrast = [0.08, 0.16];
    for mean in
        [&mut look.boundary_families, &mut look.lamellae, &mut look.hair, &mut look.slip_traces, &mut look.bright]
    {
        *mean = 0.0;
    }
    settings.acquisition.dose = [500.0, 1000.0];
    settings.foil.field_lengths = Range::new(8.0, 16.0);
    settings.foil.density_per_m2 = Range::exactly(1e14);
    settings.foil.variety = 0.0;
    let mut manifest = Manifest { name: Some("low-contrast".into()), seed: Some(SEED), ..Manifest::empty() };
    manifest.program = Some(env!("CARGO_PKG_VERSION").into());
    manifest.settings.insert("low-contrast".into(), settings);
    for foil in 0..=LOOKED_AT {
        let split = if foil == 0 { Split::Train } else { Split::TestA };
        let name = format!("{}-{foil:02}", split.word());
        manifest.items.push(Item::planned(name, split, "low-contrast", foil, [0, 1]));
    }
    manifest
}

/// How well line pixels are found in one image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PixelScore {
    /// Name of the image's item.
    pub item: String,
    /// Pixels found that are line.
    pub right: usize,
    /// Pixels found.
    pub found: usize,
    /// Line pixels.
    pub lines: usize,
}

impl PixelScore {
    /// The score of line probabilities `[row, column]`; `mask` is 255 on visible lines, 0 off all lines, and between where lines do
    /// not stand out, which is not asked for.
    ///
    /// A pixel is found from the probability on from which tracing takes it for part of a line.
    pub fn of(item: &str, probability: &Array2<f32>, mask: &Array2<u8>) -> Self {
        let least = TraceSettings::default().low;
        let mut score = Self { item: item.into(), right: 0, found: 0, lines: 0 };
        for (probability, line) in probability.iter().zip(mask).filter(|(_, line)| matches!(line, 0 | 255)) {
            let (found, line) = (*probability >= least, *line == 255);
            score.found += usize::from(found);
            score.lines += usize::from(line);
            score.right += usize::from(found && line);
        }
        score
    }
}

/// The detector in one state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// One of [`STATES`].
    pub name: String,
    /// SHA-256 of its weights.
    pub weights_sha256: String,
    /// Settings of the training, TOML; none as shipped.
    pub settings: Option<String>,
    /// Steps of the training.
    pub steps: u64,
    /// How long they took, s.
    pub seconds: f64,
    /// Its curve.
    pub curve: Vec<CurvePoint>,
    /// Scores on images of low contrast.
    pub low_contrast: Vec<PixelScore>,
    /// Scores on the left images of a set of all kinds.
    pub others: Vec<PixelScore>,
}

/// The record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Version of the program.
    pub version: String,
    /// SHA-256 of the foils of low contrast.
    pub data_sha256: String,
    /// Name of the set of all kinds.
    pub others: String,
    /// The states, in the order of [`STATES`].
    pub states: Vec<State>,
}

/// The table of a record.
pub fn table(record: &Record) -> String {
    let mut text = String::from("| detector | images | precision | recall | F1, pixels |\n|---|---|---|---|---|\n");
    for low in [true, false] {
        let kind = if low { "low contrast" } else { &record.others };
        for state in &record.states {
            let scores = if low { &state.low_contrast } else { &state.others };
            let parts = |value: fn(&PixelScore) -> (usize, usize)| -> Vec<(f64, f64)> {
                scores.iter().map(|score| (value(score).0 as f64, value(score).1 as f64)).collect()
            };
            let precision = pooled(&parts(|score| (score.right, score.found)));
            let recall = pooled(&parts(|score| (score.right, score.lines)));
            let f1 = pooled(&parts(|score| (2 * score.right, score.found + score.lines)));
            let [precision, recall, f1] = [precision, recall, f1].map(|figure| with_interval(figure, 3));
            let _ = writeln!(text, "| {} | {kind} ({}) | {precision} | {recall} | {f1} |", state.name, scores.len());
        }
    }
    text
}

/// What the image does beyond the steps that it is trained in, in a sentence.
pub fn verdict(record: &Record) -> String {
    let [shipped, without, with] = &record.states[..] else { return String::new() };
    let f1 = |scores: &[PixelScore]| {
        let sum = |value: fn(&PixelScore) -> usize| scores.iter().map(value).sum::<usize>() as f64;
        2.0 * sum(|score| score.right) / (sum(|score| score.found) + sum(|score| score.lines)).max(1.0)
    };
    let [shipped, without, with] = [shipped, without, with].map(|state| f1(&state.low_contrast));
    let word = if with > without { "higher" } else { "not higher, so this does not show that the image adds" };
    format!(
        "On images of low contrast F1 is {shipped:.3} as shipped, {without:.3} without the image and {with:.3} with it, which has half of the usual examples: \
         {word}; one seed and so few images tell no small difference."
    )
}

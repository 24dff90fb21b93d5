//! Figures 10 and 11, Table 3: what images are trained on and scored on, and how noisy they are.

use std::collections::BTreeMap;
use std::fmt::Write;

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use super::FiguresError;
use super::chart::{Histogram, histograms};
use super::pool::{pooled, with_interval};
use crate::dataset::{Item, Manifest, line_mask};
use crate::score::{ImageStatistics, image_statistics};
use crate::simulate::geometry::Split;
use crate::simulate::{Family, Mode, SimulateSettings};
use crate::truth::{TrueView, Truth};

/// Foils of each family in the sample of the training data; the first is diffracted, the others are drawn.
const TRAINING_FOILS: u32 = 12;
/// Seed of the sample.
const TRAINING_SEED: u64 = 7;
/// The paper's Table 3: signal-to-noise ratio of dislocations and of background in dB, contrast in grey levels.
const PAPER: [(Family, [f64; 3]); 3] = [
    (Family::Gan, [30.16, 44.68, 42.64]),
    (Family::Tial, [34.24, 25.32, 35.78]),
    (Family::Cantor, [25.70, 16.42, 26.91]),
];

/// Statistics of one image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of its item.
    pub item: String,
    /// Its family.
    pub family: String,
    /// What was measured on the lines that are visible in it.
    pub statistics: ImageStatistics,
}

/// Measures an image on the visible lines of its truth.
///
/// # Errors
/// Where image and truth differ in size.
pub fn measure(item: &str, image: &Array2<f32>, truth: &Truth, view: &TrueView) -> Result<Row, FiguresError> {
    let mask = line_mask(truth, view).mapv(|value| value == u8::MAX);
    let family = truth.family.clone().unwrap_or_default();
    Ok(Row { item: item.into(), family, statistics: image_statistics(image, &mask)? })
}

/// A sample of what networks are trained on: foils of the training split, every family equally often, views 8 degrees apart, `size_px`
/// a side.
pub fn training_sample(size_px: usize) -> Manifest {
    let mut manifest =
        Manifest { name: Some("training-sample".into()), seed: Some(TRAINING_SEED), ..Manifest::empty() };
    manifest.program = Some(env!("CARGO_PKG_VERSION").into());
    let mut foil = 0;
    for family in Family::ALL {
        for number in 0..TRAINING_FOILS {
            let mode = if number == 0 { Mode::Physics } else { Mode::Parametric };
            let key = format!("{}-{}", family.word(), mode.word());
            let settings =
                SimulateSettings { mode, size_px, tilts_deg: vec![-4.0, 4.0], ..SimulateSettings::of_family(family) };
            manifest.items.push(Item::planned(format!("{key}-{number:02}"), Split::Train, &key, foil, [0, 1]));
            manifest.settings.insert(key, settings);
            foil += 1;
        }
    }
    manifest
}

/// The items of [`training_sample`] that Figure 10 shows: of each family the first that is drawn, and the one that is diffracted.
pub fn shown(manifest: &Manifest) -> Vec<&Item> {
    let ends = |item: &&Item| item.name.ends_with("-01") || item.name.ends_with("-00");
    let mut items: Vec<&Item> = manifest.items.iter().filter(ends).collect();
    items.sort_by_key(|item| item.name.ends_with("-00"));
    items
}

fn families(rows: &[Row]) -> BTreeMap<&str, Vec<&Row>> {
    let mut families: BTreeMap<&str, Vec<&Row>> = BTreeMap::new();
    for row in rows {
        families.entry(&row.family).or_default().push(row);
    }
    families
}

type Figure = fn(&ImageStatistics) -> Option<f64>;
const FIGURES: [Figure; 3] = [
    |statistics| statistics.snr_lines_db,
    |statistics| statistics.snr_background_db,
    |statistics| statistics.contrast_grey,
];

/// Table 3: means over the images of each family, the paper's figures in square brackets.
pub fn table(rows: &[Row]) -> String {
    let mut text =
        "| family | images | SNR, lines, dB | SNR, background, dB | contrast, grey levels of 255 |\n|---|---|---|---|---|\n"
            .to_owned();
    let of_family = families(rows);
    for family in Family::ALL {
        let Some(of_family) = of_family.get(family.word()) else { continue };
        let paper = PAPER.iter().find(|paper| paper.0 == family).map(|paper| paper.1);
        let _ = write!(text, "| {} | {} |", family.word(), of_family.len());
        for (index, figure) in FIGURES.into_iter().enumerate() {
            let parts: Vec<(f64, f64)> =
                of_family.iter().filter_map(|row| Some((figure(&row.statistics)?, 1.0))).collect();
            let _ = write!(text, " {}", with_interval(pooled(&parts), 1));
            if let Some(paper) = paper {
                let _ = write!(text, " [{:.1}]", paper[index]);
            }
            text += " |";
        }
        text += "\n";
    }
    text
}

/// Figure 11: how the training images are distributed over the same three figures.
pub fn draw(rows: &[Row]) -> String {
    const COLOURS: [&str; 4] = ["#0072b2", "#e69f00", "#009e73", "#999999"];
    let of_family = families(rows);
    let panel = |heading: &str, x_title: &str, figure: Figure| Histogram {
        heading: heading.to_owned(),
        x_title: x_title.to_owned(),
        groups: of_family
            .iter()
            .enumerate()
            .map(|(index, (family, rows))| {
                let values = rows.iter().filter_map(|row| figure(&row.statistics)).collect();
                ((*family).to_owned(), COLOURS[index % COLOURS.len()], values)
            })
            .collect(),
    };
    let panels = [
        panel("Lines", "signal-to-noise ratio (dB)", FIGURES[0]),
        panel("Background", "signal-to-noise ratio (dB)", FIGURES[1]),
        panel("Contrast", "grey levels of 255", FIGURES[2]),
    ];
    histograms("Signal-to-noise ratio and contrast of training images", "images", &panels)
}

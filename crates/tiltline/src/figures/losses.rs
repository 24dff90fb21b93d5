//! Table 2: what the terms of the loss are worth. The record of five trainings that differ in nothing else, and its table.

use std::fmt::Write;

use serde::{Deserialize, Serialize};

use super::pool::{pooled, with_interval};
use crate::simulate::Family;

/// The combinations in the order of the paper, and the weights of its three terms (disparity, warp, variance).
pub const COMBINATIONS: [(&str, [f64; 3]); 5] = [
    ("Disp+Warp+Var", [1.0, 1.0, 0.1]),
    ("Disp+Var", [1.0, 0.0, 0.1]),
    ("Disp+Warp", [1.0, 1.0, 0.0]),
    ("Disp", [1.0, 0.0, 0.0]),
    ("Warp", [0.0, 1.0, 0.0]),
];

/// The paper's Table 2: bad-1, -3, -5 in percent and EPE in px, in the order of [`COMBINATIONS`].
const PAPER: [(Family, [[f64; 4]; 5]); 3] = [
    (
        Family::Gan,
        [
            [40.1, 8.3, 3.5, 1.112],
            [40.3, 8.5, 3.5, 1.120],
            [41.0, 8.6, 3.8, 1.238],
            [52.1, 9.4, 4.4, 1.852],
            [81.6, 55.3, 30.2, 5.034],
        ],
    ),
    (
        Family::Tial,
        [
            [41.0, 9.6, 4.1, 1.411],
            [40.7, 9.7, 4.2, 1.418],
            [41.6, 9.7, 4.2, 1.415],
            [54.9, 14.2, 5.8, 1.755],
            [84.8, 57.9, 38.3, 5.879],
        ],
    ),
    (
        Family::Cantor,
        [
            [38.2, 8.0, 3.1, 0.982],
            [40.5, 8.4, 3.3, 1.101],
            [41.3, 8.7, 3.6, 1.322],
            [49.8, 9.0, 4.3, 1.523],
            [80.4, 52.4, 28.5, 5.011],
        ],
    ),
];

/// Errors of a dense matcher at the true line pixels of one pair.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DenseScore {
    /// Name of the pair.
    pub item: String,
    /// Its family.
    pub family: String,
    /// True line pixels.
    pub pixels: usize,
    /// Sum of the absolute errors of disparity, px.
    pub sum_px: f64,
    /// How many are off by more than 1, 3 and 5 px.
    pub bad: [usize; 3],
}

impl DenseScore {
    /// The score of disparities that were found, px, where the truth (NaN off the lines) is known.
    pub fn of(item: &str, family: &str, found: &[f32], truth: &[f32]) -> Self {
        let known = found.iter().zip(truth).filter(|(_, truth)| truth.is_finite());
        let errors: Vec<f64> = known.map(|(found, truth)| f64::from((found - truth).abs())).collect();
        let bad = [1.0, 3.0, 5.0].map(|limit| errors.iter().filter(|error| **error > limit).count());
        Self { item: item.into(), family: family.into(), pixels: errors.len(), sum_px: errors.iter().sum(), bad }
    }
}

/// A point of a training's curve.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Steps done.
    pub step: u64,
    /// Mean loss since the last point.
    pub loss: f64,
    /// End-point error of the training crops, px, where they are labelled.
    pub epe_px: Option<f64>,
}

/// One training and what came of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Training {
    /// The terms, as in [`COMBINATIONS`].
    pub terms: String,
    /// All settings, TOML.
    pub settings: String,
    /// Steps.
    pub steps: u64,
    /// How long they took on the machine that it was done on, s.
    pub seconds: f64,
    /// SHA-256 of the weights that came out.
    pub weights_sha256: String,
    /// Its curve.
    pub curve: Vec<CurvePoint>,
    /// Scores of the weights, a pair each.
    pub scores: Vec<DenseScore>,
}

/// The record of all trainings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Version of the program.
    pub version: String,
    /// SHA-256 of the detector that all of them see through.
    pub detector_sha256: String,
    /// Name of the set they are scored on.
    pub set: String,
    /// Its SHA-256.
    pub data_sha256: String,
    /// The trainings, in the order of [`COMBINATIONS`].
    pub trainings: Vec<Training>,
    /// The matcher that is part of the program, scored alike.
    pub shipped: Vec<DenseScore>,
}

/// The table, the paper's figures in square brackets.
pub fn table(record: &Record) -> String {
    let mut text = String::from("| loss | bad-1, % | bad-3, % | bad-5, % | EPE, px |\n|---|---|---|---|---|\n");
    for (family, paper) in PAPER {
        let _ = writeln!(text, "| **{}** | | | | |", family.word());
        for (index, training) in record.trainings.iter().enumerate() {
            line(&mut text, &training.terms, &training.scores, family, paper.get(index));
        }
        line(&mut text, "the shipped matcher", &record.shipped, family, None);
    }
    text
}

fn line(text: &mut String, name: &str, scores: &[DenseScore], family: Family, paper: Option<&[f64; 4]>) {
    let parts = |value: &dyn Fn(&DenseScore) -> f64| -> Vec<(f64, f64)> {
        let of_family = scores.iter().filter(|score| score.family == family.word());
        of_family.map(|score| (value(score), score.pixels as f64)).collect()
    };
    let _ = write!(text, "| {name} |");
    for column in 0..4 {
        let (estimate, decimals) = match column {
            3 => (pooled(&parts(&|score| score.sum_px)), 2),
            _ => (pooled(&parts(&|score| 100.0 * score.bad[column] as f64)), 1),
        };
        let _ = write!(text, " {}", with_interval(estimate, decimals));
        if let Some(paper) = paper {
            let _ = write!(text, " [{:.decimals$}]", paper[column]);
        }
        text.push_str(" |");
    }
    text.push('\n');
}

/// End-point error and time of the trainings, in a sentence.
pub fn budget(record: &Record) -> String {
    let Some(first) = record.trainings.first() else { return String::new() };
    let minutes: Vec<String> =
        record.trainings.iter().map(|training| format!("{:.1}", training.seconds / 60.0)).collect();
    let ends: Vec<String> = record
        .trainings
        .iter()
        .map(|training| {
            let last = training.curve.iter().rev().find_map(|point| point.epe_px);
            format!("{} {}", training.terms, last.map_or("-".into(), |epe| format!("{epe:.2}")))
        })
        .collect();
    format!(
        "{} steps each, from the same random weights and the same batches ({} minutes of wall time). EPE of the last \
         training crops, px: {}.",
        first.steps,
        minutes.join(", "),
        ends.join(", ")
    )
}

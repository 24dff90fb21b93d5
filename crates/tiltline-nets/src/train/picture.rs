//! `validation.png`: what the networks make of a few validation crops, a row each, to be looked at while they learn.
//!
//! Detector: image, true lines (grey: not known), line probability. Matcher: image, true disparity, found disparity where the
//! truth is known, from black (the lowest of the row) to white.

use std::path::Path;

use burn::tensor::Device;
use ndarray::{Array2, s};
use tiltline::export::png::write_grey;

use super::{TrainError, TrainSettings, images};
use crate::data::Batch;
use crate::networks::Networks;
use crate::score::{found_disparity, probability};
use crate::weights::write_atomically;

/// Crops that are shown.
const ROWS: usize = 6;
/// Grey of what is not known.
const UNKNOWN: f32 = 0.5;

/// Draws the picture of some networks for inference.
pub fn write(
    path: &Path,
    networks: &Networks,
    batches: &[Batch],
    settings: &TrainSettings,
    device: &Device,
) -> Result<(), TrainError> {
    let rows: Vec<[Vec<f32>; 3]> = batches
        .iter()
        .take(ROWS)
        .map(|batch| {
            // Flattened images are within some 3 deviations of their surroundings.
            let image = batch.left.iter().map(|value| value / 6.0 + 0.5).collect();
            let [truth, found] = match &networks.matcher {
                None => {
                    let lines = batch.left_lines.iter().map(|line| if line.is_nan() { UNKNOWN } else { *line });
                    let logits = networks.detector.forward(images(&batch.left, batch, device)).logits;
                    [lines.collect(), probability(logits)]
                }
                Some(matcher) => disparities(batch, &found_disparity(networks, matcher, batch, settings, device)),
            };
            [image, truth, found]
        })
        .collect();
    let Some(side) = batches.first().map(|batch| batch.side) else { return Ok(()) };
    let mut sheet = Array2::<u8>::zeros((rows.len() * side, 3 * side));
    for (row, maps) in rows.iter().enumerate() {
        for (column, map) in maps.iter().enumerate() {
            let grey = map.iter().take(side * side).map(|value| (255.0 * value.clamp(0.0, 1.0)) as u8).collect();
            let grey = Array2::from_shape_vec((side, side), grey).expect("crops are square");
            sheet.slice_mut(s![row * side..(row + 1) * side, column * side..(column + 1) * side]).assign(&grey);
        }
    }
    let mut bytes = Vec::new();
    let io = |source| TrainError::Io { path: path.into(), source };
    write_grey(&sheet, &mut bytes).map_err(io)?;
    write_atomically(path, &bytes).map_err(io)
}

/// True and found disparities on one grey scale, [`UNKNOWN`] where there is no truth.
fn disparities(batch: &Batch, found: &[f32]) -> [Vec<f32>; 2] {
    let known = || batch.disparity.iter().filter(|d| !d.is_nan());
    let low = known().copied().fold(f32::INFINITY, f32::min) - 1.0;
    let span = known().copied().fold(f32::NEG_INFINITY, f32::max) + 1.0 - low;
    let grey = |value: f32, truth: f32| if truth.is_nan() { UNKNOWN } else { (value - low) / span };
    let pairs = || batch.disparity.iter().zip(found);
    [
        pairs().map(|(truth, _)| grey(*truth, *truth)).collect(),
        pairs().map(|(truth, found)| grey(*found, *truth)).collect(),
    ]
}

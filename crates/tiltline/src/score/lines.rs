//! Detected lines of the left image against the true ones: clDice.
//!
//! clDice (Shit et al., CVPR 2021, "clDice - a novel topology-preserving loss function for tubular structure
//! segmentation", eq. 1 and 2): topology precision is the share of the predicted skeleton inside the true mask, topology
//! sensitivity the share of the true skeleton inside the predicted mask; clDice is their harmonic mean. From curves, the
//! skeletons are the centrelines and the masks all within half a line width of them, so that no pixel grid is in it. From masks,
//! the skeleton is made by the function that is given.

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use crate::geometry::Point2;
use crate::score::sampling::{Chords, Piece, pieces};
use crate::score::{ResultCurves, ScoreError};
use crate::truth::TruthPair;

/// Line detection in the left image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LineScore {
    /// Whether lines without a match in the right image were known and are in it.
    pub with_unmatched: bool,
    /// Length of visible true line, px.
    pub truth_length_px: f64,
    /// Length of detected line, px.
    pub detected_length_px: f64,
    /// Share of detected line on a true one; none where nothing was detected.
    pub precision: Option<f64>,
    /// Share of visible true line under a detected one.
    pub sensitivity: f64,
    /// Harmonic mean of both.
    pub cl_dice: f64,
}

/// clDice of two masks `[row, column]`; `skeleton` thins a mask to lines one pixel wide.
///
/// Two empty masks agree (1); one empty mask gives 0.
///
/// # Errors
/// Masks of different sizes.
pub fn cl_dice(
    predicted: &Array2<bool>,
    truth: &Array2<bool>,
    skeleton: impl Fn(&Array2<bool>) -> Array2<bool>,
) -> Result<f64, ScoreError> {
    if predicted.dim() != truth.dim() {
        return Err(ScoreError::MaskSize { image: truth.dim().into(), mask: predicted.dim().into() });
    }
    let share = |of: &Array2<bool>, inside: &Array2<bool>| {
        let (mut all, mut hits) = (0usize, 0usize);
        for (line, mask) in of.iter().zip(inside).filter(|(line, _)| **line) {
            (all, hits) = (all + usize::from(*line), hits + usize::from(*mask));
        }
        (all > 0).then(|| hits as f64 / all as f64)
    };
    let precision = share(&skeleton(predicted), truth);
    let sensitivity = share(&skeleton(truth), predicted);
    Ok(match (precision, sensitivity) {
        (None, None) => 1.0,
        (precision, sensitivity) => super::end_to_end::f_score(sensitivity.unwrap_or(0.0), precision),
    })
}

/// clDice of the detected lines of the left image, masks being `mask_width_px` wide. A detection on a true line that is not
/// visible is right, but such lines are not asked for.
pub(crate) fn line_score(result: &ResultCurves, pair: &TruthPair<'_>, mask_width_px: f64) -> LineScore {
    let mut detected: Vec<(Vec<Point2>, bool)> =
        result.curves.iter().map(|curve| (curve.left(), curve.closed)).collect();
    detected.extend(result.unmatched_left.iter().flatten().map(|line| (line.clone(), false)));
    let is_closed = |label: &str| pair.truth.curve(label).is_some_and(|curve| curve.closed);
    let truth: Vec<(Vec<Point2>, bool)> =
        pair.left.curves.iter().map(|curve| (curve.contrast.clone(), is_closed(&curve.label))).collect();
    let cut = |curves: &[(Vec<Point2>, bool)]| -> Vec<Vec<Piece>> {
        curves.iter().map(|(points, closed)| pieces(points, *closed)).collect()
    };
    let (detected_cut, truth_cut) = (cut(&detected), cut(&truth));
    let chords = |curves: &[(Vec<Point2>, bool)], cut: &[Vec<Piece>]| {
        Chords::new(curves.iter().zip(cut).map(|((points, closed), cut)| (points.as_slice(), *closed, cut.as_slice())))
    };
    let (detected_chords, truth_chords) = (chords(&detected, &detected_cut), chords(&truth, &truth_cut));
    // A distance of exactly the radius, but for rounding, is on the line.
    let radius = 0.5 * mask_width_px + 1e-9;
    let far = 2.0 * radius;
    let (mut detected_length, mut right) = (0.0, 0.0);
    for ((points, _), cut) in detected.iter().zip(&detected_cut) {
        for piece in cut {
            detected_length += piece.length;
            if truth_chords.capped_distance(&piece.middle.point(points), far) <= radius {
                right += piece.length;
            }
        }
    }
    let (mut truth_length, mut found) = (0.0, 0.0);
    for (curve, cut) in pair.left.curves.iter().zip(&truth_cut) {
        let points = &curve.contrast;
        let seen = |index: usize| curve.is_visible(index) && pair.left.contains(&points[index]);
        for piece in cut.iter().filter(|piece| piece.middle.holds(seen, points.len())) {
            truth_length += piece.length;
            if detected_chords.capped_distance(&piece.middle.point(points), far) <= radius {
                found += piece.length;
            }
        }
    }
    let precision = (detected_length > 0.0).then(|| right / detected_length);
    let sensitivity = if truth_length > 0.0 { found / truth_length } else { 0.0 };
    LineScore {
        with_unmatched: result.unmatched_left.is_some(),
        truth_length_px: truth_length,
        detected_length_px: detected_length,
        precision,
        sensitivity,
        cl_dice: super::end_to_end::f_score(sensitivity, precision),
    }
}

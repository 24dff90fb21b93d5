//! The paper's protocol: for true line pixels of the left image, where does the result put them in the right image?
//! (paper, section "Ablation Study": end-point error and the percentage of line pixels beyond 1, 3 and 5 px.)
//!
//! The truth is the centre of contrast, cut into pieces of equal length, visible and inside in both views. A prediction is
//! the true left point moved by the displacement (right minus left, in input px) of the result's curve beside it, so that
//! no offset is free: what rectification gets wrong counts. A pixel without a prediction is bad; missed lines therefore show
//! in bad-n and in the coverage, and the end-point error is over predicted pixels only. Invented lines cost nothing here:
//! that is the other protocol's work ([`crate::score::end_to_end`]).

use serde::{Deserialize, Serialize};

use crate::curve::Flag;
use crate::geometry::{Point2, Vector2};
use crate::score::ResultCurves;
use crate::score::sampling::{Chords, Piece, pieces, sine_between};
use crate::truth::TruthPair;

/// At a crossing, the line that runs the same way is taken: a line at right angles counts as this much further away, in px.
const CROSSING_PENALTY_PX: f64 = 2.0;

/// Scores of the paper's protocol; lengths and errors in input px.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PaperScore {
    /// Length of true left line that is asked for.
    pub truth_length_px: f64,
    /// Share of it with a prediction, 0 to 1.
    pub coverage: f64,
    /// End-point error: mean distance of predicted and true right point, where there is a prediction.
    pub epe_px: Option<f64>,
    /// Percentage of true line with an error above 1 px, or without a prediction.
    pub bad_1_percent: f64,
    /// The same for 3 px.
    pub bad_3_percent: f64,
    /// The same for 5 px.
    pub bad_5_percent: f64,
    /// End-point error as depth, `epe / (2 sin(phi / 2))`; none where the tilts are unknown.
    pub depth_error_px: Option<f64>,
}

/// What a result says about one true left point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    /// Right point in input px.
    pub right: Point2,
    /// One sigma of its disparity in px, where the result has one.
    pub sigma_px: Option<f64>,
    /// How far the result trusts it.
    pub flag: Flag,
}

/// A piece of true line and how far the prediction is off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Length of the piece in px.
    pub length_px: f64,
    /// The error, where there is a prediction.
    pub error: Option<ResidualError>,
}

/// How far a prediction is off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualError {
    /// Distance to the true right point, px.
    pub distance_px: f64,
    /// Its part along the epipolar row, signed: the error of disparity.
    pub along_row_px: f64,
    /// What the result expected of itself.
    pub sigma_px: Option<f64>,
    /// Its flag.
    pub flag: Flag,
}

/// Residuals of any predictor: `predict` is given a true left point (input px) and the direction of its line. A dense
/// matcher is scored with `right = left + disparity` looked up at the point.
pub fn residuals(pair: &TruthPair<'_>, predict: impl Fn(&Point2, &Vector2) -> Option<Prediction>) -> Vec<Residual> {
    let row = pair.right_row_direction();
    let mut residuals = Vec::new();
    for paired in pair.curves() {
        let points = &paired.left;
        for piece in pieces(points, paired.curve.closed) {
            let place = piece.middle;
            if !place.holds(|index| paired.counts[index], points.len()) {
                continue;
            }
            let right_at = |index: usize| paired.right[index].unwrap_or(Point2::new(f64::NAN, f64::NAN));
            let true_right = Point2::new(
                place.interpolate(|index| right_at(index).x, points.len()),
                place.interpolate(|index| right_at(index).y, points.len()),
            );
            let direction = piece.end.point(points) - piece.start.point(points);
            let error = predict(&place.point(points), &direction).map(|prediction| {
                let off = prediction.right - true_right;
                let (sigma_px, flag) = (prediction.sigma_px, prediction.flag);
                ResidualError { distance_px: off.norm(), along_row_px: off.dot(&row), sigma_px, flag }
            });
            residuals.push(Residual { length_px: piece.length, error });
        }
    }
    residuals
}

/// Scores of residuals.
pub fn paper_score(pair: &TruthPair<'_>, residuals: &[Residual]) -> PaperScore {
    let sum =
        |value: &dyn Fn(&Residual) -> f64| residuals.iter().map(|piece| piece.length_px * value(piece)).sum::<f64>();
    let truth_length_px = sum(&|_| 1.0);
    if truth_length_px == 0.0 {
        return PaperScore::default();
    }
    let predicted = sum(&|piece| f64::from(u8::from(piece.error.is_some())));
    let bad = |limit: f64| 100.0 * sum(&|piece| f64::from(u8::from(piece.is_bad(limit)))) / truth_length_px;
    let total_error = sum(&|piece| piece.error.map_or(0.0, |error| error.distance_px));
    let epe_px = (predicted > 0.0).then(|| total_error / predicted);
    let gain = pair.tilts.map(|tilts| tilts.depth_gain().abs());
    PaperScore {
        truth_length_px,
        coverage: predicted / truth_length_px,
        epe_px,
        bad_1_percent: bad(1.0),
        bad_3_percent: bad(3.0),
        bad_5_percent: bad(5.0),
        depth_error_px: epe_px.zip(gain).map(|(epe, gain)| epe * gain),
    }
}

impl Residual {
    /// Whether the error is above a limit or there is no prediction. An error of exactly the limit, but for rounding, is not.
    pub fn is_bad(&self, limit_px: f64) -> bool {
        self.error.is_none_or(|error| error.distance_px > limit_px + 1e-9)
    }
}

/// Predicts right points from the curves of a result.
pub struct CurvePredictor<'a> {
    result: &'a ResultCurves,
    pieces: Vec<Piece>,
    chords: Chords,
    reach_px: f64,
}

impl<'a> CurvePredictor<'a> {
    /// A result's curve speaks for true points up to `reach_px` beside it.
    pub fn new(result: &'a ResultCurves, reach_px: f64) -> Self {
        let left: Vec<Vec<Point2>> = result.curves.iter().map(|curve| curve.left()).collect();
        let cut: Vec<Vec<Piece>> =
            result.curves.iter().zip(&left).map(|(curve, points)| pieces(points, curve.closed)).collect();
        let curves = result.curves.iter().zip(&left).zip(&cut);
        let chords =
            Chords::new(curves.map(|((curve, points), cut)| (points.as_slice(), curve.closed, cut.as_slice())));
        Self { result, pieces: cut.into_iter().flatten().collect(), chords, reach_px }
    }

    /// The prediction for a true left point whose line runs along `direction`.
    pub fn predict(&self, left: &Point2, direction: &Vector2) -> Option<Prediction> {
        let mut feet = Vec::new();
        self.chords.feet(left, self.reach_px, &mut feet);
        let cost = |foot: &crate::score::sampling::Foot| {
            let [start, end] = self.chords.ends[foot.piece];
            foot.distance + CROSSING_PENALTY_PX * sine_between(&(end - start), direction)
        };
        let foot = feet.iter().min_by(|a, b| cost(a).total_cmp(&cost(b)))?;
        let points = &self.result.curves[self.chords.curve[foot.piece]].points;
        let piece = &self.pieces[foot.piece];
        // A piece may hold a vertex; between its ends everything is taken as straight.
        let between = |value: &dyn Fn(usize) -> f64| {
            let (a, b) = (piece.start.interpolate(value, points.len()), piece.end.interpolate(value, points.len()));
            a + (b - a) * foot.fraction
        };
        let dx = between(&|index| points[index].right.x - points[index].left.x);
        let dy = between(&|index| points[index].right.y - points[index].left.y);
        let sigma_px = Some(between(&|index| points[index].sigma_disparity_px));
        let nearest = if piece.middle.fraction < 0.5 { piece.middle.segment } else { piece.middle.segment + 1 };
        Some(Prediction { right: left + Vector2::new(dx, dy), sigma_px, flag: points[nearest % points.len()].flag })
    }
}

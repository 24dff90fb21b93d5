//! Refinement along whole curves, to sub-pixel centrelines in both images. All in rectified px.
//!
//! 1. Each row of a curve is cut with the right centrelines near the disparity found so far; dynamic programming along
//!    the curve keeps to one right line.
//! 2. Disparity is smoothed along arc length with weights 1 / sigma^2 ([`super::smooth`]), which also bridges gaps and
//!    ill-conditioned stretches from their neighbours; points far off are weighted down (Huber).
//! 3. Sigma is the posterior one, calibrated ([`CALIBRATION`]). Errors of tracing are alike over a few px, so that they average more slowly than
//!    independent ones; the error of the row is taken as constant along the curve and passed through the same smoothing.

use rayon::prelude::*;

use super::sigma_of_left;
use super::smooth::{Sample, Smoothed, smooth};
use crate::curve::{Flag, MatchedCurve, MatchedPoint, Trace};
use crate::geometry::{Vector2, angle_to_row};
use crate::matching::candidates::{Candidate, line_angle};
use crate::matching::crossings::RowIndex;
use crate::matching::path::{Step, cheapest_path};
use crate::matching::sigma::{ill_conditioned, sigma_along_row_px};

/// Length over which errors of tracing are alike, px: the reach of the profile across a line that is about 3 px wide.
const CORRELATION_PX: f64 = 4.0;
/// The same for disparities that were not measured on a right centreline: the height of the window they come from.
const WINDOW_PX: f64 = 9.0;
/// Roughness of disparity along a curve that is tried, value^2 / px^3 (see `smooth`): decades, from a straight line to one
/// that turns within 10 px.
const ROUGHNESS: [f64; 9] = [1e-7, 1e-6, 1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2];
/// Prior of its logarithm (base 10): mean and sigma.
const ROUGHNESS_PRIOR: [f64; 2] = [-4.5, 1.0];
/// Prior one-sigma slope of disparity at an end or a kink.
const SLOPE_SIGMA: f64 = 0.3;
/// Residuals beyond this many sigma are weighted down.
const HUBER: f64 = 2.5;
/// What the posterior sigma is multiplied with. The model knows errors of tracing, alike over [`CORRELATION_PX`], and of the row; on
/// foils the centre of contrast also wanders from view to view, over longer stretches. Chosen on `val-8deg` with the classical methods:
/// two thirds of the true line within one sigma. Errors have heavier tails than normal ones (wrong matches), so that fewer than 95
/// percent lie within two.
pub(crate) const CALIBRATION: f64 = 1.75;
/// Rounds of weighting.
const ROUNDS: usize = 3;
/// A line that turns by more than this within [`KINK_REACH`] points on either side has a kink.
const KINK_RAD: f64 = 0.7;
const KINK_REACH: usize = 3;
/// Cost per px at the largest distance from the disparity found before, and where tangents disagree by a right angle.
const DISTANCE_COST: f64 = 0.5;
const TANGENT_COST: f64 = 0.4;

/// Refines all curves against the right traces; `left` gives the error of the left lines.
pub(super) fn along_curves(
    matched: &[MatchedCurve],
    [left, right]: [&[Trace]; 2],
    sigma_row_px: f64,
    max_distance_px: f64,
) -> Vec<MatchedCurve> {
    let index = RowIndex::new(right);
    matched.par_iter().map(|curve| refine_curve(curve, left, &index, sigma_row_px, max_distance_px)).collect()
}

/// A disparity measured at a point of the curve.
#[derive(Clone, Copy)]
struct Measurement {
    disparity_px: f64,
    /// Variance as if errors were independent from point to point, px^2; without the row error.
    variance: f64,
    /// Change of disparity per px of row error: cot psi with its sign.
    row_gain: f64,
    tangent_right: Option<Vector2>,
}

fn refine_curve(
    curve: &MatchedCurve,
    left: &[Trace],
    right: &RowIndex<'_>,
    sigma_row_px: f64,
    max_distance_px: f64,
) -> MatchedCurve {
    let points = &curve.points;
    let steps_px = step_lengths(points);
    let candidates: Vec<Vec<Candidate>> =
        points.iter().map(|point| near_crossings(point, right, max_distance_px)).collect();
    let steps: Vec<Step<'_>> = candidates
        .iter()
        .zip(points)
        .zip(&steps_px)
        .map(|((candidates, point), &step_px)| Step {
            candidates,
            surcharge: &[],
            step_px,
            ill: ill_conditioned(&point.tangent_left),
        })
        .collect();
    let path = cheapest_path(&steps, right);
    let spacing_px = (steps_px.iter().sum::<f64>() / (points.len() - 1).max(1) as f64).max(0.1);
    let measurements: Vec<Option<Measurement>> = points
        .iter()
        .zip(path)
        .enumerate()
        .map(|(index, (point, chosen))| match chosen {
            Some(chosen) => {
                let sigma_left_px = sigma_of_left(point, left.get(curve.left_trace));
                Some(from_crossing(point, sigma_left_px, &candidates[index][chosen], spacing_px))
            }
            None => from_matcher(point, spacing_px),
        })
        .collect();
    if measurements.iter().flatten().count() < 2 {
        return curve.clone();
    }
    let (disparity_px, sigma_px) = fit(curve, &steps_px, &measurements, spacing_px, sigma_row_px);
    let refined = points.iter().enumerate().map(|(index, point)| {
        let tangent_right = measurements[index].and_then(|measurement| measurement.tangent_right);
        let ill = ill_conditioned(&point.tangent_left) || tangent_right.is_some_and(|right| ill_conditioned(&right));
        MatchedPoint {
            disparity_px: disparity_px[index],
            sigma_px: sigma_px[index],
            tangent_right,
            flag: match measurements[index] {
                None => Flag::Bridged,
                Some(_) if ill => Flag::IllConditioned,
                Some(_) => Flag::Ok,
            },
            ..*point
        }
    });
    MatchedCurve { points: refined.collect(), ..curve.clone() }
}

/// Crossings of the point's row with right lines within reach of where the matcher saw it.
fn near_crossings(point: &MatchedPoint, right: &RowIndex<'_>, max_distance_px: f64) -> Vec<Candidate> {
    let warped = point.right();
    // A distance across the line is longer along the row; not without bound, lest a flat line reach everywhere.
    let reach = max_distance_px / angle_to_row(&point.tangent_left).sin().max(0.3);
    let crossings = right.crossings(warped.y, [warped.x - reach, warped.x + reach]);
    let candidate = |crossing: &crate::matching::crossings::Crossing| {
        let distance = (crossing.x - warped.x) / reach;
        let expected = point.tangent_right.unwrap_or(point.tangent_left);
        let angle = line_angle(&expected, &crossing.tangent) / std::f64::consts::FRAC_PI_2;
        Candidate {
            disparity_px: crossing.x - point.left.x,
            sigma_px: sigma_along_row_px(&crossing.tangent, crossing.sigma_perp_px),
            on: Some((crossing.trace, crossing.arc_px)),
            tangent: Some(crossing.tangent),
            cost: (DISTANCE_COST * distance * distance + TANGENT_COST * angle) as f32,
        }
    };
    crossings.iter().map(candidate).collect()
}

fn from_crossing(point: &MatchedPoint, sigma_left_px: f64, candidate: &Candidate, spacing_px: f64) -> Measurement {
    let left = sigma_along_row_px(&point.tangent_left, sigma_left_px);
    Measurement {
        disparity_px: candidate.disparity_px,
        variance: (candidate.sigma_px.powi(2) + left.powi(2)) * (CORRELATION_PX / spacing_px).max(1.0),
        row_gain: row_gain(&candidate.tangent.unwrap_or(point.tangent_left)),
        tangent_right: candidate.tangent,
    }
}

/// The matcher's own disparity, where the right line was not traced but the matcher did measure.
fn from_matcher(point: &MatchedPoint, spacing_px: f64) -> Option<Measurement> {
    (point.flag == Flag::Ok).then(|| Measurement {
        disparity_px: point.disparity_px,
        variance: point.sigma_px.powi(2) * (WINDOW_PX / spacing_px).max(1.0),
        row_gain: row_gain(&point.tangent_left),
        tangent_right: None,
    })
}

/// Smoothed disparity and its sigma at each point of the curve, px.
fn fit(
    curve: &MatchedCurve,
    steps_px: &[f64],
    measurements: &[Option<Measurement>],
    spacing_px: f64,
    sigma_row_px: f64,
) -> (Vec<f64>, Vec<f64>) {
    let count = measurements.len();
    let kinks = kinks(curve);
    // A closed curve is run on at both ends, so that where it starts does not matter.
    let overlap = if curve.closed { count / 2 } else { 0 };
    let closing_px = (curve.points[0].left - curve.points[count - 1].left).norm();
    let mut arc_px = 0.0;
    let order: Vec<(usize, f64)> = (0..count + 2 * overlap)
        .map(|unrolled| {
            let index = (unrolled + count - overlap) % count;
            arc_px += if unrolled == 0 {
                0.0
            } else if index == 0 {
                closing_px
            } else {
                steps_px[index]
            };
            (index, arc_px)
        })
        .collect();
    let samples = |weights: &[f64], value: &dyn Fn(&Measurement) -> f64| -> Vec<Sample> {
        let sample = |&(index, arc_px): &(usize, f64)| Sample {
            arc_px,
            measured: measurements[index].map(|measurement| {
                // The row error moves neighbours alike; it enters the weights, its effect is added below.
                let row = measurement.row_gain * sigma_row_px;
                (value(&measurement), (measurement.variance + row * row) / weights[index])
            }),
            kink: kinks[index],
        };
        order.iter().map(sample).collect()
    };
    // Neighbours share their error, so that they say less about roughness than as many independent points.
    let independent = (spacing_px / CORRELATION_PX).min(1.0);
    let mut weights = vec![1.0; count];
    let mut roughness = 0.0;
    let mut smoothed = None;
    for _ in 0..ROUNDS {
        let samples = samples(&weights, &|measurement| measurement.disparity_px);
        let plausibility = |roughness: f64, smoothed: &Smoothed| {
            let off = (roughness.log10() - ROUGHNESS_PRIOR[0]) / ROUGHNESS_PRIOR[1];
            independent * smoothed.log_likelihood - 0.5 * off * off
        };
        let best = ROUGHNESS
            .iter()
            .map(|&roughness| (roughness, smooth(&samples, roughness, SLOPE_SIGMA)))
            .max_by(|a, b| plausibility(a.0, &a.1).total_cmp(&plausibility(b.0, &b.1)))
            .expect("there are several levels of roughness");
        for (unrolled, &(index, _)) in order.iter().enumerate() {
            if let Some(measurement) = measurements[index] {
                let sigma = (measurement.variance * independent).sqrt().max(1e-9);
                let residual = (measurement.disparity_px - best.1.values[unrolled]).abs() / sigma;
                weights[index] = (HUBER / residual).min(1.0);
            }
        }
        roughness = best.0;
        smoothed = Some(best.1);
    }
    let smoothed = smoothed.expect("there is at least one round");
    let row = smooth(&samples(&weights, &|measurement| measurement.row_gain), roughness, SLOPE_SIGMA.max(1.0));
    let middle = overlap..overlap + count;
    // `order` starts `overlap` points before the curve's first.
    let disparity_px = smoothed.values[middle.clone()].to_vec();
    let sigma_px =
        middle.map(|at| CALIBRATION * smoothed.variances[at].sqrt().hypot(row.values[at] * sigma_row_px)).collect();
    (disparity_px, sigma_px)
}

/// Whether the left line has a kink just before each point.
fn kinks(curve: &MatchedCurve) -> Vec<bool> {
    let points = &curve.points;
    let turn = |index: usize| -> f64 {
        if index < KINK_REACH || index + KINK_REACH >= points.len() {
            return 0.0;
        }
        let before = points[index].left - points[index - KINK_REACH].left;
        let after = points[index + KINK_REACH].left - points[index].left;
        (before.x * after.y - before.y * after.x).atan2(before.dot(&after)).abs()
    };
    let turns: Vec<f64> = (0..points.len()).map(turn).collect();
    (0..points.len())
        .map(|index| {
            let around = &turns[index.saturating_sub(KINK_REACH)..(index + KINK_REACH + 1).min(turns.len())];
            turns[index] > KINK_RAD && around.iter().all(|turn| *turn <= turns[index])
        })
        .collect()
}

/// Change of disparity per px of row error, `cot psi` with its sign; bounded as psi is in every sigma.
fn row_gain(tangent: &Vector2) -> f64 {
    const MOST: f64 = 60.0;
    if tangent.y.abs() * MOST <= tangent.x.abs() {
        MOST * (tangent.x * tangent.y).signum()
    } else {
        tangent.x / tangent.y
    }
}

/// Arc length from the previous point, px.
fn step_lengths(points: &[MatchedPoint]) -> Vec<f64> {
    let inner = points.windows(2).map(|pair| (pair[1].left - pair[0].left).norm());
    std::iter::once(0.0).chain(inner).collect()
}

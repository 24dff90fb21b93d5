//! What the views say about the curves: offsets from projected places to the lines across them.

use rayon::prelude::*;

use super::FitView;
use super::solve::{Observation, PER_VIEW};
use super::spline::{Spline, Weights};
use crate::geometry::{Point2, Vector2, Vector3};

/// Distance of the places on a curve at which it is compared with the views, px of arc length.
const SPACING_PX: f64 = 2.0;
/// Errors of traced lines are alike over so many px.
pub(super) const CORRELATION_PX: f64 = 4.0;
/// A line's error is never taken as smaller, px: what the tracing does not know of.
const LEAST_SIGMA_PX: f64 = 0.15;
/// Sine of the angle up to which a line runs along a projected curve.
const MOST_TURN: f64 = 0.5;
/// Residuals beyond this many sigma are weighted down.
pub(super) const HUBER: f64 = 2.0;
/// A piece of a curve on one line of a view counts from this many neighbouring places on: less is a crossing.
const LEAST_RUN: usize = 4;
/// Noise of a view relative to what its lines say: between these.
const NOISE_RANGE: [f64; 2] = [0.5, 20.0];

/// How much noisier the lines of a view are than they say: a factor on sigma.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Noise(pub f64);

impl Default for Noise {
    fn default() -> Self {
        Self(1.0)
    }
}

/// A curve with the places at which it is compared and given out.
pub(super) struct Sampled {
    /// The curve.
    pub spline: Spline,
    /// Places at which it is compared with the views, px of arc length.
    pub places: Vec<f64>,
    /// Places of the points that it was made from.
    pub points: Vec<f64>,
    /// Whether it joins itself.
    pub closed: bool,
    weights: Vec<Weights>,
    spacing_px: f64,
}

impl Sampled {
    pub fn new(spline: Spline, points: Vec<f64>, length_px: f64, closed: bool) -> Self {
        let count = ((length_px / SPACING_PX).round() as usize).max(3);
        // The last place of a closed curve is its first.
        let last = if closed { count } else { count - 1 };
        let places: Vec<f64> = (0..count).map(|at| at as f64 * length_px / last as f64).collect();
        let weights = places.iter().map(|place| spline.basis.at(*place)).collect();
        Self { spline, places, points, closed, weights, spacing_px: length_px / last as f64 }
    }
}

/// A place on a curve in a view.
struct Place {
    landed: Point2,
    /// Unit normal of the projected curve.
    normal: Vector2,
    /// To the line across it and the line's sigma, px, and the line.
    offset: Option<(f64, f64, usize)>,
}

/// The places of a curve in a view; `None` where they lie outside the image.
fn places(sampled: &Sampled, view: &FitView, reach_px: f64) -> Vec<Option<Place>> {
    let [height, width] = view.lines.lines().shape;
    let rows = view.pose.rows();
    let mut places: Vec<Option<Place>> = sampled
        .weights
        .iter()
        .map(|weights| {
            let [point, first, _] = sampled.spline.at(weights);
            let landed = view.pose.project(&point.into());
            let inside =
                landed.x >= 0.0 && landed.y >= 0.0 && landed.x <= width as f64 - 1.0 && landed.y <= height as f64 - 1.0;
            let along = Vector2::new(rows[0].dot(&first), rows[1].dot(&first)).try_normalize(1e-6)?;
            inside.then(|| Place {
                landed,
                normal: Vector2::new(-along.y, along.x),
                offset: view.lines.offset_across(&landed, &along, reach_px, MOST_TURN),
            })
        })
        .collect();
    // Runs on one line; a line that is only crossed tells nothing.
    let line = |place: &Option<Place>| place.as_ref().and_then(|place| place.offset).map(|(_, _, trace)| trace);
    let mut start = 0;
    for end in 1..=places.len() {
        if end < places.len() && line(&places[end]) == line(&places[start]) {
            continue;
        }
        if end - start < LEAST_RUN.min(places.len()) {
            places[start..end].iter_mut().flatten().for_each(|place| place.offset = None);
        }
        start = end;
    }
    places
}

/// Observations of every curve in every view, weighted; the noise of each view is measured anew.
pub(super) fn observe(
    curves: &[Sampled],
    views: &[FitView],
    noise: &mut [Noise],
    reach_px: f64,
) -> Vec<Vec<Observation>> {
    let mut observed: Vec<Vec<Observation>> =
        curves.par_iter().map(|sampled| observe_curve(sampled, views, reach_px)).collect();
    // Robust scale of each view: 1.48 times the median of |offset| / sigma.
    for (index, noise) in noise.iter_mut().enumerate() {
        let of_view = observed.iter().flatten().filter(|seen| seen.view == index);
        let mut sizes: Vec<f64> = of_view.map(|seen| seen.offset_px.abs() * seen.weight.sqrt()).collect();
        let middle = sizes.len() / 2;
        if sizes.len() >= 20 {
            let median = *sizes.select_nth_unstable_by(middle, f64::total_cmp).1;
            noise.0 = (1.4826 * median).clamp(NOISE_RANGE[0], NOISE_RANGE[1]);
        }
    }
    for (curve, sampled) in observed.iter_mut().zip(curves) {
        let independent = (sampled.spacing_px / CORRELATION_PX).min(1.0);
        for seen in curve {
            seen.weight /= noise[seen.view].0.powi(2);
            let off = seen.offset_px.abs() * seen.weight.sqrt();
            seen.weight *= independent * (HUBER / off.max(1e-9)).min(1.0);
        }
    }
    observed
}

fn observe_curve(sampled: &Sampled, views: &[FitView], reach_px: f64) -> Vec<Observation> {
    let mut observations = Vec::new();
    for (index, view) in views.iter().enumerate() {
        let rows = view.pose.rows();
        let origin = view.pose.origin();
        let (sin, cos) = view.pose.tilt_rad.sin_cos();
        for (place, weights) in places(sampled, view, reach_px).into_iter().zip(&sampled.weights) {
            let Some(Place { landed, normal, offset: Some((offset_px, sigma_px, _)) }) = place else { continue };
            let [point, ..] = sampled.spline.at(weights);
            let arm = landed - origin;
            let tilted = view.pose.image_from_projection * Vector2::new(point.z * cos - point.x * sin, 0.0);
            let per_view: [f64; PER_VIEW] =
                [normal.x, normal.y, normal.dot(&Vector2::new(-arm.y, arm.x)), normal.dot(&arm), normal.dot(&tilted)];
            let per_point: Vector3 = rows[0] * normal.x + rows[1] * normal.y;
            let weight = 1.0 / sigma_px.max(LEAST_SIGMA_PX).powi(2);
            observations.push(Observation { view: index, weights: *weights, per_point, per_view, offset_px, weight });
        }
    }
    observations
}

/// Per curve: in how many views each of its points lies on a line, and in what share of the places in the images of the views
/// beyond the first two (those of the pair) a line was found.
pub(super) fn seen(curves: &[Sampled], views: &[FitView], reach_px: f64) -> Vec<(Vec<usize>, f64)> {
    let of_curve = |sampled: &Sampled| {
        let mut count = vec![0_usize; sampled.places.len()];
        let (mut inside, mut found) = (0_usize, 0_usize);
        for (index, view) in views.iter().enumerate() {
            for (at, place) in places(sampled, view, reach_px).iter().enumerate() {
                let Some(place) = place else { continue };
                count[at] += usize::from(place.offset.is_some());
                if index >= 2 {
                    inside += 1;
                    found += usize::from(place.offset.is_some());
                }
            }
        }
        let at = |place: &f64| {
            let near = sampled.places.partition_point(|other| other < place).min(count.len() - 1);
            count[near]
        };
        (sampled.points.iter().map(at).collect(), found as f64 / inside.max(1) as f64)
    };
    curves.par_iter().map(of_curve).collect()
}

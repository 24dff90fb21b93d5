//! Truth for rendered pairs and the two simplest scores of a result against it.
#![allow(dead_code, clippy::unwrap_used)] // clippy.toml allows it in tests, but does not see helpers as such

use tiltline::curve::{CurvePoint, Flag};
use tiltline::geometry::{Point2, TiltPair, angle_to_row};
use tiltline::micrograph::StereoPair;
use tiltline::reconstruction::Reconstruction;
use tiltline::simulate::{Scene, SceneSettings, ViewSettings, render};

/// Lines nearer to the row than this have no disparity to speak of (CONVENTIONS.md): the second kind of agreement leaves
/// them out, degrees.
pub const ILL_CONDITIONED_DEG: f64 = 10.0;

/// A point counts as found within this distance across the line and this difference of disparity, px.
pub const TOLERANCE_PX: f64 = 2.0;

/// A rendered pair and where its curves are in both input images: same index, same physical point.
pub struct RenderedPair {
    pub scene: Scene,
    pub views: [ViewSettings; 2],
    pub pair: StereoPair,
    pub curves: [Vec<Vec<Point2>>; 2],
}

/// Renders a random scene at two tilts; `edit` changes the right view (shift, rotation, magnification).
pub fn rendered_pair(
    settings: &SceneSettings,
    tilts_deg: [f64; 2],
    base: &ViewSettings,
    edit: impl Fn(&mut ViewSettings),
) -> RenderedPair {
    let scene = Scene::random(settings);
    let tilts = TiltPair::from_degrees(tilts_deg[0], tilts_deg[1]);
    let left = ViewSettings { tilt_rad: tilts.left_rad, seed: 2 * settings.seed, ..base.clone() };
    let mut right = ViewSettings { tilt_rad: tilts.right_rad, seed: 2 * settings.seed + 1, ..base.clone() };
    edit(&mut right);
    let pair =
        StereoPair { left: render(&scene, &left), right: render(&scene, &right), tilts, tilt_axis_rad: base.axis_rad };
    let curves = [left.project_curves(&scene), right.project_curves(&scene)];
    RenderedPair { scene, views: [left, right], pair, curves }
}

/// How well a result agrees with the truth.
#[derive(Debug)]
pub struct Agreement {
    /// Share of the true left length (inside both images) that a reconstructed point explains within the tolerance.
    pub completeness: f64,
    /// Share of reconstructed points that a true curve explains within the tolerance.
    pub correctness: f64,
    /// Mean absolute difference of the right point along x, in input px, of the points near a true line.
    pub mean_disparity_error_px: f64,
    /// Share of those within one and two of their own sigma.
    pub within_sigma: [f64; 2],
    /// Number of points near a true line.
    pub points: usize,
}

/// The reconstructed right point at a true left point, and the other way round, in input px: no free offset.
///
/// With `well_conditioned`, only true lines [`ILL_CONDITIONED_DEG`] or more off the row and reconstructed points that are
/// flagged `ok` count.
pub fn agreement(result: &Reconstruction, truth: &RenderedPair, well_conditioned: bool) -> Agreement {
    let points: Vec<&CurvePoint> = result
        .curves
        .iter()
        .flat_map(|curve| &curve.points)
        .filter(|point| !well_conditioned || point.flag == Flag::Ok)
        .collect();
    let inside = |point: &Point2, view: &ViewSettings| {
        let border = 6.0;
        let [height, width] = view.shape.map(|side| side as f64 - 1.0 - border);
        point.x > border && point.y > border && point.x < width && point.y < height
    };
    // True points inside both images, and whether their line is far enough off the row.
    let mut visible = Vec::new();
    for (left_curve, right_curve) in truth.curves[0].iter().zip(&truth.curves[1]) {
        for (index, (left, right)) in left_curve.iter().zip(right_curve).enumerate() {
            if inside(left, &truth.views[0]) && inside(right, &truth.views[1]) {
                let neighbours = (index.saturating_sub(1), (index + 1).min(left_curve.len() - 1));
                let tangent = left_curve[neighbours.1] - left_curve[neighbours.0];
                let steep = angle_to_row(&tangent).to_degrees() >= ILL_CONDITIONED_DEG;
                visible.push((*left, *right, steep));
            }
        }
    }
    let explains = |point: &CurvePoint, left: &Point2, right: &Point2| {
        (point.left_input - left).norm() <= TOLERANCE_PX
            && ((point.right_input.x - point.left_input.x) - (right.x - left.x)).abs() <= TOLERANCE_PX
    };
    let all = || result.curves.iter().flat_map(|curve| &curve.points);
    let wanted: Vec<_> = visible.iter().filter(|(.., steep)| *steep || !well_conditioned).collect();
    let found = wanted.iter().filter(|(left, right, _)| all().any(|point| explains(point, left, right))).count();
    let mut correct = 0;
    let mut errors = Vec::new();
    for point in &points {
        correct += usize::from(visible.iter().any(|(left, right, _)| explains(point, left, right)));
        // Where lines cross, the truth meant is the one whose disparity is nearer.
        let error = truth.curves[0]
            .iter()
            .zip(&truth.curves[1])
            .filter_map(|(left_curve, right_curve)| disparity_error(point, left_curve, right_curve))
            .min_by(f64::total_cmp);
        errors.extend(error.map(|error| (error, point.sigma_disparity_px)));
    }
    let share =
        |k: f64| errors.iter().filter(|(error, sigma)| *error <= k * sigma).count() as f64 / errors.len() as f64;
    Agreement {
        completeness: found as f64 / wanted.len() as f64,
        correctness: correct as f64 / points.len() as f64,
        mean_disparity_error_px: errors.iter().map(|(error, _)| error).sum::<f64>() / errors.len() as f64,
        within_sigma: [share(1.0), share(2.0)],
        points: errors.len(),
    }
}

/// Absolute disparity error of a point if it lies within the tolerance of a true curve in the left image.
///
/// The true disparity is read on the true curve at the point's own row, where a line crosses it; that is what matching
/// along rows measures.
fn disparity_error(point: &CurvePoint, left_curve: &[Point2], right_curve: &[Point2]) -> Option<f64> {
    let mut best: Option<(f64, f64)> = None;
    for index in 1..left_curve.len() {
        let (a, b) = (left_curve[index - 1], left_curve[index]);
        let along = b - a;
        let foot = ((point.left_input - a).dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
        let distance = (point.left_input - (a + along * foot)).norm();
        if distance <= best.map_or(TOLERANCE_PX, |(nearest, _)| nearest) {
            let start = right_curve[index - 1].x - a.x;
            let end = right_curve[index].x - b.x;
            let measured = point.right_input.x - point.left_input.x;
            best = Some((distance, (measured - start * (1.0 - foot) - end * foot).abs()));
        }
    }
    best.map(|(_, error)| error)
}

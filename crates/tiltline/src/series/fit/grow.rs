//! The fit from a pair outwards: views are taken in by their distance in tilt, each registered on the curves as they are by then.

use super::{FitSettings, FitView, FittedCurve, Problem, StartCurve};
use crate::geometry::Point3;
use crate::series::{AlignedSeries, LineIndex, Series, SeriesError, ViewLines, ViewPose, register};

/// Views are taken in up to so many times the tilt that is in already, counted from the pair's middle.
const GROWTH: f64 = 1.5;
/// Rounds of the fit after each batch of views.
pub(super) const ROUNDS: usize = 4;
/// Reach while views come in, px.
pub(super) const WIDE_PX: f64 = 6.0;
/// Shifts of a new view are looked for within this share of the image's longer side, px at least.
const SEARCH_SHARE: f64 = 0.04;
const SEARCH_LEAST_PX: f64 = 12.0;

/// What the fit to all views found.
#[derive(Clone, Debug)]
pub struct Grown {
    /// The curves, in the order of the start.
    pub curves: Vec<FittedCurve>,
    /// The views that took part, those of the pair first.
    pub views: Vec<FitView>,
    /// Factor by which the lines of each are noisier than their tracing says.
    pub noise: Vec<f64>,
    /// One sigma of the tilt of each, radians.
    pub tilt_sigma_rad: Vec<f64>,
    /// Views whose lines do not fit the curves, by their places in the series.
    pub left_out: Vec<usize>,
}

impl Grown {
    /// Puts poses and curves into the frame in which the two views of the pair, the first ones, have the poses `pair`.
    pub(super) fn move_to(&mut self, pair: [ViewPose; 2]) {
        let [left, right] = [0, 1].map(|view| self.views[view].pose);
        let turn = 0.5 * (left.tilt_rad + right.tilt_rad) - 0.5 * (pair[0].tilt_rad + pair[1].tilt_rad);
        // The new origin in the old frame: where both views show it, x = X cos a + Z sin a and y = Y.
        let seen =
            [(left, pair[0]), (right, pair[1])].map(|(old, new)| old.image_from_projection.inverse() * new.origin());
        let (sines, cosines) =
            ([left, right].map(|pose| pose.tilt_rad.sin()), [left, right].map(|pose| pose.tilt_rad.cos()));
        let determinant = cosines[0] * sines[1] - sines[0] * cosines[1];
        let origin = Point3::new(
            (seen[0].x * sines[1] - seen[1].x * sines[0]) / determinant,
            0.5 * (seen[0].y + seen[1].y),
            (seen[1].x * cosines[0] - seen[0].x * cosines[1]) / determinant,
        );
        for view in &mut self.views {
            let FitView { pose, nominal_rad, .. } = view;
            *pose = ViewPose::new(pose.tilt_rad - turn, pose.axis_rad(), pose.scale(), pose.project(&origin));
            *nominal_rad -= turn;
        }
        let (sin, cos) = turn.sin_cos();
        for point in self.curves.iter_mut().flat_map(|curve| &mut curve.points) {
            let from = *point - origin;
            *point = Point3::new(from.x * cos + from.z * sin, from.y, from.z * cos - from.x * sin);
        }
    }
}

/// Fits curves to all views of a series. `pair` are the two views that the curves come from, with their poses in the curves'
/// frame; `tilt_in_frame` gives the tilt of a view there.
///
/// # Errors
/// Where a view cannot be read.
pub fn grow(
    curves: &[StartCurve],
    pair: [(usize, ViewPose); 2],
    series: &Series,
    aligned: &AlignedSeries,
    settings: &FitSettings,
    lines_of: &mut dyn FnMut(usize) -> Result<ViewLines, SeriesError>,
) -> Result<Grown, SeriesError> {
    let tilt = |view: usize| series.views[view].tilt_deg.to_radians();
    let mid = 0.5 * (tilt(pair[0].0) + tilt(pair[1].0));
    let in_pair = |view: usize| pair.iter().any(|(other, _)| *other == view);
    let mut waiting: Vec<usize> = (0..series.views.len()).filter(|view| !in_pair(*view)).collect();
    waiting.sort_by(|&a, &b| (tilt(a) - mid).abs().total_cmp(&(tilt(b) - mid).abs()));
    let mut views = Vec::new();
    for (view, pose) in pair {
        views.push(FitView::new(view, pose, LineIndex::new(lines_of(view)?)));
    }
    let mut problem = Problem::new(curves, views, settings);
    let mut reached = (tilt(pair[0].0) - mid).abs().max(1e-3);
    let search_px = (SEARCH_SHARE * series.shape[0].max(series.shape[1]) as f64).max(SEARCH_LEAST_PX);
    let mut left_out = Vec::new();
    while !waiting.is_empty() {
        // At least the next two views, however far they are.
        let limit = (GROWTH * reached).max((tilt(waiting[1.min(waiting.len() - 1)]) - mid).abs() + 1e-9);
        let batch = waiting.iter().take_while(|&&view| (tilt(view) - mid).abs() <= limit).count();
        for view in waiting.drain(..batch) {
            let lines = LineIndex::new(lines_of(view)?);
            let start = expected(view, tilt(view) - mid, &problem.views, aligned);
            let found = register(&problem.points_with_tangents(), &lines, &start, search_px, false);
            match found.filter(|found| found.is_supported()) {
                Some(found) => problem.add(FitView::new(view, found.pose, lines)),
                None => left_out.push(view),
            }
        }
        reached = limit;
        problem.run(ROUNDS, [WIDE_PX, settings.reach_px], settings);
    }
    problem.run(settings.rounds, [settings.reach_px; 2], settings);
    Ok(finished(problem, left_out, settings))
}

/// The views of a series where its alignment says they are, those of the pair first; lines that are known already are not looked for
/// again.
///
/// # Errors
/// Where a view cannot be read.
pub(super) fn aligned_views(
    pair: [(usize, ViewPose); 2],
    series: &Series,
    aligned: &AlignedSeries,
    known: &[FitView],
    lines_of: &mut dyn FnMut(usize) -> Result<ViewLines, SeriesError>,
) -> Result<Vec<FitView>, SeriesError> {
    let mut lines = |view: usize| match known.iter().find(|known| known.view == view) {
        Some(known) => Ok(known.lines.clone()),
        None => lines_of(view).map(LineIndex::new),
    };
    let tilt = |view: usize| series.views[view].tilt_deg.to_radians();
    let mid = 0.5 * (tilt(pair[0].0) + tilt(pair[1].0));
    let mut views = Vec::new();
    for (view, pose) in pair {
        views.push(FitView::new(view, pose, lines(view)?));
    }
    for view in (0..series.views.len()).filter(|view| pair.iter().all(|(other, _)| other != view)) {
        let pose = expected(view, tilt(view) - mid, &views[..2], aligned);
        views.push(FitView::new(view, pose, lines(view)?));
    }
    Ok(views)
}

/// Fits the same views again, with further curves behind those that were fitted before.
pub(super) fn extended(before: Grown, further: &[StartCurve], settings: &FitSettings) -> Grown {
    let mut curves: Vec<StartCurve> = before.curves.iter().map(FittedCurve::as_start).collect();
    curves.extend_from_slice(further);
    let mut problem = Problem::new(&curves, before.views, settings);
    problem.run(ROUNDS, [WIDE_PX, settings.reach_px], settings);
    problem.run(settings.rounds, [settings.reach_px; 2], settings);
    finished(problem, before.left_out, settings)
}

pub(super) fn finished(mut problem: Problem, left_out: Vec<usize>, settings: &FitSettings) -> Grown {
    let curves = problem.fitted(settings.reach_px);
    let tilt_sigma_rad = match &problem.step {
        Some(step) => (0..problem.views.len()).map(|view| step.view_variance(view, 4).sqrt()).collect(),
        None => vec![settings.tilt_sigma_deg.to_radians(); problem.views.len()],
    };
    let noise = problem.noise.iter().map(|noise| noise.0).collect();
    Grown { curves, views: problem.views, noise, tilt_sigma_rad, left_out }
}

/// Where a view is expected: beside its nearest neighbour in the fit, moved by the alignment of the series; turned and magnified as
/// the pair, as the stage and the microscope do not change.
fn expected(view: usize, tilt_rad: f64, known: &[FitView], aligned: &AlignedSeries) -> ViewPose {
    let nearest = known
        .iter()
        .min_by(|a, b| (a.pose.tilt_rad - tilt_rad).abs().total_cmp(&(b.pose.tilt_rad - tilt_rad).abs()))
        .expect("the views of the pair are in the fit");
    let off = nearest.pose.origin() - aligned.poses[nearest.view].origin();
    let pair = &known[0].pose;
    ViewPose::new(tilt_rad, pair.axis_rad(), pair.scale(), aligned.poses[view].origin() + off)
}

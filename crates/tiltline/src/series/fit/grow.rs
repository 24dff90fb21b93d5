//! The fit from a pair outwards: views are taken in by their distance in tilt, each registered on the curves as they are by then.

use super::{FitSettings, FitView, FittedCurve, Hold, Problem, StartCurve};
use crate::geometry::{Point2, Point3};
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
    /// The curves, in the order of the start, and behind them those that all views show.
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
        // The new origin in the old frame.
        let seen =
            [(left, pair[0]), (right, pair[1])].map(|(old, new)| old.image_from_projection.inverse() * new.origin());
        let origin = shown_by_both([left.tilt_rad, right.tilt_rad], seen);
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

/// The point that two views at different tilts show at `seen` in their projections: `x = X cos a + Z sin a`, `y = Y`.
pub(super) fn shown_by_both(tilts_rad: [f64; 2], seen: [Point2; 2]) -> Point3 {
    let [(sin, cos), (other_sin, other_cos)] = tilts_rad.map(f64::sin_cos);
    let determinant = cos * other_sin - sin * other_cos;
    Point3::new(
        (seen[0].x * other_sin - seen[1].x * sin) / determinant,
        0.5 * (seen[0].y + seen[1].y),
        (seen[1].x * cos - seen[0].x * other_cos) / determinant,
    )
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
    problem.hold_depths(curves);
    let mut reached = (tilt(pair[0].0) - mid).abs().max(1e-3);
    let search_px = (SEARCH_SHARE * series.shape[0].max(series.shape[1]) as f64).max(SEARCH_LEAST_PX);
    let mut left_out = Vec::new();
    while !waiting.is_empty() {
        let off: Vec<f64> = waiting.iter().map(|&view| (tilt(view) - mid).abs()).collect();
        let (batch, limit) = next_batch(&off, reached);
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

/// How many of the views that wait come in next, and how far the tilts reach then; views are ordered by how far their tilts are from the
/// pair's middle, `off_rad`, of which there is one at least.
pub(super) fn next_batch(off_rad: &[f64], reached_rad: f64) -> (usize, f64) {
    // At least the next two, however far they are.
    let limit = (GROWTH * reached_rad).max(off_rad[1.min(off_rad.len() - 1)] + 1e-9);
    (off_rad.iter().take_while(|off| **off <= limit).count(), limit)
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
    let tilts: Vec<f64> = series.views.iter().map(|view| view.tilt_deg.to_radians()).collect();
    let poses = placed(pair, &tilts, &aligned.poses);
    let of_pair = pair.map(|(view, _)| view);
    let others = (0..series.views.len()).filter(|view| !of_pair.contains(view));
    of_pair.into_iter().chain(others).map(|view| Ok(FitView::new(view, poses[view], lines(view)?))).collect()
}

/// Poses of aligned views in the frame of a pair, turned and magnified as its first view. Where its origin lies in the frame of the
/// alignment follows from where the two views of the pair show it; in the others that point moves with the tilt.
fn placed(pair: [(usize, ViewPose); 2], tilts_rad: &[f64], aligned: &[ViewPose]) -> Vec<ViewPose> {
    let mid = 0.5 * (tilts_rad[pair[0].0] + tilts_rad[pair[1].0]);
    let (axis_rad, scale) = (pair[0].1.axis_rad(), pair[0].1.scale());
    let about = |view: usize| ViewPose::new(tilts_rad[view] - mid, axis_rad, scale, aligned[view].origin());
    let seen = pair.map(|(view, pose)| about(view).image_from_projection.inverse() * pose.origin());
    let origin = shown_by_both(pair.map(|(view, _)| tilts_rad[view] - mid), seen);
    let mut poses: Vec<ViewPose> = (0..tilts_rad.len())
        .map(|view| ViewPose::new(tilts_rad[view] - mid, axis_rad, scale, about(view).project(&origin)))
        .collect();
    for (view, pose) in pair {
        poses[view] = pose;
    }
    poses
}

/// Fits the same views again, whose poses are known as well as `hold` says, with further curves behind those that were fitted before. The
/// first ones are held to the depths of `held`, which are in the same frame.
pub(super) fn extended(
    before: Grown,
    hold: Hold,
    further: &[StartCurve],
    held: &[StartCurve],
    settings: &FitSettings,
) -> Grown {
    let mut curves: Vec<StartCurve> = before.curves.iter().map(FittedCurve::as_start).collect();
    curves.extend_from_slice(further);
    let mut problem = Problem::new(&curves, before.views, settings);
    problem.hold = hold;
    problem.hold_depths(held);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vector2;

    /// A pair whose frame has its origin far behind the point that the alignment keeps in place, and beside it: every view shows
    /// what it would show of the same foil, far tilts too.
    #[test]
    fn aligned_views_are_placed_by_where_the_origin_of_the_pair_is_seen() {
        let tilts = [-50.0_f64, -20.0, -3.0, 5.0, 30.0, 50.0].map(f64::to_radians);
        let mid = 0.5 * (tilts[2] + tilts[3]);
        let axis_rad = 0.3;
        let origin = |view: usize| Point2::new(250.0, 240.0) + Vector2::new(3.0, -2.0) * view as f64;
        let aligned: Vec<ViewPose> =
            (0..tilts.len()).map(|view| ViewPose::new(tilts[view], axis_rad, 1.0, origin(view))).collect();
        // In the alignment's frame; the pair's is turned by the middle of its tilts.
        let of_pair = Point3::new(15.0, -8.0, 60.0);
        let pose = |view: usize| ViewPose::new(tilts[view] - mid, axis_rad, 1.0, aligned[view].project(&of_pair));
        let poses = placed([(3, pose(3)), (2, pose(2))], &tilts, &aligned);
        for (view, found) in poses.iter().enumerate() {
            assert!((found.origin() - pose(view).origin()).norm() < 1e-6, "{view}");
            assert!((found.tilt_rad - pose(view).tilt_rad).abs() < 1e-12);
        }
        // 60 px behind: at 50 degrees 46 px to the right of where it is seen without tilt, not beside its neighbour.
        let beside = poses[5].image_from_projection.inverse() * aligned[5].origin();
        assert!((-beside.x - (15.0 * tilts[5].cos() + 60.0 * tilts[5].sin())).abs() < 1e-6);
    }
}

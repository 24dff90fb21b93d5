//! Lines that only other pairs show: pairs of views tilted away from the first one, matched with the poses that are known by now.

use super::{FitView, StartCurve};
use crate::curve::MatchedCurve;
use crate::geometry::{Point2, Point3, Similarity2, TiltPair, Vector2};
use crate::micrograph::View;
use crate::pipeline::{Detect, Match};
use crate::rectify::resample::{common_grid, resample};
use crate::rectify::{Rectification, RectifiedPair};
use crate::refine::refine;
use crate::series::{LineIndex, Series, SeriesError, ViewLines, ViewPose};
use crate::settings::Settings;
use crate::trace::trace;

/// Further pairs that are matched.
const PAIRS: usize = 4;
/// Angle between their views that is aimed at, and what is accepted, degrees.
const WANTED_DEG: f64 = 8.0;
const POSSIBLE_DEG: [f64; 2] = [3.0, 14.0];
/// Middles of further pairs are at least so far from each other and from the first pair's, degrees.
const APART_DEG: f64 = 9.0;
/// A stretch this far from every curve that is known, in the pair's left view, is new, px.
const NEW_PX: f64 = 4.0;
/// Shortest new stretch, px.
const SHORTEST_PX: f64 = 25.0;
/// Error of a row, px: that of the poses.
const ROW_SIGMA_PX: f64 = 0.3;
/// Disparities are looked for so far beyond those of the known curves, px.
const BEYOND_PX: f64 = 2.0;

/// Pairs of views (by their places in the fit) about other tilts than the first pair's, the nearest to it first.
pub(super) fn other_pairs(views: &[FitView]) -> Vec<[usize; 2]> {
    let tilt = |place: usize| views[place].nominal_rad.to_degrees();
    let mut candidates: Vec<(f64, [usize; 2])> = Vec::new();
    for a in 0..views.len() {
        for b in 0..views.len() {
            let phi = tilt(b) - tilt(a);
            if (POSSIBLE_DEG[0]..=POSSIBLE_DEG[1]).contains(&phi) {
                candidates.push(((phi - WANTED_DEG).abs() + 0.01 * (tilt(a) + tilt(b)).abs(), [a, b]));
            }
        }
    }
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut middles = vec![0.0];
    let mut pairs = Vec::new();
    for (_, [a, b]) in candidates {
        let middle = 0.5 * (tilt(a) + tilt(b));
        if pairs.len() < PAIRS && middles.iter().all(|other: &f64| (other - middle).abs() >= APART_DEG) {
            middles.push(middle);
            pairs.push([a, b]);
        }
    }
    pairs
}

/// New curves of a pair of views, in the frame of the poses; `known` are the curves so far.
///
/// # Errors
/// Where a view cannot be read.
pub(super) fn new_curves(
    views: [&FitView; 2],
    known: &[StartCurve],
    series: &Series,
    detector: &dyn Detect,
    matcher: &dyn Match,
    settings: &Settings,
) -> Result<Vec<StartCurve>, SeriesError> {
    let poses = views.map(|view| view.pose);
    let disparities = disparities(known, &poses);
    let Some([low, middle, high]) = disparities else { return Ok(Vec::new()) };
    let images = [series.view(views[0].view)?.normalised(), series.view(views[1].view)?.normalised()];
    // Disparity is measured from the middle of what is known, as rectification does.
    let maps = poses.map(|pose| pose.image_from_projection.inverse());
    let maps = [maps[0], moved(&maps[1], Vector2::new(-middle, 0.0))];
    let shapes = images.each_ref().map(|image| [image.nrows(), image.ncols()]);
    let grid = common_grid(shapes, [&maps[0], &maps[1]]);
    let maps = maps.map(|map| moved(&map, grid.shift));
    let [left, right] = [0, 1].map(|view| resample(&images[view].view(), &maps[view], grid.shape));
    let rectification = Rectification {
        rms_row_error_px: ROW_SIGMA_PX,
        sigma_row_px: ROW_SIGMA_PX,
        disparity_range_px: [low - middle - BEYOND_PX, high - middle + BEYOND_PX],
        ..Rectification::known(maps, grid.shape)
    };
    let pair = RectifiedPair { left, right, rectification };
    let lines = View::BOTH.map(|view| detector.detect(&pair, view));
    let traces = [0, 1].map(|view| trace(&lines[view], &settings.trace));
    let matched = matcher.match_curves(&pair, &lines, &traces);
    let matched = refine(matched, &traces, &pair.rectification, &settings.refine);
    let covered = index_of(known, &poses[0], shapes[0]);
    let tilts = TiltPair { left_rad: poses[0].tilt_rad, right_rad: poses[1].tilt_rad };
    let curves = matched.iter().flat_map(|curve| fresh(curve, &tilts, &grid.shift, middle, &poses[0], &covered));
    Ok(curves.collect())
}

/// The map followed by a shift.
fn moved(map: &Similarity2, shift: Vector2) -> Similarity2 {
    let mut map = *map;
    map.isometry.translation.vector += shift;
    map
}

/// Least, middle and largest disparity of known curves between two views (1, 50 and 99 percent); `None` without curves.
fn disparities(known: &[StartCurve], poses: &[ViewPose; 2]) -> Option<[f64; 3]> {
    let at = |point: &Point3, pose: &ViewPose| crate::geometry::project_at_tilt(point, pose.tilt_rad).x;
    let points = known.iter().flat_map(|curve| &curve.points);
    let mut all: Vec<f64> = points.map(|point| at(point, &poses[1]) - at(point, &poses[0])).collect();
    all.sort_by(f64::total_cmp);
    let share = |share: f64| all[((all.len() - 1) as f64 * share) as usize];
    (!all.is_empty()).then(|| [share(0.01), share(0.5), share(0.99)])
}

/// The known curves as lines of a view.
fn index_of(known: &[StartCurve], pose: &ViewPose, shape: [usize; 2]) -> LineIndex {
    let traces = known.iter().map(|curve| crate::curve::Trace {
        points: curve
            .points
            .iter()
            .map(|point| crate::curve::TracePoint {
                position: pose.project(point),
                tangent: Vector2::y(),
                probability: 1.0,
                sigma_perp_px: 0.0,
            })
            .collect(),
        closed: curve.closed,
        ends: [crate::curve::TraceEnd::Free; 2],
    });
    let traces = crate::curve::TraceGraph { traces: traces.collect(), junctions: Vec::new() };
    LineIndex::new(ViewLines { traces, shape })
}

/// The stretches of a matched curve that are away from every known one, in the frame of the poses.
fn fresh(
    curve: &MatchedCurve,
    tilts: &TiltPair,
    shift: &Vector2,
    middle: f64,
    left: &ViewPose,
    covered: &LineIndex,
) -> Vec<StartCurve> {
    let (sin, cos) = tilts.mid_rad().sin_cos();
    let gain = tilts.depth_gain().abs();
    let points: Vec<(Point3, f64)> = curve
        .points
        .iter()
        .map(|point| {
            let on_left = point.left - shift;
            let (x, z) = tilts.triangulate(on_left.x, on_left.x + point.disparity_px + middle);
            (Point3::new(x * cos - z * sin, on_left.y, x * sin + z * cos), point.sigma_px * gain)
        })
        .collect();
    let is_new = |(point, _): &(Point3, f64)| covered.distance(&left.project(point)).is_none_or(|px| px > NEW_PX);
    let stretches = points.split(|point| !is_new(point));
    let long = stretches.filter(|stretch| {
        let projected: Vec<Point2> = stretch.iter().map(|(point, _)| left.project(point)).collect();
        stretch.len() >= 2 && crate::geometry::length2(&projected) >= SHORTEST_PX
    });
    long.map(|stretch| StartCurve {
        points: stretch.iter().map(|(point, _)| *point).collect(),
        sigma_z: stretch.iter().map(|(_, sigma)| *sigma).collect(),
        closed: curve.closed && stretch.len() == points.len(),
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::curve::{Flag, MatchedPoint, TraceEnd, TraceGraph};
    use approx::assert_abs_diff_eq;

    fn view(place: usize, tilt_deg: f64) -> FitView {
        let pose = ViewPose::new(tilt_deg.to_radians(), 0.0, 1.0, Point2::new(100.0, 100.0));
        FitView::new(place, pose, LineIndex::new(ViewLines { traces: TraceGraph::default(), shape: [200, 200] }))
    }

    #[test]
    fn further_pairs_look_from_other_sides() {
        let views: Vec<FitView> = (0..23).map(|k| view(k, 4.0 * k as f64 - 44.0)).collect();
        let pairs = other_pairs(&views);
        assert_eq!(pairs.len(), PAIRS);
        for [a, b] in pairs {
            let [a, b] = [a, b].map(|place| views[place].nominal_rad.to_degrees());
            assert_abs_diff_eq!(b - a, 8.0, epsilon = 1e-9);
            assert!((0.5 * (a + b)).abs() >= APART_DEG);
        }
    }

    /// A point seen from a pair about 20 degrees comes back to where it is in the frame of the poses.
    #[test]
    fn points_of_a_tilted_pair_come_back_to_the_frame() {
        let [left, right] = [16.0, 24.0].map(|tilt| view(0, tilt).pose);
        let truth: Vec<Point3> = (0..60).map(|k| Point3::new(5.0 + 0.3 * f64::from(k), f64::from(k), 12.0)).collect();
        let (shift, middle) = (Vector2::new(3.0, 4.0), 1.5);
        let at = |point: &Point3, pose: &ViewPose| crate::geometry::project_at_tilt(point, pose.tilt_rad);
        let points = truth.iter().map(|point| MatchedPoint {
            left: at(point, &left) + shift,
            tangent_left: Vector2::y(),
            tangent_right: None,
            disparity_px: at(point, &right).x - at(point, &left).x - middle,
            sigma_px: 0.1,
            flag: Flag::Ok,
        });
        let matched =
            MatchedCurve { left_trace: 0, points: points.collect(), closed: false, ends: [TraceEnd::Free; 2] };
        let tilts = TiltPair { left_rad: left.tilt_rad, right_rad: right.tilt_rad };
        let none = index_of(&[], &left, [200, 200]);
        let curves = fresh(&matched, &tilts, &shift, middle, &left, &none);
        for (point, truth) in curves[0].points.iter().zip(&truth) {
            assert!((point - truth).norm() < 1e-9);
        }
        // A curve that is known is not new.
        assert!(fresh(&matched, &tilts, &shift, middle, &left, &index_of(&curves, &left, [200, 200])).is_empty());
    }
}

//! The fit to all views on simulated curves with exact, noisy centrelines: against the bound of its error, and for its signs.

use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;

use super::*;
use crate::curve::{Trace, TraceEnd, TraceGraph, TracePoint};
use crate::geometry::{Point2, Vector2};
use crate::series::ViewLines;
use crate::simulate::scene::bezier;

/// Error of a traced line across itself, px, independent from point to point.
const SIGMA_X: f64 = 0.3;
pub(super) const SHAPE: [usize; 2] = [512, 512];

/// Bowed curves that run roughly along the tilt axis, at depths up to 60 px: well placed.
pub(super) fn curves() -> Vec<Vec<Point3>> {
    (0..12)
        .map(|k| {
            let (x, slope) = (-200.0 + 36.0 * f64::from(k), if k % 2 == 0 { 0.5 } else { -0.4 });
            let (up, bow) = (if k % 3 == 0 { -1.0 } else { 1.0 }, 12.0 * f64::from(k % 4));
            let at = |y: f64, across: f64, z: f64| Point3::new(x + slope * y + across, y, z);
            bezier([at(-150.0, 0.0, -60.0 * up), at(-50.0, bow, -10.0), at(50.0, bow, 25.0), at(150.0, 0.0, 60.0 * up)])
        })
        .collect()
}

/// The true pose of a view, a little off what is known of it: shift, turn, magnification, tilt.
/// Errors of the tilts have no mean: that would turn the foil, and no image shows it.
fn true_pose(index: usize, count: usize, tilt_deg: f64, off: f64) -> ViewPose {
    let wave_of = |index: usize, k: f64| (12.9898 * (index as f64 + 1.0) * k).sin();
    let wave = |k: f64| wave_of(index, k);
    let mean = (0..count).map(|index| wave_of(index, 1.0)).sum::<f64>() / count as f64;
    let tilt = (tilt_deg + 0.1 * off * (wave(1.0) - mean)).to_radians();
    let origin = Point2::new(255.5 + 3.0 * off * wave(2.0), 255.5 + 3.0 * off * wave(3.0));
    let scale = if index == 0 { 1.0 } else { 1.0 + 0.003 * off * wave(5.0) };
    ViewPose::new(tilt, (0.3 * off * wave(4.0)).to_radians(), scale, origin)
}

/// Centrelines of the curves in a view, points about 1 px apart, with independent errors across the line.
pub(super) fn noisy_lines(curves: &[Vec<Point3>], pose: &ViewPose, rng: &mut Pcg64) -> ViewLines {
    let noise = Normal::new(0.0, SIGMA_X).unwrap();
    let traces = curves.iter().map(|curve| {
        let projected: Vec<Point2> = curve.iter().map(|point| pose.project(point)).collect();
        let count = projected.len();
        let points = (0..count).map(|at| {
            let tangent = (projected[(at + 1).min(count - 1)] - projected[at.saturating_sub(1)]).normalize();
            let position = projected[at] + Vector2::new(-tangent.y, tangent.x) * noise.sample(rng);
            TracePoint { position, tangent, probability: 1.0, sigma_perp_px: SIGMA_X }
        });
        Trace { points: points.collect(), closed: false, ends: [TraceEnd::Free; 2] }
    });
    ViewLines::new(TraceGraph { traces: traces.collect(), junctions: Vec::new() }, SHAPE)
}

/// The views of a problem: true poses, and what is known of them: the nominal tilt, and the turn of the pair's views to 0.05 degrees.
fn views(tilts_deg: &[f64], off: f64, seed: u64) -> (Vec<ViewPose>, Vec<FitView>) {
    let curves = curves();
    let mut rng = Pcg64::seed_from_u64(seed);
    let truth: Vec<ViewPose> =
        tilts_deg.iter().enumerate().map(|(at, tilt)| true_pose(at, tilts_deg.len(), *tilt, off)).collect();
    // The views of the pair are turned against each other as their rows say.
    let turned = truth[1].axis_rad() - truth[0].axis_rad();
    let views = truth.iter().zip(tilts_deg).enumerate().map(|(at, (pose, tilt))| {
        let lines = LineIndex::new(noisy_lines(&curves, pose, &mut rng));
        let near = ViewPose::new(
            tilt.to_radians(),
            if at == 1 { turned + 0.05_f64.to_radians() * off } else { 0.0 },
            1.0,
            pose.origin() + Vector2::new(0.4, -0.3) * (off * (at % 3) as f64),
        );
        FitView::new(at, near, lines)
    });
    let views = views.collect();
    (truth, views)
}

/// Starts whose depths are off by a smooth error of some px, as a pair's are.
fn starts(error_px: f64) -> Vec<StartCurve> {
    wavy_starts(error_px, 0.04)
}

/// Starts whose depths are off by a wave of so many radians per point.
fn wavy_starts(error_px: f64, rate: f64) -> Vec<StartCurve> {
    let start = |(index, curve): (usize, Vec<Point3>)| {
        let wave = |at: usize| error_px * (rate * at as f64 + index as f64).sin();
        let points =
            curve.iter().enumerate().map(|(at, point)| Point3::new(point.x, point.y, point.z + wave(at))).collect();
        StartCurve { points, sigma_z: vec![error_px.max(1.0); curve.len()], closed: false }
    };
    curves().into_iter().enumerate().map(start).collect()
}

/// Root mean square error of z, and of its stated sigma: depth is relative, so that one offset is removed; x and y of truth and
/// result are compared at the same arc.
fn depth_errors(fitted: &[FittedCurve]) -> (f64, f64) {
    let truth = curves();
    let mut off = Vec::new();
    let mut sigmas = Vec::new();
    for (curve, fitted) in truth.iter().zip(fitted) {
        for (at, point) in fitted.points.iter().enumerate() {
            // The truth at this height: curves run along y.
            let after = curve.partition_point(|other| other.y < point.y).clamp(1, curve.len() - 1);
            let (a, b) = (curve[after - 1], curve[after]);
            let share = ((point.y - a.y) / (b.y - a.y)).clamp(0.0, 1.0);
            off.push(point.z - (a.z + (b.z - a.z) * share));
            sigmas.push(fitted.sigma_z[at]);
        }
    }
    let mean = off.iter().sum::<f64>() / off.len() as f64;
    let rms = |values: &mut dyn Iterator<Item = f64>| {
        let (sum, count) = values.fold((0.0, 0), |(sum, count), value| (sum + value * value, count + 1));
        (sum / f64::from(count)).sqrt()
    };
    (rms(&mut off.iter().map(|value| value - mean)), rms(&mut sigmas.iter().copied()))
}

/// The bound of the error of depth at a single point: sqrt of `[sigma_x^2 (sum u u')^-1]_ZZ`, `u = (cos a, sin a)`.
fn bound(tilts_deg: &[f64]) -> f64 {
    let mut matrix = nalgebra::Matrix2::zeros();
    for tilt in tilts_deg {
        let (sin, cos) = tilt.to_radians().sin_cos();
        matrix += nalgebra::Matrix2::new(cos * cos, cos * sin, cos * sin, sin * sin);
    }
    SIGMA_X * matrix.try_inverse().unwrap()[(1, 1)].sqrt()
}

fn fitted(tilts_deg: &[f64], off: f64, error_px: f64, seed: u64) -> Vec<FittedCurve> {
    let settings = FitSettings::default();
    let (_, views) = views(tilts_deg, off, seed);
    let mut problem = Problem::new(&starts(error_px), views, &settings);
    problem.run(6, [6.0, 3.0], &settings);
    problem.run(10, [3.0, 3.0], &settings);
    problem.fitted(3.0)
}

/// The pair first, then the others, as the fit has them.
fn tilts(count: usize) -> Vec<f64> {
    let step = if count == 3 { 4.0 } else { 88.0 / (count - 1) as f64 };
    let half = (count as f64 - 1.0) / 2.0;
    let all: Vec<f64> = (0..count).map(|at| (at as f64 - half) * step).collect();
    let near =
        |wanted: f64| (0..count).min_by(|&a, &b| (all[a] - wanted).abs().total_cmp(&(all[b] - wanted).abs())).unwrap();
    let pair = [near(-4.0), near(4.0)];
    let pair = if pair[0] == pair[1] { [pair[0], pair[0] + 1] } else { pair };
    let others = (0..count).filter(|at| !pair.contains(at));
    pair.into_iter().chain(others).map(|at| all[at]).collect()
}

#[test]
fn depths_reach_the_bound_at_3_9_and_45_views() {
    for count in [3, 9, 45] {
        let tilts = tilts(count);
        let (rms, stated) = depth_errors(&fitted(&tilts, 1.0, 4.0, 7));
        let bound = bound(&tilts);
        assert!(rms < 1.5 * bound, "{count} views: {rms} px, bound {bound} px");
        // The stated sigma is neither boast nor excuse: errors of tracing are taken to be alike over some px, and are independent here.
        assert!((0.5..3.0).contains(&(stated / rms)), "{count} views: {rms} px, stated {stated} px");
    }
}

/// Physical argument, not a round trip: what lies behind mid-foil (Z > 0) moves to larger x as the tilt grows. Lines are drawn by that
/// rule alone, and the fit starts from flat curves.
#[test]
fn a_line_that_moves_to_larger_x_as_the_tilt_grows_lies_behind() {
    let depths = [-40.0, 0.0, 40.0];
    let line = |tilt: f64, k: usize| {
        let x = |y: f64| (120.0 * (k as f64 - 1.0) + 0.2 * y) * tilt.cos() + depths[k] * tilt.sin();
        let point = |y: f64| TracePoint {
            position: Point2::new(255.5 + x(y - 255.5), y),
            tangent: Vector2::new(0.2, 1.0).normalize(),
            probability: 1.0,
            sigma_perp_px: 0.2,
        };
        Trace { points: (100..400).map(|y| point(f64::from(y))).collect(), closed: false, ends: [TraceEnd::Free; 2] }
    };
    let view = |(index, tilt_deg): (usize, f64)| {
        let tilt = tilt_deg.to_radians();
        let traces = (0..3).map(|k| line(tilt, k)).collect();
        let lines = ViewLines::new(TraceGraph { traces, junctions: Vec::new() }, SHAPE);
        let pose = ViewPose::new(tilt, 0.0, 1.0, Point2::new(255.5, 255.5));
        FitView::new(index, pose, LineIndex::new(lines))
    };
    let views = [-4.0, 4.0, -8.0, 0.0, 8.0].into_iter().enumerate().map(view).collect();
    let start = |k: usize| StartCurve {
        points: (-100..100)
            .map(|y| Point3::new(120.0 * (k as f64 - 1.0) + 0.2 * f64::from(y), f64::from(y), 0.0))
            .collect(),
        sigma_z: vec![30.0; 200],
        closed: false,
    };
    let settings = FitSettings { scale_sigma: 1e-4, ..FitSettings::default() };
    let mut problem = Problem::new(&[0, 1, 2].map(start), views, &settings);
    problem.run(12, [8.0, 3.0], &settings);
    let depth = problem.fitted(3.0).iter().map(|curve| curve.points[100].z).collect::<Vec<_>>();
    assert!((depth[2] - depth[1] - 40.0).abs() < 4.0 && (depth[1] - depth[0] - 40.0).abs() < 4.0, "{depth:?}");
}

/// Changing the frame changes no image: every view shows the moved points where it showed them before, and the pair has the poses
/// that were asked for.
#[test]
fn moved_to_another_frame_every_view_shows_the_same() {
    let lines = || LineIndex::new(ViewLines::new(TraceGraph::default(), SHAPE));
    let view = |(index, (tilt, axis, x)): (usize, (f64, f64, f64))| {
        FitView::new(index, ViewPose::new(tilt, axis, 1.0 + 0.01 * axis, Point2::new(x, 200.0 - x)), lines())
    };
    let poses = [(-0.07, 0.1, 250.0), (0.09, 0.12, 260.0), (0.5, 0.08, 240.0)];
    let views = poses.into_iter().enumerate().map(view).collect();
    let points = [Point3::new(3.0, 5.0, 40.0), Point3::new(-60.0, 9.0, -20.0), Point3::new(0.0, -70.0, 8.0)];
    let curve =
        FittedCurve { points: points.to_vec(), sigma_z: vec![1.0; 3], seen: vec![3; 3], closed: false, support: 1.0 };
    let shown = |grown: &Grown| -> Vec<Point2> {
        grown
            .views
            .iter()
            .flat_map(|view| grown.curves[0].points.iter().map(|point| view.pose.project(point)))
            .collect()
    };
    let mut grown =
        Grown { curves: vec![curve], noise: vec![1.0; 3], tilt_sigma_rad: vec![0.0; 3], left_out: Vec::new(), views };
    let before = shown(&grown);
    // The same pair about a point of the foil, turned so that its middle has no tilt.
    let origin = Point3::new(11.0, -4.0, 25.0);
    let pair = [0, 1].map(|index| {
        let pose = grown.views[index].pose;
        ViewPose::new(pose.tilt_rad - 0.01, pose.axis_rad(), pose.scale(), pose.project(&origin))
    });
    grown.move_to(pair);
    for (was, is) in before.iter().zip(shown(&grown)) {
        assert!((was - is).norm() < 1e-9, "{was} {is}");
    }
    for (view, pose) in grown.views.iter().zip(&pair) {
        assert!(
            (view.pose.origin() - pose.origin()).norm() < 1e-9 && (view.pose.tilt_rad - pose.tilt_rad).abs() < 1e-12
        );
        // What the fit found as the error of a tilt is no matter of the frame.
        assert!((view.pose.tilt_rad - view.nominal_rad).abs() < 1e-12);
    }
}

/// Where only one view shows a line its depth stays what the pair's matcher said; without that it would follow the stiffness of the
/// curve, away from where it bends.
#[test]
fn depths_that_no_other_view_shows_are_held() {
    let at = |y: f64| Point3::new(10.0 + 0.2 * y, y, 0.002 * (y + 120.0).powi(2));
    let curve: Vec<Point3> = (-120..=120).map(|y| at(f64::from(y))).collect();
    let mut rng = Pcg64::seed_from_u64(8);
    let seen = [(-4.0_f64, 240), (4.0, 60)].map(|(tilt_deg, length)| {
        let pose = ViewPose::new(tilt_deg.to_radians(), 0.0, 1.0, Point2::new(255.5, 255.5));
        (pose, noisy_lines(&[curve[..length].to_vec()], &pose, &mut rng))
    });
    let start = [StartCurve { points: curve.clone(), sigma_z: vec![1.0; curve.len()], closed: false }];
    let settings = FitSettings::default();
    let worst = |hold: bool| {
        let views = seen.iter().enumerate();
        let views =
            views.map(|(index, (pose, lines))| FitView::new(index, *pose, LineIndex::new(lines.clone()))).collect();
        let mut problem = Problem::new(&start, views, &settings);
        if hold {
            problem.hold_depths(&start);
        }
        problem.run(settings.rounds, [settings.reach_px; 2], &settings);
        let fitted = &problem.fitted(settings.reach_px)[0].points;
        fitted.iter().zip(&curve).map(|(found, truth)| (found.z - truth.z).abs()).fold(0.0, f64::max)
    };
    assert!(worst(true) < 3.0 && worst(false) > 10.0, "{} {}", worst(true), worst(false));
}

/// Depths that rise and fall twice as fast as the curve goes on, as those of wrong matches do: where points are seen in the left view
/// stays, along the curves too, at their ends above all. These curves run along y.
#[test]
fn curves_with_steep_wrong_depths_keep_their_length() {
    let settings = FitSettings::default();
    for count in [3, 9] {
        // The spline goes through the wrong depths: they are called sure.
        let starts = wavy_starts(10.0, 0.2)
            .into_iter()
            .map(|start| StartCurve { sigma_z: vec![0.1; start.points.len()], ..start });
        let starts: Vec<StartCurve> = starts.collect();
        let (_, views) = views(&tilts(count), 0.0, 5);
        let mut problem = Problem::new(&starts, views, &settings);
        let rise = |(_, along): &(Point3, Vector3)| along.z.abs() / along.xy().norm();
        let steepest = problem.points_with_tangents().iter().map(rise).fold(0.0, f64::max);
        assert!(steepest > 1.5, "{steepest}");
        problem.run(6, [6.0, 3.0], &settings);
        problem.run(10, [3.0, 3.0], &settings);
        for (curve, start) in problem.fitted(3.0).iter().zip(&starts) {
            let moved = curve.points.iter().zip(&start.points).map(|(point, from)| (point.y - from.y).abs());
            let worst = moved.fold(0.0, f64::max);
            assert!(worst < 1.5, "{count} views: {worst} px along");
        }
    }
}

/// What the rows of the pair leave free, whatever the tilt axis: a common shift along them is the depth of the frame and is fixed, one
/// across them is held as rows are, as is a turn of one view against the other; both together may turn.
#[test]
fn the_pair_keeps_its_rows() {
    let settings = FitSettings::default();
    let lines = || LineIndex::new(ViewLines::new(TraceGraph::default(), SHAPE));
    for axis_rad in [0.0, 0.4, std::f64::consts::FRAC_PI_2, -2.0] {
        let pose = |tilt_rad: f64| ViewPose::new(tilt_rad, axis_rad, 1.0, Point2::new(255.5, 255.5));
        let views = [-0.07, 0.07, 0.4].into_iter().enumerate();
        let views = views.map(|(index, tilt)| FitView::new(index, pose(tilt), lines())).collect();
        let mut problem = Problem::new(&[], views, &settings);
        // Where the images show what lies behind moving as the tilt grows, and what lies below.
        let map = pose(0.0).image_from_projection;
        let [along, across] = [map * Vector2::new(1.0, 0.0), map * Vector2::new(0.0, 1.0)];
        let cost = |problem: &Problem, view: usize, change: [f64; PER_VIEW]| {
            let prior = problem.prior(&settings);
            let mut step = DVector::zeros(prior.right.len());
            step.rows_mut(PER_VIEW * view, PER_VIEW).copy_from_slice(&change);
            (prior.matrix * &step).dot(&step)
        };
        let shift = |by: Vector2| [by.x, by.y, 0.0, 0.0, 0.0];
        let rows = settings.pair_row_sigma_px;
        approx::assert_relative_eq!(cost(&problem, 1, shift(across)), rows.powi(-2), max_relative = 1e-3);
        assert!(cost(&problem, 1, shift(along)) > 1e6 && cost(&problem, 0, shift(across)) > 1e6);
        assert!(cost(&problem, 2, shift(across)) < 1e-2 && cost(&problem, 2, shift(along)) < 1e-2);
        // Of three views, one turned alone: what the others do not share.
        let [of_view, of_axis] = [settings.turn_sigma_deg, settings.axis_sigma_deg].map(|deg| deg.to_radians().powi(2));
        let turn = (rows / 128.0).powi(-2) + (1.0 - of_axis / (of_view + 3.0 * of_axis)) / of_view;
        approx::assert_relative_eq!(cost(&problem, 1, [0.0, 0.0, 1.0, 0.0, 0.0]), turn, max_relative = 1e-9);
        // A view that is off is asked back: by as much and the other way.
        problem.views[1].pose = problem.views[1].pose.changed(0.0, 0.001, 0.0, across * 0.5, &Point2::origin());
        let right = problem.prior(&settings).right;
        let asked = Vector2::new(right[PER_VIEW], right[PER_VIEW + 1]).dot(&across);
        approx::assert_relative_eq!(asked, -0.5 * rows.powi(-2), max_relative = 1e-3);
        assert!(right[PER_VIEW + 2] < 0.0 && right[2] > 0.0);
    }
}

/// All views share the error of the axis: it costs less than turns of each view that are as large, and the fit finds it.
#[test]
fn an_axis_that_is_off_by_a_degree_is_found() {
    let settings = FitSettings::default();
    let (truth, mut views) = views(&tilts(9), 0.0, 4);
    for (view, pose) in views.iter_mut().zip(&truth) {
        view.pose = pose.changed(0.0, 1.0_f64.to_radians(), 0.0, Vector2::zeros(), &Point2::origin());
    }
    let mut problem = Problem::new(&starts(2.0), views, &settings);
    // A turn of all views together is known as well as one number with both variances, over n views: n / (turn^2 + n axis^2).
    let all = DVector::from_fn(9 * PER_VIEW, |place, _| if place % PER_VIEW == 2 { 1.0 } else { 0.0 });
    let [turn, axis] = [settings.turn_sigma_deg, settings.axis_sigma_deg].map(f64::to_radians);
    let information = 9.0 / (turn * turn + 9.0 * axis * axis);
    approx::assert_relative_eq!((problem.prior(&settings).matrix * &all).dot(&all), information, max_relative = 1e-6);
    let start = problem.views.clone();
    for view in &mut problem.views {
        view.pose = view.pose.changed(0.0, 0.001, 0.0, Vector2::zeros(), &Point2::origin());
    }
    approx::assert_relative_eq!(problem.prior(&settings).right.dot(&all), -0.001 * information, max_relative = 1e-6);
    problem.views = start;
    problem.run(10, [6.0, 3.0], &settings);
    problem.run(20, [3.0; 2], &settings);
    let off = problem.views.iter().zip(&truth).map(|(view, pose)| view.pose.axis_rad() - pose.axis_rad());
    let off = (off.sum::<f64>() / 9.0).to_degrees();
    assert!(off.abs() < 0.1, "{off}");
}

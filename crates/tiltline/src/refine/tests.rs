//! Hand-computable cases of both refinements, and what they do to rendered scenes.

use approx::assert_relative_eq;

use super::*;
use crate::curve::{Flag, MatchedPoint, TraceEnd};
use crate::geometry::{Point2, Vector2};
use crate::matching::tests::{Rendered, usual_faults};
use crate::matching::{TraceFaults, trace_through};
use crate::simulate::{Scene, SceneSettings, ViewSettings};

fn rectification(sigma_row_px: f64) -> Rectification {
    let view = ViewSettings::default();
    Rectification { sigma_row_px, ..Rectification::from_known_views(&view, &view) }
}

fn graph(traces: Vec<Trace>) -> TraceGraph {
    TraceGraph { traces, junctions: Vec::new() }
}

/// A curve along a left trace with one disparity.
fn matched(trace: &Trace, disparity_px: f64) -> MatchedCurve {
    let point = |point: &TracePoint| MatchedPoint {
        left: point.position,
        tangent_left: point.tangent,
        tangent_right: None,
        disparity_px,
        sigma_px: 1.0,
        flag: Flag::Ok,
    };
    MatchedCurve {
        left_trace: 0,
        points: trace.points.iter().map(point).collect(),
        closed: trace.closed,
        ends: [TraceEnd::Junction(0), TraceEnd::Border],
    }
}

fn vertical(x: f64, from: f64, to: f64) -> Trace {
    trace_through(&[Point2::new(x, from), Point2::new(x, to)], false, 0.1)
}

#[test]
fn nearest_snaps_within_three_pixels_and_splits_where_nothing_is_near() {
    let left = vertical(10.0, 0.0, 30.0);
    // Right points at x = 15 for rows 0 to 10 and 20 to 30; the curve predicts 13 (2 px off).
    let right = graph(vec![vertical(15.0, 0.0, 10.0), vertical(15.0, 20.0, 30.0)]);
    let curve = matched(&left, 3.0);
    let settings = RefineSettings { method: Refinement::Nearest, ..RefineSettings::default() };
    let refined = refine(vec![curve], &[graph(vec![left]), right], &rectification(0.0), &settings);
    assert_eq!(refined.len(), 2);
    // Rows 0 to 12: (13, 12) is sqrt(8) < 3 px from (15, 10), (13, 13) is sqrt(13) > 3 px.
    assert_eq!(refined[0].points.len(), 13);
    assert_eq!(refined[1].points.len(), 13);
    for point in refined.iter().flat_map(|curve| &curve.points) {
        assert_relative_eq!(point.disparity_px, 5.0, epsilon = 1e-9);
        // 0.1 px across both vertical lines, and nothing left over.
        assert_relative_eq!(point.sigma_px, 0.1 * 2.0_f64.sqrt(), epsilon = 1e-9);
    }
    assert_eq!(refined[0].ends, [TraceEnd::Junction(0), TraceEnd::Free]);
    assert_eq!(refined[1].ends, [TraceEnd::Free, TraceEnd::Border]);
}

#[test]
fn nearest_is_meant_in_the_image_plane() {
    // A right line at 45 degrees, x = y + 14, against predictions on x = y + 12: 1.41 px off, but 2 px along the row.
    let left = trace_through(&[Point2::new(10.0, 0.0), Point2::new(40.0, 30.0)], false, 0.1);
    let right = trace_through(&[Point2::new(14.0, 0.0), Point2::new(44.0, 30.0)], false, 0.1);
    let curve = matched(&left, 2.0);
    let settings = RefineSettings { method: Refinement::Nearest, max_distance_px: 3.0 };
    let refined = refine(vec![curve], &[graph(vec![left]), graph(vec![right])], &rectification(0.0), &settings);
    for point in &refined[0].points[5..25] {
        // Its foot is half way: 1 px to the right and 1 px up; points are 1 px apart, so within half of that.
        assert_relative_eq!(point.disparity_px, 3.0, epsilon = 0.5);
        // Half of the sigma of 1 that came in is along the line and stays.
        assert_relative_eq!(point.sigma_px, (0.25_f64 + 0.04).sqrt(), epsilon = 1e-6);
    }
}

#[test]
fn no_refinement_changes_nothing() {
    let left = vertical(10.0, 0.0, 30.0);
    let curve = matched(&left, 3.0);
    let settings = RefineSettings { method: Refinement::None, ..RefineSettings::default() };
    let refined = refine(vec![curve.clone()], &[graph(vec![left]), graph(vec![])], &rectification(0.0), &settings);
    assert_eq!(refined, [curve]);
}

#[test]
fn curve_moves_to_the_right_centreline_and_bridges_its_gap() {
    let left = vertical(10.0, 0.0, 60.0);
    // d = 5 + 0.05 y, off by up to 1.5 px from the prediction; rows 25 to 35 were not traced.
    let at = |y: f64| Point2::new(15.0 + 0.05 * y, y);
    let right =
        graph(vec![trace_through(&[at(0.0), at(25.0)], false, 0.1), trace_through(&[at(35.0), at(60.0)], false, 0.1)]);
    let mut curve = matched(&left, 6.5);
    curve.points[25..36].iter_mut().for_each(|point| point.flag = Flag::Bridged);
    let refined = refine(vec![curve], &[graph(vec![left]), right], &rectification(0.0), &RefineSettings::default());
    assert_eq!(refined.len(), 1);
    for point in &refined[0].points {
        assert_relative_eq!(point.disparity_px, 5.0 + 0.05 * point.left.y, epsilon = 0.01);
    }
    let points = &refined[0].points;
    assert_eq!((points[10].flag, points[30].flag), (Flag::Ok, Flag::Bridged));
    assert!(points[30].sigma_px > points[10].sigma_px);
    assert!(points[10].tangent_right.is_some() && points[30].tangent_right.is_none());
}

#[test]
fn the_error_of_the_row_is_not_averaged_away() {
    // A line at 45 degrees: cot psi is 1 all along, and the whole curve moves by the row error.
    let left = trace_through(&[Point2::new(10.0, 0.0), Point2::new(110.0, 100.0)], false, 0.1);
    let right = trace_through(&[Point2::new(14.0, 0.0), Point2::new(114.0, 100.0)], false, 0.1);
    let sigma = |sigma_row_px: f64| {
        let traces = [graph(vec![left.clone()]), graph(vec![right.clone()])];
        let refined =
            refine(vec![matched(&left, 4.0)], &traces, &rectification(sigma_row_px), &RefineSettings::default());
        refined[0].points[70].sigma_px
    };
    // A calibrated sigma is larger than what the model alone says, by the stated factor.
    let modelled = |sigma_row_px: f64| sigma(sigma_row_px) / curve::CALIBRATION;
    assert!(modelled(0.0) < 0.1);
    assert!(modelled(0.7) > 0.69 && modelled(0.7) < 0.85, "{}", modelled(0.7));
}

#[test]
fn a_closed_curve_does_not_care_where_it_starts() {
    let circle = |at: f64, from: usize| -> Vec<Point2> {
        let angle = |i: usize| ((i + from) % 150) as f64 / 150.0 * std::f64::consts::TAU;
        (0..150).map(|i| Point2::new(at + 24.0 * angle(i).cos(), 40.0 + 24.0 * angle(i).sin())).collect()
    };
    let right = graph(vec![trace_through(&circle(45.0, 20), true, 0.1)]);
    let refined = |from: usize| {
        let left = trace_through(&circle(40.0, from), true, 0.1);
        let mut refined = refine(
            vec![matched(&left, 4.5)],
            &[graph(vec![left]), right.clone()],
            &rectification(0.0),
            &RefineSettings::default(),
        );
        refined.remove(0)
    };
    for from in [0, 40] {
        let curve = refined(from);
        assert!(curve.closed);
        for point in &curve.points {
            assert_relative_eq!(point.disparity_px, 5.0, epsilon = 0.02);
        }
    }
}

#[test]
fn refining_along_curves_beats_both_alternatives_on_rendered_scenes() {
    let scene = Scene::random(&SceneSettings { seed: 11, ..SceneSettings::default() });
    let rendered = Rendered::new(&scene, 512, &TraceFaults { false_lines: 0, ..usual_faults(11) });
    let matched = rendered.matched();
    let error = |method: Refinement| {
        let settings = RefineSettings { method, ..RefineSettings::default() };
        let refined = refine(matched.clone(), &rendered.traces, &rendered.pair.rectification, &settings);
        let (mut sum, mut count) = (0.0, 0.0);
        for curve in &refined {
            for point in curve.points.iter().filter(|point| point.flag == Flag::Ok) {
                let truth = rendered.truth(curve.left_trace, &point.left).expect("a true line");
                sum += (point.disparity_px - truth).abs();
                count += 1.0;
            }
        }
        sum / count
    };
    let (none, nearest, curve) = (error(Refinement::None), error(Refinement::Nearest), error(Refinement::Curve));
    // Averaging over several correlation lengths of the tracing error at least halves it.
    assert!(curve < 0.5 * none && curve < 0.5 * nearest, "{none} {nearest} {curve}");
}

#[test]
fn tangents_are_carried() {
    let left = vertical(10.0, 0.0, 30.0);
    let right = vertical(12.0, 0.0, 30.0);
    let traces = [graph(vec![left.clone()]), graph(vec![right])];
    let refined = refine(vec![matched(&left, 2.0)], &traces, &rectification(0.0), &RefineSettings::default());
    assert_eq!(refined[0].points[15].tangent_right, Some(Vector2::y()));
}

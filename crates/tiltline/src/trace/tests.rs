//! Laws of tracing on line maps drawn here.

use super::*;
use crate::oracle::Oracle;
use crate::pipeline::Detect;
use crate::rectify::{Rectification, RectifiedPair};
use crate::simulate::draw::union_of_profiles;
use crate::simulate::{Scene, SceneSettings, ViewSettings};

const SIGMA: f64 = 1.5;

/// A map of Gaussian profiles along polylines.
fn map(shape: [usize; 2], polylines: &[Vec<Point2>]) -> LineMap {
    LineMap { probability: union_of_profiles(shape, polylines, SIGMA), line_width_px: SIGMA * 2.355 }
}

fn line(from: (f64, f64), to: (f64, f64)) -> Vec<Point2> {
    vec![Point2::new(from.0, from.1), Point2::new(to.0, to.1)]
}

fn traced(shape: [usize; 2], polylines: &[Vec<Point2>]) -> TraceGraph {
    trace(&map(shape, polylines), &TraceSettings::default())
}

/// Distance of a point to polylines.
fn distance(point: &Point2, polylines: &[Vec<Point2>]) -> f64 {
    let segments = polylines.iter().flat_map(|polyline| polyline.windows(2));
    segments
        .map(|ends| {
            let along = ends[1] - ends[0];
            let foot = ((point - ends[0]).dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
            (point - (ends[0] + along * foot)).norm()
        })
        .fold(f64::INFINITY, f64::min)
}

#[test]
fn a_straight_line_at_any_angle_has_its_length_and_place() {
    for degrees in [0.0_f64, 7.0, 22.5, 45.0, 63.0, 90.0, 117.0, 135.0, 171.0] {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let (x, y) = (100.3 + 0.13 * degrees / 9.0, 99.6);
        let truth = line((x - 70.0 * cos, y - 70.0 * sin), (x + 70.0 * cos, y + 70.0 * sin));
        let graph = traced([200, 200], std::slice::from_ref(&truth));
        assert_eq!((graph.traces.len(), graph.junctions.len()), (1, 0), "{degrees}");
        let trace = &graph.traces[0];
        assert!((trace.length_px() - 140.0).abs() < 1.4, "{degrees}: {}", trace.length_px());
        assert_eq!(trace.ends, [TraceEnd::Free; 2]);
        for pair in trace.points.windows(2) {
            assert!(((pair[1].position - pair[0].position).norm() - 1.0).abs() < 0.05, "points are 1 px apart");
        }
        for point in &trace.points {
            assert!(point.tangent.perp(&truth[1].coords.normalize()).is_finite());
            assert!(point.tangent.perp(&(truth[1] - truth[0]).normalize()).abs() < 0.02, "{degrees}");
        }
        let inner = &trace.points[5..trace.points.len() - 5];
        // Interpolation of a sampled Gaussian of sigma 1.5 is good to about 0.02 px.
        assert!(inner.iter().all(|p| distance(&p.position, std::slice::from_ref(&truth)) < 0.04), "{degrees}");
    }
}

#[test]
fn a_circle_is_closed_and_has_two_pi_r() {
    for radius in [12.0, 30.0, 70.0] {
        let circle: Vec<Point2> = (0..=360)
            .map(|degree| {
                let (sin, cos) = f64::from(degree).to_radians().sin_cos();
                Point2::new(90.2 + radius * cos, 89.7 + radius * sin)
            })
            .collect();
        let graph = traced([180, 180], &[circle]);
        assert_eq!((graph.traces.len(), graph.junctions.len()), (1, 0));
        let trace = &graph.traces[0];
        assert!(trace.closed);
        let expected = std::f64::consts::TAU * radius;
        assert!((trace.length_px() / expected - 1.0).abs() < 0.01, "{radius}: {} {expected}", trace.length_px());
    }
}

#[test]
fn crossing_lines_pass_through_each_other() {
    for (from, to) in [((20.0, 100.0), (180.0, 100.0)), ((20.0, 60.0), (180.0, 140.0)), ((30.0, 40.0), (170.0, 170.0))]
    {
        let truth = [line(from, to), line((104.0, 15.0), (96.0, 185.0))];
        let graph = traced([200, 200], &truth);
        assert_eq!((graph.traces.len(), graph.junctions.len()), (2, 0), "{from:?}");
        for trace in &graph.traces {
            let ends = [trace.points[0].position, trace.points[trace.points.len() - 1].position];
            assert!(truth.iter().any(|line| ends.iter().all(|end| distance(end, std::slice::from_ref(line)) < 0.5)));
            assert!(trace.points.iter().all(|point| distance(&point.position, &truth) < 0.5));
        }
    }
}

#[test]
fn a_shallow_crossing_is_a_crossing_and_not_two_junctions() {
    // 30 degrees: the mask of the two merges over more than 10 px.
    let truth = [line((20.0, 78.0), (180.0, 122.0)), line((20.0, 122.0), (180.0, 78.0))];
    let graph = traced([200, 200], &truth);
    assert_eq!((graph.traces.len(), graph.junctions.len()), (2, 0));
}

#[test]
fn a_t_stays_a_junction_of_three_traces() {
    for lean in [0.0, 20.0] {
        let truth = [line((20.0, 100.0), (180.0, 100.0)), line((100.0, 100.0), (100.0 + lean, 180.0))];
        let graph = traced([200, 200], &truth);
        assert_eq!((graph.traces.len(), graph.junctions.len()), (3, 1));
        assert!((graph.junctions[0] - Point2::new(100.0, 100.0)).norm() < 1.5, "{}", graph.junctions[0]);
        for trace in &graph.traces {
            assert_eq!(trace.ends.iter().filter(|end| **end == TraceEnd::Junction(0)).count(), 1);
            let at = if trace.ends[0] == TraceEnd::Junction(0) { 0 } else { trace.points.len() - 1 };
            assert!((trace.points[at].position - graph.junctions[0]).norm() < 1.0, "traces reach their junction");
        }
    }
}

#[test]
fn a_gap_is_bridged_and_a_line_that_stops_short_of_another_meets_it() {
    let gap = [line((20.0, 60.0), (97.0, 64.0)), line((105.0, 64.4), (180.0, 68.0))];
    let graph = traced([120, 200], &gap);
    assert_eq!(graph.traces.len(), 1);
    assert!((graph.traces[0].length_px() - 160.2).abs() < 1.6);
    let stops = [line((20.0, 60.0), (180.0, 60.0)), line((100.0, 66.0), (104.0, 110.0))];
    let graph = traced([120, 200], &stops);
    assert_eq!((graph.traces.len(), graph.junctions.len()), (3, 1));
    let apart = [line((20.0, 40.0), (90.0, 40.0)), line((110.0, 48.0), (180.0, 48.0))];
    assert_eq!(traced([120, 200], &apart).traces.len(), 2, "8 px aside is another line");
}

#[test]
fn short_spurs_and_short_pieces_go_and_ends_at_the_border_are_told() {
    let truth =
        [line((-10.0, 50.0), (150.0, 54.0)), line((80.0, 52.0), (80.0, 57.5)), line((40.0, 90.0), (49.0, 92.0))];
    let graph = traced([120, 200], &truth);
    assert_eq!((graph.traces.len(), graph.junctions.len()), (1, 0));
    let mut ends = graph.traces[0].ends;
    ends.sort_by_key(|end| *end == TraceEnd::Border);
    assert_eq!(ends, [TraceEnd::Free, TraceEnd::Border]);

    // The same free end where the data stop 5 px further.
    let has_data = Array2::from_shape_fn((120, 200), |(_, column)| column < 155);
    let graph = trace_within(&map([120, 200], &truth), Some(&has_data), &TraceSettings::default());
    assert_eq!(graph.traces[0].ends, [TraceEnd::Border; 2]);
}

#[test]
fn a_mirrored_or_turned_map_has_the_mirrored_or_turned_traces() {
    let scene = Scene::random(&SceneSettings { size_px: 200.0, curves: 5, ..SceneSettings::default() });
    let curves = ViewSettings { shape: [201, 201], ..ViewSettings::default() }.project_curves(&scene);
    let length =
        |curves: &[Vec<Point2>]| traced([201, 201], curves).traces.iter().map(|trace| trace.length_px()).sum::<f64>();
    let moved = |f: fn(&Point2) -> Point2| -> Vec<Vec<Point2>> {
        curves.iter().map(|curve| curve.iter().map(f).collect()).collect()
    };
    let plain = length(&curves);
    for other in [moved(|p| Point2::new(200.0 - p.x, p.y)), moved(|p| Point2::new(p.y, 200.0 - p.x))] {
        // Thinning goes side by side, so that ends and crossings may differ by about a pixel each.
        assert!((length(&other) / plain - 1.0).abs() < 0.02, "{} {plain}", length(&other));
        let graph = traced([201, 201], &other);
        let mut errors: Vec<f64> =
            graph.traces.iter().flat_map(|t| &t.points).map(|p| distance(&p.position, &other)).collect();
        errors.sort_by(f64::total_cmp);
        assert!(errors[errors.len() / 2] < 0.03);
    }
}

#[test]
fn the_oracles_map_is_traced_to_a_twentieth_of_a_pixel() {
    let mut errors = Vec::new();
    let (mut found, mut all) = (0, 0);
    for seed in 1..4 {
        let scene = Scene::random(&SceneSettings { seed, ..SceneSettings::default() });
        let view = ViewSettings::default();
        let rectification = Rectification::from_known_views(&view, &view);
        let oracle = Oracle::new(&scene, [&view, &view], &rectification);
        let blank = Array2::zeros((512, 512));
        let pair = RectifiedPair { left: blank.clone(), right: blank, rectification };
        let graph = trace(&oracle.detect(&pair, crate::micrograph::View::Left), &TraceSettings::default());
        let truth = &oracle.curves[0];
        let points: Vec<Point2> = graph.traces.iter().flat_map(|t| &t.points).map(|p| p.position).collect();
        errors.extend(points.iter().map(|point| distance(point, truth)));
        for point in truth.iter().flatten().filter(|p| p.x > 0.0 && p.y > 0.0 && p.x < 511.0 && p.y < 511.0) {
            all += 1;
            found += usize::from(points.iter().any(|traced| (traced - point).norm() < 2.0));
        }
    }
    errors.sort_by(f64::total_cmp);
    let at = |share: f64| errors[(errors.len() as f64 * share) as usize];
    assert!(at(0.5) < 0.05, "median {}", at(0.5));
    // Where lines touch or cross at a small angle their crests merge: one point in ten or so lies further off.
    assert!(at(0.85) < 0.1, "85 percent {}", at(0.85));
    assert!(found as f64 / all as f64 > 0.98, "{found} of {all}");
}

#[test]
fn an_empty_map_and_a_full_one_have_no_lines_that_crash() {
    assert_eq!(traced([20, 30], &[]), TraceGraph::default());
    assert_eq!(traced([0, 0], &[]), TraceGraph::default());
    let full = LineMap { probability: Array2::from_elem((30, 30), 1.0), line_width_px: 3.0 };
    let graph = trace(&full, &TraceSettings::default());
    assert!(graph.traces.iter().all(|trace| trace.points.len() >= 2));
}

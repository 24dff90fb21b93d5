//! Laws of matching, toy scenes with known answers, and rendered scenes.

use super::*;
use crate::curve::{Flag, TraceEnd};
use crate::geometry::{Point2, Point3, angle_to_row};
use crate::micrograph::View;
use crate::oracle::Oracle;
use crate::pipeline::Detect;
use crate::refine::{RefineSettings, refine};
use crate::simulate::scene::bezier;
use crate::simulate::{Scene, SceneSettings, ViewSettings, render};

/// A rendered pair with its truth and traces made from it.
pub(crate) struct Rendered {
    pub pair: RectifiedPair,
    pub oracle: Oracle,
    pub lines: [LineMap; 2],
    pub traces: [TraceGraph; 2],
    /// The true curve of each left trace.
    pub sources: Vec<Option<usize>>,
}

impl Rendered {
    /// A scene at +-4 degrees, signal-to-noise 10, in images of `size` px.
    pub fn new(scene: &Scene, size: usize, faults: &TraceFaults) -> Self {
        let [left, right] = [-4.0_f64, 4.0].map(|tilt_deg| ViewSettings {
            shape: [size, size],
            tilt_rad: tilt_deg.to_radians(),
            seed: if tilt_deg > 0.0 { 2 } else { 1 },
            ..ViewSettings::default()
        });
        let rectification = Rectification::from_known_views(&left, &right);
        let oracle = Oracle::new(scene, [&left, &right], &rectification);
        let [left, right] = [&left, &right].map(|view| render(scene, view).normalised());
        let pair = RectifiedPair { left, right, rectification };
        let lines = View::BOTH.map(|view| oracle.detect(&pair, view));
        let [(left, sources), (right, _)] = [0, 1].map(|view| {
            let faults = TraceFaults { seed: faults.seed + view as u64, ..*faults };
            known_traces(&oracle.curves[view], [size, size], &faults)
        });
        Self { pair, oracle, lines, traces: [left, right], sources }
    }

    pub fn matched(&self) -> Vec<MatchedCurve> {
        ClassicalMatcher::default().match_curves(&self.pair, &self.lines, &self.traces)
    }

    /// True disparity of the curve that a left trace comes from, at the point of it nearest to `left`.
    pub fn truth(&self, left_trace: usize, left: &Point2) -> Option<f64> {
        let curve = self.sources[left_trace]?;
        let [left_curve, right_curve] = [0, 1].map(|view| &self.oracle.curves[view][curve]);
        let d = |index: usize| right_curve[index].x - left_curve[index].x;
        let mut best = (f64::INFINITY, 0.0);
        for index in 1..left_curve.len() {
            let along = left_curve[index] - left_curve[index - 1];
            let offset = left - left_curve[index - 1];
            let t = (offset.dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
            let distance = (offset - along * t).norm();
            if distance < best.0 {
                best = (distance, d(index - 1) * (1.0 - t) + d(index) * t);
            }
        }
        Some(best.1)
    }
}

/// Faults of the size a tracer has at signal-to-noise 10.
pub(crate) fn usual_faults(seed: u64) -> TraceFaults {
    TraceFaults { sigma_perp_px: 0.2, correlation_px: 1.1, gap_every_px: 300.0, false_lines: 5, seed }
}

fn random_scene(seed: u64) -> Scene {
    Scene::random(&SceneSettings { seed, ..SceneSettings::default() })
}

/// Straight or bowed lines through the given control points.
fn lines_scene(controls: &[[[f64; 3]; 4]]) -> Scene {
    let curves = controls.iter().map(|control| bezier(control.map(|[x, y, z]| Point3::new(x, y, z)))).collect();
    Scene { curves, specks: Scene::random(&SceneSettings { size_px: 160.0, specks: 250, ..Default::default() }).specks }
}

/// Control points of a straight line.
fn straight(from: [f64; 3], to: [f64; 3]) -> [[f64; 3]; 4] {
    [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0].map(|t| [0, 1, 2].map(|axis| from[axis] + (to[axis] - from[axis]) * t))
}

fn all_points(curves: &[MatchedCurve]) -> impl Iterator<Item = (usize, &crate::curve::MatchedPoint)> {
    curves.iter().flat_map(|curve| curve.points.iter().map(|point| (curve.left_trace, point)))
}

#[test]
fn rendered_scenes_are_matched_to_a_fraction_of_a_pixel_with_an_honest_sigma() {
    let (mut errors, mut within, mut matched_px, mut true_px) = (Vec::new(), 0, 0.0, 0.0);
    for seed in 0..3 {
        let rendered = Rendered::new(&random_scene(seed), 512, &usual_faults(10 * seed));
        let matched = rendered.matched();
        let settings = RefineSettings::default();
        let refined = refine(matched, &rendered.traces, &rendered.pair.rectification, &settings);
        for (trace, point) in all_points(&refined) {
            if point.flag == Flag::Ok {
                let truth = rendered.truth(trace, &point.left).expect("false lines have no match");
                errors.push((point.disparity_px - truth).abs());
                // Here the errors that the model knows are all there are; what foils add is not.
                let modelled = point.sigma_px / crate::refine::curve::CALIBRATION;
                within += usize::from(errors[errors.len() - 1] <= modelled);
            }
        }
        matched_px += refined.iter().map(MatchedCurve::length_px).sum::<f64>();
        let true_traces =
            rendered.traces[0].traces.iter().zip(&rendered.sources).filter(|(_, source)| source.is_some());
        true_px += true_traces.map(|(trace, _)| trace.length_px()).sum::<f64>();
    }
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    let share = within as f64 / errors.len() as f64;
    // 0.2 px across both lines and averaging over a correlation length or more leave 0.12; the bar is 0.5.
    assert!(mean < 0.2, "mean error {mean}");
    assert!(matched_px / true_px > 0.95, "completeness {}", matched_px / true_px);
    // Errors along one curve are alike, so that some 60 curves give the share to within 0.1.
    assert!((0.58..0.82).contains(&share), "{share} within one sigma");
}

#[test]
fn swapping_left_and_right_negates_disparity() {
    let rendered = Rendered::new(&random_scene(7), 512, &TraceFaults::none());
    let Rendered { pair, lines: [left, right], traces: [left_traces, right_traces], .. } = &rendered;
    let swapped_pair =
        RectifiedPair { left: pair.right.clone(), right: pair.left.clone(), rectification: pair.rectification.clone() };
    let forth = rendered.matched();
    let back = ClassicalMatcher::default().match_curves(
        &swapped_pair,
        &[right.clone(), left.clone()],
        &[right_traces.clone(), left_traces.clone()],
    );
    let mut compared = 0;
    for (_, point) in all_points(&forth).filter(|(_, point)| point.flag == Flag::Ok) {
        let right = point.right();
        let back = back.iter().flat_map(|curve| curve.points.windows(2)).find_map(|pair| {
            let along = pair[1].left - pair[0].left;
            let t = (right - pair[0].left).dot(&along) / along.norm_squared();
            let near = (0.0..=1.0).contains(&t) && (pair[0].left + along * t - right).norm() < 0.05;
            let same = pair[0].right() + (pair[1].right() - pair[0].right()) * t;
            (near && (same - point.left).norm() < 1.0 && pair.iter().all(|point| point.flag == Flag::Ok))
                .then(|| pair[0].disparity_px + (pair[1].disparity_px - pair[0].disparity_px) * t)
        });
        if let Some(back) = back {
            compared += 1;
            // The chord of a curve over 1 px strays from it by less than this.
            assert!((point.disparity_px + back).abs() < 0.05, "{} and {back}", point.disparity_px);
        }
    }
    let all = all_points(&forth).filter(|(_, point)| point.flag == Flag::Ok).count();
    assert!(compared as f64 > 0.97 * all as f64, "{compared} of {all}");
}

#[test]
fn shifting_one_image_shifts_all_disparities_and_changes_no_shape() {
    const SHIFT: usize = 7;
    // Without false lines: their chance matches may lie anywhere in the range, hence leave it when it is shifted.
    let faults = TraceFaults { false_lines: 0, ..usual_faults(3) };
    let mut rendered = Rendered::new(&random_scene(3), 512, &faults);
    let plain = rendered.matched();
    let shifted = |image: &ndarray::Array2<f32>, fill: f32| {
        ndarray::Array2::from_shape_fn(image.dim(), |(row, x)| if x < SHIFT { fill } else { image[[row, x - SHIFT]] })
    };
    rendered.pair.right = shifted(&rendered.pair.right, f32::NAN);
    rendered.lines[1].probability = shifted(&rendered.lines[1].probability, 0.0);
    for trace in &mut rendered.traces[1].traces {
        trace.points.iter_mut().for_each(|point| point.position.x += SHIFT as f64);
    }
    let moved = rendered.matched();
    assert_eq!(plain.len(), moved.len());
    for (a, b) in plain.iter().zip(&moved) {
        assert_eq!((a.left_trace, a.points.len(), a.closed, a.ends), (b.left_trace, b.points.len(), b.closed, b.ends));
        for (a, b) in a.points.iter().zip(&b.points) {
            assert!((b.disparity_px - a.disparity_px - SHIFT as f64).abs() < 1e-6);
            assert_eq!(a.flag, b.flag);
        }
    }
}

#[test]
fn equal_images_have_no_disparity() {
    let mut rendered = Rendered::new(&random_scene(5), 512, &TraceFaults::none());
    rendered.pair.right = rendered.pair.left.clone();
    rendered.lines[1] = rendered.lines[0].clone();
    rendered.traces[1] = rendered.traces[0].clone();
    let matched = rendered.matched();
    for (_, point) in all_points(&matched).filter(|(_, point)| point.flag == Flag::Ok) {
        assert!(point.disparity_px.abs() < 1e-6, "{point:?}");
    }
    let length: f64 = matched.iter().map(MatchedCurve::length_px).sum();
    let traced: f64 = rendered.traces[0].traces.iter().map(crate::curve::Trace::length_px).sum();
    assert!(length > 0.97 * traced);
}

#[test]
fn lines_that_cross_at_different_depth_keep_their_own() {
    // +-45 px of depth are +-6.3 px of disparity; they cross at the centre in the mid view.
    let scene = lines_scene(&[
        straight([-30.0, -60.0, 45.0], [30.0, 60.0, 45.0]),
        straight([30.0, -60.0, -45.0], [-30.0, 60.0, -45.0]),
    ]);
    let rendered = Rendered::new(&scene, 160, &usual_faults(1));
    let matched = rendered.matched();
    assert!(matched.len() >= 2);
    for (trace, point) in all_points(&matched) {
        let truth = rendered.truth(trace, &point.left).expect("a true line");
        // 5 sigma of 0.2 px across both lines, at 63 degrees.
        assert!((point.disparity_px - truth).abs() < 5.0 * 0.2 * 2.0_f64.sqrt() / 0.89, "{point:?}, truth {truth}");
    }
}

#[test]
fn lines_that_overlap_and_change_sides_are_not_exchanged() {
    // Nearly parallel, 80 px apart in depth: one passes from the left of the other to its right between the views, and
    // the bowed one meets the straight one twice in either view.
    let scene = lines_scene(&[
        straight([-22.0, -70.0, 40.0], [22.0, 70.0, 40.0]),
        [[-28.0, -70.0, -40.0], [0.0, -30.0, -40.0], [14.0, 20.0, -40.0], [16.0, 70.0, -40.0]],
    ]);
    let rendered = Rendered::new(&scene, 160, &TraceFaults { false_lines: 0, ..usual_faults(4) });
    let matched = rendered.matched();
    let mut errors: Vec<f64> = all_points(&matched)
        .map(|(trace, point)| (point.disparity_px - rendered.truth(trace, &point.left).expect("a true line")).abs())
        .collect();
    errors.sort_by(f64::total_cmp);
    assert!(errors.len() > 260);
    // Exchanged lines would be wrong by up to 11 px over tens of px of length.
    assert!(errors[errors.len() * 99 / 100] < 1.5);
}

#[test]
fn a_stretch_along_the_row_is_bridged_and_flagged_with_a_large_sigma() {
    // An arch whose top runs along the row, level in depth at first, then sinking.
    let scene = lines_scene(&[[[-60.0, 40.0, -30.0], [-40.0, -50.0, -10.0], [40.0, -50.0, 10.0], [60.0, 40.0, 30.0]]]);
    let rendered = Rendered::new(&scene, 160, &TraceFaults { gap_every_px: f64::INFINITY, ..usual_faults(2) });
    for refined in [false, true] {
        let mut matched = rendered.matched();
        matched.retain(|curve| rendered.sources[curve.left_trace].is_some());
        if refined {
            matched = refine(matched, &rendered.traces, &rendered.pair.rectification, &RefineSettings::default());
        }
        assert_eq!(matched.len(), 1, "one line, one curve");
        let points = &matched[0].points;
        let flat: Vec<_> = points.iter().filter(|point| angle_to_row(&point.tangent_left).to_degrees() < 8.0).collect();
        assert!(flat.len() > 10);
        let steep = points.iter().filter(|point| angle_to_row(&point.tangent_left).to_degrees() > 45.0);
        let steep_sigma = steep.map(|point| point.sigma_px).fold(0.0, f64::max);
        for point in &flat {
            assert_ne!(point.flag, Flag::Ok);
            let truth = rendered.truth(matched[0].left_trace, &point.left).expect("a true line");
            assert!((point.disparity_px - truth).abs() < 4.0 * point.sigma_px);
        }
        let middle = flat[flat.len() / 2];
        assert!(middle.sigma_px > steep_sigma);
    }
}

#[test]
fn a_line_that_was_not_traced_on_the_right_is_found_by_its_looks() {
    let scene = lines_scene(&[straight([-20.0, -60.0, 35.0], [10.0, 60.0, -20.0])]);
    let mut rendered = Rendered::new(&scene, 160, &TraceFaults::none());
    rendered.traces[1] = TraceGraph::default();
    let matched = rendered.matched();
    let length: f64 = matched.iter().map(MatchedCurve::length_px).sum();
    assert!(length > 0.8 * rendered.traces[0].traces[0].length_px());
    for (trace, point) in all_points(&matched) {
        let truth = rendered.truth(trace, &point.left).expect("a true line");
        assert!((point.disparity_px - truth).abs() < 3.0 * point.sigma_px);
        assert!(point.sigma_px >= 0.5 && point.tangent_right.is_none());
    }
}

#[test]
fn a_line_in_one_view_only_has_no_match() {
    let scene = lines_scene(&[straight([-20.0, -60.0, 10.0], [-10.0, 60.0, 10.0])]);
    let mut rendered = Rendered::new(&scene, 160, &TraceFaults::none());
    // Traced where there is nothing: in the left image, 40 px beside the line.
    let ghost = trace_through(&[Point2::new(110.0, 30.0), Point2::new(120.0, 130.0)], false, 0.2);
    rendered.traces[0].traces.push(ghost);
    let matched = rendered.matched();
    assert!(matched.iter().all(|curve| curve.left_trace == 0) && !matched.is_empty());
}

#[test]
fn a_loop_stays_closed_and_a_line_keeps_its_ends() {
    let circle = |at: f64| -> Vec<Point2> {
        (0..120)
            .map(|i| (i as f64 / 120.0 * std::f64::consts::TAU).sin_cos())
            .map(|(s, c)| Point2::new(at + 30.0 * c, 60.0 + 30.0 * s))
            .collect()
    };
    let line = |at: f64| [Point2::new(at, 20.0), Point2::new(at + 10.0, 100.0)];
    let image = |d: f64| {
        let mut closed = circle(60.0 + d);
        closed.push(closed[0]);
        let lines = [closed, line(110.0 - d).to_vec()];
        crate::simulate::draw::union_of_profiles([120, 160], &lines, 1.5)
    };
    let graph = |d: f64| {
        let mut line = trace_through(&line(110.0 - d), false, 0.1);
        line.ends = [TraceEnd::Junction(3), TraceEnd::Border];
        TraceGraph { traces: vec![trace_through(&circle(60.0 + d), true, 0.1), line], junctions: Vec::new() }
    };
    let map = |d: f64| LineMap { probability: image(d), line_width_px: 3.5 };
    let view = ViewSettings::default();
    let rectification = Rectification::from_known_views(&view, &view);
    let pair = RectifiedPair { left: image(0.0), right: image(4.0), rectification };
    let matched = ClassicalMatcher::default().match_curves(&pair, &[map(0.0), map(4.0)], &[graph(0.0), graph(4.0)]);
    assert_eq!(matched.len(), 2);
    assert!(matched[0].closed && matched[0].points.len() == graph(0.0).traces[0].points.len());
    for point in matched[0].points.iter().filter(|point| point.flag == Flag::Ok) {
        assert!((point.disparity_px - 4.0).abs() < 1e-6);
    }
    assert!(!matched[1].closed);
    assert_eq!(matched[1].ends, [TraceEnd::Junction(3), TraceEnd::Border]);
    assert!(matched[1].points.iter().all(|point| (point.disparity_px + 4.0).abs() < 1e-6));
}

#[test]
fn the_range_is_the_users_then_that_of_the_point_matches_then_wide() {
    let view = ViewSettings::default();
    let mut rectification = Rectification::from_known_views(&view, &view);
    let range = |max_disparity_px: f64, rectification: &Rectification| {
        MatchSettings { max_disparity_px }.range_px(rectification)
    };
    assert_eq!(range(0.0, &rectification), [-32.0, 32.0]);
    rectification.disparity_range_px = [-2.0, 3.0];
    assert_eq!(range(0.0, &rectification), [-8.0, 9.0]);
    rectification.disparity_range_px = [10.0, 30.0];
    assert_eq!(range(0.0, &rectification), [0.0, 40.0]);
    assert_eq!(range(5.0, &rectification), [-5.0, 5.0]);
}

#[test]
fn empty_inputs_give_no_curves() {
    let rendered = Rendered::new(&Scene::default(), 64, &TraceFaults::none());
    assert!(rendered.matched().is_empty());
}

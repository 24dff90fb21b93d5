//! Laws of the ridge detector on images drawn here, and scores on rendered scenes.

use super::*;
use crate::curve::TraceGraph;
use crate::geometry::Point2;
use crate::rectify::Rectification;
use crate::simulate::draw::profile;
use crate::simulate::{Scene, SceneSettings, ViewSettings, render};
use crate::trace::{TraceSettings, trace};
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};

/// A pair whose two views are both this image.
fn pair(image: Array2<f32>) -> RectifiedPair {
    let view = ViewSettings { shape: image.dim().into(), ..ViewSettings::default() };
    RectifiedPair { left: image.clone(), right: image, rectification: Rectification::from_known_views(&view, &view) }
}

fn detect(image: &Array2<f32>, lines: LinePolarity) -> LineMap {
    let settings = RidgeSettings { lines, ..RidgeSettings::default() };
    RidgeDetector { settings }.detect(&pair(image.clone()), View::Left)
}

fn traced(image: &Array2<f32>, lines: LinePolarity) -> TraceGraph {
    trace(&detect(image, lines), &TraceSettings::default())
}

fn length(graph: &TraceGraph) -> f64 {
    graph.traces.iter().map(|trace| trace.length_px()).sum()
}

fn with_noise(mut image: Array2<f32>, sigma: f32, seed: u64) -> Array2<f32> {
    let normal = Normal::new(0.0, sigma).unwrap();
    let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
    image.mapv_inplace(|value| value + normal.sample(&mut rng));
    image
}

/// A dark line of depth 0.5 on a background of 1.
fn dark_line(shape: [usize; 2], polyline: &[Point2], sigma: f64) -> Array2<f32> {
    let mut image = Array2::from_elem(shape, 1.0);
    profile(shape, polyline, sigma, |row, column, value| image[[row, column]] -= 0.5 * value);
    image
}

/// A gentle arc of radius 150 px.
fn arc() -> Vec<Point2> {
    (-60..=60)
        .map(|step| {
            let (sin, cos) = (f64::from(step) * 0.5).to_radians().sin_cos();
            Point2::new(100.3 + 150.0 * sin, 230.8 - 150.0 * cos)
        })
        .collect()
}

/// Root mean square distance of the traced points from a circle about (100.3, 230.8), without 8 px at each end.
fn rms_off_arc(graph: &TraceGraph) -> f64 {
    let off = |point: &Point2| (point - Point2::new(100.3, 230.8)).norm() - 150.0;
    let inner: Vec<f64> = graph
        .traces
        .iter()
        .flat_map(|trace| &trace.points[8..trace.points.len() - 8])
        .map(|point| off(&point.position).powi(2))
        .collect();
    (inner.iter().sum::<f64>() / inner.len() as f64).sqrt()
}

#[test]
fn a_line_is_found_where_it_is_and_with_its_width() {
    for sigma in [1.0, 1.5, 2.5] {
        let image = dark_line([200, 200], &arc(), sigma);
        let lines = detect(&image, LinePolarity::Dark);
        assert!((lines.line_width_px / (sigma * FWHM) - 1.0).abs() < 0.25, "{sigma}: {}", lines.line_width_px);
        let graph = trace(&lines, &TraceSettings::default());
        assert_eq!(graph.traces.len(), 1);
        let rms = rms_off_arc(&graph);
        assert!(rms < 0.05, "sigma {sigma}: rms {rms}");
        // 157 px; each end is good to about the line's own width.
        assert!((length(&graph) - 157.1).abs() < 2.0 * sigma * FWHM, "{sigma}: {}", length(&graph));
    }
}

#[test]
fn at_a_signal_to_noise_of_ten_a_line_is_placed_within_a_fifth_of_a_pixel() {
    let (mut within, mut all) = (0, 0);
    for seed in 0..6 {
        let image = with_noise(dark_line([200, 200], &arc(), 1.5), 0.05, seed);
        let graph = traced(&image, LinePolarity::Dark);
        assert_eq!(graph.traces.len(), 1, "seed {seed}");
        let rms = rms_off_arc(&graph);
        assert!(rms < 0.2, "seed {seed}: rms {rms}");
        for point in &graph.traces[0].points {
            let off = (point.position - Point2::new(100.3, 230.8)).norm() - 150.0;
            within += i32::from(off.abs() < point.sigma_perp_px);
            all += 1;
        }
    }
    // One sigma holds 68 percent; neighbours are correlated, so that 6 lines give about 8 percent either way.
    let share = f64::from(within) / f64::from(all);
    assert!((0.55..0.9).contains(&share), "{share} within one sigma");
}

#[test]
fn steps_bands_ramps_and_blobs_are_no_lines() {
    let shape = (200, 200);
    let draw =
        |f: &dyn Fn(f64, f64) -> f64| Array2::from_shape_fn(shape, |(row, column)| f(column as f64, row as f64) as f32);
    // At a slant, so that nothing lies on the grid. `u` is the distance from the middle.
    let slant = |x: f64, y: f64| (x - 100.0) * 0.94 + (y - 100.0) * 0.34;
    let edge = |u: f64| 0.5 + 0.5 * (u / 1.5).tanh();
    let step = draw(&|x, y| edge(slant(x, y)));
    let band = draw(&|x, y| 1.0 - 0.6 * (edge(slant(x, y) + 18.0) - edge(slant(x, y) - 18.0)));
    let ramp = draw(&|x, y| 0.5 + 0.003 * slant(x, y));
    let blob = draw(&|x, y| 1.0 - 0.5 * (-((x - 90.0).powi(2) + (y - 110.0).powi(2)) / 18.0).exp());
    for (name, image) in [("step", step), ("band", band), ("ramp", ramp), ("blob", blob)] {
        for polarity in [LinePolarity::Dark, LinePolarity::Bright] {
            for noise in [0.0, 0.03] {
                let graph = traced(&with_noise(image.clone(), noise, 3), polarity);
                assert!(length(&graph) < 20.0, "{name} {polarity:?} noise {noise}: {}", length(&graph));
            }
        }
    }
}

#[test]
fn a_line_beside_a_step_and_a_line_across_a_band_are_still_found() {
    let mut image = dark_line([200, 200], &[Point2::new(20.0, 60.0), Point2::new(180.0, 75.0)], 1.5);
    for ((_, column), value) in image.indexed_iter_mut() {
        if (90..125).contains(&column) {
            *value -= 0.3;
        }
    }
    let graph = traced(&with_noise(image, 0.03, 1), LinePolarity::Dark);
    assert!((length(&graph) - 160.7).abs() < 12.0, "{}", length(&graph));
}

#[test]
fn constant_and_noise_images_have_no_lines() {
    assert_eq!(length(&traced(&Array2::from_elem((64, 80), 0.7), LinePolarity::Auto)), 0.0);
    assert_eq!(length(&traced(&Array2::from_elem((3, 3), 0.7), LinePolarity::Auto)), 0.0);
    assert_eq!(length(&traced(&Array2::from_elem((64, 64), f32::NAN), LinePolarity::Auto)), 0.0);
    let mut total = 0.0;
    for seed in 0..4 {
        let white = with_noise(Array2::from_elem((400, 400), 0.5), 0.1, seed);
        // Resampling correlates noise: blurred noise is as good a trap.
        let blurred = crate::filter::gaussian_blur(&white, 0.8);
        total += length(&traced(&white, LinePolarity::Dark)) + length(&traced(&blurred, LinePolarity::Dark));
    }
    // 1.28 million pixels: at most one or two worms.
    assert!(total < 60.0, "{total}");
}

#[test]
fn inverting_the_image_inverts_the_polarity() {
    let image = with_noise(dark_line([160, 200], &arc(), 1.5), 0.05, 2);
    let inverted = image.mapv(|value| 1.0 - value);
    let (dark, bright) = (detect(&image, LinePolarity::Dark), detect(&inverted, LinePolarity::Bright));
    let worst = (&dark.probability - &bright.probability).iter().fold(0.0_f32, |worst, d| worst.max(d.abs()));
    // The same arithmetic but for the rounding of 1 - value; a rounding may flip one end point of a chain.
    assert!(worst < 0.05, "{worst}");
    let detector = RidgeDetector::default();
    assert_eq!(detector.polarity(&pair(image)), LinePolarity::Dark);
    assert_eq!(detector.polarity(&pair(inverted)), LinePolarity::Bright);
}

#[test]
fn a_turned_or_mirrored_image_has_the_turned_or_mirrored_lines() {
    let image = with_noise(dark_line([200, 200], &arc(), 1.5), 0.05, 4);
    let turned = Array2::from_shape_fn((200, 200), |(row, column)| image[[column, 199 - row]]);
    let mirrored = Array2::from_shape_fn((200, 200), |(row, column)| image[[row, 199 - column]]);
    let positions = |image: &Array2<f32>| -> Vec<Point2> {
        let graph = traced(image, LinePolarity::Dark);
        graph.traces.iter().flat_map(|trace| &trace.points).map(|point| point.position).collect()
    };
    let plain = positions(&image);
    // (row, column) of the turned image shows (column, 199 - row) of the plain one.
    let back_turned: Vec<Point2> = positions(&turned).iter().map(|p| Point2::new(199.0 - p.y, p.x)).collect();
    let back_mirrored: Vec<Point2> = positions(&mirrored).iter().map(|p| Point2::new(199.0 - p.x, p.y)).collect();
    for back in [back_turned, back_mirrored] {
        let mut errors: Vec<f64> = back
            .iter()
            .map(|point| plain.iter().map(|other| (other - point).norm()).fold(f64::INFINITY, f64::min))
            .collect();
        errors.sort_by(f64::total_cmp);
        // Points are 1 px apart, so that the nearest is up to half a px off along the line.
        assert!(errors[errors.len() * 95 / 100] < 0.55, "{}", errors[errors.len() * 95 / 100]);
        assert!((back.len() as f64 - plain.len() as f64).abs() < 6.0);
    }
}

#[test]
fn missing_data_make_no_lines() {
    let mut image = with_noise(Array2::from_elem((200, 200), 0.6), 0.03, 7);
    for ((row, column), value) in image.indexed_iter_mut() {
        // A turned frame of missing data, and a black border inside it.
        if (column as f64) < 20.0 + 0.1 * row as f64 {
            *value = f32::NAN;
        } else if row > 170 {
            *value = -0.5;
        }
    }
    let lines = detect(&image, LinePolarity::Dark);
    assert!(image.iter().zip(&lines.probability).all(|(value, p)| value.is_finite() || *p == 0.0));
    assert!(lines.probability.iter().all(|p| (0.0..=1.0).contains(p)));
    assert_eq!(length(&trace(&lines, &TraceSettings::default())), 0.0);
}

/// Share of true points near a traced one, and of traced points near a true one, at 2 px.
fn completeness_and_correctness(view: &ViewSettings, scene: &Scene) -> [f64; 2] {
    let image = render(scene, view).normalised();
    let graph = traced(&image, LinePolarity::Auto);
    let traced: Vec<Point2> = graph.traces.iter().flat_map(|t| &t.points).map(|p| p.position).collect();
    let inside = |p: &&Point2| p.x >= 0.0 && p.y >= 0.0 && p.x <= 511.0 && p.y <= 511.0;
    let curves = view.project_curves(scene);
    let truth: Vec<Point2> = curves.iter().flatten().filter(inside).copied().collect();
    let near = |from: &[Point2], to: &[Point2]| {
        let hits = from.iter().filter(|a| to.iter().any(|b| (*a - b).norm() <= 2.0)).count();
        hits as f64 / from.len().max(1) as f64
    };
    [near(&truth, &traced), near(&traced, &truth)]
}

#[test]
fn lines_of_rendered_scenes_are_found_at_high_and_at_low_contrast() {
    // Signal to noise 10, then 3.5.
    for (contrast, least) in [(0.5, 0.95), (0.175, 0.9)] {
        let mut mean = [0.0; 2];
        for seed in 1..5 {
            let scene = Scene::random(&SceneSettings { seed, ..SceneSettings::default() });
            let view = ViewSettings { line_contrast: contrast, seed, ..ViewSettings::default() };
            let scores = completeness_and_correctness(&view, &scene);
            assert!(scores.iter().all(|score| *score > least - 0.02), "contrast {contrast}, seed {seed}: {scores:?}");
            mean = [mean[0] + scores[0] / 4.0, mean[1] + scores[1] / 4.0];
        }
        assert!(mean.iter().all(|score| *score > least), "contrast {contrast}: {mean:?}");
    }
}

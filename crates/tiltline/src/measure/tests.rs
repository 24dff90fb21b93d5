use approx::assert_relative_eq;
use nalgebra::Rotation3;
use ndarray::Array2;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;

use super::*;
use crate::curve::{CurvePoint, TraceEnd};
use crate::geometry::{Point2, Point3, TiltPair};
use crate::reconstruction::LengthUnit;
use crate::rectify::Rectification;
use crate::simulate::ViewSettings;

fn frame(unit: LengthUnit, pixel: f64) -> Frame {
    let depth_gain = TiltPair::from_degrees(-4.0, 4.0).depth_gain();
    let relative_tilt_error = 0.1 / 8.0;
    Frame { unit, pixel, centre_px: [0.0; 2], depth_gain, median_z: 0.0, depth_flipped: false, relative_tilt_error }
}

fn pixels() -> Frame {
    frame(LengthUnit::Px, 1.0)
}

fn rectified(left: Array2<f32>, right: Array2<f32>) -> RectifiedPair {
    let view = ViewSettings { shape: [left.nrows(), left.ncols()], ..ViewSettings::default() };
    RectifiedPair { left, right, rectification: Rectification::from_known_views(&view, &view) }
}

fn field(rows: usize, columns: usize) -> RectifiedPair {
    rectified(Array2::zeros((rows, columns)), Array2::zeros((rows, columns)))
}

fn curve(points: impl IntoIterator<Item = Point3>, sigma_z: f64) -> Curve3 {
    let point = |position: Point3| CurvePoint {
        left_input: Point2::origin(),
        right_input: Point2::origin(),
        left_rectified: position.xy(),
        disparity_px: 0.0,
        sigma_disparity_px: 0.1,
        position,
        sigma_z,
        flag: Flag::Ok,
    };
    Curve3 { points: points.into_iter().map(point).collect(), closed: false, ends: [TraceEnd::Free; 2] }
}

/// A straight line with points about 1 px apart in projection.
fn straight(start: Point3, end: Point3, sigma_z: f64) -> Curve3 {
    let steps = (end - start).xy().norm().ceil().max(2.0) as usize;
    curve((0..=steps).map(|step| start + (end - start) * (step as f64 / steps as f64)), sigma_z)
}

fn with_depth_noise(mut curve: Curve3, sigma: f64, rng: &mut Pcg64) -> Curve3 {
    let noise = Normal::new(0.0, sigma).expect("sigma is positive");
    for point in &mut curve.points {
        point.position.z += noise.sample(rng);
    }
    curve
}

/// Two turns of radius 40 with 40 px of advance a radian: slopes up to one, curvature R / (R^2 + c^2).
fn helix(sigma_z: f64) -> (Curve3, f64, f64) {
    let (radius, advance, turn) = (40.0, 40.0, 4.0 * std::f64::consts::PI);
    let points = (0..=600).map(|step| {
        let t = turn * f64::from(step) / 600.0;
        Point3::new(radius * t.cos(), advance * t, radius * t.sin())
    });
    let speed2 = radius * radius + advance * advance;
    (curve(points, sigma_z), turn * speed2.sqrt(), radius / speed2)
}

#[test]
fn length_and_curvature_of_a_helix() {
    let (helix, length, curvature) = helix(0.05);
    let (measures, _) = measure(&[helix], &pixels(), &field(64, 64), &MeasureSettings::default());
    // A window of 2 px on a radius of curvature of 80 px smooths away less than 1e-3 of the length.
    assert_relative_eq!(measures.total_length, length, max_relative = 1e-3);
    let mean = measures.per_curve[0].mean_curvature.expect("long enough");
    // The quadratic fit has no bias from a change of curvature to first order; to second, (6 px / 80 px)^2.
    assert_relative_eq!(mean, curvature, max_relative = 0.02);
}

/// A polyline through noisy depths grows by the noise of every step; a dislocation does not.
#[test]
fn depth_noise_does_not_lengthen_a_line() {
    let mut rng = Pcg64::seed_from_u64(3);
    let (helix, length, _) = helix(1.5);
    let noisy = with_depth_noise(helix, 1.5, &mut rng);
    assert!(noisy.length() > 1.5 * length);
    let (measures, _) = measure(&[noisy], &pixels(), &field(64, 64), &MeasureSettings::default());
    // The window leaves a slope error of 0.1, half a percent of length, and as much again for the ends.
    assert_relative_eq!(measures.total_length, length, max_relative = 0.01);
}

#[test]
fn a_straight_line_has_a_direction_and_no_curvature_beyond_its_sigma() {
    let mut rng = Pcg64::seed_from_u64(5);
    let line = straight(Point3::new(0.0, 0.0, 0.0), Point3::new(0.0, 300.0, 400.0), 1.0);
    let (measures, _) =
        measure(&[with_depth_noise(line, 1.0, &mut rng)], &pixels(), &field(64, 64), &Default::default());
    let measured = &measures.per_curve[0];
    let [x, y, z] = measured.direction.expect("open");
    // sqrt(2) px of noise on a chord of 500 px turns it by 0.003.
    assert_relative_eq!(Vector3::new(x, y, z), Vector3::new(0.0, 0.6, 0.8), epsilon = 0.01);
    let (mean, sigma) = (measured.mean_curvature.expect("long"), measured.sigma_curvature.expect("long"));
    assert!(mean < 2.0 * sigma, "{mean} {sigma}");
}

/// A flat foil of known thickness, its lines from surface to surface, is turned; its thickness along its own normal stays
/// while the depth it spans along the beam grows.
fn tilted_foil(thickness: f64, tilt_deg: f64, sigma_z: f64, lost: usize) -> Vec<Curve3> {
    let mut rng = Pcg64::seed_from_u64(11);
    let axis = Unit::new_normalize(Vector3::new(0.8, 0.6, 0.0));
    let turn = Rotation3::from_axis_angle(&axis, tilt_deg.to_radians());
    let mut curves = Vec::new();
    for index in 0..20 {
        let mut place = || Vector3::new(rng.random_range(-200.0..200.0), rng.random_range(-200.0..200.0), 0.0);
        let start = turn * (Point3::from(place()) - Vector3::z() * (0.5 * thickness));
        let mut end = turn * (Point3::from(place()) + Vector3::z() * (0.5 * thickness));
        if index < lost {
            // A match that was lost half way.
            end = start + (end - start) * 0.5;
        }
        curves.push(with_depth_noise(straight(start, end, sigma_z), sigma_z, &mut rng));
    }
    curves
}

#[test]
fn thickness_is_found_along_the_normal_of_a_tilted_foil() {
    let curves = tilted_foil(120.0, 20.0, 2.0, 4);
    let (measures, _) = measure(&curves, &pixels(), &field(500, 500), &MeasureSettings::default());
    let foil = measures.foil.known().expect("40 ends, 36 of them on the surfaces");
    let [low, high] = foil.thickness_interval;
    assert!(low < 120.0 && 120.0 < high, "{foil:?}");
    // 18 ends a surface with 2 to 3 px of scatter: below 1 px for the mean of a surface, 3 sigma.
    assert_relative_eq!(foil.thickness, 120.0, epsilon = 3.0);
    assert_relative_eq!(foil.normal_tilt_deg, 20.0, epsilon = 1.0);
    // The turn by +20 degrees about (0.8, 0.6, 0) takes z to (0.6, -0.8, .) sin 20.
    let expected = Vector3::new(0.6, -0.8, 0.0) * 20.0_f64.to_radians().sin();
    assert_relative_eq!(Vector3::from(foil.normal).xy(), expected.xy(), epsilon = 0.02);
    // Along the beam the foil is thicker.
    let path = foil.surfaces.z_far - foil.surfaces.z_near;
    assert_relative_eq!(path * 20.0_f64.to_radians().cos(), foil.thickness, max_relative = 0.01);

    let density = measures.density.known().expect("thickness is known");
    assert_eq!(density.unit, DensityUnit::PerSquarePixel);
    assert_eq!(density.note, "lower bound: lines invisible with this g are not counted");
    let volume = projected_area(&field(500, 500), &pixels()) * path;
    assert_relative_eq!(density.value * volume, measures.total_length, max_relative = 1e-9);
    // Counting twenty curves alone gives more than 1.96 / sqrt(20).
    assert!(density.high > density.value * (1.96_f64 / 20.0_f64.sqrt()).exp());
}

#[test]
fn the_tilt_error_widens_the_interval_of_the_thickness() {
    let curves = tilted_foil(120.0, 0.0, 1.0, 0);
    let half = |relative_tilt_error: f64| {
        let frame = Frame { relative_tilt_error, ..pixels() };
        let (measures, _) = measure(&curves, &frame, &field(500, 500), &MeasureSettings::default());
        let [low, high] = measures.foil.known().expect("clean surfaces").thickness_interval;
        0.5 * (high - low)
    };
    let (exact, doubtful) = (half(0.0), half(0.05));
    // 1.96 * 5 percent of 120 px in quadrature with the scatter.
    assert_relative_eq!(doubtful, exact.hypot(1.96 * 0.05 * 120.0), max_relative = 0.02);
}

#[test]
fn ends_at_random_depths_are_no_surfaces() {
    let mut believed = 0;
    for seed in 0..20 {
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut place =
            || Point3::from(Vector3::from_fn(|axis, _| rng.random_range(-60.0..60.0) * [3.0, 3.0, 1.0][axis]));
        let curves: Vec<Curve3> = (0..10).map(|_| straight(place(), place(), 3.0)).collect();
        let (measures, _) = measure(&curves, &pixels(), &field(50, 50), &MeasureSettings::default());
        assert!(measures.density.known().is_some());
        match &measures.foil {
            Known::Known(_) => believed += 1,
            Known::Unknown(reason) => assert!(reason.contains("free line ends"), "{reason}"),
        }
    }
    // Each is believed with a probability of at most 0.01: two or more of twenty would be one case in sixty.
    assert!(believed <= 1, "{believed} of 20");
}

#[test]
fn only_free_ends_mark_a_surface() {
    let mut curves = tilted_foil(120.0, 0.0, 1.0, 0);
    for curve in &mut curves {
        curve.ends = [TraceEnd::Border, TraceEnd::Junction(0)];
    }
    let (measures, _) = measure(&curves, &pixels(), &field(500, 500), &MeasureSettings::default());
    assert_eq!(measures.foil, Known::Unknown("0 free line ends, 8 are needed to see the foil's surfaces".into()));
}

#[test]
fn density_by_hand_where_the_thickness_is_unknown() {
    // Two lines of 100 nm at 2 nm a pixel; half of 100 x 200 px is seen in both views.
    let line = |x: f64| straight(Point3::new(x, 0.0, 0.0), Point3::new(x, 100.0, 0.0), 1e-3);
    let right = Array2::from_shape_fn((100, 200), |(_, column)| if column < 100 { 0.0 } else { f32::NAN });
    let seen = rectified(Array2::zeros((100, 200)), right);
    let frame = frame(LengthUnit::Nm, 2.0);
    let (measures, _) = measure(&[line(0.0), line(50.0)], &frame, &seen, &MeasureSettings::default());
    assert_relative_eq!(measures.total_length, 200.0, max_relative = 1e-9);
    // Each view is foreshortened by cos 4 degrees.
    let area_nm2 = 100.0 * 100.0 * 4.0 / 4.0_f64.to_radians().cos();
    let density = measures.density.known().expect("lines and area");
    assert_eq!(density.unit, DensityUnit::PerMetre);
    assert_relative_eq!(density.value, 200.0 / area_nm2 * 1e9, max_relative = 1e-9);
    // Two equal curves count with a relative error of 1 / sqrt(2); 4 ends of 1.5 px = 3 nm add 6 nm to 200 nm.
    let relative = (0.5 + (6.0_f64 / 200.0).powi(2)).sqrt();
    assert_relative_eq!(density.high / density.value, (1.959_964 * relative).exp(), max_relative = 1e-6);
    assert_relative_eq!(density.value / density.low, density.high / density.value, max_relative = 1e-9);
}

#[test]
fn nothing_found_is_said_and_not_measured() {
    let (measures, warnings) = measure(&[], &pixels(), &field(10, 10), &MeasureSettings::default());
    assert_eq!((measures.curves, measures.total_length, measures.depth), (0, 0.0, None));
    assert_eq!(measures.density, Known::Unknown("there are no curves".into()));
    assert_eq!(warnings.len(), 1);
    assert!(warnings[0].message.contains("no curves"), "{}", warnings[0]);
}

#[test]
fn doubtful_length_and_a_poor_tilt_are_warned_about_with_numbers() {
    let mut line = straight(Point3::origin(), Point3::new(0.0, 100.0, 0.0), 1.0);
    for point in &mut line.points[10..60] {
        point.flag = Flag::Bridged;
    }
    let frame = Frame { relative_tilt_error: 0.024, ..pixels() };
    let (measures, warnings) = measure(&[line], &frame, &field(10, 10), &MeasureSettings::default());
    // Inner points stand for a step each, of 100.
    assert_relative_eq!(measures.doubtful_share, 0.5, epsilon = 1e-9);
    let text: Vec<String> = warnings.iter().map(ToString::to_string).collect();
    assert!(text[0].contains("50 percent"), "{text:?}");
    assert!(text[1].contains("2.4 percent"), "{text:?}");
}

#[test]
fn the_depth_range_leaves_out_the_outer_twentieth_of_the_length() {
    let line = straight(Point3::origin(), Point3::new(0.0, 1000.0, 500.0), 0.7);
    let depth = depth_range(&[line]).expect("a line");
    assert_relative_eq!(depth.low, 12.5, epsilon = 0.6);
    assert_relative_eq!(depth.high, 487.5, epsilon = 0.6);
    assert_relative_eq!(depth.sigma_z, 0.7);
}

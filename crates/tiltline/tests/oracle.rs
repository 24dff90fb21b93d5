//! The geometry proved without an image: a detector and a matcher that know the curves.
#![allow(clippy::unwrap_used, clippy::print_stderr)] // a failed unwrap is a failed test

mod common;

use approx::assert_abs_diff_eq;
use common::truth::{RenderedPair, rendered_pair};
use ndarray::Array2;
use tiltline::geometry::{Point3, TiltPair};
use tiltline::oracle::Oracle;
use tiltline::pipeline::reconstruct_rectified;
use tiltline::reconstruction::{LengthUnit, Reconstruction};
use tiltline::rectify::{Rectification, RectifiedPair};
use tiltline::settings::Settings;
use tiltline::simulate::{SceneSettings, ViewSettings};

/// Every stage but rectification, on truth: known curves projected at two tilts, also with the axis turned, the right
/// view shifted, turned and magnified.
fn run(tilts_deg: [f64; 2], axis_deg: f64, pixel_size_nm: Option<f64>) -> (RenderedPair, Reconstruction) {
    let scene = SceneSettings { curves: 5, specks: 0, seed: 3, ..SceneSettings::default() };
    let base = ViewSettings { axis_rad: axis_deg.to_radians(), noise: 0.0, ..ViewSettings::default() };
    let mut truth = rendered_pair(&scene, tilts_deg, &base, |right| {
        right.axis_rad += 0.01;
        right.scale = 1.01;
        right.shift_px = [20.0, -11.0];
    });
    truth.pair.left.pixel_size_nm = pixel_size_nm;
    let rectification = Rectification::from_known_views(&truth.views[0], &truth.views[1]);
    let oracle = Oracle::new(&truth.scene, [&truth.views[0], &truth.views[1]], &rectification);
    let blank = Array2::<f32>::zeros(rectification.shape);
    let rectified = RectifiedPair { left: blank.clone(), right: blank, rectification };
    let pair = truth.pair.clone();
    let result = reconstruct_rectified(pair, rectified, Vec::new(), &oracle, &oracle, &Settings::default(), &|_| ());
    (truth, result)
}

/// The point in the mid-view frame: the specimen turned by the mid tilt about y.
fn in_mid_view(point: &Point3, tilts: &TiltPair) -> Point3 {
    let (sin, cos) = tilts.mid_rad().sin_cos();
    Point3::new(point.x * cos + point.z * sin, point.y, point.z * cos - point.x * sin)
}

#[test]
fn known_curves_come_back_to_a_twentieth_of_a_pixel() {
    for (tilts_deg, axis_deg) in [([-4.0, 4.0], 0.0), ([3.0, 9.0], 0.0), ([4.0, -4.0], 20.0), ([-2.0, 6.0], 90.0)] {
        let (truth, result) = run(tilts_deg, axis_deg, None);
        assert!(!result.curves.is_empty());
        assert_eq!(result.frame.unit, LengthUnit::Px);
        let curves: Vec<Vec<Point3>> = truth
            .scene
            .curves
            .iter()
            .map(|curve| curve.iter().map(|point| in_mid_view(point, &truth.pair.tilts)).collect())
            .collect();
        let mut errors = Vec::new();
        for point in result.curves.iter().flat_map(|curve| &curve.points) {
            let z = point.position.z + result.frame.median_z;
            let position = Point3::new(point.position.x, point.position.y, z);
            // In px of the image: across the line, and depth as disparity (z / depth_gain).
            let nearest = curves
                .iter()
                .flat_map(|curve| curve.windows(2))
                .map(|ends| {
                    let along = ends[1] - ends[0];
                    let foot = (position - ends[0]).xy().dot(&along.xy()) / along.xy().norm_squared();
                    let offset = position - (ends[0] + along * foot.clamp(0.0, 1.0));
                    offset.xy().norm().hypot(offset.z / result.frame.depth_gain)
                })
                .fold(f64::INFINITY, f64::min);
            errors.push(nearest);
        }
        errors.sort_unstable_by(f64::total_cmp);
        let median = errors[errors.len() / 2];
        let percent90 = errors[errors.len() * 9 / 10];
        // 0.05 px is the bound the geometry must hold; where lines cross, the traced centreline is pulled aside.
        assert!(median < 0.05 && percent90 < 0.2, "tilts {tilts_deg:?} axis {axis_deg}: {median} {percent90}");
    }
}

#[test]
fn a_known_pixel_size_scales_every_length() {
    let (_, in_px) = run([-4.0, 4.0], 0.0, None);
    let (_, in_nm) = run([-4.0, 4.0], 0.0, Some(2.5));
    assert_eq!(in_nm.frame.unit, LengthUnit::Nm);
    for (a, b) in in_px.curves.iter().zip(&in_nm.curves) {
        assert_abs_diff_eq!(a.length() * 2.5, b.length(), epsilon = 1e-6);
    }
}

#[test]
fn swapping_the_views_with_their_tilts_changes_no_depth() {
    // A physical argument: the foil does not know which image was named first.
    let (_, result) = run([-4.0, 4.0], 0.0, None);
    let (_, swapped) = run([4.0, -4.0], 0.0, None);
    // Tails without the last points of single lines, where one image's trace ends a little before the other's.
    let depth_span = |result: &Reconstruction| {
        let points = result.curves.iter().flat_map(|curve| &curve.points);
        let mut depths: Vec<f64> = points.map(|point| point.position.z + result.frame.median_z).collect();
        depths.sort_unstable_by(f64::total_cmp);
        (depths[depths.len() / 20], depths[depths.len() * 19 / 20])
    };
    let (low, high) = depth_span(&result);
    let (swapped_low, swapped_high) = depth_span(&swapped);
    // Half a px of disparity at 8 degrees is 3.6 px of depth.
    assert_abs_diff_eq!(low, swapped_low, epsilon = 3.6);
    assert_abs_diff_eq!(high, swapped_high, epsilon = 3.6);
    assert!(result.frame.depth_gain > 0.0 && swapped.frame.depth_gain < 0.0);
}

//! The whole path on rendered images: plain dark lines at a signal-to-noise ratio of 10, a speckled background that moves
//! with the foil, 512x512 px, 8 degrees, the right view turned and shifted.

mod common;

use common::truth::{Agreement, agreement, rendered_pair};
use tiltline::matching::ClassicalMatcher;
use tiltline::pipeline::reconstruct;
use tiltline::ridge::RidgeDetector;
use tiltline::settings::Settings;
use tiltline::simulate::{SceneSettings, ViewSettings};

fn reconstructed(curves: usize, seed: u64) -> Agreement {
    let scene = SceneSettings { curves, seed, ..SceneSettings::default() };
    let truth = rendered_pair(&scene, [-4.0, 4.0], &ViewSettings::default(), |right| {
        right.axis_rad += 0.008;
        right.shift_px = [14.0, -6.0];
    });
    let settings = Settings::default();
    let (detector, matcher) = (RidgeDetector::default(), ClassicalMatcher::default());
    let result = reconstruct(truth.pair.clone(), &detector, &matcher, &settings, &|_| ()).unwrap();
    let agreement = agreement(&result, &truth);
    eprintln!("{curves} curves, seed {seed}: {agreement:.3?}");
    agreement
}

fn mean(of: &[Agreement], value: impl Fn(&Agreement) -> f64) -> f64 {
    of.iter().map(value).sum::<f64>() / of.len() as f64
}

#[test]
fn rendered_curves_are_found_and_placed() {
    let results: Vec<Agreement> = (11..17).map(|seed| reconstructed(5, seed)).collect();
    assert!(mean(&results, |result| result.completeness) > 0.95, "{results:#?}");
    assert!(mean(&results, |result| result.correctness) > 0.95, "{results:#?}");
    assert!(mean(&results, |result| result.mean_disparity_error_px) < 0.5, "{results:#?}");
}

#[test]
fn dense_scenes_lose_little() {
    // Fourteen curves, many of which cross at small angles or run into each other for tens of px: what the classical
    // detector cannot take apart. The bounds are below what was measured when they were set, by about half of the
    // missing part's scatter between seeds.
    let results: Vec<Agreement> = (11..17).map(|seed| reconstructed(14, seed)).collect();
    assert!(mean(&results, |result| result.completeness) > 0.88, "{results:#?}");
    assert!(mean(&results, |result| result.correctness) > 0.93, "{results:#?}");
    assert!(mean(&results, |result| result.mean_disparity_error_px) < 0.5, "{results:#?}");
}

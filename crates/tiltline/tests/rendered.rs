//! The whole path on rendered images: plain dark lines at a signal-to-noise ratio of 10, a speckled background that moves
//! with the foil, 512x512 px, 8 degrees, the right view turned and shifted.
#![allow(clippy::unwrap_used, clippy::print_stderr)] // a failed unwrap is a failed test

mod common;

use common::truth::{Agreement, agreement, rendered_pair};
use tiltline::matching::ClassicalMatcher;
use tiltline::pipeline::reconstruct;
use tiltline::ridge::RidgeDetector;
use tiltline::settings::Settings;
use tiltline::simulate::{SceneSettings, ViewSettings};

/// Agreement of one scene: of lines 10 degrees or more off the row, and of all.
fn reconstructed(curves: usize, seed: u64) -> [Agreement; 2] {
    let scene = SceneSettings { curves, specks: 5000, seed, ..SceneSettings::default() };
    let truth = rendered_pair(&scene, [-4.0, 4.0], &ViewSettings::default(), |right| {
        right.axis_rad += 0.008;
        right.shift_px = [14.0, -6.0];
    });
    let settings = Settings::default();
    let (detector, matcher) = (RidgeDetector::default(), ClassicalMatcher::default());
    let result = reconstruct(truth.pair.clone(), &detector, &matcher, &settings, &|_| ()).unwrap();
    let both = [true, false].map(|well_conditioned| agreement(&result, &truth, well_conditioned));
    eprintln!("{curves} curves, seed {seed}: {:.3?}\n    all: {:.3?}", both[0], both[1]);
    both
}

fn mean(of: &[[Agreement; 2]], which: usize, value: impl Fn(&Agreement) -> f64) -> f64 {
    of.iter().map(|both| value(&both[which])).sum::<f64>() / of.len() as f64
}

#[test]
fn rendered_curves_are_found_and_placed() {
    let results: Vec<_> = (11..17).map(|seed| reconstructed(5, seed)).collect();
    for which in [0, 1] {
        let (completeness, correctness) =
            (mean(&results, which, |r| r.completeness), mean(&results, which, |r| r.correctness));
        let error = mean(&results, which, |r| r.mean_disparity_error_px);
        eprintln!("mean: completeness {completeness:.3} correctness {correctness:.3} error {error:.3} px");
        assert!(completeness > 0.95, "{completeness}");
        assert!(correctness > 0.95, "{correctness}");
        assert!(error < 0.5, "{error}");
    }
}

#[test]
fn dense_scenes_lose_little() {
    // Fourteen curves, many of which cross at small angles or run into each other for tens of px, which the classical
    // detector cannot take apart: the bounds are what it does reach, so that a change for the worse is seen.
    let results: Vec<_> = (11..17).map(|seed| reconstructed(14, seed)).collect();
    let (completeness, correctness) = (mean(&results, 0, |r| r.completeness), mean(&results, 0, |r| r.correctness));
    let error = mean(&results, 0, |r| r.mean_disparity_error_px);
    eprintln!("mean: completeness {completeness:.3} correctness {correctness:.3} error {error:.3} px");
    assert!(completeness > 0.90, "{completeness}");
    assert!(correctness > 0.94, "{correctness}");
    assert!(error < 0.5, "{error}");
}

//! The whole path on rendered images: plain dark lines, a speckled background that moves with the foil, noise.

mod common;

use common::truth::{agreement, rendered_pair};
use tiltline::matching::ClassicalMatcher;
use tiltline::pipeline::reconstruct;
use tiltline::ridge::RidgeDetector;
use tiltline::settings::Settings;
use tiltline::simulate::{SceneSettings, ViewSettings};

#[test]
fn rendered_curves_are_found_and_placed() {
    for seed in [11, 12, 13] {
        let scene = SceneSettings { seed, ..SceneSettings::default() };
        let truth = rendered_pair(&scene, [-4.0, 4.0], &ViewSettings::default(), |right| {
            right.axis_rad += 0.008;
            right.shift_px = [14.0, -6.0];
        });
        let settings = Settings::default();
        let (detector, matcher) = (RidgeDetector::default(), ClassicalMatcher::default());
        let result = reconstruct(truth.pair.clone(), &detector, &matcher, &settings, &|_| ()).unwrap();
        let agreement = agreement(&result, &truth);
        assert!(agreement.completeness > 0.95, "seed {seed}: {agreement:?}");
        assert!(agreement.correctness > 0.95, "seed {seed}: {agreement:?}");
        assert!(agreement.mean_disparity_error_px < 0.5, "seed {seed}: {agreement:?}");
    }
}

mod common;
use common::truth::{agreement, rendered_pair};
use tiltline::matching::ClassicalMatcher;
use tiltline::pipeline::reconstruct;
use tiltline::ridge::RidgeDetector;
use tiltline::settings::Settings;
use tiltline::simulate::{SceneSettings, ViewSettings};
use tiltline::oracle::Oracle;
#[test]
fn scratch() {
    for seed in [12u64,14,15] {
        let scene = SceneSettings { seed, curves:5, ..SceneSettings::default() };
        let truth = rendered_pair(&scene, [-4.0, 4.0], &ViewSettings::default(), |right| {
            right.axis_rad += 0.008;
            right.shift_px = [14.0, -6.0];
        });
        let settings = Settings::default();
        let (detector, matcher) = (RidgeDetector::default(), ClassicalMatcher::default());
        let result = reconstruct(truth.pair.clone(), &detector, &matcher, &settings, &|_| ()).unwrap();
        let r = &result.rectified.rectification;
        let oracle = Oracle::new(&truth.scene, [&truth.views[0], &truth.views[1]], r);
        let mut s=0.0; let mut n=0.0f64; let mut m=0.0;
        for (a,b) in oracle.curves[0].iter().zip(&oracle.curves[1]) { for (p,q) in a.iter().zip(b) { s+=(p.y-q.y).powi(2); m+=p.y-q.y; n+=1.0; } }
        eprintln!("seed {seed} {:?}\n truth rms {:.3} mean {:.3}", r, (s/n).sqrt(), m/n);
        tiltline::export::write_all(&result,&[],std::path::Path::new(&format!("/tmp/s{seed}")),true).unwrap();
        eprintln!("  est  {:?}", agreement(&result, &truth));
    }
}

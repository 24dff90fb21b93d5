//! `cargo bench --bench stages`: each stage of the main job on a rendered 1024x1024 pair.
#![allow(missing_docs)]

use criterion::{Criterion, criterion_group, criterion_main};
use tiltline::geometry::TiltPair;
use tiltline::matching::ClassicalMatcher;
use tiltline::micrograph::{StereoPair, View};
use tiltline::pipeline::{Detect, Match};
use tiltline::rectify::rectify;
use tiltline::refine::refine;
use tiltline::ridge::RidgeDetector;
use tiltline::settings::Settings;
use tiltline::simulate::{Scene, SceneSettings, ViewSettings, render};
use tiltline::trace::trace;

/// A rendered pair at 8 degrees with as many lines and specks per area as the example pair.
pub fn rendered_pair(size: usize) -> StereoPair {
    let area = (size * size) as f64 / (512.0 * 512.0);
    let scene = Scene::random(&SceneSettings {
        size_px: size as f64,
        curves: (14.0 * area).ceil() as usize,
        specks: (2500.0 * area).ceil() as usize,
        ..SceneSettings::default()
    });
    let view = |tilt_deg: f64, seed| {
        let tilt_rad = tilt_deg.to_radians();
        render(&scene, &ViewSettings { shape: [size, size], tilt_rad, seed, ..ViewSettings::default() })
    };
    StereoPair {
        left: view(-4.0, 1),
        right: view(4.0, 2),
        tilts: TiltPair::from_degrees(-4.0, 4.0),
        tilt_axis_rad: 0.0,
    }
}

fn stages(criterion: &mut Criterion) {
    let pair = rendered_pair(1024);
    let settings = Settings::default();
    let (detector, matcher) = (RidgeDetector::default(), ClassicalMatcher::default());
    let (rectified, _) = rectify(&pair, &settings.rectify, 0).expect("a rendered pair can be rectified");
    let lines = View::BOTH.map(|view| detector.detect(&rectified, view));
    let traces = [0, 1].map(|view| trace(&lines[view], &settings.trace));
    let matched = matcher.match_curves(&rectified, &lines, &traces);
    let mut group = criterion.benchmark_group("1024x1024");
    group.sample_size(10);
    group.bench_function("rectify", |bencher| bencher.iter(|| rectify(&pair, &settings.rectify, 0)));
    group.bench_function("detect, both views", |bencher| {
        bencher.iter(|| View::BOTH.map(|view| detector.detect(&rectified, view)));
    });
    group.bench_function("trace, both views", |bencher| {
        bencher.iter(|| [0, 1].map(|view| trace(&lines[view], &settings.trace)));
    });
    group.bench_function("match", |bencher| bencher.iter(|| matcher.match_curves(&rectified, &lines, &traces)));
    group.bench_function("refine", |bencher| {
        bencher.iter(|| refine(matched.clone(), &traces, &rectified.rectification, &settings.refine));
    });
    group.finish();
}

criterion_group!(benches, stages);
criterion_main!(benches);

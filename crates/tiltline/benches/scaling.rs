//! `cargo bench --bench scaling`: the whole library path (no files) from 256x256 to 4096x4096, median of three runs.
//!
//! Cost should be linear in pixels: the last column stays about level.
#![allow(missing_docs, clippy::print_stdout)]

use std::time::Instant;

use tiltline::geometry::TiltPair;
use tiltline::matching::ClassicalMatcher;
use tiltline::micrograph::StereoPair;
use tiltline::pipeline::reconstruct;
use tiltline::ridge::RidgeDetector;
use tiltline::settings::Settings;
use tiltline::simulate::{Scene, SceneSettings, ViewSettings, render};

fn main() {
    println!("| size | seconds | microseconds per pixel of one image |");
    println!("|---|---|---|");
    for size in [256, 512, 1024, 2048, 4096] {
        let pair = rendered_pair(size);
        let mut seconds: Vec<f64> = (0..3).map(|_| time(pair.clone())).collect();
        seconds.sort_unstable_by(f64::total_cmp);
        println!("| {size}x{size} | {:.2} | {:.2} |", seconds[1], seconds[1] * 1e6 / (size * size) as f64);
    }
}

fn time(pair: StereoPair) -> f64 {
    let start = Instant::now();
    let (detector, matcher) = (RidgeDetector::default(), ClassicalMatcher::default());
    let result = reconstruct(pair, &detector, &matcher, &Settings::default(), &|_| ());
    let seconds = start.elapsed().as_secs_f64();
    assert!(result.is_ok_and(|result| !result.curves.is_empty()), "a rendered pair gives curves");
    seconds
}

/// A rendered pair at 8 degrees with the same lines and specks per area at every size.
fn rendered_pair(size: usize) -> StereoPair {
    let area = (size * size) as f64 / (512.0 * 512.0);
    let scene = SceneSettings { size_px: 512.0, curves: 14, specks: 2500, ..SceneSettings::default() };
    let scene = tiled(&scene, area.sqrt());
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

/// 512 px scenes of different seeds side by side, so that lines do not grow with the image.
fn tiled(settings: &SceneSettings, tiles: f64) -> Scene {
    let count = tiles.ceil() as usize;
    let mut scene = Scene::default();
    for index in 0..count * count {
        let part = Scene::random(&SceneSettings { seed: 1 + index as u64, ..settings.clone() });
        let place = |i: usize| (i as f64 - 0.5 * (count as f64 - 1.0)) * settings.size_px;
        let (x, y) = (place(index % count), place(index / count));
        let shift = tiltline::geometry::Vector3::new(x, y, 0.0);
        scene
            .curves
            .extend(part.curves.into_iter().map(|curve| curve.into_iter().map(|point| point + shift).collect()));
        scene.specks.extend(part.specks.into_iter().map(|mut speck| {
            speck.position += shift;
            speck
        }));
    }
    scene
}

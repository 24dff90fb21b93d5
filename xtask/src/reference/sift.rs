//! SIFT against OpenCV's on the same 8-bit images: repeatability and matches under a known warp, and time.
//!
//! The pairs are rendered twice from one flat foil, turned, scaled and shifted in between, each with its own noise, so
//! that where a point of the left image lies in the right one is known exactly and nothing is interpolated.

use std::time::Instant;

use miette::{IntoDiagnostic, Result};
use ndarray::Array2;
use tiltline::geometry::{Point2, Similarity2};
use tiltline::rectify::{Feature, SiftSettings, match_features, sift};
use tiltline::simulate::{Scene, SceneSettings, ViewSettings, render};

use crate::npy;
use crate::venv::Venv;

/// Furthest a point may lie from where the warp puts it.
const REACH_PX: f64 = 1.5;
/// Ours and theirs are timed in turn this many times; the median counts.
const ROUNDS: usize = 5;

struct Case {
    name: &'static str,
    size: usize,
    noise: f32,
    turn_deg: f64,
    scale: f64,
}

const CASES: [Case; 4] = [
    Case { name: "512, noise 0.02", size: 512, noise: 0.02, turn_deg: 2.0, scale: 1.01 },
    Case { name: "512, noise 0.05", size: 512, noise: 0.05, turn_deg: 2.0, scale: 1.01 },
    Case { name: "512, turned 35 deg", size: 512, noise: 0.03, turn_deg: 35.0, scale: 1.1 },
    Case { name: "1024, noise 0.05", size: 1024, noise: 0.05, turn_deg: -1.5, scale: 0.99 },
];

/// Runs the comparison.
pub fn run(venv: &Venv) -> Result<()> {
    println!(
        "{:<20} {:>9} {:>11} {:>14} {:>8} {:>9} {:>9}",
        "image", "", "features", "repeatability", "matches", "correct", "time ms"
    );
    for case in &CASES {
        let (images, right_from_left) = pair(case);
        let settings = SiftSettings::default();
        let paths = ["left", "right"].map(|side| venv.work.join(format!("sift_{side}.npy")));
        for (image, path) in images.iter().zip(&paths) {
            npy::write_f32(path, image)?;
        }
        let map = right_from_left.to_homogeneous();
        let mut arguments = paths.map(|path| path.display().to_string()).to_vec();
        arguments.push(settings.max_keypoints.to_string());
        arguments.push(REACH_PX.to_string());
        arguments.extend((0..6).map(|i| map[(i / 3, i % 3)].to_string()));

        let mut times = [Vec::new(), Vec::new()];
        let mut theirs = serde_json::Value::Null;
        for _ in 0..ROUNDS {
            let start = Instant::now();
            std::hint::black_box(sift(&images[0], &settings));
            times[0].push(start.elapsed().as_secs_f64() * 1e3);
            theirs = serde_json::from_str(&venv.run("sift.py", &arguments)?).into_diagnostic()?;
            times[1].push(theirs["time_ms"].as_f64().unwrap_or(f64::NAN));
        }
        let [ours_ms, theirs_ms] = times.map(|mut times| {
            times.sort_by(f64::total_cmp);
            times[ROUNDS / 2]
        });
        let features = images.each_ref().map(|image| sift(image, &settings));
        let matches = match_features(&features[0], &features[1]).distinct;
        let correct =
            matches.iter().filter(|pair| (right_from_left * pair.left - pair.right).norm() < REACH_PX).count();
        let repeated = repeatability(&features, &right_from_left, case.size);
        println!(
            "{:<20} {:>9} {:>5} {:>5} {:>14.3} {:>8} {:>9} {:>9.0}",
            case.name,
            "ours",
            features[0].len(),
            features[1].len(),
            repeated,
            matches.len(),
            correct,
            ours_ms
        );
        println!(
            "{:<20} {:>9} {:>5} {:>5} {:>14.3} {:>8} {:>9} {:>9.0}   time ratio {:.2}",
            "",
            "opencv",
            theirs["left"],
            theirs["right"],
            theirs["repeatability"].as_f64().unwrap_or(f64::NAN),
            theirs["matches"],
            theirs["correct"],
            theirs_ms,
            ours_ms / theirs_ms
        );
    }
    Ok(())
}

/// Both images as OpenCV can take them: 256 grey levels, here scaled to 0..1.
fn pair(case: &Case) -> ([Array2<f32>; 2], Similarity2) {
    let area = (case.size as f64 / 512.0).powi(2);
    let scene = Scene::random(&SceneSettings {
        size_px: case.size as f64,
        thickness_px: 1e-6,
        curves: (14.0 * area) as usize,
        specks: (2500.0 * area) as usize,
        seed: 5,
    });
    let view = |axis_deg: f64, scale, shift_px, seed| ViewSettings {
        shape: [case.size; 2],
        axis_rad: axis_deg.to_radians(),
        scale,
        shift_px,
        noise: case.noise,
        seed,
        ..ViewSettings::default()
    };
    let views = [view(0.0, 1.0, [0.0, 0.0], 1), view(case.turn_deg, case.scale, [7.3, -4.6], 2)];
    let images = views
        .each_ref()
        .map(|view| render(&scene, view).normalised().mapv(|value| (value.clamp(0.0, 1.0) * 255.0).round() / 255.0));
    (images, views[1].image_from_projection() * views[0].image_from_projection().inverse())
}

/// Share of keypoints whose place in the other image has a keypoint within reach, of the image with fewer that lie in
/// both (Mikolajczyk and Schmid 2004, without the overlap of regions).
fn repeatability(features: &[Vec<Feature>; 2], right_from_left: &Similarity2, size: usize) -> f64 {
    let points = |features: &[Feature]| {
        let mut points: Vec<Point2> = features.iter().map(|f| Point2::new(f.x.into(), f.y.into())).collect();
        points.dedup();
        points
    };
    let inside = |point: &Point2| point.x.min(point.y) >= 0.0 && point.x.max(point.y) <= (size - 1) as f64;
    let left: Vec<Point2> = points(&features[0]).iter().map(|p| right_from_left * p).filter(inside).collect();
    let right: Vec<Point2> =
        points(&features[1]).into_iter().filter(|p| inside(&(right_from_left.inverse() * p))).collect();
    let found = left.iter().filter(|l| right.iter().any(|r| (r - **l).norm() < REACH_PX)).count();
    found as f64 / left.len().min(right.len()).max(1) as f64
}

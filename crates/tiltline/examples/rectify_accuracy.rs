//! How well rectification does on a data set: rows, axis and rotation against the truth, one line a pair.
//!
//! `cargo run --release -p tiltline --example rectify_accuracy -- FOLDER [SEED]`
//!
//! `FOLDER` holds a data set (`tiltline simulate`, or `data` of `tiltline bench`). The row error of a pair is the root mean
//! square over the cores of its lines, where both images show them, of the true row less the rectified one.
#![allow(clippy::print_stdout, clippy::unwrap_used)]

use std::time::Instant;

use tiltline::dataset::Dataset;
use tiltline::geometry::project_at_tilt;
use tiltline::io::read_micrograph;
use tiltline::micrograph::StereoPair;
use tiltline::rectify::{Rectification, RectifySettings, rectify};
use tiltline::truth::TruthPair;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = arguments.first().expect("usage: rectify_accuracy FOLDER [SEED]");
    let seed = arguments.get(1).map_or(0, |seed| seed.parse().unwrap());
    let dataset = Dataset::open(folder).unwrap();
    let (mut all, mut axes, mut turns, mut seconds) = (Vec::new(), Vec::new(), Vec::new(), 0.0);
    let (mut pairs, mut within, mut failed) = (Vec::new(), [0; 2], 0);
    println!(
        "pair                                      matches inliers  rms row  sigma | true row rms  95 %    axis +- sigma   turn"
    );
    for item in &dataset.manifest.items {
        let truth = dataset.truth(item).unwrap();
        let pair = truth.pair(item.pair[0], item.pair[1]).unwrap();
        let [left, right] = [pair.left, pair.right]
            .map(|view| read_micrograph(&dataset.path(item, &view.name).to_string_lossy()).unwrap());
        let images = StereoPair { left, right, tilts: pair.tilts.unwrap(), tilt_axis_rad: 0.0 };
        let start = Instant::now();
        let result = rectify(&images, &RectifySettings::default(), seed);
        let time = start.elapsed().as_secs_f64();
        seconds += time;
        let found = match result {
            Ok((rectified, _)) => rectified.rectification,
            Err(error) => {
                failed += 1;
                println!("{:42} failed ({time:.2} s): {error}", item.name);
                continue;
            }
        };
        let mut errors = row_errors(&pair, &found);
        let rms = (errors.iter().map(|error| error * error).sum::<f64>() / errors.len().max(1) as f64).sqrt();
        let geometry = pair.geometry.unwrap();
        let [axis_left, axis_right] =
            [geometry.rows_from_left, geometry.rows_from_right].map(|map| -map.isometry.rotation.angle().to_degrees());
        let axis = found.axis_deg - axis_left;
        let turn = found.relative_rotation_deg - (axis_right - axis_left);
        println!(
            "{:42} {:6} {:6} {:9.2} {:6.2} | {rms:9.2} {:9.2} {axis:8.2} {:6.2} {turn:8.3}  {time:.2} s",
            item.name,
            found.matches,
            found.inliers,
            found.rms_row_error_px,
            found.sigma_row_px,
            quantile(&mut errors, 0.95),
            found.axis_sigma_deg,
        );
        within[0] += usize::from(rms < found.sigma_row_px);
        within[1] += usize::from(rms < 2.0 * found.sigma_row_px);
        all.extend(errors);
        pairs.push(rms);
        axes.push(axis.abs());
        turns.push(turn.abs());
    }
    println!("failed: {failed} of {}", dataset.manifest.items.len());
    let line = |name: &str, values: &mut Vec<f64>| {
        println!("{name}: median {:.3}, 95 % {:.3}", quantile(values, 0.5), quantile(values, 0.95));
    };
    line("row error over line points, px", &mut all);
    line("row error rms of a pair, px", &mut pairs);
    line("axis error, degrees", &mut axes);
    line("relative rotation error, degrees", &mut turns);
    let share = |count: usize| count as f64 / pairs.len().max(1) as f64;
    println!("pairs within 1 and 2 sigma_row: {:.2} {:.2}", share(within[0]), share(within[1]));
    println!("time: {:.2} s a pair", seconds / dataset.manifest.items.len().max(1) as f64);
}

/// Absolute row errors of the true cores, rectified px.
fn row_errors(pair: &TruthPair<'_>, found: &Rectification) -> Vec<f64> {
    let geometry = pair.geometry.unwrap();
    let images = [geometry.rows_from_left.inverse(), geometry.rows_from_right.inverse()];
    let tilts = [geometry.tilts.left_rad, geometry.tilts.right_rad];
    let points = pair.truth.curves.iter().filter_map(|curve| curve.points.as_ref()).flatten();
    let error = |point| {
        let [left, right] =
            [0, 1].map(|view| images[view] * (project_at_tilt(point, tilts[view]) * geometry.px_per_unit));
        let seen = pair.left.contains(&left) && pair.right.contains(&right);
        seen.then(|| ((found.rectified_from_right * right).y - (found.rectified_from_left * left).y).abs())
    };
    points.filter_map(error).collect()
}

fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    if values.is_empty() { f64::NAN } else { values[((values.len() - 1) as f64 * share).round() as usize] }
}

//! Simulated views to look at beside real micrographs, and what they measure.
//!
//! ```text
//! cargo run --release -p tiltline --example simulate_gallery -- FOLDER FAMILY MODE [COUNT] [FIRST]
//! ```
//!
//! Writes `FAMILY-MODE-N.png` (left, right, and left with its true centres of contrast: visible ones white, others black) and prints, for
//! each pair, the length of visible line and the statistics of docs/truth.md, then their means and standard deviations.
#![allow(clippy::print_stdout)]

use std::fs::File;
use std::path::Path;

use ndarray::{Array2, Axis, concatenate};
use tiltline::filter::percentiles;
use tiltline::score::image_statistics;
use tiltline::simulate::geometry::{Split, geometry_seed};
use tiltline::simulate::{Family, Lines, Mode, SimulateSettings, sample};
use tiltline::truth::{TrueView, curve_mask};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, family, mode, rest @ ..] = &arguments[..] else {
        println!("usage: simulate_gallery FOLDER FAMILY MODE [COUNT] [FIRST]");
        return;
    };
    let number = |index: usize, default: u64| rest.get(index).map_or(default, |text| text.parse().expect("a number"));
    let family = Family::ALL.into_iter().find(|known| known.word() == family).expect("a family");
    let mode = if mode == "physics" { Mode::Physics } else { Mode::Parametric };
    let settings = SimulateSettings { mode, ..SimulateSettings::of_family(family) };
    let mut measured = Vec::new();
    println!("   seed  curves  visible, px  SNR lines, dB  SNR background, dB  contrast, grey  seconds");
    for index in number(1, 0)..number(1, 0) + number(0, 6) {
        let start = std::time::Instant::now();
        let sample = sample(&settings, Lines::Random, geometry_seed(Split::Train, index)).expect("presets are valid");
        let seconds = start.elapsed().as_secs_f64();
        let view = &sample.truth.views[0];
        let closed = |label: &str| sample.truth.curve(label).is_some_and(|curve| curve.closed);
        let image = &sample.views[0].recording.image;
        let found =
            image_statistics(image, &curve_mask(view, closed, 3.0, true)).expect("mask and image have one size");
        let values = [found.snr_lines_db, found.snr_background_db, found.contrast_grey].map(|v| v.unwrap_or(f64::NAN));
        println!(
            "{index:>7} {:>7} {:>12.0} {:>14.1} {:>19.1} {:>15.1} {seconds:>8.2}",
            sample.truth.curves.len(),
            visible_length_px(view),
            values[0],
            values[1],
            values[2]
        );
        measured.push(values);
        let [left, right] = [0, 1].map(|index| stretched(&sample.views[index].recording.image));
        let overlay = overlay(&left, view);
        let row = concatenate(Axis(1), &[left.view(), right.view(), overlay.view()]).expect("views have one shape");
        write(&Path::new(folder).join(format!("{}-{}-{index}.png", family.word(), mode.word())), &row);
    }
    for (column, name) in ["SNR lines, dB", "SNR background, dB", "contrast, grey"].into_iter().enumerate() {
        let values: Vec<f64> = measured.iter().map(|row| row[column]).filter(|value| value.is_finite()).collect();
        let count = values.len().max(1) as f64;
        let mean = values.iter().sum::<f64>() / count;
        let deviation = (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt();
        println!("{name}: mean {mean:.1}, standard deviation {deviation:.1}, {} images", values.len());
    }
}

fn visible_length_px(view: &TrueView) -> f64 {
    let pieces = view.curves.iter().flat_map(|curve| {
        let ends = curve.contrast.windows(2).enumerate();
        ends.filter(|(index, ends)| curve.is_visible(*index) && view.contains(&ends[0]))
            .map(|(_, ends)| (ends[1] - ends[0]).norm())
    });
    pieces.sum()
}

fn stretched(image: &Array2<f32>) -> Array2<f32> {
    let [low, high] = percentiles(image, [0.005, 0.995]);
    image.mapv(|value| ((value - low) / (high - low).max(1e-6)).clamp(0.0, 1.0))
}

fn overlay(image: &Array2<f32>, view: &TrueView) -> Array2<f32> {
    let mut image = image.mapv(|value| 0.25 + 0.5 * value);
    for curve in &view.curves {
        for (index, point) in curve.contrast.iter().enumerate().filter(|(_, point)| view.contains(point)) {
            let (column, row) = (point.x.round().max(0.0) as usize, point.y.round().max(0.0) as usize);
            if let Some(pixel) = image.get_mut([row, column]) {
                *pixel = if curve.is_visible(index) { 1.0 } else { 0.0 };
            }
        }
    }
    image
}

fn write(path: &Path, image: &Array2<f32>) {
    let (height, width) = image.dim();
    let mut encoder = png::Encoder::new(File::create(path).expect("the folder exists"), width as u32, height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    let bytes: Vec<u8> = image.iter().map(|value| (value * 255.0).round() as u8).collect();
    encoder.write_header().and_then(|mut writer| writer.write_image_data(&bytes)).expect("the disk has space");
}

//! Detectors on real images that were labelled by hand: `real IMAGES LABELS OUT [WEIGHTS|ridge]`; without, the built-in network.
//!
//! IMAGES is a folder of images, LABELS one of LabelMe files with "line" strips and "unknown" polygons, drawn by eye to some
//! 2 px. For each image: found, the share of labelled length with a traced line within 4 px; invented, the share of traced length
//! further than that from every label; stretches in unknown polygons count for neither. OUT gets a picture of each: input beside
//! the traced lines.
#![allow(clippy::print_stdout)] // what a program is for

use std::error::Error;
use std::path::{Path, PathBuf};

use burn::tensor::Device;
use ndarray::{Array2, s};
use serde::Deserialize;
use tiltline::export::png::write_grey;
use tiltline::geometry::Point2;
use tiltline::io::read_micrograph;
use tiltline::micrograph::View;
use tiltline::pipeline::Detect;
use tiltline::rectify::{Rectification, RectifiedPair};
use tiltline::ridge::RidgeDetector;
use tiltline::simulate::view::ViewSettings;
use tiltline::trace::{TraceSettings, trace};
use tiltline_nets::infer::{Named, NetDetector};

/// A label and a line this close are the same, px: twice what a hand is off.
const NEAR_PX: f64 = 4.0;

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Labels {
    image_path: String,
    shapes: Vec<Shape>,
}

#[derive(Deserialize)]
struct Shape {
    label: String,
    points: Vec<[f64; 2]>,
}

impl Shape {
    /// LabelMe counts from the corner of the first pixel.
    fn points(&self) -> Vec<Point2> {
        self.points.iter().map(|[x, y]| Point2::new(x - 0.5, y - 0.5)).collect()
    }
}

/// Points every half px along a polyline.
fn along(points: &[Point2]) -> Vec<Point2> {
    let pieces = points.windows(2).flat_map(|ends| {
        let count = (2.0 * (ends[1] - ends[0]).norm()).ceil().max(1.0) as usize;
        (0..count).map(move |index| ends[0] + (ends[1] - ends[0]) * (index as f64 / count as f64))
    });
    pieces.collect()
}

fn inside(polygon: &[Point2], point: &Point2) -> bool {
    let edges = polygon.iter().zip(polygon.iter().cycle().skip(1));
    let crossed = edges.filter(|(a, b)| {
        (a.y > point.y) != (b.y > point.y) && point.x < (b.x - a.x) * (point.y - a.y) / (b.y - a.y) + a.x
    });
    crossed.count() % 2 == 1
}

/// How many points there are outside the unknown, and how many of them have one of the others near.
fn near(points: &[Point2], others: &[Point2], unknown: &[Vec<Point2>]) -> [usize; 2] {
    let known = points.iter().filter(|point| !unknown.iter().any(|polygon| inside(polygon, point)));
    known.fold([0; 2], |[all, near], point| {
        let hit = others.iter().any(|other| (other - point).norm() <= NEAR_PX);
        [all + 1, near + usize::from(hit)]
    })
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [images, labels, out, rest @ ..] = &arguments[..] else {
        return Err("real IMAGES LABELS OUT [WEIGHTS|ridge]".into());
    };
    let device = Device::flex();
    let detector: Box<dyn Detect> = match rest.first().map(String::as_str) {
        Some("ridge") => Box::new(RidgeDetector::default()),
        Some(path) => Box::new(NetDetector::new(&Named::read(Path::new(path))?, &device)?),
        None => Box::new(NetDetector::new(&Named::built_in_detector()?, &device)?),
    };
    std::fs::create_dir_all(out)?;
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(labels)?.map(|entry| Ok(entry?.path())).collect::<Result<_, std::io::Error>>()?;
    files.retain(|path| path.extension().is_some_and(|ending| ending == "json"));
    files.sort();
    println!("{:20} {:>8} {:>8} {:>9} {:>9}", "image", "found", "invented", "label, px", "drawn, px");
    let mut sums = [0; 4];
    for file in files {
        let labels: Labels = serde_json::from_slice(&std::fs::read(&file)?)?;
        let shapes = |label: &str| -> Vec<Vec<Point2>> {
            labels.shapes.iter().filter(|shape| shape.label == label).map(Shape::points).collect()
        };
        let unknown = shapes("unknown");
        let lines: Vec<Point2> = shapes("line").iter().flat_map(|points| along(points)).collect();
        let image = read_micrograph(&Path::new(images).join(&labels.image_path).to_string_lossy())?.normalised();
        let view = ViewSettings { shape: [image.nrows(), image.ncols()], ..ViewSettings::default() };
        let rectification = Rectification::from_known_views(&view, &view);
        let pair = RectifiedPair { left: image.clone(), right: image.clone(), rectification };
        let map = detector.detect(&pair, View::Left);
        let graph = trace(&map, &TraceSettings::default());
        let traced: Vec<Point2> = graph
            .traces
            .iter()
            .flat_map(|trace| along(&trace.points.iter().map(|point| point.position).collect::<Vec<_>>()))
            .collect();
        let [length, found] = near(&lines, &traced, &unknown);
        let [drawn, right] = near(&traced, &lines, &unknown);
        let share = |part: usize, of: usize| 100.0 * part as f64 / of.max(1) as f64;
        println!(
            "{:20} {:7.1}% {:7.1}% {:9} {:9}",
            labels.image_path,
            share(found, length),
            share(drawn - right, drawn),
            length / 2,
            drawn / 2
        );
        for (sum, value) in sums.iter_mut().zip([length, found, drawn, right]) {
            *sum += value;
        }
        let name = file.file_stem().unwrap_or_default().to_string_lossy();
        picture(&Path::new(out).join(format!("{name}.png")), &image, &map.probability, &traced)?;
    }
    let [length, found, drawn, right] = sums.map(|sum| sum as f64);
    println!(
        "{:20} {:7.1}% {:7.1}% {:9.0} {:9.0}",
        "all",
        100.0 * found / length,
        100.0 * (1.0 - right / drawn),
        length / 2.0,
        drawn / 2.0
    );
    Ok(())
}

/// Input, probability, and the traced lines, side by side.
fn picture(
    path: &Path,
    image: &Array2<f32>,
    probability: &Array2<f32>,
    traced: &[Point2],
) -> Result<(), Box<dyn Error>> {
    let (rows, columns) = image.dim();
    let mut sheet = Array2::<u8>::zeros((rows, 3 * columns));
    for (place, map) in [image, probability, image].into_iter().enumerate() {
        let level = if place == 2 { 110.0 } else { 255.0 };
        let grey = map.mapv(|value| (level * value.clamp(0.0, 1.0)) as u8);
        sheet.slice_mut(s![.., place * columns..(place + 1) * columns]).assign(&grey);
    }
    for point in traced {
        let (row, column) = (point.y.round().max(0.0) as usize, point.x.round().max(0.0) as usize);
        if row < rows && column < columns {
            sheet[[row, 2 * columns + column]] = 255;
        }
    }
    write_grey(&sheet, &mut std::fs::File::create(path)?)?;
    Ok(())
}

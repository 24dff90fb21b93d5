//! Shows what the ridge detector and the tracer make of one image: lines over the image at twice its size.
//!
//! `cargo run --release -p tiltline --example trace_image -- IMAGE.png OUT.png [dark|bright|auto] [SENSITIVITY]`
//!
//! `OUT.png` may be `-` for no picture. `IMAGE.png` may be `scene:SEED:CONTRAST`: a rendered scene, whose true curves are then drawn in cyan.
//!
//! Red: traces; yellow dots: junctions; green: ends at the border; blue: free ends. Eight-bit grey PNG only.
#![allow(clippy::print_stdout, clippy::unwrap_used)]

use std::fs::File;
use std::io::{BufReader, BufWriter};
use std::time::Instant;

use ndarray::Array2;
use tiltline::curve::{TraceEnd, TraceGraph};
use tiltline::filter::sample_cubic;
use tiltline::geometry::Point2;
use tiltline::micrograph::{Micrograph, View};
use tiltline::pipeline::Detect;
use tiltline::rectify::{Rectification, RectifiedPair};
use tiltline::ridge::{LinePolarity, RidgeDetector};
use tiltline::simulate::{Scene, SceneSettings, ViewSettings, render};
use tiltline::trace::{TraceSettings, trace};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [input, output] = &arguments[..2] else { panic!("usage: trace_image IMAGE.png OUT.png [dark|bright|auto]") };
    let (image, truth) = match input.strip_prefix("scene:").and_then(|rest| rest.split_once(':')) {
        Some((seed, contrast)) => {
            let (seed, line_contrast) = (seed.parse().unwrap(), contrast.parse().unwrap());
            let view = ViewSettings { seed, line_contrast, ..ViewSettings::default() };
            let scene = Scene::random(&SceneSettings { seed, ..SceneSettings::default() });
            (render(&scene, &view).normalised(), view.project_curves(&scene))
        }
        None => (Micrograph::new(read_grey(input)).normalised(), Vec::new()),
    };
    let view = ViewSettings { shape: image.dim().into(), ..ViewSettings::default() };
    let rectification = Rectification::from_known_views(&view, &view);
    let pair = RectifiedPair { left: image.clone(), right: image.clone(), rectification };
    let mut detector = RidgeDetector::default();
    detector.settings.lines = match arguments.get(2).map(String::as_str) {
        Some("dark") => LinePolarity::Dark,
        Some("bright") => LinePolarity::Bright,
        _ => LinePolarity::Auto,
    };
    if let Some(sensitivity) = arguments.get(3) {
        detector.settings.sensitivity = sensitivity.parse().unwrap();
    }
    let start = Instant::now();
    let polarity = detector.polarity(&pair);
    let polarity_s = start.elapsed().as_secs_f64();
    detector.settings.lines = polarity;
    let start = Instant::now();
    let lines = detector.detect(&pair, View::Left);
    let detect_s = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let graph = trace(&lines, &TraceSettings::default());
    let trace_s = start.elapsed().as_secs_f64();
    let length: f64 = graph.traces.iter().map(|trace| trace.length_px()).sum();
    println!(
        "{input}: {polarity:?}, width {:.2} px, {} traces, {} junctions, {length:.0} px; polarity {polarity_s:.3} s, detect {detect_s:.3} s, trace {trace_s:.3} s",
        lines.line_width_px,
        graph.traces.len(),
        graph.junctions.len(),
    );
    if !truth.is_empty() {
        let traced: Vec<Point2> = graph.traces.iter().flat_map(|t| &t.points).map(|p| p.position).collect();
        let (rows, columns) = image.dim();
        let inside = |p: &&Point2| p.x >= 0.0 && p.y >= 0.0 && p.x < columns as f64 && p.y < rows as f64;
        let truth: Vec<Point2> = truth.iter().flatten().filter(inside).copied().collect();
        let near = |from: &[Point2], to: &[Point2]| {
            let hits = from.iter().filter(|a| to.iter().any(|b| (*a - b).norm() <= 2.0)).count();
            hits as f64 / from.len().max(1) as f64
        };
        println!("  completeness {:.3}, correctness {:.3} at 2 px", near(&truth, &traced), near(&traced, &truth));
    }
    if output != "-" {
        draw(&image, &truth, &graph, output);
    }
}

fn read_grey(path: &str) -> Array2<f32> {
    let mut reader = png::Decoder::new(BufReader::new(File::open(path).unwrap())).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    assert_eq!((info.color_type, info.bit_depth), (png::ColorType::Grayscale, png::BitDepth::Eight), "8-bit grey only");
    let shape = (info.height as usize, info.width as usize);
    Array2::from_shape_fn(shape, |(row, column)| f32::from(bytes[row * info.line_size + column]))
}

fn draw(image: &Array2<f32>, truth: &[Vec<Point2>], graph: &TraceGraph, path: &str) {
    let (rows, columns) = (2 * image.nrows(), 2 * image.ncols());
    let mut canvas = vec![[0_u8; 3]; rows * columns];
    for (index, pixel) in canvas.iter_mut().enumerate() {
        let (x, y) = ((index % columns) as f64 / 2.0, (index / columns) as f64 / 2.0);
        let value = sample_cubic(&image.view(), x, y).unwrap_or(0.0);
        *pixel = [(value.clamp(0.0, 1.0) * 255.0) as u8; 3];
    }
    let mut dot = |point: Point2, size: i64, colour: [u8; 3]| {
        let (x, y) = ((2.0 * point.x).round() as i64, (2.0 * point.y).round() as i64);
        for (x, y) in (-size..=size).flat_map(|down| (-size..=size).map(move |right| (x + right, y + down))) {
            if x >= 0 && y >= 0 && x < columns as i64 && y < rows as i64 {
                canvas[y as usize * columns + x as usize] = colour;
            }
        }
    };
    for point in truth.iter().flatten() {
        dot(*point, 0, [0, 230, 230]);
    }
    for trace in &graph.traces {
        for pair in trace.points.windows(2) {
            for step in 0..3 {
                let point = pair[0].position + (pair[1].position - pair[0].position) * (f64::from(step) / 3.0);
                dot(point, 0, [255, 40, 40]);
            }
        }
        for (end, point) in trace.ends.iter().zip([&trace.points[0], &trace.points[trace.points.len() - 1]]) {
            match end {
                TraceEnd::Free if !trace.closed => dot(point.position, 1, [60, 120, 255]),
                TraceEnd::Border => dot(point.position, 1, [40, 255, 40]),
                _ => {}
            }
        }
    }
    for junction in &graph.junctions {
        dot(*junction, 2, [255, 255, 0]);
    }
    let mut encoder = png::Encoder::new(BufWriter::new(File::create(path).unwrap()), columns as u32, rows as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header().unwrap().write_image_data(&canvas.concat()).unwrap();
}

//! Sheets of pictures: panels of grey images with lines over them, each with a caption, as PNG.

use ndarray::Array2;

use super::FiguresError;
use crate::export::overlay::canvas::{Canvas, Rgb, Strokes, text_width};
use crate::export::overlay::{Zoom, draw_image};
use crate::filter::percentiles;
use crate::geometry::Point2;

const INK: Rgb = [32, 32, 32];
const PAPER: Rgb = [255, 255, 255];
/// Canvas px a dot of the font.
const DOT: usize = 2;
/// Room between panels.
const GAP: usize = 10;
/// Height of a caption.
const CAPTION: usize = 14 * DOT;

/// How large a panel's image px are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Size {
    /// One canvas px each.
    Full,
    /// Squares of two are averaged.
    Half,
}

impl Size {
    pub(super) fn zoom(self) -> Zoom {
        match self {
            Size::Full => Zoom::In(1),
            Size::Half => Zoom::Out(2),
        }
    }
}

/// A picture with words above it.
pub struct Panel {
    /// The words.
    pub caption: String,
    /// The picture.
    pub canvas: Canvas,
}

/// A curve in a picture, in px of the image.
#[derive(Clone, Debug, PartialEq)]
pub struct Stroke {
    /// Its points.
    pub points: Vec<Point2>,
    /// Whether the last joins the first.
    pub closed: bool,
    /// Its colour.
    pub colour: Rgb,
}

/// Grey values stretched to 0 to 1 between two shares of them.
pub fn stretched(image: &Array2<f32>, shares: [f64; 2]) -> Array2<f32> {
    let [low, high] = percentiles(image, shares);
    image.mapv(|value| ((value - low) / (high - low).max(1e-9)).clamp(0.0, 1.0))
}

/// An image of values from 0 to 1 with curves over it, `width` canvas px wide.
pub fn drawn(image: &Array2<f32>, size: Size, strokes: &[Stroke], width: f64) -> Canvas {
    let zoom = size.zoom();
    let mut canvas = draw_image(image, zoom);
    let mut over = Strokes::new([canvas.width, canvas.height]);
    for stroke in strokes {
        let place = |point: &Point2| point.map(|value| zoom.map(value));
        let closing = stroke.points.first().filter(|_| stroke.closed);
        let points: Vec<Point2> = stroke.points.iter().chain(closing).map(place).collect();
        points.windows(2).for_each(|ends| over.piece([ends[0], ends[1]], width, stroke.colour));
    }
    over.paint(&mut canvas, 1.0);
    canvas
}

/// Lines on white.
pub fn on_white(shape: [usize; 2], size: Size, strokes: &[Stroke], width: f64) -> Canvas {
    let mut canvas = drawn(&Array2::zeros(shape), size, &[], width);
    canvas.pixels.fill(u8::MAX);
    let lines = drawn(&Array2::from_elem(shape, f32::NAN), size, strokes, width);
    let void = drawn(&Array2::from_elem(shape, f32::NAN), size, &[], width);
    for ((pixel, line), void) in canvas.pixels.iter_mut().zip(lines.pixels).zip(void.pixels) {
        if line != void {
            *pixel = line;
        }
    }
    canvas
}

/// Panels in rows of `across`.
pub fn sheet(panels: &[Panel], across: usize) -> Canvas {
    let across = across.max(1);
    let cell = |value: fn(&Canvas) -> usize| panels.iter().map(|panel| value(&panel.canvas)).max().unwrap_or(1);
    let (width, height) = (cell(|canvas| canvas.width), cell(|canvas| canvas.height));
    let widest = panels.iter().map(|panel| text_width(&panel.caption, DOT)).max().unwrap_or(0);
    let width = width.max(widest);
    let rows = panels.len().div_ceil(across);
    let total = [GAP + across * (width + GAP), GAP + rows * (CAPTION + height + GAP)];
    let mut sheet = Canvas::new(total[0], total[1], PAPER);
    for (index, panel) in panels.iter().enumerate() {
        let left = GAP + (index % across) * (width + GAP);
        let top = GAP + (index / across) * (CAPTION + height + GAP);
        sheet.text([left, top], &panel.caption, DOT, INK);
        sheet.paste([left, top + CAPTION], &panel.canvas);
    }
    sheet
}

/// One canvas above another.
pub fn stacked(above: &Canvas, below: &Canvas) -> Canvas {
    let mut both = Canvas::new(above.width.max(below.width), above.height + 4 + below.height, PAPER);
    both.paste([0, 0], above);
    both.paste([0, above.height + 4], below);
    both
}

/// A canvas as PNG (8-bit RGB), as small as it gets.
///
/// # Errors
/// Where a side is longer than PNG allows.
pub fn png(canvas: &Canvas) -> Result<Vec<u8>, FiguresError> {
    let (width, height) = (canvas.width, canvas.height);
    let fault = |source| FiguresError::Picture { width, height, source };
    let side = |length: usize| u32::try_from(length).map_err(std::io::Error::other);
    let mut bytes = Vec::new();
    let mut encode = || -> std::io::Result<()> {
        let mut encoder = ::png::Encoder::new(&mut bytes, side(width)?, side(height)?);
        encoder.set_color(::png::ColorType::Rgb);
        encoder.set_depth(::png::BitDepth::Eight);
        encoder.set_compression(::png::Compression::High);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&canvas.pixels)?;
        Ok(writer.finish()?)
    };
    encode().map_err(fault)?;
    Ok(bytes)
}

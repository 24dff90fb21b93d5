//! An RGB picture to draw lines, boxes and text on, with smooth edges. Coordinates are in canvas px, pixel centres at
//! integers.

use std::collections::HashMap;

use crate::export::overlay::font;
use crate::geometry::Point2;

/// A colour: red, green, blue.
pub type Rgb = [u8; 3];

/// An RGB picture.
pub struct Canvas {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Rows of red, green, blue.
    pub pixels: Vec<u8>,
}

impl Canvas {
    /// A picture of one colour.
    pub fn new(width: usize, height: usize, colour: Rgb) -> Self {
        Self { width, height, pixels: colour.repeat(width * height) }
    }

    /// Mixes a colour into a pixel; `cover` from 0 to 1. Outside the picture nothing happens.
    pub fn blend(&mut self, column: isize, row: isize, colour: Rgb, cover: f32) {
        if column < 0 || row < 0 || column as usize >= self.width || row as usize >= self.height || cover <= 0.0 {
            return;
        }
        let first = 3 * (row as usize * self.width + column as usize);
        for (old, new) in self.pixels[first..first + 3].iter_mut().zip(colour) {
            *old = (f32::from(*old) * (1.0 - cover) + f32::from(new) * cover).round() as u8;
        }
    }

    /// Fills the box of columns `x..x + width` and rows `y..y + height`.
    pub fn fill(&mut self, [x, y]: [usize; 2], [width, height]: [usize; 2], colour: Rgb, cover: f32) {
        for row in y..y + height {
            for column in x..x + width {
                self.blend(column as isize, row as isize, colour, cover);
            }
        }
    }

    /// Writes text with its top left corner at (x, y), `scale` px a dot of the font.
    pub fn text(&mut self, [x, y]: [usize; 2], text: &str, scale: usize, colour: Rgb) {
        let letters: Vec<char> = text.chars().collect();
        let dot = scale as f32;
        for row in 0..(font::HEIGHT + 3) * scale {
            for column in 0..text_width(text, scale) + scale {
                // Between the dots ink is interpolated and cut at one half: stems keep their width, diagonals join.
                let (u, v) = ((column as f32 + 0.5) / dot - 0.5, (row as f32 + 0.5) / dot - 0.5);
                let (left, top) = (u.floor(), v.floor());
                let (s, t) = (u - left, v - top);
                let ink = |dx: isize, dy: isize| font::ink(&letters, left as isize + dx, top as isize + dy);
                let above = ink(0, 0) * (1.0 - s) + ink(1, 0) * s;
                let below = ink(0, 1) * (1.0 - s) + ink(1, 1) * s;
                let cover = ((above * (1.0 - t) + below * t - 0.5) * dot + 0.5).clamp(0.0, 1.0);
                self.blend((x + column) as isize, (y + row) as isize, colour, cover);
            }
        }
    }
}

/// Width in px of a text.
pub fn text_width(text: &str, scale: usize) -> usize {
    (text.chars().count() * font::ADVANCE).saturating_sub(1) * scale
}

/// Lines that are drawn together, so that one does not darken where its own pieces overlap.
#[derive(Default)]
pub struct Strokes {
    covers: HashMap<(i32, i32), (f32, Rgb)>,
}

impl Strokes {
    /// Adds a straight piece of a line, `width` px wide. Later pieces lie on top.
    pub fn piece(&mut self, [a, b]: [Point2; 2], width: f64, colour: Rgb) {
        let along = b - a;
        let length2 = along.norm_squared().max(1e-12);
        let reach = 0.5 * width + 0.5;
        let range = |p: f64, q: f64| ((p.min(q) - reach).ceil() as i32)..=((p.max(q) + reach).floor() as i32);
        for row in range(a.y, b.y) {
            for column in range(a.x, b.x) {
                let offset = Point2::new(f64::from(column), f64::from(row)) - a;
                let foot = (offset.dot(&along) / length2).clamp(0.0, 1.0);
                let cover = (reach - (offset - along * foot).norm()).clamp(0.0, 1.0) as f32;
                if cover > 0.0 {
                    let best = self.covers.entry((column, row)).or_insert((0.0, colour));
                    if cover >= best.0 {
                        *best = (cover, colour);
                    }
                }
            }
        }
    }

    /// Draws everything within a box of the canvas (`corner`, `[width, height]`), so opaque.
    pub fn paint(&self, canvas: &mut Canvas, corner: [usize; 2], size: [usize; 2], opacity: f32) {
        for (&(column, row), &(cover, colour)) in &self.covers {
            let (x, y) = (i64::from(column) - corner[0] as i64, i64::from(row) - corner[1] as i64);
            if x >= 0 && y >= 0 && x < size[0] as i64 && y < size[1] as i64 {
                canvas.blend(column as isize, row as isize, colour, cover * opacity);
            }
        }
    }
}

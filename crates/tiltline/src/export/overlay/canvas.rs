//! An RGB picture to draw lines, boxes and text on, with smooth edges. Coordinates are in canvas px, pixel centres at
//! integers.

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

    /// Copies a smaller picture in, its top left corner at (x, y); it must fit.
    pub fn paste(&mut self, [x, y]: [usize; 2], picture: &Canvas) {
        for (row, line) in picture.pixels.chunks_exact(3 * picture.width).enumerate() {
            let first = 3 * ((y + row) * self.width + x);
            self.pixels[first..first + line.len()].copy_from_slice(line);
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

/// Lines that are drawn together on a picture of a given size, so that one does not darken where its own pieces overlap.
pub struct Strokes {
    width: usize,
    height: usize,
    /// Cover (255 is full) and colour of each pixel, row by row.
    covers: Vec<(u8, Rgb)>,
}

impl Strokes {
    /// No lines yet, on a picture of `[width, height]`.
    pub fn new([width, height]: [usize; 2]) -> Self {
        Self { width, height, covers: vec![(0, [0; 3]); width * height] }
    }

    /// Adds a straight piece of a line from a to b (canvas px), `width` px wide. Later pieces lie on top.
    pub fn piece(&mut self, [a, b]: [Point2; 2], width: f64, colour: Rgb) {
        let along = b - a;
        let length2 = along.norm_squared().max(1e-12);
        let reach = 0.5 * width + 0.5;
        let range = |p: f64, q: f64, size: usize| {
            let first = (p.min(q) - reach).ceil().max(0.0) as usize;
            let end = (p.max(q) + reach + 1.0).floor().max(0.0) as usize;
            first..end.min(size)
        };
        for row in range(a.y, b.y, self.height) {
            for column in range(a.x, b.x, self.width) {
                let offset = Point2::new(column as f64, row as f64) - a;
                let foot = (offset.dot(&along) / length2).clamp(0.0, 1.0);
                let cover = (reach - (offset - along * foot).norm()).clamp(0.0, 1.0);
                let cover = (255.0 * cover).round() as u8;
                let best = &mut self.covers[row * self.width + column];
                if cover > 0 && cover >= best.0 {
                    *best = (cover, colour);
                }
            }
        }
    }

    /// Draws everything, so opaque (0 to 1).
    pub fn paint(&self, canvas: &mut Canvas, opacity: f32) {
        for (row, line) in self.covers.chunks_exact(self.width).enumerate() {
            for (column, &(cover, colour)) in line.iter().enumerate().filter(|(_, (cover, _))| *cover > 0) {
                canvas.blend(column as isize, row as isize, colour, f32::from(cover) / 255.0 * opacity);
            }
        }
    }
}

//! `overlay.png`: both rectified images side by side with the detected lines and, coloured by depth, the curves that were
//! matched; a colour bar, a scale bar and a legend (8-bit RGB PNG).

pub mod canvas;
pub mod colour;
pub mod font;

use std::io::{self, Write};

use ndarray::Array2;

use crate::curve::{CurvePoint, Flag};
use crate::export::png::encode;
use crate::geometry::Point2;
use crate::micrograph::View;
use crate::reconstruction::Reconstruction;
use canvas::{Canvas, Rgb, Strokes, text_width};
use colour::viridis;

const PAPER: Rgb = [255, 255, 255];
const INK: Rgb = [32, 32, 32];
/// Where an image has no data.
const VOID: Rgb = [225, 228, 232];
/// Detected lines.
const DETECTED: Rgb = [255, 255, 255];
/// Thin edges of the coloured lines: a dark line would swallow the dark end of the colour map.
const CASING: Rgb = [255, 255, 255];
const CASING_OPACITY: f32 = 0.7;
/// A panel is enlarged by whole factors until its longer side has this many px, so that lines do not hide the image.
const WANTED_PANEL_PX: usize = 768;
/// A panel is shrunk by whole factors until its longer side has no more px than this.
const MAX_PANEL_PX: usize = 2048;

/// Writes `overlay.png`.
pub fn write(reconstruction: &Reconstruction, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    let canvas = draw(reconstruction);
    encode(out, [canvas.height, canvas.width], ::png::ColorType::Rgb, &canvas.pixels)
}

/// Draws the picture.
pub fn draw(reconstruction: &Reconstruction) -> Canvas {
    let layout = Layout::new(reconstruction);
    let mut canvas = Canvas::new(layout.width, layout.height, PAPER);
    let scale = ColourScale::new(reconstruction);
    let panel = |view| {
        let mut panel = draw_image(reconstruction.rectified.view(view), layout.zoom);
        draw_traces(&mut panel, reconstruction, view, &layout);
        draw_curves(&mut panel, reconstruction, view, &layout, &scale);
        panel
    };
    let (left, right) = rayon::join(|| panel(View::Left), || panel(View::Right));
    for (view, panel) in View::BOTH.into_iter().zip([left, right]) {
        canvas.paste(layout.panel(view), &panel);
        draw_title(&mut canvas, reconstruction, view, &layout);
    }
    draw_scale_bar(&mut canvas, reconstruction, &layout);
    draw_colour_bar(&mut canvas, reconstruction, &layout, &scale);
    draw_legend(&mut canvas, &layout);
    canvas
}

/// How rectified px become canvas px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Zoom {
    /// Enlarged by a whole factor.
    In(usize),
    /// Shrunk by a whole factor.
    Out(usize),
}

impl Zoom {
    pub(crate) fn new(longer_side: usize) -> Self {
        if longer_side > MAX_PANEL_PX {
            Zoom::Out(longer_side.div_ceil(MAX_PANEL_PX))
        } else {
            Zoom::In(WANTED_PANEL_PX.div_ceil(longer_side.max(1)).clamp(1, 16))
        }
    }

    pub(crate) fn factor(self) -> f64 {
        match self {
            Zoom::In(factor) => factor as f64,
            Zoom::Out(factor) => 1.0 / factor as f64,
        }
    }

    pub(crate) fn size(self, length: usize) -> usize {
        match self {
            Zoom::In(factor) => length * factor,
            Zoom::Out(factor) => length.div_ceil(factor),
        }
    }

    /// Canvas px of a rectified coordinate: pixel centres are at integers in both.
    pub(crate) fn map(self, value: f64) -> f64 {
        (value + 0.5) * self.factor() - 0.5
    }
}

/// Where everything is, in canvas px.
struct Layout {
    width: usize,
    height: usize,
    zoom: Zoom,
    /// Width and height of an image on the canvas.
    size: [usize; 2],
    /// Canvas px a dot of the font.
    dot: usize,
    margin: usize,
}

impl Layout {
    fn new(reconstruction: &Reconstruction) -> Self {
        let (rows, columns) = reconstruction.rectified.left.dim();
        let zoom = Zoom::new(rows.max(columns));
        let size = [zoom.size(columns), zoom.size(rows)];
        let dot = (size[0].max(size[1]) as f64 / 400.0).round().clamp(2.0, 8.0) as usize;
        let margin = 8 * dot;
        let images = 3 * margin + 2 * size[0];
        let legend = 2 * margin + legend_width(dot);
        let mut layout = Self { width: 0, height: 0, zoom, size, dot, margin };
        layout.width = images.max(legend);
        layout.height = layout.bar_top() + layout.bar_height() + layout.line() + margin;
        layout
    }

    /// Height of a line of text with what parts it from the next.
    fn line(&self) -> usize {
        14 * self.dot
    }

    fn panel(&self, view: View) -> [usize; 2] {
        [self.margin + view.index() * (self.size[0] + self.margin), self.margin / 2 + self.line()]
    }

    fn legend_top(&self) -> usize {
        self.panel(View::Left)[1] + self.size[1] + self.margin
    }

    fn bar_top(&self) -> usize {
        self.legend_top() + self.line() + self.margin / 2
    }

    fn bar_height(&self) -> usize {
        9 * self.dot
    }

    /// A rectified point on the panel of its image.
    fn panel_point(&self, point: &Point2) -> Point2 {
        point.map(|value| self.zoom.map(value))
    }

    /// Width of a detected line on the canvas.
    fn thin_stroke(&self) -> f64 {
        0.55 * self.stroke()
    }

    /// Width of a matched line on the canvas: no wider than the lines it lies on.
    fn stroke(&self) -> f64 {
        (0.5 * self.dot as f64).max(1.5 * self.zoom.factor()).max(2.0)
    }
}

/// The depths that the ends of the colour map stand for.
struct ColourScale {
    low: f64,
    high: f64,
}

impl ColourScale {
    /// The length-weighted 2.5 to 97.5 percent of depth; one pixel wide without curves.
    fn new(reconstruction: &Reconstruction) -> Self {
        let depth = reconstruction.measures.depth.as_ref();
        let (low, high) = depth.map_or((0.0, 0.0), |depth| (depth.low, depth.high));
        // A flat curve still needs a range.
        let spare = if high - low > 1e-6 * reconstruction.frame.pixel { 0.0 } else { 0.5 * reconstruction.frame.pixel };
        Self { low: low - spare, high: high + spare }
    }

    fn colour(&self, z: f64) -> Rgb {
        viridis((z - self.low) / (self.high - self.low))
    }
}

/// A rectified image, whose intensity is normalised to 0..1, from dark to light grey; white is left for the lines.
pub(crate) fn draw_image(image: &Array2<f32>, zoom: Zoom) -> Canvas {
    let (rows, columns) = image.dim();
    let mut canvas = Canvas::new(zoom.size(columns), zoom.size(rows), VOID);
    let width = canvas.width;
    for (row, line) in canvas.pixels.chunks_exact_mut(3 * width).enumerate() {
        for (column, pixel) in line.chunks_exact_mut(3).enumerate() {
            let value = match zoom {
                Zoom::In(factor) => image[[row / factor, column / factor]],
                Zoom::Out(factor) => mean(image, [row * factor, column * factor], factor),
            };
            if value.is_finite() {
                pixel.fill((15.0 + 195.0 * value.clamp(0.0, 1.0)).round() as u8);
            }
        }
    }
    canvas
}

/// Mean of a square of pixels; NaN if one of them is.
fn mean(image: &Array2<f32>, [row, column]: [usize; 2], side: usize) -> f32 {
    let rows = row..(row + side).min(image.nrows());
    let columns = column..(column + side).min(image.ncols());
    let count = (rows.len() * columns.len()) as f32;
    rows.map(|row| columns.clone().map(|column| image[[row, column]]).sum::<f32>()).sum::<f32>() / count
}

fn draw_traces(canvas: &mut Canvas, reconstruction: &Reconstruction, view: View, layout: &Layout) {
    let mut strokes = Strokes::new(layout.size);
    for trace in &reconstruction.traces[view.index()].traces {
        let points = trace.points.iter().chain(trace.closed.then(|| &trace.points[0]));
        let points: Vec<Point2> = points.map(|point| layout.panel_point(&point.position)).collect();
        for pair in points.windows(2) {
            strokes.piece([pair[0], pair[1]], layout.thin_stroke(), DETECTED);
        }
    }
    strokes.paint(canvas, 0.75);
}

fn draw_curves(canvas: &mut Canvas, reconstruction: &Reconstruction, view: View, layout: &Layout, scale: &ColourScale) {
    let place = |point: &CurvePoint| match view {
        View::Left => layout.panel_point(&point.left_rectified),
        View::Right => {
            let right = Point2::new(point.left_rectified.x + point.disparity_px, point.left_rectified.y);
            layout.panel_point(&right)
        }
    };
    // Far curves first, so that near ones lie on top.
    let mean_z = |index: &usize| {
        let points = &reconstruction.curves[*index].points;
        points.iter().map(|point| point.position.z).sum::<f64>() / points.len() as f64
    };
    let mut order: Vec<usize> = (0..reconstruction.curves.len()).collect();
    order.sort_by(|a, b| mean_z(b).total_cmp(&mean_z(a)));
    let boxed = || Strokes::new(layout.size);
    let (mut casing, mut strokes) = (boxed(), boxed());
    let dash = 3.0 * layout.dot as f64;
    for index in order {
        let curve = &reconstruction.curves[index];
        let mut along = 0.0;
        let closing = curve.closed.then(|| [&curve.points[curve.points.len() - 1], &curve.points[0]]);
        for [a, b] in curve.points.windows(2).map(|pair| [&pair[0], &pair[1]]).chain(closing) {
            let ends = [place(a), place(b)];
            let doubtful = a.flag != Flag::Ok || b.flag != Flag::Ok;
            // A dash and a gap of the same length where the depth was not measured well.
            if !doubtful || ((along / dash) as usize).is_multiple_of(2) {
                casing.piece(ends, 1.5 * layout.stroke(), CASING);
                strokes.piece(ends, layout.stroke(), scale.colour(0.5 * (a.position.z + b.position.z)));
            }
            along += (ends[1] - ends[0]).norm();
        }
    }
    casing.paint(canvas, CASING_OPACITY);
    strokes.paint(canvas, 1.0);
}

fn draw_title(canvas: &mut Canvas, reconstruction: &Reconstruction, view: View, layout: &Layout) {
    let tilts = reconstruction.pair.tilts;
    let (name, tilt) = match view {
        View::Left => ("left", tilts.left_rad),
        View::Right => ("right", tilts.right_rad),
    };
    let [x, y] = layout.panel(view);
    let text = format!("{name} {:+.2}°", tilt.to_degrees());
    canvas.text([x, y - layout.line() + 3 * layout.dot], &text, layout.dot, INK);
}

/// A bar of a round length in the lower left corner of the left image.
fn draw_scale_bar(canvas: &mut Canvas, reconstruction: &Reconstruction, layout: &Layout) {
    let pixel = reconstruction.frame.pixel / layout.zoom.factor();
    let length = round_down(0.3 * layout.size[0] as f64 * pixel);
    let bar = (length / pixel).round() as usize;
    let dot = layout.dot;
    let (text, unit) = (number(length), reconstruction.frame.unit.word());
    let text = format!("{text} {unit}");
    let box_size = [bar.max(text_width(&text, dot)) + 8 * dot, 20 * dot];
    let [x, y] = layout.panel(View::Left);
    if box_size[0] + 4 * dot > layout.size[0] || box_size[1] + 4 * dot > layout.size[1] {
        return;
    }
    let corner = [x + 4 * dot, y + layout.size[1] - 4 * dot - box_size[1]];
    canvas.fill(corner, box_size, [0, 0, 0], 0.6);
    let middle = corner[0] + box_size[0] / 2;
    canvas.text([middle - text_width(&text, dot) / 2, corner[1] + 3 * dot], &text, dot, PAPER);
    canvas.fill([middle - bar / 2, corner[1] + 14 * dot], [bar, 2 * dot], PAPER, 1.0);
}

fn draw_colour_bar(canvas: &mut Canvas, reconstruction: &Reconstruction, layout: &Layout, scale: &ColourScale) {
    let dot = layout.dot;
    let unit = reconstruction.frame.unit.word();
    let (left, top) = (layout.margin, layout.bar_top());
    let below = top + layout.bar_height() + 4 * dot;
    let flipped = if reconstruction.frame.depth_flipped { ", flipped" } else { "" };
    let label = format!("depth z ({unit}), + away from viewer{flipped}");
    canvas.text([left, top + dot], &label, dot, INK);
    let bar_left = left + text_width(&label, dot) + 2 * layout.margin;
    let bar_width = layout.width.saturating_sub(layout.margin + bar_left);
    let Some(depth) = &reconstruction.measures.depth else {
        canvas.text([left, below], "no curves", dot, INK);
        return;
    };
    let sigma = format!("typical sigma {} {unit}", two_digits(depth.sigma_z));
    canvas.text([left, below], &sigma, dot, INK);
    for column in 0..bar_width {
        let fraction = column as f64 / bar_width as f64;
        canvas.fill([bar_left + column, top], [1, layout.bar_height()], viridis(fraction), 1.0);
    }
    let step = tick_step(scale.high - scale.low);
    let mut tick = (scale.low / step).ceil();
    while tick * step <= scale.high + 1e-9 * step {
        let fraction = (tick * step - scale.low) / (scale.high - scale.low);
        let x = bar_left + (fraction * bar_width.saturating_sub(1) as f64).round() as usize;
        canvas.fill([x.saturating_sub(dot / 2), top + layout.bar_height()], [dot, 3 * dot], INK, 1.0);
        let text = number(tick * step);
        // A minus sign hangs out to the left, so that the digits stand under their tick.
        let half = text_width(text.trim_start_matches('-'), dot) / 2;
        let hang = if text.starts_with('-') { font::ADVANCE * dot } else { 0 };
        let at = x.saturating_sub(half + hang).min(layout.width.saturating_sub(text_width(&text, dot) + 1));
        canvas.text([at, below], &text, dot, INK);
        tick += 1.0;
    }
}

const DETECTED_TEXT: &str = "detected line";
const MATCHED_TEXT: &str = "matched, coloured by depth";
const DOUBTFUL_TEXT: &str = "bridged or ill conditioned";

/// Width of a sample of a line in the legend, in dots.
const SAMPLE_DOTS: usize = 24;

fn legend_width(dot: usize) -> usize {
    let texts = [DETECTED_TEXT, MATCHED_TEXT, DOUBTFUL_TEXT];
    texts.iter().map(|text| text_width(text, dot) + (SAMPLE_DOTS + 20) * dot).sum()
}

fn draw_legend(canvas: &mut Canvas, layout: &Layout) {
    let dot = layout.dot;
    let top = layout.legend_top();
    let mut left = layout.margin;
    let [width, height] = [SAMPLE_DOTS * dot, 9 * dot];
    for (index, text) in [DETECTED_TEXT, MATCHED_TEXT, DOUBTFUL_TEXT].into_iter().enumerate() {
        let mut sample = Canvas::new(width, height, [120; 3]);
        let (mut casing, mut strokes) = (Strokes::new([width, height]), Strokes::new([width, height]));
        let pieces = 48;
        for piece in 0..pieces {
            let at = |step: usize| Point2::new((width * step) as f64 / pieces as f64, 0.5 * (height - 1) as f64);
            let ends = [at(piece), at(piece + 1)];
            if index == 0 {
                strokes.piece(ends, layout.thin_stroke(), DETECTED);
            } else if index == 1 || (piece / 6) % 2 == 0 {
                casing.piece(ends, 1.5 * layout.stroke(), CASING);
                strokes.piece(ends, layout.stroke(), viridis(piece as f64 / pieces as f64));
            }
        }
        casing.paint(&mut sample, CASING_OPACITY);
        strokes.paint(&mut sample, 1.0);
        canvas.paste([left, top], &sample);
        canvas.text([left + width + 4 * dot, top + dot], text, dot, INK);
        left += width + text_width(text, dot) + 20 * dot;
    }
}

/// The largest of 1, 2, 5 times a power of ten that is not above a positive value.
pub(crate) fn round_down(value: f64) -> f64 {
    let power = 10.0_f64.powf(value.log10().floor());
    let factor = [5.0, 2.0, 1.0].into_iter().find(|factor| factor * power <= value * (1.0 + 1e-9));
    factor.unwrap_or(1.0) * power
}

/// A round distance between ticks that puts three to eight of them on a range.
pub(crate) fn tick_step(range: f64) -> f64 {
    round_down(range / 3.0)
}

/// A positive value with two digits that count.
pub(crate) fn two_digits(value: f64) -> String {
    let decimals = if value > 0.0 { (1.0 - value.log10().floor()).clamp(0.0, 9.0) as usize } else { 1 };
    format!("{value:.decimals$}")
}

/// A round number as short as it can be; a minus sign stays with its number.
pub(crate) fn number(value: f64) -> String {
    let rounded = format!("{value:.9}").parse().unwrap_or(value) + 0.0;
    format!("{rounded}")
}

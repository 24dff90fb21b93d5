//! A small SVG document: shapes, text, axes, the colour bar of depth.

use std::fmt::Write;

use crate::export::overlay::canvas::Rgb;
use crate::export::overlay::colour::viridis;
use crate::export::overlay::{number, tick_step};
use crate::report::page::escaped;
use crate::report::{Report, ReportCurve};

/// Width of a figure in points: 180 mm, two columns of a page.
pub const WIDTH: f64 = 510.24;
/// Points in a millimetre.
const POINTS_PER_MM: f64 = 72.0 / 25.4;
/// Size of all text.
pub const FONT: f64 = 7.5;
/// Text and axes.
pub const INK: &str = "#222222";
/// What only guides the eye.
pub const FAINT: &str = "#c9ced4";
/// Share of the colour map that is used: its lightest end vanishes on white.
const SHOWN: f64 = 0.93;
/// Width of a number below the colour bar and the gap to the next, points.
const TICK_ROOM: f64 = 24.0;
/// Colours that a line is cut into.
const SHADES: usize = 48;

/// A document under construction.
pub struct Svg {
    height: f64,
    body: String,
}

/// Where text stands relative to its point.
#[derive(Clone, Copy)]
pub enum Anchor {
    /// To the right of it.
    Start,
    /// About it.
    Middle,
    /// To the left of it.
    End,
}

impl Svg {
    /// An empty figure, so many points high.
    pub fn new(height: f64) -> Self {
        Self { height, body: String::new() }
    }

    /// Appends markup.
    pub fn push(&mut self, markup: &str) {
        self.body.push_str(markup);
        self.body.push('\n');
    }

    /// The document, with a title for those who cannot see it.
    pub fn finish(self, title: &str) -> String {
        let (width_mm, height_mm) = (WIDTH / POINTS_PER_MM, self.height / POINTS_PER_MM);
        format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<svg xmlns=\"http://www.w3.org/2000/svg\" \
             xmlns:xlink=\"http://www.w3.org/1999/xlink\" width=\"{width_mm:.2}mm\" height=\"{height_mm:.2}mm\" \
             viewBox=\"0 0 {WIDTH:.2} {:.2}\" font-family=\"Helvetica, Arial, 'DejaVu Sans', sans-serif\" font-size=\"{FONT}\" \
             fill=\"{INK}\">\n<title>{}</title>\n<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n{}</svg>\n",
            self.height,
            escaped(title),
            self.body
        )
    }

    /// A straight line.
    pub fn line(&mut self, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2], colour: &str, width: f64) {
        self.push(&format!(
            "<line x1=\"{x1:.2}\" y1=\"{y1:.2}\" x2=\"{x2:.2}\" y2=\"{y2:.2}\" stroke=\"{colour}\" stroke-width=\"{width}\"/>"
        ));
    }

    /// A filled rectangle.
    pub fn rect(&mut self, [x, y]: [f64; 2], [width, height]: [f64; 2], fill: &str) {
        self.push(&format!(
            "<rect x=\"{x:.2}\" y=\"{y:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" fill=\"{fill}\"/>"
        ));
    }

    /// Text on a baseline.
    pub fn text(&mut self, [x, y]: [f64; 2], anchor: Anchor, text: &str) {
        let anchor = anchor_word(anchor);
        self.push(&format!(
            "<text x=\"{x:.2}\" y=\"{y:.2}\" text-anchor=\"{anchor}\">{}</text>",
            escaped(&minus(text))
        ));
    }

    /// Text that runs upwards, about its point.
    pub fn text_up(&mut self, [x, y]: [f64; 2], text: &str) {
        self.push(&format!(
            "<text transform=\"translate({x:.2} {y:.2}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            escaped(text)
        ));
    }

    /// Bold text on a baseline: the name of a panel.
    pub fn heading(&mut self, [x, y]: [f64; 2], text: &str) {
        let text = escaped(&minus(text));
        self.push(&format!("<text x=\"{x:.2}\" y=\"{y:.2}\" font-weight=\"bold\">{text}</text>"));
    }

    /// A curve coloured by depth; `place` puts its points on the paper.
    pub fn curve(
        &mut self,
        report: &Report,
        scale: &DepthScale,
        curve: &ReportCurve,
        width: f64,
        place: impl Fn(usize) -> [f64; 2],
    ) {
        let count = curve.x.len();
        let shade = |point: usize| scale.shade(report.position(curve, point)[2]);
        let steps = if curve.closed { count } else { count.saturating_sub(1) };
        let mut step = 0;
        while step < steps {
            let colour = shade(step);
            let [x, y] = place(step);
            let mut path = format!("M{x:.2} {y:.2}");
            while step < steps && shade(step) == colour {
                step += 1;
                let [x, y] = place(step % count);
                let _ = write!(path, "L{x:.2} {y:.2}");
            }
            let colour = hex(scale.colour_of(colour));
            self.push(&format!(
                "<path d=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\" stroke-linecap=\"round\" \
                 stroke-linejoin=\"round\"/>"
            ));
        }
    }
}

fn anchor_word(anchor: Anchor) -> &'static str {
    match anchor {
        Anchor::Start => "start",
        Anchor::Middle => "middle",
        Anchor::End => "end",
    }
}

/// A true minus sign before numbers.
fn minus(text: &str) -> String {
    let mut result = String::with_capacity(text.len());
    let letters: Vec<char> = text.chars().collect();
    for (index, &letter) in letters.iter().enumerate() {
        let starts = index == 0 || letters[index - 1] == ' ';
        let number = letters.get(index + 1).is_some_and(char::is_ascii_digit);
        result.push(if letter == '-' && starts && number { '\u{2212}' } else { letter });
    }
    result
}

/// `#rrggbb`.
pub fn hex([r, g, b]: Rgb) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// The depths that the colours stand for.
pub struct DepthScale {
    /// Depth of the first colour.
    pub low: f64,
    /// Depth of the last.
    pub high: f64,
}

impl DepthScale {
    /// The length-weighted 2.5 to 97.5 percent of depth, as on the page.
    pub fn new(report: &Report) -> Self {
        let (low, high) = report.measures.depth.as_ref().map_or((0.0, 0.0), |depth| (depth.low, depth.high));
        let spare = if high - low > 1e-6 * report.frame.pixel { 0.0 } else { 0.5 * report.frame.pixel };
        Self { low: low - spare, high: high + spare }
    }

    fn shade(&self, z: f64) -> usize {
        let fraction = ((z - self.low) / (self.high - self.low)).clamp(0.0, 1.0);
        ((fraction * SHADES as f64) as usize).min(SHADES - 1)
    }

    fn colour_of(&self, shade: usize) -> Rgb {
        viridis(SHOWN * (shade as f64 + 0.5) / SHADES as f64)
    }

    /// Colour of a depth.
    pub fn colour(&self, z: f64) -> Rgb {
        self.colour_of(self.shade(z))
    }

    /// A horizontal colour bar with its ticks and unit; (x, y) is its upper left corner.
    pub fn draw(&self, svg: &mut Svg, [x, y]: [f64; 2], width: f64, report: &Report) {
        let (unit, height) = (report.frame.unit.word(), 5.0);
        for shade in 0..SHADES {
            let left = x + width * shade as f64 / SHADES as f64;
            svg.rect([left, y], [width / SHADES as f64 + 0.2, height], &hex(self.colour_of(shade)));
        }
        let found = ticks(self.low, self.high);
        // No more numbers than there is room for; zero stays.
        let step = (TICK_ROOM * found.len() as f64 / width).ceil().max(1.0) as usize;
        let zero = found.iter().position(|(value, _)| *value == 0.0).unwrap_or(0);
        for (value, text) in found.into_iter().skip(zero % step).step_by(step) {
            let at = x + width * (value - self.low) / (self.high - self.low);
            svg.line([at, y + height], [at, y + height + 2.5], INK, 0.5);
            svg.text([at, y + height + 3.5 + FONT], Anchor::Middle, &text);
        }
        let flipped = if report.frame.depth_flipped { ", turned" } else { "" };
        let label = format!("depth z ({unit}), + away from viewer{flipped}");
        svg.text([x, y + height + 6.0 + 2.2 * FONT], Anchor::Start, &label);
    }
}

/// Round values in a range, and how they are written.
pub fn ticks(low: f64, high: f64) -> Vec<(f64, String)> {
    let step = tick_step((high - low).max(1e-9));
    let mut found = Vec::new();
    let mut tick = (low / step - 1e-9).ceil();
    while tick * step <= high + 1e-9 * step {
        found.push((tick * step, number(tick * step)));
        tick += 1.0;
    }
    found
}

/// A panel with axes: values to points on the paper.
pub struct Plot {
    /// Upper left corner and size on the paper.
    pub at: [f64; 2],
    /// Width and height.
    pub size: [f64; 2],
    /// Values at the left and right.
    pub x: [f64; 2],
    /// Values at the top and bottom.
    pub y: [f64; 2],
}

impl Plot {
    /// A pair of values on the paper.
    pub fn place(&self, x: f64, y: f64) -> [f64; 2] {
        [
            self.at[0] + self.size[0] * (x - self.x[0]) / (self.x[1] - self.x[0]),
            self.at[1] + self.size[1] * (y - self.y[0]) / (self.y[1] - self.y[0]),
        ]
    }

    /// Frame, ticks and titles.
    pub fn axes(&self, svg: &mut Svg, x_title: &str, y_title: &str) {
        let ([left, top], [width, height]) = (self.at, self.size);
        svg.push(&format!(
            "<rect x=\"{left:.2}\" y=\"{top:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" fill=\"none\" stroke=\"{INK}\" \
             stroke-width=\"0.5\"/>"
        ));
        let found = ticks(self.x[0].min(self.x[1]), self.x[0].max(self.x[1]));
        // No more numbers than there is room for; zero stays.
        let step = (TICK_ROOM * found.len() as f64 / width).ceil().max(1.0) as usize;
        let zero = found.iter().position(|(value, _)| *value == 0.0).unwrap_or(0);
        for (value, text) in found.into_iter().skip(zero % step).step_by(step) {
            let [x, _] = self.place(value, self.y[0]);
            svg.line([x, top + height], [x, top + height + 2.5], INK, 0.5);
            svg.text([x, top + height + 3.5 + FONT], Anchor::Middle, &text);
        }
        for (value, text) in ticks(self.y[0].min(self.y[1]), self.y[0].max(self.y[1])) {
            let [_, y] = self.place(self.x[0], value);
            svg.line([left - 2.5, y], [left, y], INK, 0.5);
            svg.text([left - 4.0, y + 0.35 * FONT], Anchor::End, &text);
        }
        svg.text([left + 0.5 * width, top + height + 2.0 + 2.6 * FONT], Anchor::Middle, x_title);
        svg.text_up([left - 28.0, top + 0.5 * height], y_title);
    }
}

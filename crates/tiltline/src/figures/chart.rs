//! Line charts and histograms in the style of the report's figures: SVG, 180 mm wide, one legend for all panels.

use std::fmt::Write;

use crate::report::figures::svg::{Anchor, FAINT, FONT, INK, Svg, WIDTH, ticks};

const MARGIN: f64 = 14.0;
/// Room left of a panel for its numbers and title.
const LEFT: f64 = 40.0;
/// Room below a panel for the same.
const BELOW: f64 = 34.0;
const TALLEST: f64 = 150.0;
/// Height of the legend.
const LEGEND: f64 = 16.0;
/// Room between the ends of an axis and the first and last place, as a share of a step.
const SPARE: f64 = 0.4;

/// A line of a panel.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// For the legend.
    pub name: String,
    /// `#rrggbb`.
    pub colour: &'static str,
    /// Dashed, and without marks: a level to compare with.
    pub dashed: bool,
    /// A value for each place, where there is one.
    pub values: Vec<Option<f64>>,
}

/// A panel with the same places along x as its neighbours.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// Above it.
    pub heading: String,
    /// Beside its y axis.
    pub y_title: String,
    /// Bottom and top; from 0 to a little above the largest value where not given.
    pub y: Option<[f64; 2]>,
    /// What it shows.
    pub lines: Vec<Line>,
}

/// Values that are counted.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    /// Above it.
    pub heading: String,
    /// Below it.
    pub x_title: String,
    /// Names, colours and values of the groups, which are stacked.
    pub groups: Vec<(String, &'static str, Vec<f64>)>,
}

/// Where the panels of a chart go.
struct Grid {
    across: usize,
    width: f64,
    height: f64,
}

impl Grid {
    fn new(across: usize) -> Self {
        let width = (WIDTH - MARGIN - across as f64 * (LEFT + 8.0)) / across as f64;
        Self { across, width, height: (0.62 * width).min(TALLEST) }
    }

    fn corner(&self, index: usize) -> [f64; 2] {
        let (row, column) = (index / self.across, index % self.across);
        let top = MARGIN + FONT + row as f64 * (self.height + BELOW + MARGIN);
        [LEFT + column as f64 * (self.width + LEFT + 8.0), top]
    }

    fn total(&self, panels: usize) -> f64 {
        let rows = panels.div_ceil(self.across.max(1)) as f64;
        FONT + rows * (self.height + BELOW + MARGIN) + LEGEND
    }
}

/// Panels of lines over the same `labels` along x, which are evenly spaced; `across` panels in a row.
pub fn lines(title: &str, x_title: &str, labels: &[String], panels: &[Panel], across: usize) -> String {
    let grid = Grid::new(across);
    let mut svg = Svg::new(grid.total(panels.len()));
    for (index, panel) in panels.iter().enumerate() {
        let [left, top] = grid.corner(index);
        let largest = panel.lines.iter().flat_map(|line| &line.values).flatten().fold(1e-9_f64, |a, b| a.max(*b));
        let [low, high] = panel.y.unwrap_or([0.0, 1.1 * largest]);
        let step = grid.width / (labels.len().saturating_sub(1) as f64 + 2.0 * SPARE);
        let x = |place: usize| left + (place as f64 + SPARE) * step;
        let y = |value: f64| top + grid.height * (high - value.clamp(low, high)) / (high - low);
        svg.heading([left, top - 4.0], &panel.heading);
        y_axis(&mut svg, [left, top], [grid.width, grid.height], [low, high], &panel.y_title);
        for (place, label) in labels.iter().enumerate() {
            svg.line([x(place), top + grid.height], [x(place), top + grid.height + 2.5], INK, 0.5);
            svg.text([x(place), top + grid.height + 3.5 + FONT], Anchor::Middle, label);
        }
        svg.text([left + 0.5 * grid.width, top + grid.height + 2.0 + 2.6 * FONT], Anchor::Middle, x_title);
        for line in &panel.lines {
            draw_line(&mut svg, line, &|place, value| [x(place), y(value)]);
        }
    }
    let names = panels.first().map(|panel| &panel.lines[..]).unwrap_or_default();
    let names = names.iter().map(|line| (line.name.as_str(), line.colour, line.dashed));
    legend(&mut svg, grid.total(panels.len()) - 6.0, names);
    svg.finish(title)
}

fn draw_line(svg: &mut Svg, line: &Line, place: &dyn Fn(usize, f64) -> [f64; 2]) {
    let mut path = String::new();
    let mut pen = 'M';
    for (index, value) in line.values.iter().enumerate() {
        let Some(value) = value else {
            pen = 'M';
            continue;
        };
        let [x, y] = place(index, *value);
        let _ = write!(path, "{pen}{x:.2} {y:.2}");
        pen = 'L';
        if !line.dashed {
            svg.push(&format!("<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"1.8\" fill=\"{}\"/>", line.colour));
        }
    }
    let dashes = if line.dashed { " stroke-dasharray=\"4 2.5\"" } else { "" };
    svg.push(&format!(
        "<path d=\"{path}\" fill=\"none\" stroke=\"{}\" stroke-width=\"1.1\" stroke-linejoin=\"round\"{dashes}/>",
        line.colour
    ));
}

/// The frame of a panel with its y axis and faint lines across.
fn y_axis(svg: &mut Svg, [left, top]: [f64; 2], [width, height]: [f64; 2], [low, high]: [f64; 2], title: &str) {
    for (value, text) in ticks(low, high) {
        let y = top + height * (high - value) / (high - low);
        svg.line([left, y], [left + width, y], FAINT, 0.4);
        svg.line([left - 2.5, y], [left, y], INK, 0.5);
        svg.text([left - 4.0, y + 0.35 * FONT], Anchor::End, &text);
    }
    svg.push(&format!(
        "<rect x=\"{left:.2}\" y=\"{top:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" fill=\"none\" stroke=\"{INK}\" \
         stroke-width=\"0.5\"/>"
    ));
    svg.text_up([left - 26.0, top + 0.5 * height], title);
}

fn legend<'a>(svg: &mut Svg, y: f64, names: impl Iterator<Item = (&'a str, &'a str, bool)>) {
    let mut x = LEFT;
    for (name, colour, dashed) in names {
        let dashes = if dashed { " stroke-dasharray=\"4 2.5\"" } else { "" };
        let (end, middle) = (x + 16.0, y - 0.35 * FONT);
        svg.push(&format!(
            "<path d=\"M{x:.2} {middle:.2}H{end:.2}\" stroke=\"{colour}\" stroke-width=\"2\" fill=\"none\"{dashes}/>"
        ));
        svg.text([x + 20.0, y], Anchor::Start, name);
        x += 20.0 + 0.56 * FONT * name.chars().count() as f64 + 16.0;
    }
}

/// Histograms side by side, about ten bars each, groups stacked.
pub fn histograms(title: &str, y_title: &str, panels: &[Histogram]) -> String {
    let grid = Grid::new(panels.len().max(1));
    let mut svg = Svg::new(grid.total(panels.len()));
    for (index, panel) in panels.iter().enumerate() {
        let [left, top] = grid.corner(index);
        let values = || panel.groups.iter().flat_map(|group| &group.2).copied();
        let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
        svg.heading([left, top - 4.0], &panel.heading);
        if low > high {
            continue;
        }
        let bins = bins(low, high);
        let count = bins.len() - 1;
        let bin = |value: f64| bins.iter().rposition(|edge| value >= *edge).unwrap_or(0).min(count - 1);
        let mut heights = vec![0_usize; count];
        values().for_each(|value| heights[bin(value)] += 1);
        let highest = 1.15 * heights.iter().copied().max().unwrap_or(0).max(1) as f64;
        y_axis(&mut svg, [left, top], [grid.width, grid.height], [0.0, highest], y_title);
        let x = |value: f64| left + grid.width * (value - bins[0]) / (bins[count] - bins[0]);
        let mut below = vec![0_usize; count];
        for (_, colour, of_group) in &panel.groups {
            let mut more = vec![0_usize; count];
            of_group.iter().for_each(|value| more[bin(*value)] += 1);
            for (place, more) in more.into_iter().enumerate().filter(|(_, more)| *more > 0) {
                let height = |count: usize| grid.height * count as f64 / highest;
                let foot = top + grid.height - height(below[place]);
                let (from, to) = (x(bins[place]), x(bins[place + 1]));
                svg.rect([from + 0.3, foot - height(more)], [to - from - 0.6, height(more)], colour);
                below[place] += more;
            }
        }
        for (value, text) in ticks(bins[0], bins[count]) {
            svg.line([x(value), top + grid.height], [x(value), top + grid.height + 2.5], INK, 0.5);
            svg.text([x(value), top + grid.height + 3.5 + FONT], Anchor::Middle, &text);
        }
        svg.text([left + 0.5 * grid.width, top + grid.height + 2.0 + 2.6 * FONT], Anchor::Middle, &panel.x_title);
    }
    let groups = panels.first().map(|panel| &panel.groups[..]).unwrap_or_default();
    let names = groups.iter().map(|(name, colour, _)| (name.as_str(), *colour, false));
    legend(&mut svg, grid.total(panels.len()) - 6.0, names);
    svg.finish(title)
}

/// Edges of about ten bins at round values; two at least.
fn bins(low: f64, high: f64) -> Vec<f64> {
    let step = crate::export::overlay::tick_step((high - low).max(1e-6)) / 2.0;
    let first = (low / step).floor();
    let count = ((high / step).floor() - first + 1.0).max(1.0) as usize;
    (0..=count).map(|edge| (first + edge as f64) * step).collect()
}

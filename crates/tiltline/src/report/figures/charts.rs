//! Histograms of depth and its sigma; residuals of the rectification.

use crate::export::overlay::{tick_step, two_digits};
use crate::report::Report;
use crate::report::figures::svg::{Anchor, DepthScale, FAINT, FONT, INK, Plot, Svg, WIDTH, hex};
use crate::report::page::title;

const LEFT: f64 = 46.0;
const GAP: f64 = 52.0;
const HEIGHT: f64 = 150.0;
const TOP: f64 = 14.0 + FONT;
/// About so many bars in a histogram.
const BINS: f64 = 10.0;
/// Plain bars.
const BAR: &str = "#5f7f9f";
/// Points above their row, on it, below it.
const BELOW: [u8; 3] = [33, 102, 172];
const ON: [u8; 3] = [138, 143, 152];
const ABOVE: [u8; 3] = [179, 88, 6];

/// Projected length of line by depth and by sigma of depth.
pub fn histograms(report: &Report) -> String {
    let unit = report.frame.unit.word();
    let (mut depths, mut sigmas) = (Vec::new(), Vec::new());
    for curve in &report.curves {
        let positions: Vec<[f64; 3]> = (0..curve.x.len()).map(|point| report.position(curve, point)).collect();
        for (point, pair) in positions.windows(2).enumerate() {
            let half = 0.5 * (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]);
            for (end, position) in pair.iter().enumerate() {
                depths.push((position[2], half));
                sigmas.push((report.sigma_z(curve.sigma[point + end]), half));
            }
        }
    }
    let width = (WIDTH - LEFT - GAP - 12.0) / 2.0;
    let mut svg = Svg::new(TOP + HEIGHT + 32.0);
    let scale = DepthScale::new(report);
    let length = format!("length ({unit})");
    let panel = Panel {
        left: LEFT,
        width,
        heading: "Depth",
        x_title: &format!("depth z ({unit}), + away from viewer"),
        y_title: &length,
    };
    panel.draw(&mut svg, &depths, 0.001, |z| hex(scale.colour(z)), &[]);
    let median = report.measures.depth.as_ref().map(|depth| depth.sigma_z);
    let marks: Vec<(f64, String)> =
        median.map(|median| (median, format!("median {} {unit}", two_digits(median)))).into_iter().collect();
    let panel = Panel {
        left: LEFT + width + GAP,
        width,
        heading: "Sigma of depth",
        x_title: &format!("one sigma of z ({unit})"),
        y_title: &length,
    };
    // From zero, so that it can be judged; the tail is cut.
    sigmas.push((0.0, 0.0));
    panel.draw(&mut svg, &sigmas, 0.02, |_| BAR.into(), &marks);
    svg.finish(&title(report))
}

/// Row differences of the point matches: how many, and where.
pub fn residuals(report: &Report) -> String {
    let points = &report.point_matches;
    let rms = report.rectification.rms_row_error_px;
    let limit = (2.0 * rms).max(1e-6);
    let colour = |row: f64| hex(mix((row / limit).clamp(-1.0, 1.0)));
    let [rows, columns] = report.rectification.shape.map(|side| side as f64);
    let width = (WIDTH - LEFT - GAP - 12.0) / 2.0;
    let zoom = width / columns;
    let height = rows * zoom;
    let mut svg = Svg::new(TOP + height.max(HEIGHT) + 32.0);
    let values: Vec<(f64, f64)> = points.row.iter().map(|&row| (row, 1.0)).collect();
    let panel = Panel {
        left: LEFT,
        width,
        heading: "Row residuals",
        x_title: "row in right less row in left (px)",
        y_title: "point matches",
    };
    let marks = [(-rms, String::new()), (rms, format!("rms {} px", two_digits(rms)))];
    panel.draw(&mut svg, &values, 0.0, colour, &marks);
    let map = Plot { at: [LEFT + width + GAP, TOP], size: [width, height], x: [0.0, columns], y: [0.0, rows] };
    svg.heading([map.at[0], TOP - 4.0], "Row residuals over the left image");
    for ((&x, &y), &row) in points.x.iter().zip(&points.y).zip(&points.row) {
        let [cx, cy] = map.place(x, y);
        svg.push(&format!("<circle cx=\"{cx:.2}\" cy=\"{cy:.2}\" r=\"1.5\" fill=\"{}\"/>", colour(row)));
    }
    map.axes(&mut svg, "column (px)", "row (px)");
    svg.finish(&title(report))
}

struct Panel<'a> {
    left: f64,
    width: f64,
    heading: &'a str,
    x_title: &'a str,
    y_title: &'a str,
}

impl Panel<'_> {
    /// A histogram of weighted values without `tail` of them at each end; lines across it at `marks`.
    fn draw(
        &self,
        svg: &mut Svg,
        values: &[(f64, f64)],
        tail: f64,
        colour: impl Fn(f64) -> String,
        marks: &[(f64, String)],
    ) {
        let mut sorted: Vec<f64> = values.iter().map(|(value, _)| *value).collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share).round() as usize];
        let (low, high) = (if sorted[0] == 0.0 { 0.0 } else { at(tail) }, at(1.0 - tail));
        let step = tick_step((high - low).max(1e-9)) / BINS * 2.0;
        let first = (low / step).floor();
        let count = ((high / step).ceil() - first).max(1.0) as usize;
        let mut heights = vec![0.0; count];
        for (value, weight) in values {
            let bin = (value / step).floor() - first;
            if bin >= 0.0 && bin < count as f64 {
                heights[bin as usize] += weight;
            }
        }
        let top = heights.iter().fold(1e-9_f64, |top, &height| top.max(height)) * 1.15;
        let [from, to] = [first * step, (first + count as f64) * step];
        let plot = Plot { at: [self.left, TOP], size: [self.width, HEIGHT], x: [from, to], y: [top, 0.0] };
        svg.heading([self.left, TOP - 4.0], self.heading);
        for (bin, &height) in heights.iter().enumerate() {
            let value = from + bin as f64 * step;
            let ([left, top], [right, bottom]) = (plot.place(value, height), plot.place(value + step, 0.0));
            svg.rect([left + 0.25, top], [(right - left - 0.5).max(0.2), bottom - top], &colour(value + 0.5 * step));
        }
        for (value, text) in marks {
            let ([x, top], [_, bottom]) = (plot.place(*value, plot.y[0]), plot.place(*value, 0.0));
            svg.push(&format!(
                "<path d=\"M{x:.2} {top:.2}V{bottom:.2}\" stroke=\"{INK}\" stroke-width=\"0.6\" stroke-dasharray=\"3 2\"/>"
            ));
            svg.text([x + 3.0, top + FONT + 2.0], Anchor::Start, text);
        }
        svg.line(plot.place(from, 0.0), plot.place(to, 0.0), FAINT, 0.5);
        plot.axes(svg, self.x_title, self.y_title);
    }
}

/// Blue below, grey on, orange above a row.
fn mix(fraction: f64) -> [u8; 3] {
    let end = if fraction < 0.0 { BELOW } else { ABOVE };
    let t = fraction.abs();
    std::array::from_fn(|channel| (f64::from(ON[channel]) * (1.0 - t) + f64::from(end[channel]) * t).round() as u8)
}

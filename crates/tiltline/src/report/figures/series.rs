//! How far the curves lie from the lines of the other views, against tilt, and the errors of the tilts where a fit found them.

use crate::report::Report;
use crate::report::figures::svg::{Anchor, FAINT, FONT, INK, Plot, Svg, WIDTH};
use crate::report::page::title;
use crate::report::series::{ReportSeries, ReportSeriesView};

const LEFT: f64 = 46.0;
const GAP: f64 = 52.0;
const HEIGHT: f64 = 150.0;
const TOP: f64 = 14.0 + FONT;
const DOT: &str = "#1f5fa8";
/// Distances are shown up to here at most, px; what lies further is drawn at the top.
const MOST_PX: f64 = 12.0;
const LEAST_PX: f64 = 4.0;

/// A value with a range at a tilt.
struct Spot {
    tilt_deg: f64,
    value: f64,
    range: [f64; 2],
    in_pair: bool,
}

/// The figure; `None` where no view was measured.
pub fn draw(report: &Report) -> Option<String> {
    let series = report.series.as_ref()?;
    let distances: Vec<Spot> = series.views.iter().filter_map(distance).collect();
    if distances.is_empty() {
        return None;
    }
    let mut far: Vec<f64> = distances.iter().map(|spot| spot.range[1]).collect();
    far.sort_by(f64::total_cmp);
    let top = (1.1 * far[(far.len() - 1) * 9 / 10]).clamp(LEAST_PX, MOST_PX);
    let errors: Vec<Spot> = series.views.iter().filter_map(tilt_error).collect();
    let both = !errors.is_empty();
    let width = if both { (WIDTH - LEFT - GAP - 12.0) / 2.0 } else { WIDTH - LEFT - 12.0 };
    let mut svg = Svg::new(TOP + HEIGHT + 32.0);
    let heading = heading(series);
    panel(&mut svg, LEFT, width, &distances, [top, 0.0], [heading, "distance to a line (px)"]);
    if both {
        let reach = errors.iter().flat_map(|spot| spot.range).map(f64::abs).fold(0.1, f64::max) * 1.1;
        let titles = ["Errors of the tilts, one sigma", "fitted less nominal (\u{b0})"];
        panel(&mut svg, LEFT + width + GAP, width, &errors, [reach, -reach], titles);
    }
    Some(svg.finish(&title(report)))
}

fn heading(series: &ReportSeries) -> &'static str {
    if series.fitted {
        "Residuals: median, and up to what 95 % are within"
    } else {
        "Re-projection: median, and up to what 95 % are within"
    }
}

fn distance(view: &ReportSeriesView) -> Option<Spot> {
    let found = view.distances.as_ref()?;
    let range = [found.median_px, found.percent95_px];
    Some(Spot { tilt_deg: view.tilt_deg, value: found.median_px, range, in_pair: view.in_pair })
}

fn tilt_error(view: &ReportSeriesView) -> Option<Spot> {
    let [value, sigma] = view.tilt_error_deg?;
    Some(Spot { tilt_deg: view.tilt_deg, value, range: [value - sigma, value + sigma], in_pair: view.in_pair })
}

/// Dots with ranges; `y` is the top and the bottom of the plot. Hollow: the pair.
fn panel(svg: &mut Svg, left: f64, width: f64, spots: &[Spot], y: [f64; 2], [heading, y_title]: [&str; 2]) {
    let tilts = spots.iter().map(|spot| spot.tilt_deg);
    let (low, high) = (tilts.clone().fold(f64::INFINITY, f64::min), tilts.fold(f64::NEG_INFINITY, f64::max));
    let spare = (0.04 * (high - low)).max(0.5);
    let plot = Plot { at: [left, TOP], size: [width, HEIGHT], x: [low - spare, high + spare], y };
    svg.heading([left, TOP - 4.0], heading);
    let inside = |value: f64| value.clamp(y[1], y[0]);
    if y[1] < 0.0 {
        svg.line(plot.place(plot.x[0], 0.0), plot.place(plot.x[1], 0.0), FAINT, 0.5);
    }
    for spot in spots {
        let [low, high] = spot.range.map(|value| plot.place(spot.tilt_deg, inside(value)));
        svg.line(low, high, DOT, 0.7);
        let [x, y] = plot.place(spot.tilt_deg, inside(spot.value));
        let fill = if spot.in_pair { "#ffffff" } else { DOT };
        svg.push(&format!(
            "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"1.8\" fill=\"{fill}\" stroke=\"{DOT}\" stroke-width=\"0.7\"/>"
        ));
    }
    if y[1] == 0.0 && y[0] > 2.0 {
        let [[from, level], [to, _]] = plot.x.map(|x| plot.place(x, 2.0));
        svg.push(&format!(
            "<path d=\"M{from:.2} {level:.2}H{to:.2}\" stroke=\"{INK}\" stroke-width=\"0.5\" stroke-dasharray=\"3 2\"/>"
        ));
        svg.text([to - 2.0, level - 2.0], Anchor::End, "2 px");
    }
    plot.axes(svg, "tilt (\u{b0})", y_title);
}

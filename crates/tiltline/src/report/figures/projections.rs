//! The curves seen along the beam, along the image's y (the tilt axis) and along x, at one scale.

use crate::report::figures::svg::{DepthScale, FAINT, FONT, Plot, Svg, WIDTH};
use crate::report::page::title;
use crate::report::{Report, ReportCurve};

const LEFT: f64 = 46.0;
const GAP: f64 = 56.0;
/// Least width of the colour bar with its words.
const BAR: f64 = 130.0;
/// Share of the depths that a panel must show at each end.
const TAIL: f64 = 0.002;

/// The figure.
pub fn draw(report: &Report) -> String {
    let unit = report.frame.unit.word();
    let pixel = report.frame.pixel;
    let x_of = |x: f64| (x - report.frame.centre_px[0]) * pixel;
    let y_of = |y: f64| (y - report.frame.centre_px[1]) * pixel;
    let corners = report.views[0].corners;
    let range = |values: [f64; 4]| {
        [values.into_iter().fold(f64::INFINITY, f64::min), values.into_iter().fold(f64::NEG_INFINITY, f64::max)]
    };
    let x = range(corners.map(|[x, _]| x_of(x)));
    let y = range(corners.map(|[_, y]| y_of(y)));
    let z = depth_range(report);
    let span = |[low, high]: [f64; 2]| high - low;
    // The beam view and, at its right, the side view share the rows; the edge-on view lies under the first.
    let zoom = (WIDTH - LEFT - GAP - 12.0) / (span(x) + span(z));
    let [width, height, depth] = [span(x) * zoom, span(y) * zoom, span(z) * zoom];
    let top = 14.0 + FONT;
    let beam = Plot { at: [LEFT, top], size: [width, height], x, y };
    let side = Plot { at: [LEFT + width + GAP, top], size: [depth, height], x: z, y };
    let edge = Plot { at: [LEFT, top + height + 52.0], size: [width, depth], x, y: z };
    let room = WIDTH - side.at[0] - 12.0;
    let below = if room < BAR { 40.0 } else { 0.0 };
    let mut svg = Svg::new(edge.at[1] + depth + 34.0 + below);
    let scale = DepthScale::new(report);
    if let Some(foil) = report.measures.foil.known() {
        let surfaces = foil.surfaces;
        for level in [surfaces.z_near, surfaces.z_far] {
            // Where the surfaces cut the middle plane of the field.
            let at_x = |x: f64| level + surfaces.slope_x * x;
            let at_y = |y: f64| level + surfaces.slope_y * y;
            svg.line(edge.place(x[0], at_x(x[0])), edge.place(x[1], at_x(x[1])), FAINT, 1.2);
            svg.line(side.place(at_y(y[0]), y[0]), side.place(at_y(y[1]), y[1]), FAINT, 1.2);
        }
    }
    let panels: [(&Plot, &str, [usize; 2]); 3] = [
        (&beam, "Along the beam", [0, 1]),
        (&side, "Along x", [2, 1]),
        (&edge, "Along y, the tilt axis: edge on", [0, 2]),
    ];
    for (index, (plot, name, [across, down])) in panels.into_iter().enumerate() {
        let ([left, top], [width, height]) = (plot.at, plot.size);
        svg.heading([left, top - 4.0], name);
        svg.push(&format!(
            "<clipPath id=\"panel{index}\"><rect x=\"{left:.2}\" y=\"{top:.2}\" width=\"{width:.2}\" height=\"{height:.2}\"/></clipPath>\
             \n<g clip-path=\"url(#panel{index})\">"
        ));
        let mut order: Vec<&ReportCurve> = report.curves.iter().collect();
        // What is far from the eye of the panel first: z for the beam view; x and y do not matter there.
        if index == 0 {
            let mean_z = |curve: &ReportCurve| {
                curve.disparity.iter().sum::<f64>() / curve.disparity.len() as f64 * report.frame.depth_gain
            };
            order.sort_by(|a, b| mean_z(b).total_cmp(&mean_z(a)));
        }
        for curve in order {
            svg.curve(report, &scale, curve, 1.0, |point| {
                let position = report.position(curve, point);
                plot.place(position[across], position[down])
            });
        }
        svg.push("</g>");
        let axis = |axis: usize| format!("{} ({unit})", ["x", "y", "z"][axis]);
        plot.axes(&mut svg, &axis(across), &axis(down));
    }
    let (bar, width) = bar_place(room, &edge, &side);
    scale.draw(&mut svg, bar, width, report);
    svg.finish(&title(report))
}

/// The colour bar's corner and width: right of the edge-on view, or below it where the foil is so thin that there is no room.
fn bar_place(room: f64, edge: &Plot, side: &Plot) -> ([f64; 2], f64) {
    if room < BAR {
        ([LEFT, edge.at[1] + edge.size[1] + 40.0], 1.5 * BAR)
    } else {
        ([side.at[0], edge.at[1] + 6.0], room)
    }
}

/// Depths of nearly all points and of both surfaces, with some room.
fn depth_range(report: &Report) -> [f64; 2] {
    let mut depths: Vec<f64> = report
        .curves
        .iter()
        .flat_map(|curve| (0..curve.x.len()).map(move |point| report.position(curve, point)[2]))
        .collect();
    depths.sort_unstable_by(f64::total_cmp);
    let at = |share: f64| depths[((depths.len() - 1) as f64 * share).round() as usize];
    let (mut low, mut high) = (at(TAIL), at(1.0 - TAIL));
    if let Some(foil) = report.measures.foil.known() {
        low = low.min(foil.surfaces.z_near);
        high = high.max(foil.surfaces.z_far);
    }
    let spare = (0.06 * (high - low)).max(2.0 * report.frame.pixel);
    [low - spare, high + spare]
}

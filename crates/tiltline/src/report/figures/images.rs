//! Both rectified images with the curves over them, coloured by depth.

use std::fmt::Write;

use crate::export::overlay::{number, round_down};
use crate::report::Report;
use crate::report::figures::svg::{Anchor, DepthScale, FONT, INK, Svg, WIDTH};
use crate::report::page::title;

const MARGIN: f64 = 14.0;

/// The figure.
pub fn draw(report: &Report) -> String {
    let [rows, columns] = report.rectification.shape.map(|side| side as f64);
    let width = (WIDTH - 3.0 * MARGIN) / 2.0;
    let zoom = width / columns;
    let height = rows * zoom;
    let top = MARGIN + FONT;
    let mut svg = Svg::new(top + height + 52.0);
    let scale = DepthScale::new(report);
    for (side, view) in report.views.iter().enumerate() {
        let left = MARGIN + side as f64 * (width + MARGIN);
        let name = if side == 0 { "Left" } else { "Right" };
        svg.heading([left, top - 4.0], &format!("{name}, {:+}\u{b0}", report.tilts_deg[side]).replace('-', "\u{2212}"));
        // Pixel centres are at integers.
        let place = move |x: f64, y: f64| [left + (x + 0.5) * zoom, top + (y + 0.5) * zoom];
        let mut corners = String::new();
        for [x, y] in view.corners {
            let [x, y] = place(x, y);
            let _ = write!(corners, "{x:.2},{y:.2} ");
        }
        svg.push(&format!("<clipPath id=\"view{side}\"><polygon points=\"{corners}\"/></clipPath>"));
        let url = view.image.data_url();
        svg.push(&format!(
            "<image x=\"{left:.2}\" y=\"{top:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" \
             preserveAspectRatio=\"none\" clip-path=\"url(#view{side})\" xlink:href=\"{url}\"/>"
        ));
        let at = |curve: &crate::report::ReportCurve, point: usize| {
            let shift = if side == 0 { 0.0 } else { curve.disparity[point] };
            place(curve.x[point] + shift, curve.y[point])
        };
        for curve in &report.curves {
            let mut path = String::new();
            for point in 0..curve.x.len() {
                let [x, y] = at(curve, point);
                let _ = write!(path, "{}{x:.2} {y:.2}", if point == 0 { 'M' } else { 'L' });
            }
            let close = if curve.closed { "Z" } else { "" };
            svg.push(&format!(
                "<path d=\"{path}{close}\" fill=\"none\" stroke=\"#ffffff\" stroke-opacity=\"0.6\" stroke-width=\"1.5\" \
                 stroke-linecap=\"round\"/>"
            ));
        }
        for curve in &report.curves {
            svg.curve(report, &scale, curve, 0.8, |point| at(curve, point));
        }
    }
    let bottom = top + height;
    let length = round_down(0.25 * columns * report.frame.pixel);
    let bar = length / report.frame.pixel * zoom;
    let unit = report.frame.unit.word();
    svg.rect([MARGIN, bottom + 12.0], [bar, 2.0], INK);
    svg.text([MARGIN + 0.5 * bar, bottom + 16.0 + FONT], Anchor::Middle, &format!("{} {unit}", number(length)));
    if !report.curves.is_empty() {
        scale.draw(&mut svg, [MARGIN + width + MARGIN, bottom + 10.0], 0.5 * width, report);
    }
    svg.finish(&title(report))
}

//! Figures 4 to 8: one foil from its image to its curves, in other views, and beside a tomogram.

use std::fmt::Write;

use ndarray::{Array2, Array3, Axis};
use serde::{Deserialize, Serialize};

use super::sheet::{Panel, Size, Stroke, drawn, on_white, sheet, stacked, stretched};
use crate::export::overlay::canvas::{Canvas, Rgb};
use crate::export::overlay::colour::viridis;
use crate::geometry::{Point2, Point3};
use crate::micrograph::Micrograph;
use crate::report::Report;
use crate::report::figures::svg::{Anchor, FONT, INK as INK_TEXT, Plot, Svg, WIDTH, hex, ticks};
use crate::score::ResultCurves;
use crate::series::ViewReprojection;
use crate::tomography::Geometry;
use crate::tomography::against_truth::KnownSeries;
use crate::truth::{TrueView, Truth, TruthPair};

const INK: Rgb = [32, 32, 32];
/// Lines of the truth that do not stand out from the noise.
const HIDDEN: Rgb = [190, 190, 190];
const GREEN: Rgb = [40, 220, 90];
const YELLOW: Rgb = [255, 214, 10];
const CYAN: Rgb = [70, 200, 255];
/// Width of lines on panels, canvas px.
const STROKE: f64 = 1.6;
/// Largest distance between two points of a curve that are joined in the picture of disparity, px.
const JOINED_PX: f64 = 12.0;

/// True lines of a view: `visible` in one colour, the others in [`HIDDEN`], or left out.
fn true_lines(truth: &Truth, view: &TrueView, visible: Rgb, hidden: bool) -> Vec<Stroke> {
    let mut strokes = Vec::new();
    for curve in &view.curves {
        let closed = truth.curve(&curve.label).is_some_and(|curve| curve.closed);
        if hidden {
            strokes.push(Stroke { points: curve.contrast.clone(), closed, colour: HIDDEN });
        }
        let seen: Vec<usize> = (0..curve.contrast.len()).collect();
        for run in seen.split(|index| !curve.is_visible(*index)).filter(|run| run.len() > 1) {
            let points: Vec<Point2> = run.iter().map(|index| curve.contrast[*index]).collect();
            strokes.push(Stroke { closed: closed && run.len() == seen.len(), points, colour: visible });
        }
    }
    strokes
}

/// Figure 4: an image, the line probability in it (dark is sure), and the true lines (grey: hidden in noise).
pub fn detection(image: &Micrograph, probability: &Array2<f32>, truth: &Truth, view: &TrueView) -> Canvas {
    let shape: [usize; 2] = image.pixels.dim().into();
    let panels = [
        Panel { caption: "(a) image".into(), canvas: drawn(&image.normalised(), Size::Full, &[], STROKE) },
        Panel { caption: "(b) line probability".into(), canvas: probability_canvas(probability, Size::Full) },
        Panel {
            caption: "(c) true lines".into(),
            canvas: on_white(shape, Size::Full, &true_lines(truth, view, INK, true), 2.0),
        },
    ];
    sheet(&panels, 3)
}

/// Probabilities from white (0) to black.
pub fn probability_canvas(probability: &Array2<f32>, size: Size) -> Canvas {
    let mut canvas = drawn(probability, size, &[], STROKE);
    // `drawn` keeps the ends of the grey scale for lines.
    canvas
        .pixels
        .iter_mut()
        .for_each(|value| *value = 255 - (u16::from(*value).saturating_sub(15) * 255 / 195).min(255) as u8);
    canvas
}

/// Figure 5: disparity along the curves of a pair on the left rectified image's grid.
pub fn disparity(report: &Report) -> String {
    let [rows, columns] = report.rectification.shape.map(|side| side as f64);
    let (left, top) = (46.0, 14.0 + FONT);
    let width = 0.74 * (WIDTH - left - 12.0);
    let plot = Plot { at: [left, top], size: [width, width * rows / columns], x: [0.0, columns], y: [0.0, rows] };
    let mut svg = Svg::new(top + plot.size[1] + 36.0);
    let mut values: Vec<f64> = report.curves.iter().flat_map(|curve| curve.disparity.iter().copied()).collect();
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values.get((values.len() as f64 * share) as usize).copied().unwrap_or(0.0);
    let (low, high) = (at(0.01), at(0.99).max(at(0.01) + 1e-3));
    let colour = |value: f64| hex(viridis(0.93 * ((value - low) / (high - low)).clamp(0.0, 1.0)));
    svg.heading([left, top - 4.0], "Disparity of the left image's lines");
    for curve in &report.curves {
        for point in 1..curve.x.len() {
            let [from, to] = [point - 1, point].map(|at| plot.place(curve.x[at], curve.y[at]));
            if (curve.x[point] - curve.x[point - 1]).hypot(curve.y[point] - curve.y[point - 1]) > JOINED_PX {
                continue;
            }
            let mean = 0.5 * (curve.disparity[point] + curve.disparity[point - 1]);
            let mut path = String::new();
            let _ = write!(path, "M{:.2} {:.2}L{:.2} {:.2}", from[0], from[1], to[0], to[1]);
            svg.push(&format!(
                "<path d=\"{path}\" fill=\"none\" stroke=\"{}\" stroke-width=\"1.4\" stroke-linecap=\"round\"/>",
                colour(mean)
            ));
        }
    }
    plot.axes(&mut svg, "column (px)", "row (px)");
    let bar = [left + width + 40.0, top];
    let steps = 64;
    for step in 0..steps {
        let (from, part) = (step as f64 / f64::from(steps), plot.size[1] / f64::from(steps));
        let y = bar[1] + plot.size[1] * (1.0 - from) - part;
        svg.rect([bar[0], y], [9.0, part + 0.3], &colour(low + (high - low) * from));
    }
    for (value, text) in ticks(low, high) {
        let y = bar[1] + plot.size[1] * (high - value) / (high - low);
        svg.line([bar[0] + 9.0, y], [bar[0] + 12.0, y], INK_TEXT, 0.5);
        svg.text([bar[0] + 14.0, y + 0.35 * FONT], Anchor::Start, &text);
    }
    svg.text_up([bar[0] - 6.0, bar[1] + 0.5 * plot.size[1]], "disparity (px)");
    svg.finish("Disparity along the curves of a pair")
}

/// Figure 7: curves of a pair in other views (green, over the images), and below the true lines there. `views` in the order of
/// the panels, each with its image.
pub fn reprojections(views: &[(&ViewReprojection, Micrograph)], closed: &[bool], truth: &Truth) -> Canvas {
    let mut above = Vec::new();
    let mut below = Vec::new();
    for (view, image) in views {
        let strokes = view.curves.iter().zip(closed);
        let strokes: Vec<Stroke> =
            strokes.map(|(points, closed)| Stroke { points: points.clone(), closed: *closed, colour: GREEN }).collect();
        let caption = format!("{:+}\u{b0}", view.tilt_deg);
        above.push(Panel { caption, canvas: drawn(&image.normalised(), Size::Half, &strokes, STROKE) });
        let shape: [usize; 2] = image.pixels.dim().into();
        let lines = true_lines(truth, &truth.views[view.view], INK, true);
        below.push(Panel { caption: "true lines".into(), canvas: on_white(shape, Size::Half, &lines, 1.4) });
    }
    let across = above.len();
    above.extend(below);
    sheet(&above, across)
}

/// A curve of the specimen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpecimenCurve {
    /// Its points in the unit and frame of the truth.
    pub points: Vec<Point3>,
    /// Whether the last joins the first.
    pub closed: bool,
}

/// Curves of a pair's result in the frame of the truth, from where both images show them and how these lie: with
/// `x_L = X cos a_L + Z sin a_L` and the same at the right. Empty where the truth does not know the geometry.
pub fn in_specimen(result: &ResultCurves, pair: &TruthPair<'_>) -> Vec<SpecimenCurve> {
    let Some(geometry) = pair.geometry else { return Vec::new() };
    let ((left_sin, left_cos), (right_sin, right_cos)) =
        (geometry.tilts.left_rad.sin_cos(), geometry.tilts.right_rad.sin_cos());
    let det = left_cos * right_sin - left_sin * right_cos;
    let place = |point: &crate::score::ResultPoint| {
        let (plan, disparity) = geometry.of_images(&point.left, &point.right);
        let (left, right) = (plan.x, plan.x + disparity);
        let (x, z) = ((left * right_sin - right * left_sin) / det, (right * left_cos - left * right_cos) / det);
        Point3::new(x, plan.y, z) / geometry.px_per_unit
    };
    let curve = |curve: &crate::score::ResultCurve| SpecimenCurve {
        points: curve.points.iter().map(place).collect(),
        closed: curve.closed,
    };
    result.curves.iter().map(curve).collect()
}

/// The true curves that are visible in both views of a pair.
pub fn true_curves(pair: &TruthPair<'_>) -> Vec<SpecimenCurve> {
    let mut curves = Vec::new();
    for paired in pair.curves() {
        let Some(points) = &paired.curve.points else { continue };
        let all: Vec<usize> = (0..points.len().min(paired.counts.len())).collect();
        for run in all.split(|index| !paired.counts[*index]).filter(|run| run.len() > 1) {
            let closed = paired.curve.closed && run.len() == points.len();
            curves.push(SpecimenCurve { points: run.iter().map(|index| points[*index]).collect(), closed });
        }
    }
    curves
}

/// Figure 8: a tomogram (largest values, along the beam and, below, along y) and curves over it, a panel for each of `results`; the
/// first is taken for the truth.
pub fn beside_tomogram(
    volume: &Array3<f32>,
    geometry: &Geometry,
    known: &KnownSeries<'_>,
    results: &[(&str, Vec<SpecimenCurve>)],
) -> Canvas {
    let largest = |axis: usize| {
        let most = volume.fold_axis(Axis(axis), f32::NEG_INFINITY, |most, value| most.max(*value));
        stretched(&most, [0.02, 0.998])
    };
    let (beam, edge) = (largest(0), largest(1));
    let panel = |(index, (caption, curves)): (usize, &(&str, Vec<SpecimenCurve>))| {
        let colour = if index == 0 { CYAN } else { YELLOW };
        let strokes = |across: usize, down: usize| -> Vec<Stroke> {
            let place = |point: &Point3| {
                let voxel = known.voxel(geometry, point);
                Point2::new(voxel[across], voxel[down])
            };
            let stroke = |curve: &SpecimenCurve| Stroke {
                points: curve.points.iter().map(place).collect(),
                closed: curve.closed,
                colour,
            };
            curves.iter().map(stroke).collect()
        };
        let above = drawn(&beam, Size::Full, &strokes(0, 1), STROKE);
        let below = drawn(&edge, Size::Full, &strokes(0, 2), STROKE);
        Panel { caption: (*caption).to_owned(), canvas: stacked(&above, &below) }
    };
    sheet(&results.iter().enumerate().map(panel).collect::<Vec<_>>(), 2)
}

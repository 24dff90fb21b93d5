//! What `tiltline reproject` writes: `reprojection.csv` (a row a view), `reprojection.json` (the same, with the self-checks),
//! `points.csv` (every re-projected point) and a picture of each view (8-bit RGB PNG; paper, Figure 7).

use std::io::{self, Write};

use serde_json::{Value, json};

use super::number::rounded;
use super::overlay::canvas::{Canvas, Rgb, Strokes, text_width};
use super::overlay::colour::viridis;
use super::overlay::{Zoom, draw_image};
use crate::geometry::Point2;
use crate::micrograph::Micrograph;
use crate::series::{Reprojection, SavedCurves, Series, SeriesFit, ViewReprojection};

const INK: Rgb = [32, 32, 32];
const PAPER: Rgb = [255, 255, 255];
/// Version of the layout of `reprojection.json`.
const FORMAT_VERSION: u32 = 1;

/// Writes `reprojection.csv`: a row a view. Empty where a view has no point or no line.
///
/// # Errors
/// Where `out` cannot be written to.
pub fn write_csv(result: &Reprojection, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    writeln!(
        out,
        "tilt_deg,in_pair,supported,points,median_px,percent95_px,within_2px,within_5px,chance_within_3px,moved_px,axis_deg,\
         scale,origin_x_px,origin_y_px"
    )?;
    for view in &result.views {
        let distances = match &view.distances {
            Some(d) => format!(
                "{},{:.4},{:.4},{:.4},{:.4},{:.4}",
                d.points, d.median_px, d.percent95_px, d.within_2px, d.within_5px, d.chance_within_3px
            ),
            None => "0,,,,,".to_owned(),
        };
        let (pose, origin) = (&view.pose, view.pose.origin());
        writeln!(
            out,
            "{},{},{},{distances},{:.3},{:.4},{:.6},{:.3},{:.3}",
            view.tilt_deg,
            view.in_pair,
            view.supported,
            view.moved_px,
            pose.axis_rad().to_degrees(),
            pose.scale(),
            origin.x,
            origin.y
        )?;
    }
    Ok(())
}

/// Writes `reprojection.json`.
///
/// # Errors
/// Where `out` cannot be written to.
pub fn write_json(result: &Reprojection, curves: &SavedCurves, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    let views: Vec<Value> = result
        .views
        .iter()
        .map(|view| {
            json!({
                "tilt_deg": view.tilt_deg,
                "in_pair": view.in_pair,
                "supported": view.supported,
                "moved_px": rounded(view.moved_px, 3),
                "axis_deg": rounded(view.pose.axis_rad().to_degrees(), 4),
                "scale": rounded(view.pose.scale(), 6),
                "origin_px": view.pose.origin().coords.as_slice().iter().map(|v| rounded(*v, 3)).collect::<Vec<_>>(),
                "distances": view.distances,
            })
        })
        .collect();
    let tilts = [curves.tilts.left_rad, curves.tilts.right_rad].map(|tilt| rounded(tilt.to_degrees(), 6));
    let value = json!({
        "format_version": FORMAT_VERSION,
        "pair_tilts_deg": tilts,
        "curves_sha256": curves.sha256,
        "checks": result.checks,
        "in_words": result.checks.sentences(),
        "views": views,
        "warnings": result.warnings,
    });
    serde_json::to_writer_pretty(&mut *out, &value)?;
    writeln!(out)
}

/// Writes `views.csv` of a fit to all views: a row a view that took part, with what was found of its pose.
///
/// # Errors
/// Where `out` cannot be written to.
pub fn write_fitted_views(fit: &SeriesFit, series: &Series, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    writeln!(
        out,
        "section,tilt_deg,in_pair,tilt_error_deg,sigma_tilt_error_deg,axis_deg,scale,origin_x_px,origin_y_px,lines_px,noise"
    )?;
    let grown = &fit.grown;
    let mut order: Vec<usize> = (0..grown.views.len()).collect();
    order.sort_by_key(|place| grown.views[*place].view);
    for place in order {
        let (view, stored) = (&grown.views[place], &series.views[grown.views[place].view]);
        let origin = view.pose.origin();
        writeln!(
            out,
            "{},{},{},{:.4},{:.4},{:.4},{:.6},{:.3},{:.3},{:.0},{:.3}",
            stored.section,
            stored.tilt_deg,
            place < 2,
            (view.pose.tilt_rad - view.nominal_rad).to_degrees(),
            grown.tilt_sigma_rad[place].to_degrees(),
            view.pose.axis_rad().to_degrees(),
            view.pose.scale(),
            origin.x,
            origin.y,
            view.lines.lines().length_px(),
            grown.noise[place]
        )?;
    }
    Ok(())
}

/// Writes `points.csv`: every re-projected point in every view, in px of its file.
///
/// # Errors
/// Where `out` cannot be written to.
pub fn write_points(result: &Reprojection, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    writeln!(out, "tilt_deg,curve,point,x_px,y_px")?;
    for view in &result.views {
        for (curve, points) in view.curves.iter().enumerate() {
            for (index, point) in points.iter().enumerate() {
                writeln!(out, "{},{curve},{index},{:.3},{:.3}", view.tilt_deg, point.x, point.y)?;
            }
        }
    }
    Ok(())
}

/// Writes the picture of a view: detected lines thin and white, re-projected curves coloured by depth.
///
/// # Errors
/// Where `out` cannot be written to.
pub fn write_view(
    image: &Micrograph,
    view: &ViewReprojection,
    curves: &SavedCurves,
    out: &mut (impl Write + ?Sized),
) -> io::Result<()> {
    let canvas = draw_view(image, view, curves);
    super::png::encode(out, [canvas.height, canvas.width], ::png::ColorType::Rgb, &canvas.pixels)
}

/// Draws a view.
pub fn draw_view(image: &Micrograph, view: &ViewReprojection, curves: &SavedCurves) -> Canvas {
    let pixels = image.normalised();
    let (rows, columns) = pixels.dim();
    let zoom = Zoom::new(rows.max(columns));
    let size = [zoom.size(columns), zoom.size(rows)];
    let dot = (size[0].max(size[1]) as f64 / 400.0).round().clamp(2.0, 8.0) as usize;
    let (margin, line) = (4 * dot, 14 * dot);
    let title = title(view);
    let legend = "white: detected   coloured by depth: re-projected";
    let width = (size[0] + 2 * margin).max(text_width(&title, dot).max(text_width(legend, dot)) + 2 * margin);
    let mut canvas = Canvas::new(width, size[1] + 2 * line + 2 * margin, PAPER);
    let mut panel = draw_image(&pixels, zoom);
    let place = |point: &Point2| point.map(|value| zoom.map(value));
    let stroke = (0.5 * dot as f64).max(1.2 * zoom.factor()).max(1.6);
    let mut detected = Strokes::new(size);
    for trace in &view.lines.traces.traces {
        for pair in trace.points.windows(2) {
            detected.piece([place(&pair[0].position), place(&pair[1].position)], 0.6 * stroke, PAPER);
        }
    }
    detected.paint(&mut panel, 0.9);
    let [low, high] = depth_range(curves);
    let mut drawn = Strokes::new(size);
    for (curve, points) in curves.curves.iter().zip(&view.curves) {
        let count = points.len();
        let closing = curve.closed.then_some((count - 1, 0));
        for (a, b) in (1..count).map(|at| (at - 1, at)).chain(closing) {
            let z = 0.5 * (curve.points[a].z + curve.points[b].z);
            drawn.piece([place(&points[a]), place(&points[b])], stroke, viridis((z - low) / (high - low)));
        }
    }
    drawn.paint(&mut panel, 1.0);
    canvas.paste([margin, line + margin], &panel);
    canvas.text([margin, 3 * dot], &title, dot, INK);
    canvas.text([margin, line + 2 * margin + size[1]], legend, dot, INK);
    canvas
}

fn title(view: &ViewReprojection) -> String {
    let what = if view.in_pair { " (of the pair)" } else { "" };
    let tilt = format!("{:+.1}\u{b0}{what}", view.tilt_deg);
    match &view.distances {
        Some(d) => format!(
            "{tilt}: median {:.2} px, 95 % {:.1} px, within 5 px {:.0} %",
            d.median_px,
            d.percent95_px,
            100.0 * d.within_5px
        ),
        None => format!("{tilt}: no lines"),
    }
}

/// The depths between which 95 percent of the points lie; never empty.
fn depth_range(curves: &SavedCurves) -> [f64; 2] {
    let mut depths: Vec<f64> = curves.curves.iter().flat_map(|curve| &curve.points).map(|point| point.z).collect();
    depths.sort_by(f64::total_cmp);
    let at = |share: f64| depths.get((depths.len() as f64 * share) as usize).copied().unwrap_or(0.0);
    let [low, high] = [at(0.025), at(0.975)];
    if high - low > 1e-6 { [low, high] } else { [low - 0.5, high + 0.5] }
}

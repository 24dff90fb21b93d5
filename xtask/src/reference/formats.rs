//! Every file of a result, read by programs that others wrote: pyvista (VTK) and tifffile.

use std::path::{Path, PathBuf};

use miette::{IntoDiagnostic, Result, miette};
use ndarray::Array2;
use serde_json::Value;
use tiltline::curve::{Flag, LineMap, MatchedCurve, MatchedPoint, Trace, TraceEnd, TraceGraph, TracePoint};
use tiltline::export;
use tiltline::geometry::{Point2, TiltPair, Vector2};
use tiltline::measure::{MeasureSettings, measure};
use tiltline::micrograph::{Micrograph, StereoPair};
use tiltline::oracle::Oracle;
use tiltline::reconstruction::Reconstruction;
use tiltline::rectify::{Rectification, RectifiedPair};
use tiltline::simulate::{Scene, SceneSettings, ViewSettings, render};
use tiltline::triangulate::triangulate;

use crate::venv::Venv;

/// Writes a rendered scene's true curves, and a result without curves, and compares what the peers read.
pub fn run(venv: &Venv) -> Result<()> {
    let cases = [("curves", 512, 14, Some(1.2)), ("large", 1024, 24, None), ("empty", 256, 0, None)];
    println!(
        "{:<8} {:>7} {:>7}  {:<6} {:<6} {:<6} {:<14} {:<10}",
        "case", "curves", "points", "vtp", "ply", "obj", "disparity.tif", "sigma.tif"
    );
    for (name, size, curves, pixel_size_nm) in cases {
        let result = truth(size, curves, pixel_size_nm);
        let folder = venv.work.join("formats").join(name);
        std::fs::create_dir_all(&folder).into_diagnostic()?;
        let start = std::time::Instant::now();
        export::write_all(&result, &[], &folder, true).into_diagnostic()?;
        let seconds = start.elapsed().as_secs_f64();
        let answer: Value = serde_json::from_str(&venv.run("formats.py", &[&folder])?).into_diagnostic()?;
        report(name, &result, &folder, &answer)?;
        println!("{:<8} written in {seconds:.2} s", "");
    }
    Ok(())
}

fn report(name: &str, result: &Reconstruction, folder: &Path, answer: &Value) -> Result<()> {
    let points: usize = result.curves.iter().map(|curve| curve.points.len()).sum();
    let mut words = Vec::new();
    for file in ["curves.vtp", "curves.ply", "curves.obj", "disparity.tif", "sigma.tif"] {
        let said = &answer[file];
        if said["ok"] != Value::Bool(true) {
            let path: PathBuf = folder.join(file);
            return Err(miette!("{} is read otherwise than written: {said}", path.display()));
        }
        words.push(said["what"].as_str().unwrap_or("same").to_owned());
    }
    println!(
        "{name:<8} {:>7} {points:>7}  {:<6} {:<6} {:<6} {:<14} {:<10}",
        result.curves.len(),
        words[0],
        words[1],
        words[2],
        words[3],
        words[4]
    );
    Ok(())
}

/// A rendered pair whose curves, disparities and lines are the truth, with a sigma of 0.2 px.
fn truth(size: usize, curves: usize, pixel_size_nm: Option<f64>) -> Reconstruction {
    let scene = Scene::random(&SceneSettings { size_px: size as f64, curves, ..SceneSettings::default() });
    let tilts = TiltPair::from_degrees(-4.0, 4.0);
    let view =
        |tilt_rad: f64, seed: u64| ViewSettings { tilt_rad, shape: [size, size], seed, ..ViewSettings::default() };
    let views = [view(tilts.left_rad, 1), view(tilts.right_rad, 2)];
    let image = |index: usize| Micrograph { pixel_size_nm, ..render(&scene, &views[index]) };
    let pair = StereoPair { left: image(0), right: image(1), tilts, tilt_axis_rad: 0.0 };
    let rectification = Rectification::from_known_views(&views[0], &views[1]);
    let oracle = Oracle::new(&scene, [&views[0], &views[1]], &rectification);
    let rectified = RectifiedPair { left: pair.left.normalised(), right: pair.right.normalised(), rectification };
    let matched: Vec<MatchedCurve> = oracle.curves[0]
        .iter()
        .zip(&oracle.curves[1])
        .enumerate()
        .filter_map(|(index, (left, right))| matched_curve(index, left, right, size))
        .collect();
    let traces = [0, 1].map(|view| TraceGraph {
        traces: oracle.curves[view].iter().filter_map(|curve| trace(curve)).collect(),
        junctions: Vec::new(),
    });
    let line_map = LineMap { probability: Array2::zeros((size, size)), line_width_px: 3.5 };
    let (curves, frame) = triangulate(&matched, &rectified, &pair, 0.1_f64.to_radians(), false);
    let (measures, warnings) = measure(&curves, &frame, &rectified, &MeasureSettings::default());
    let lines = [line_map.clone(), line_map];
    Reconstruction { pair, rectified, lines, traces, matched, curves, unmatched: Vec::new(), frame, measures, warnings }
}

fn trace(curve: &[Point2]) -> Option<Trace> {
    let points: Vec<TracePoint> = curve
        .iter()
        .map(|&position| TracePoint { position, tangent: Vector2::x(), probability: 1.0, sigma_perp_px: 0.2 })
        .collect();
    (points.len() >= 2).then_some(Trace { points, closed: false, ends: [TraceEnd::Free; 2] })
}

fn matched_curve(index: usize, left: &[Point2], right: &[Point2], size: usize) -> Option<MatchedCurve> {
    let inside = |point: &Point2| point.iter().all(|value| (0.0..=size as f64 - 1.0).contains(value));
    let points: Vec<MatchedPoint> = left
        .iter()
        .zip(right)
        .enumerate()
        .filter(|(_, (a, b))| inside(a) && inside(b))
        .map(|(at, (a, b))| MatchedPoint {
            left: *a,
            tangent_left: Vector2::x(),
            tangent_right: None,
            disparity_px: b.x - a.x,
            sigma_px: 0.2,
            // A stretch of one curve is marked, so that the picture shows how that looks.
            flag: if index == 0 && (60..120).contains(&at) { Flag::Bridged } else { Flag::Ok },
        })
        .collect();
    let ends =
        [left.first(), left.last()].map(|end| if end.is_some_and(inside) { TraceEnd::Free } else { TraceEnd::Border });
    (points.len() >= 2).then_some(MatchedCurve { left_trace: index, points, closed: false, ends })
}

//! Reports for the tests in the browser: the example pair, two thousand curves, user text that tries to be markup, and
//! a result without curves.

use std::path::Path;

use miette::{IntoDiagnostic, Result};
use ndarray::Array2;
use tiltline::export;
use tiltline::geometry::TiltPair;
use tiltline::io::read_micrograph;
use tiltline::matching::ClassicalMatcher;
use tiltline::measure::{CurveMeasures, DepthRange, Foil, FoilSurfaces, Known, Measures};
use tiltline::micrograph::{StereoPair, View};
use tiltline::pipeline;
use tiltline::progress::Stage;
use tiltline::reconstruction::{LengthUnit, Reconstruction};
use tiltline::report::image::Picture;
use tiltline::report::series::{ReportSeries, ReportSeriesView, ViewPicture};
use tiltline::report::tomogram::ReportTomogram;
use tiltline::report::{CurveEnd, PointColumns, Report, ReportCurve, page};
use tiltline::ridge::RidgeDetector;
use tiltline::series::{Distances, LineIndex, SavedCurves, ViewLines};
use tiltline::settings::Settings;
use tiltline::tomography::compare::Comparison;
use tiltline::warning::Warning;

use crate::venv::root;

/// Curves of the large report, points of each and px between them: no more points than WebGL in software draws in a moment.
const MANY: usize = 2000;
const POINTS: usize = 16;
const STEP_PX: f64 = 4.0;
const SIDE: usize = 1024;
/// Half the thickness of its foil, px.
const HALF_THICKNESS_PX: f64 = 90.0;
/// Text that must be shown, not run.
const HOSTILE: &str = "</script></title><script>alert(2)</script><!--\"><img src=x onerror=alert(1)>.png";

/// Writes the reports, a folder each, over older ones.
pub fn write(folder: &Path) -> Result<()> {
    let result = example()?;
    let run = "# a run record\nseed = 0\n";
    let report = Report::new(&result, run).into_diagnostic()?;
    let text = page::write(&report).into_diagnostic()?;
    std::fs::create_dir_all(folder).into_diagnostic()?;
    let extra = [("report.html", text.into_bytes())];
    export::write_all(&result, &extra, &folder.join("example"), true).into_diagnostic()?;
    put(folder, "series", &Report { series: Some(series(&result)?), ..report.clone() })?;
    put(folder, "flipped", &flipped(report.clone()))?;
    put(folder, "many", &many(&report))?;
    put(folder, "hostile", &hostile(report.clone()))?;
    put(folder, "empty", &empty(report))
}

fn put(folder: &Path, name: &str, report: &Report) -> Result<()> {
    let folder = folder.join(name);
    std::fs::create_dir_all(&folder).into_diagnostic()?;
    std::fs::write(folder.join("report.html"), page::write(report).into_diagnostic()?).into_diagnostic()
}

/// The example pair with the classical methods, which need no weights.
fn example() -> Result<Reconstruction> {
    let read = |name: &str| {
        let path = root().join("examples").join(name);
        let mut micrograph = read_micrograph(&path.to_string_lossy()).into_diagnostic()?;
        micrograph.source.path = format!("examples/{name}");
        Ok::<_, miette::Report>(micrograph)
    };
    let (mut left, mut right) = (read("rendered_-4deg.png")?, read("rendered_+4deg.png")?);
    for view in [&mut left, &mut right] {
        view.pixel_size_nm = Some(1.2);
    }
    let (pair, _) = StereoPair::new(left, right, TiltPair::from_degrees(-4.0, 4.0), 0.0).into_diagnostic()?;
    let settings = Settings::default();
    let detector = RidgeDetector { settings: settings.ridge.clone() };
    let matcher = ClassicalMatcher { settings: settings.matching.clone() };
    pipeline::reconstruct(pair, &detector, &matcher, &settings, &|_| ()).into_diagnostic()
}

/// The pair as if it were of a series: its own two views, figures of five, and a tomogram that has its lines at z = 0.
fn series(result: &Reconstruction) -> Result<ReportSeries> {
    let curves = SavedCurves::of(result);
    let views = [-12.0, -4.0, 0.0, 4.0, 12.0].map(|tilt_deg: f64| ReportSeriesView {
        tilt_deg,
        in_pair: tilt_deg.abs() == 4.0,
        supported: true,
        distances: Distances::of((0..40).map(|k| 0.01 * f64::from(k) * tilt_deg.abs()).collect(), 0.08),
        tilt_error_deg: None,
    });
    let pictures = [&result.pair.left, &result.pair.right].into_iter().zip(&curves.poses).enumerate();
    let pictures = pictures.map(|(side, (view, pose))| {
        // Traces are on the rectified grid.
        let map = result.rectified.rectification.rectified_from(View::BOTH[side]).inverse();
        let mut traces = result.traces[side].clone();
        for point in traces.traces.iter_mut().flat_map(|trace| &mut trace.points) {
            point.position = map * point.position;
        }
        let lines = ViewLines::new(traces, [view.height(), view.width()]);
        ViewPicture::new(view, [-4.0, 4.0][side], pose, &LineIndex::new(lines), &curves)
    });
    let [rows, columns] = result.rectified.rectification.shape;
    let (pixel, [cx, cy]) = (result.frame.pixel, result.frame.centre_px);
    let edge = Array2::from_shape_fn((60, columns), |(layer, _)| if layer == 30 { 1.0 } else { 0.1 });
    Ok(ReportSeries {
        path: "series.mrc".into(),
        fitted: false,
        views: views.to_vec(),
        checks: vec!["the pair's order agrees with the tilts of the series".into()],
        warnings: vec![Warning::new(Stage::Read, HOSTILE)],
        pictures: pictures.collect::<Result<_, _>>().into_diagnostic()?,
        tomogram: Some(ReportTomogram {
            method: "SIRT, 30 iterations, 5 views from -12 to 12 degrees".into(),
            comparison: Comparison {
                threshold: 0.1,
                share: 0.001,
                result: [1000.0, 0.7],
                tomogram: [1500.0, 0.5],
                reach_px: [2.0, 14.0],
                depth_px: Some([1.0, 5.0]),
            },
            size: [columns, rows, 60],
            above: Picture::encode(&result.lines[0].probability).into_diagnostic()?,
            edge: Picture::encode(&edge).into_diagnostic()?,
            step: [1, 1],
            voxels: [[1.0 / pixel, 0.0, 0.0, cx], [0.0, 1.0 / pixel, 0.0, cy], [0.0, 0.0, 1.0 / pixel, 29.5]],
        }),
    })
}

/// The result with the other sign of depth, as `--flip-depth` gives it.
fn flipped(mut report: Report) -> Report {
    report.frame.depth_flipped = true;
    report.frame.depth_gain = -report.frame.depth_gain;
    report.frame.median_z = -report.frame.median_z;
    report
}

/// Many short curves in a foil of known thickness.
fn many(like: &Report) -> Report {
    let mut report = like.clone();
    let (centre, gain) = ((SIDE as f64 - 1.0) / 2.0, report.frame.depth_gain);
    report.frame.centre_px = [centre; 2];
    report.frame.median_z = 0.0;
    report.rectification.shape = [SIDE; 2];
    let mut state = 1_u64;
    let mut random = || {
        // Knuth's linear congruential generator; the pictures need no better.
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    let mut image = Array2::from_elem((SIDE, SIDE), 0.6_f32);
    for value in &mut image {
        *value += 0.12 * (random() as f32 - 0.5);
    }
    let mut probability = Array2::zeros((SIDE, SIDE));
    report.curves = (0..MANY)
        .map(|_| {
            let (x, y, turn) = (random() * 1000.0, random() * 1000.0, random() * std::f64::consts::TAU);
            let (z, slope) = ((random() * 2.0 - 1.0) * HALF_THICKNESS_PX, random() - 0.5);
            let mut curve = ReportCurve {
                closed: false,
                ends: [CurveEnd::Free, CurveEnd::Junction],
                x: Vec::new(),
                y: Vec::new(),
                disparity: Vec::new(),
                sigma: Vec::new(),
                flags: (0..POINTS).map(|point| if point < 12 { '0' } else { '2' }).collect(),
            };
            for step in 0..POINTS {
                let t = STEP_PX * step as f64;
                let bend = 0.01 * t;
                let z = (z + slope * t).clamp(-HALF_THICKNESS_PX, HALF_THICKNESS_PX);
                let (x, y) = (x + t * (turn + bend).cos(), y + t * (turn + bend).sin());
                curve.x.push((x * 1e3).round() / 1e3);
                curve.y.push((y * 1e3).round() / 1e3);
                curve.disparity.push((z / gain * 1e4).round() / 1e4);
                curve.sigma.push(0.3);
                let index = [y as usize, x as usize];
                if x >= 0.0 && y >= 0.0 && index[0] < SIDE && index[1] < SIDE {
                    image[index] = 0.2;
                    probability[index] = 1.0;
                }
            }
            curve
        })
        .collect();
    let side = SIDE as f64 - 0.5;
    for view in &mut report.views {
        view.image = Picture::encode(&image).expect("the image is small enough");
        view.probability = Picture::encode(&probability).expect("the image is small enough");
        view.corners = [[-0.5, -0.5], [side, -0.5], [side, side], [-0.5, side]];
        view.lines = Vec::new();
        view.unmatched = Vec::new();
    }
    let pixel = report.frame.pixel;
    let surface = HALF_THICKNESS_PX * pixel;
    let sigma_z = report.sigma_z(0.3);
    report.measures = Measures {
        curves: MANY,
        depth: Some(DepthRange { low: -0.9 * surface, high: 0.9 * surface, sigma_z }),
        foil: Known::Known(Foil {
            thickness: 2.0 * surface,
            thickness_interval: [1.9 * surface, 2.1 * surface],
            fit_sigma: 0.02 * surface,
            normal_tilt_deg: 3.0,
            normal: [0.05, 0.0, 0.999],
            surfaces: FoilSurfaces { slope_x: 0.05, slope_y: 0.0, z_near: -surface, z_far: surface },
            ends_on_surfaces: [600, 600],
            ends: MANY,
        }),
        per_curve: report
            .curves
            .iter()
            .map(|curve| {
                let z: Vec<f64> = curve.disparity.iter().map(|disparity| disparity * gain * pixel).collect();
                CurveMeasures {
                    length: POINTS as f64 * STEP_PX * pixel,
                    direction: Some([0.8, 0.6, 0.0]),
                    mean_curvature: None,
                    max_curvature: None,
                    sigma_curvature: None,
                    min_z: z.iter().copied().fold(f64::INFINITY, f64::min),
                    max_z: z.iter().copied().fold(f64::NEG_INFINITY, f64::max),
                    sigma_z,
                }
            })
            .collect(),
        ..report.measures
    };
    report
}

fn hostile(mut report: Report) -> Report {
    report.sources[0].path = HOSTILE.into();
    report.sources[1].path = format!("folder/{HOSTILE}");
    report.warnings.push(Warning::new(Stage::Read, HOSTILE));
    report.run = HOSTILE.into();
    report
}

fn empty(mut report: Report) -> Report {
    report.frame.unit = LengthUnit::Px;
    report.frame.pixel = 1.0;
    report.curves.clear();
    report.point_matches = PointColumns::default();
    report.measures = Measures::default();
    report
}

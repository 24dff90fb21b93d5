//! The classical matcher against OpenCV's StereoSGBM (block 15, +-32 px) at the same line pixels of the same rectified,
//! rendered pairs. The background moves with the foil. Errors are compared where both give a disparity and the line is
//! 10 degrees or more off the row.

use std::f64::consts::PI;
use std::time::Instant;

use miette::{IntoDiagnostic, Result, miette};
use ndarray::Array2;
use tiltline::curve::{Flag, MatchedCurve, Trace};
use tiltline::geometry::{Point2, Vector2, angle_to_row};
use tiltline::matching::{ClassicalMatcher, TraceFaults, known_traces};
use tiltline::micrograph::View;
use tiltline::oracle::Oracle;
use tiltline::pipeline::{Detect, Match};
use tiltline::rectify::{Rectification, RectifiedPair};
use tiltline::refine::{RefineSettings, Refinement, refine};
use tiltline::ridge::RidgeDetector;
use tiltline::simulate::{Scene, SceneSettings, ViewSettings, render};
use tiltline::trace::{TraceSettings, trace};

use crate::npy;
use crate::venv::Venv;

/// The ways to refine, the default last.
const METHODS: [Refinement; 3] = [Refinement::None, Refinement::Nearest, Refinement::Curve];
const SEEDS: u64 = 6;
/// Another line within this distance makes a crossing (in the left image) or an overlap (in either), px.
const NEAR_PX: f64 = 6.0;
/// Lines that overlap rather than cross are within this angle of each other.
const OVERLAP_RAD: f64 = 20.0 * PI / 180.0;
/// A matched curve serves a true point if it is this near, px, and within this angle.
const REACH_PX: f64 = 2.0;
const REACH_RAD: f64 = 30.0 * PI / 180.0;

/// A true point of a left line.
struct Truth {
    curve: usize,
    left: Point2,
    disparity_px: f64,
    tangent: Vector2,
    crossing: bool,
    overlap: bool,
}

/// A disparity that was found at a true point.
#[derive(Clone, Copy)]
struct Found {
    disparity_px: f64,
    sigma_px: f64,
    flag: Flag,
}

/// What both give at a true point.
struct Sample<'a> {
    truth: &'a Truth,
    /// By the methods of [`METHODS`].
    ours: Vec<Option<Found>>,
    sgbm: Option<f64>,
}

/// What the matcher is fed with.
#[derive(Clone, Copy, Debug)]
enum Feed {
    /// The ridge detector and the tracer.
    Detected,
    /// Known curves with jitter, gaps and false lines.
    Known,
}

/// Prints the comparison.
pub fn run(venv: &Venv) -> Result<()> {
    let folder = venv.work.join("sgbm");
    std::fs::create_dir_all(&folder).into_diagnostic()?;
    let pairs: Vec<(RectifiedPair, Oracle)> = (0..SEEDS).map(rendered).collect();
    let truths: Vec<Vec<Truth>> =
        pairs.iter().map(|(pair, oracle)| true_points(oracle, pair.rectification.shape)).collect();
    for (seed, ((pair, _), truth)) in pairs.iter().zip(&truths).enumerate() {
        npy::write_f32(&folder.join(format!("left-{seed}.npy")), &pair.left)?;
        npy::write_f32(&folder.join(format!("right-{seed}.npy")), &pair.right)?;
        let points = Array2::from_shape_fn((truth.len(), 2), |(row, column)| truth[row].left[column]);
        npy::write_f64(&folder.join(format!("points-{seed}.npy")), &points)?;
    }
    let output = venv.run("sgbm.py", &[folder.as_os_str(), SEEDS.to_string().as_ref()])?;
    let output: serde_json::Value = serde_json::from_str(&output).into_diagnostic()?;
    let theirs = output["disparity"].as_array().ok_or_else(|| miette!("sgbm.py gave no disparities"))?;
    println!("{SEEDS} pairs of 512x512 at 8 degrees, signal-to-noise 10; OpenCV {}", output["version"]);
    for feed in [Feed::Known, Feed::Detected] {
        println!("-- lines: {feed:?}");
        let mut samples: Vec<Sample> = Vec::new();
        for (seed, ((pair, oracle), truth)) in pairs.iter().zip(&truths).enumerate() {
            let found = ours(feed, seed as u64, pair, oracle, truth);
            let theirs = theirs[seed].as_array().into_iter().flatten().map(serde_json::Value::as_f64);
            samples.extend(truth.iter().zip(found).zip(theirs).map(|((truth, ours), sgbm)| Sample {
                truth,
                ours,
                sgbm,
            }));
        }
        report(&samples);
    }
    Ok(())
}

/// What each method of refinement gives at each true point.
fn ours(feed: Feed, seed: u64, pair: &RectifiedPair, oracle: &Oracle, truth: &[Truth]) -> Vec<Vec<Option<Found>>> {
    let lines = View::BOTH.map(|view| match feed {
        Feed::Detected => RidgeDetector::default().detect(pair, view),
        Feed::Known => oracle.detect(pair, view),
    });
    let traces = View::BOTH.map(|view| match feed {
        Feed::Detected => trace(&lines[view.index()], &TraceSettings::default()),
        Feed::Known => {
            let faults = TraceFaults {
                sigma_perp_px: 0.2,
                correlation_px: 1.1,
                gap_every_px: 300.0,
                false_lines: 6,
                seed: 2 * seed + view.index() as u64,
            };
            known_traces(&oracle.curves[view.index()], pair.rectification.shape, &faults).0
        }
    });
    let start = Instant::now();
    let matched = ClassicalMatcher::default().match_curves(pair, &lines, &traces);
    let matching_s = start.elapsed().as_secs_f64();
    let refined = METHODS.map(|method| {
        let settings = RefineSettings { method, ..RefineSettings::default() };
        refine(matched.clone(), &traces, &pair.rectification, &settings)
    });
    let length_px: f64 = traces[0].traces.iter().map(Trace::length_px).sum();
    let matched_px: f64 = matched.iter().map(MatchedCurve::length_px).sum();
    println!(
        "seed {seed}: {} left lines of {length_px:.0} px, {} matched curves of {matched_px:.0} px, {matching_s:.3} s",
        traces[0].traces.len(),
        matched.len(),
    );
    let labels = refined.each_ref().map(|curves| labels(curves, oracle));
    let at = |truth: &Truth| refined.iter().zip(&labels).map(|(curves, labels)| found(curves, labels, truth)).collect();
    truth.iter().map(at).collect()
}

/// A pair at +-4 degrees, 512x512, signal-to-noise 10, whose geometry is known.
fn rendered(seed: u64) -> (RectifiedPair, Oracle) {
    let scene = Scene::random(&SceneSettings { seed, ..SceneSettings::default() });
    let [left, right] = [-4.0_f64, 4.0].map(|tilt_deg| ViewSettings {
        tilt_rad: tilt_deg.to_radians(),
        seed: 2 * seed + u64::from(tilt_deg > 0.0),
        ..ViewSettings::default()
    });
    let rectification = Rectification::from_known_views(&left, &right);
    let oracle = Oracle::new(&scene, [&left, &right], &rectification);
    let [left, right] = [&left, &right].map(|view| render(&scene, view).normalised());
    (RectifiedPair { left, right, rectification }, oracle)
}

/// Points about 1 px apart on the true left curves whose right point is inside too.
fn true_points(oracle: &Oracle, shape: [usize; 2]) -> Vec<Truth> {
    let inside = |point: &Point2| {
        let margin = 1.0;
        let within = |value: f64, count: usize| value >= margin && value <= count as f64 - 1.0 - margin;
        within(point.x, shape[1]) && within(point.y, shape[0])
    };
    let [left, right] = &oracle.curves;
    let mut points = Vec::new();
    for curve in 0..left.len() {
        for index in 1..left[curve].len() {
            let (l, r) = (left[curve][index], right[curve][index]);
            let tangents = [l - left[curve][index - 1], r - right[curve][index - 1]];
            if !(inside(&l) && inside(&r)) || tangents.iter().any(|tangent| tangent.norm() < 1e-6) {
                continue;
            }
            let others = |view: usize, point: Point2| {
                let curves = oracle.curves[view].iter().enumerate().filter(move |(other, _)| *other != curve);
                curves.flat_map(|(_, points)| points.windows(2)).filter(move |pair| (pair[0] - point).norm() < NEAR_PX)
            };
            let along = |view: usize, point: Point2| {
                others(view, point).any(|pair| angle(&(pair[1] - pair[0]), &tangents[view]) < OVERLAP_RAD)
            };
            points.push(Truth {
                curve,
                left: l,
                disparity_px: r.x - l.x,
                tangent: tangents[0].normalize(),
                crossing: others(0, l).next().is_some(),
                overlap: along(0, l) || along(1, r),
            });
        }
    }
    points
}

/// The true curve that each matched curve follows in the left image: where two true curves lie over each other, the
/// nearest at a point may be the wrong one, but not along the whole.
fn labels(curves: &[MatchedCurve], oracle: &Oracle) -> Vec<usize> {
    let distance = |curve: &MatchedCurve, truth: &Vec<Point2>| -> f64 {
        let to = |point: &Point2| truth.iter().map(|other| (other - point).norm()).fold(f64::INFINITY, f64::min);
        curve.points.iter().map(|point| to(&point.left).min(2.0 * NEAR_PX)).sum()
    };
    let label = |curve: &MatchedCurve| {
        let distances = oracle.curves[0].iter().map(|truth| distance(curve, truth));
        distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(index, _)| index)
    };
    curves.iter().map(label).collect()
}

/// The disparity that matched curves give at a true point: on the nearest segment of about its direction.
fn found(curves: &[MatchedCurve], labels: &[usize], truth: &Truth) -> Option<Found> {
    let mut best: Option<(f64, Found)> = None;
    let own = curves.iter().zip(labels).filter(|(_, label)| **label == truth.curve);
    for pair in own.flat_map(|(curve, _)| curve.points.windows(2)) {
        let along = pair[1].left - pair[0].left;
        let offset = truth.left - pair[0].left;
        if offset.norm() > REACH_PX + along.norm() || angle(&along, &truth.tangent) > REACH_RAD {
            continue;
        }
        let t = (offset.dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
        let distance = (offset - along * t).norm();
        if distance <= best.map_or(REACH_PX, |(nearest, _)| nearest) {
            let mix = |a: f64, b: f64| a + (b - a) * t;
            let found = Found {
                disparity_px: mix(pair[0].disparity_px, pair[1].disparity_px),
                sigma_px: mix(pair[0].sigma_px, pair[1].sigma_px),
                flag: if t < 0.5 { pair[0].flag } else { pair[1].flag },
            };
            best = Some((distance, found));
        }
    }
    best.map(|(_, found)| found)
}

/// Angle between undirected lines.
fn angle(a: &Vector2, b: &Vector2) -> f64 {
    (a.x * b.y - a.y * b.x).abs().atan2(a.dot(b).abs())
}

/// What makes a subset of the samples.
type Choice = fn(&Truth) -> bool;

fn report(samples: &[Sample<'_>]) {
    let methods = METHODS;
    let steep = |sample: &&Sample<'_>| angle_to_row(&sample.truth.tangent) >= 10.0 * PI / 180.0;
    let choices: [(&str, Choice); 3] =
        [("all", |_| true), ("near crossings", |truth| truth.crossing), ("overlaps", |truth| truth.overlap)];
    println!(
        "{:<15} {:<9} {:>6} {:>8} {:>8} {:>8} {:>8}",
        "where", "method", "n", "mean", "median", "bad-1 %", "cover %"
    );
    for (name, choice) in choices {
        let chosen: Vec<&Sample<'_>> = samples.iter().filter(steep).filter(|sample| choice(sample.truth)).collect();
        let curve = methods.len() - 1;
        let both: Vec<&&Sample<'_>> =
            chosen.iter().filter(|sample| sample.sgbm.is_some() && sample.ours[curve].is_some()).collect();
        let covered = |count: usize| 100.0 * count as f64 / chosen.len().max(1) as f64;
        let row = |method: &str, errors: Vec<f64>, cover: f64| {
            let (mean, median, bad) = summary(errors.clone());
            println!("{name:<15} {method:<9} {:>6} {mean:>8.3} {median:>8.3} {bad:>8.2} {cover:>8.1}", errors.len());
        };
        let sgbm = both.iter().filter_map(|s| Some((s.sgbm? - s.truth.disparity_px).abs())).collect();
        row("SGBM", sgbm, covered(chosen.iter().filter(|sample| sample.sgbm.is_some()).count()));
        for (index, method) in methods.iter().enumerate() {
            let errors = both.iter().filter_map(|s| Some((s.ours[index]?.disparity_px - s.truth.disparity_px).abs()));
            let cover = covered(chosen.iter().filter(|sample| sample.ours[index].is_some()).count());
            row(&format!("{method:?}"), errors.collect(), cover);
        }
    }
    println!(
        "{:<9} {:<15} {:>6} {:>8} {:>9} {:>9} {:>9}",
        "method", "flag", "n", "mean", "sigma", "in 1s %", "in 2s %"
    );
    for (index, method) in methods.iter().enumerate() {
        // Lines apart from others show the error of measuring; the rest adds that of lines that were traced as one.
        for (flag, apart) in
            [(Flag::Ok, false), (Flag::Ok, true), (Flag::IllConditioned, false), (Flag::Bridged, false)]
        {
            let found: Vec<(f64, f64)> = samples
                .iter()
                .filter(|sample| !apart || !(sample.truth.crossing || sample.truth.overlap))
                .filter_map(|sample| Some((sample.ours[index]?, sample.truth.disparity_px)))
                .filter(|(found, _)| found.flag == flag)
                .map(|(found, truth)| ((found.disparity_px - truth).abs(), found.sigma_px))
                .collect();
            let share = |k: f64| {
                100.0 * found.iter().filter(|(error, sigma)| *error <= k * sigma).count() as f64 / found.len() as f64
            };
            let (mean, ..) = summary(found.iter().map(|(error, _)| *error).collect());
            let (_, sigma, _) = summary(found.iter().map(|(_, sigma)| *sigma).collect());
            let (one, two, n) = (share(1.0), share(2.0), found.len());
            let method = format!("{method:?}");
            let flag = format!("{}{}", flag.word(), if apart { ", apart" } else { "" });
            println!("{method:<9} {flag:<15} {n:>6} {mean:>8.3} {sigma:>9.3} {one:>9.1} {two:>9.1}");
        }
    }
}

/// Mean, median, and percentage above 1.
fn summary(mut errors: Vec<f64>) -> (f64, f64, f64) {
    if errors.is_empty() {
        return (f64::NAN, f64::NAN, f64::NAN);
    }
    errors.sort_unstable_by(f64::total_cmp);
    let count = errors.len() as f64;
    let bad = errors.iter().filter(|error| **error > 1.0).count() as f64;
    (errors.iter().sum::<f64>() / count, errors[errors.len() / 2], 100.0 * bad / count)
}

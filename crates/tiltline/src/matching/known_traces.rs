//! Traces made from known curves, exact or with the faults of a real tracer: what matching and refinement are proved on,
//! apart from the detector. Lengths in px.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::curve::{Trace, TraceEnd, TraceGraph, TracePoint};
use crate::geometry::{Point2, Vector2, length2};

/// Spacing of the points along a trace.
const SPACING_PX: f64 = 1.0;
/// Tangents are taken over this many points on either side.
const TANGENT_REACH: usize = 3;
/// Shortest trace that is made.
const MIN_LENGTH_PX: f64 = 10.0;

/// The faults of the traces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TraceFaults {
    /// One sigma of the error across the line.
    pub sigma_perp_px: f64,
    /// Length along the line over which that error is alike (standard deviation of its Gaussian smoothing).
    pub correlation_px: f64,
    /// Mean distance between gaps of 5 to 12 px; infinite for none.
    pub gap_every_px: f64,
    /// Lines that are in this view only.
    pub false_lines: usize,
    /// Seed of all of it.
    pub seed: u64,
}

impl TraceFaults {
    /// No faults.
    pub fn none() -> Self {
        Self { sigma_perp_px: 0.0, correlation_px: 0.0, gap_every_px: f64::INFINITY, false_lines: 0, seed: 0 }
    }
}

/// Traces of known curves on a grid of `[rows, columns]`, and the curve each comes from (`None` for a false one).
pub fn known_traces(
    curves: &[Vec<Point2>],
    shape: [usize; 2],
    faults: &TraceFaults,
) -> (TraceGraph, Vec<Option<usize>>) {
    let mut rng = Pcg64::seed_from_u64(faults.seed);
    let inside = |point: &Point2| {
        point.x >= 0.0 && point.y >= 0.0 && point.x <= (shape[1] - 1) as f64 && point.y <= (shape[0] - 1) as f64
    };
    let mut graph = TraceGraph::default();
    let mut sources = Vec::new();
    let mut add = |rng: &mut Pcg64, curve: &[Point2], source: Option<usize>| {
        let points = resample(curve, SPACING_PX);
        let points = jitter(&points, faults, rng);
        let keep: Vec<bool> = gaps(points.len(), faults.gap_every_px, rng);
        let kept = points.iter().zip(keep).map(|(point, keep)| (keep && inside(point)).then_some(*point));
        let kept: Vec<Option<Point2>> = kept.collect();
        for stretch in kept.split(Option::is_none) {
            let stretch: Vec<Point2> = stretch.iter().flatten().copied().collect();
            if stretch.len() >= 2 && length2(&stretch) >= MIN_LENGTH_PX {
                graph.traces.push(trace_of_points(&stretch, false, faults.sigma_perp_px));
                sources.push(source);
            }
        }
    };
    for (index, curve) in curves.iter().enumerate() {
        add(&mut rng, curve, Some(index));
    }
    for _ in 0..faults.false_lines {
        let start = Point2::new(rng.random_range(0.0..shape[1] as f64), rng.random_range(0.0..shape[0] as f64));
        let angle: f64 = rng.random_range(0.0..std::f64::consts::TAU);
        let bow = rng.random_range(-0.005..0.005);
        let length = rng.random_range(20.0..80.0);
        let line = (0..length as usize).scan((start, angle), |(point, angle), _| {
            *angle += bow;
            *point += Vector2::new(angle.cos(), angle.sin());
            Some(*point)
        });
        add(&mut rng, &line.collect::<Vec<_>>(), None);
    }
    (graph, sources)
}

/// A trace through the corners of a polyline, points 1 px apart, with tangents.
pub fn trace_through(corners: &[Point2], closed: bool, sigma_perp_px: f64) -> Trace {
    let mut corners = corners.to_vec();
    if closed {
        corners.extend(corners.first().copied());
    }
    let mut points = resample(&corners, SPACING_PX);
    if closed {
        points.pop();
    }
    trace_of_points(&points, closed, sigma_perp_px)
}

fn trace_of_points(points: &[Point2], closed: bool, sigma_perp_px: f64) -> Trace {
    let count = points.len();
    let tangent = |index: usize| {
        let reach = TANGENT_REACH.min(count / 2).max(1);
        let (before, after) = if closed {
            ((index + count - reach) % count, (index + reach) % count)
        } else {
            (index.saturating_sub(reach), (index + reach).min(count - 1))
        };
        (points[after] - points[before]).try_normalize(1e-12).unwrap_or_else(Vector2::x)
    };
    let points = points
        .iter()
        .enumerate()
        .map(|(index, position)| TracePoint {
            position: *position,
            tangent: tangent(index),
            probability: 1.0,
            sigma_perp_px: sigma_perp_px.max(0.02),
        })
        .collect();
    Trace { points, closed, ends: [TraceEnd::Free; 2] }
}

/// Points at equal arc length along a polyline, about `spacing` apart, with both ends.
fn resample(curve: &[Point2], spacing: f64) -> Vec<Point2> {
    let total = length2(curve);
    let steps = (total / spacing).round().max(1.0) as usize;
    let mut points = Vec::with_capacity(steps + 1);
    let (mut segment, mut start) = (0, 0.0);
    for step in 0..=steps {
        let s = total * step as f64 / steps as f64;
        while segment + 2 < curve.len() && start + (curve[segment + 1] - curve[segment]).norm() < s {
            start += (curve[segment + 1] - curve[segment]).norm();
            segment += 1;
        }
        let along = curve[segment + 1] - curve[segment];
        points.push(curve[segment] + along * ((s - start) / along.norm().max(1e-12)).clamp(0.0, 1.0));
    }
    points
}

/// Moves points across the line by Gaussian noise that is smooth along it.
fn jitter(points: &[Point2], faults: &TraceFaults, rng: &mut Pcg64) -> Vec<Point2> {
    if faults.sigma_perp_px <= 0.0 {
        return points.to_vec();
    }
    let white: Vec<f64> = (0..points.len()).map(|_| StandardNormal.sample(rng)).collect();
    let reach = (3.0 * faults.correlation_px).ceil() as isize;
    (0..points.len())
        .map(|index| {
            let (mut sum, mut square) = (0.0, 0.0);
            for offset in -reach..=reach {
                let weight = (-0.5 * (offset as f64 / faults.correlation_px.max(1e-9)).powi(2)).exp();
                if let Some(noise) = index.checked_add_signed(offset).and_then(|index| white.get(index)) {
                    sum += weight * noise;
                    square += weight * weight;
                }
            }
            let along = points[(index + 1).min(points.len() - 1)] - points[index.saturating_sub(1)];
            let across = Vector2::new(-along.y, along.x).try_normalize(1e-12).unwrap_or_else(Vector2::zeros);
            points[index] + across * (faults.sigma_perp_px * sum / square.sqrt())
        })
        .collect()
}

fn gaps(count: usize, every_px: f64, rng: &mut Pcg64) -> Vec<bool> {
    let mut keep = vec![true; count];
    if every_px.is_finite() {
        let mut index = 0;
        while index < count {
            if rng.random_range(0.0..1.0) < SPACING_PX / every_px {
                let end = (index + rng.random_range(5..13)).min(count);
                keep[index..end].fill(false);
                index = end;
            }
            index += 1;
        }
    }
    keep
}

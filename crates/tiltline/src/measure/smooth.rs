//! Smooth curves from noisy points: local quadratic regression along arc length (Cleveland 1979), because the length of
//! a polyline through noisy points grows with every point.
//!
//! The arc length is that of the projection (x, y), which is known far better than z. The width of the window is chosen
//! from sigma_z: as small as keeps the error of the slope, or of the curvature, at a set level.

use std::f64::consts::PI;

use nalgebra::Matrix3;

use crate::curve::Curve3;
use crate::geometry::{Point3, Vector3};
use crate::reconstruction::Frame;

/// Wanted one-sigma error of `dz/ds`: a slope of 0.1 lengthens a line by half a percent.
const SLOPE_SIGMA: f64 = 0.1;
/// Smallest standard deviation of the window, px.
const MIN_WINDOW_PX: f64 = 2.0;
/// Smallest standard deviation of the window for curvature, px: second derivatives need more points.
const MIN_CURVATURE_WINDOW_PX: f64 = 6.0;
/// Wanted one-sigma error of the curvature, 1/px: a radius of 400 px.
const CURVATURE_SIGMA_PER_PX: f64 = 0.0025;
/// Points further from the centre of the window than this many of its standard deviations are left out.
const REACH: f64 = 3.0;

/// A curve after smoothing; same number of points.
pub(super) struct SmoothCurve {
    /// Points.
    pub points: Vec<Point3>,
    /// Whether the last joins the first.
    pub closed: bool,
    /// Curvature, where the curve is long enough for it.
    pub curvature: Option<Curvature>,
    /// Median of sigma_z over the points of the curve.
    pub median_sigma_z: f64,
}

/// Curvature along one curve, in 1/unit.
pub(super) struct Curvature {
    pub mean: f64,
    pub max: f64,
    pub sigma: f64,
}

impl SmoothCurve {
    pub fn new(curve: &Curve3, frame: &Frame) -> Self {
        let samples = Samples::new(curve);
        let mut sigmas: Vec<f64> = curve.points.iter().map(|point| point.sigma_z).collect();
        sigmas.sort_unstable_by(f64::total_cmp);
        let sigma_z = sigmas[sigmas.len() / 2];
        let spacing = samples.span / samples.arc.len() as f64;
        // Variance of the slope of a Gaussian-weighted fit: sigma^2 spacing / (4 sqrt(pi) window^3).
        let noise2 = sigma_z * sigma_z * spacing / PI.sqrt();
        let window = (noise2 / (4.0 * SLOPE_SIGMA.powi(2))).cbrt();
        let window = window.max(MIN_WINDOW_PX * frame.pixel).min(samples.span / 6.0);
        let points = (0..curve.points.len()).map(|index| samples.fit(index, window)[0]).map(Point3::from).collect();
        let curvature = samples.curvature(noise2, frame.pixel);
        Self { points, closed: curve.closed, curvature, median_sigma_z: sigma_z }
    }

    /// Vectors between neighbours.
    pub fn steps(&self) -> impl Iterator<Item = Vector3> {
        let closing = if self.closed { self.points.first().zip(self.points.last()) } else { None };
        let open = self.points.windows(2).map(|pair| pair[1] - pair[0]);
        open.chain(closing.map(|(first, last)| first - last))
    }

    pub fn length(&self) -> f64 {
        self.steps().map(|step| step.norm()).sum()
    }
}

/// The points of one curve over the arc length of its projection.
struct Samples<'a> {
    curve: &'a Curve3,
    arc: Vec<f64>,
    /// Whole projected length, with the closing step of a closed curve.
    span: f64,
}

impl<'a> Samples<'a> {
    fn new(curve: &'a Curve3) -> Self {
        let mut sum = 0.0;
        let mut arc = vec![0.0];
        for pair in curve.points.windows(2) {
            sum += (pair[1].position.xy() - pair[0].position.xy()).norm();
            arc.push(sum);
        }
        if let (true, Some(first), Some(last)) = (curve.closed, curve.points.first(), curve.points.last()) {
            sum += (first.position.xy() - last.position.xy()).norm();
        }
        Self { curve, arc, span: sum }
    }

    /// Position, first and second derivative by arc length at a point: a weighted quadratic fit around it.
    fn fit(&self, index: usize, window: f64) -> [Vector3; 3] {
        let points = &self.curve.points;
        let own = points[index].position.coords;
        // Sums of weight t^0..t^4, and of weight t^0..t^2 times the position.
        let (mut sums, mut right) = ([0.0; 5], [Vector3::zeros(); 3]);
        let mut used = 0;
        if window > 0.0 {
            let mut add = |other: usize, offset: f64| {
                let t = offset / window;
                let weight = (-0.5 * t * t).exp();
                let position = points[other].position.coords - own;
                let mut term = weight;
                for power in 0..5 {
                    sums[power] += term;
                    if power < 3 {
                        right[power] += position * term;
                    }
                    term *= t;
                }
                used += 1;
            };
            add(index, 0.0);
            self.walk(index, window, 1, &mut add);
            self.walk(index, window, -1, &mut add);
        }
        // Fewer than five points would be interpolated, not smoothed.
        let moments = Matrix3::from_fn(|row, column| sums[row + column]);
        let inverse = if used >= 5 { moments.try_inverse() } else { None };
        let solution = inverse.map(|inverse| inverse * Matrix3::from_columns(&right).transpose());
        match solution {
            Some(fit) => [
                own + fit.row(0).transpose(),
                fit.row(1).transpose() / window,
                fit.row(2).transpose() * (2.0 / (window * window)),
            ],
            None => [own, Vector3::zeros(), Vector3::zeros()],
        }
    }

    /// Calls `add(point, offset in arc length)` for the points in reach on one side, around the end of a closed curve.
    fn walk(&self, index: usize, window: f64, direction: isize, add: &mut impl FnMut(usize, f64)) {
        let count = self.arc.len() as isize;
        let mut turns = 0.0;
        let mut at = index as isize;
        loop {
            at += direction;
            if at < 0 || at >= count {
                if !self.curve.closed {
                    return;
                }
                at = at.rem_euclid(count);
                turns += direction as f64;
            }
            let offset = self.arc[at as usize] + turns * self.span - self.arc[index];
            // Half way round the other side is nearer.
            if offset.abs() > (REACH * window).min(0.5 * self.span.max(f64::MIN_POSITIVE)) && self.curve.closed
                || offset.abs() > REACH * window
            {
                return;
            }
            add(at as usize, offset);
        }
    }

    /// `|r' x r''| / |r'|^3`, with the window that `noise2` (sigma_z^2 spacing / sqrt(pi)) asks for.
    fn curvature(&self, noise2: f64, pixel: f64) -> Option<Curvature> {
        // Variance of the second derivative: 3 sigma^2 spacing / (8 sqrt(pi) window^5), to leading order.
        let variance = |window: f64| 3.0 * noise2 / (8.0 * window.powi(5));
        let wanted = (3.0 * noise2 / (8.0 * (CURVATURE_SIGMA_PER_PX / pixel).powi(2))).powf(0.2);
        let smallest = MIN_CURVATURE_WINDOW_PX * pixel;
        let largest = self.span / 6.0;
        if largest < smallest {
            return None;
        }
        let window = wanted.clamp(smallest, largest);
        let mut values = Vec::with_capacity(self.arc.len());
        for index in 0..self.arc.len() {
            // A one-sided window says nothing about the bend at an end.
            let inside = self.arc[index] >= window && self.span - self.arc[index] >= window;
            if self.curve.closed || inside {
                let [_, first, second] = self.fit(index, window);
                let speed = first.norm();
                if speed > 0.0 {
                    values.push(first.cross(&second).norm() / speed.powi(3));
                }
            }
        }
        let max = values.iter().copied().reduce(f64::max)?;
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        Some(Curvature { mean, max, sigma: variance(window).sqrt() })
    }
}

//! Length, depth range, curvature, foil thickness and dislocation density of what was reconstructed, each with its
//! uncertainty; what cannot be known is said with the reason.
//!
//! Lengths are in the unit of the reconstruction ([`Frame::unit`]), curvatures in its inverse, angles in degrees.

mod density;
mod foil;
mod smooth;

use nalgebra::Unit;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::curve::{Curve3, Flag};
use crate::geometry::Vector3;
use crate::progress::Stage;
use crate::reconstruction::Frame;
use crate::rectify::RectifiedPair;
use crate::warning::Warning;

pub use density::{Density, DensityUnit, LOWER_BOUND, projected_area};
pub use foil::{Foil, FoilSurfaces};
use smooth::SmoothCurve;

/// Above this share of doubtful length (bridged or ill conditioned) there is a warning.
const MAX_DOUBTFUL_SHARE: f64 = 0.3;
/// Above this relative error of all depths there is a warning.
const MAX_RELATIVE_TILT_ERROR: f64 = 0.02;
/// Error along the line of where it ends, in px: a detector loses a line a pixel or so before or after its end.
const END_ERROR_PX: f64 = 1.5;

/// Settings of the measures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MeasureSettings {
    /// One-sigma error of the angle between the two views, in degrees.
    pub tilt_sigma_deg: f64,
    /// Free line ends below which no foil surfaces are sought.
    pub min_surface_ends: usize,
}

impl Default for MeasureSettings {
    fn default() -> Self {
        Self { tilt_sigma_deg: 0.1, min_surface_ends: 8 }
    }
}

/// A value, or why there is none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Known<T> {
    /// It could be measured.
    Known(T),
    /// It could not; a sentence with the numbers.
    Unknown(String),
}

impl<T> Default for Known<T> {
    fn default() -> Self {
        Known::Unknown("not measured".into())
    }
}

impl<T> Known<T> {
    /// The value, if it is known.
    pub fn known(&self) -> Option<&T> {
        match self {
            Known::Known(value) => Some(value),
            Known::Unknown(_) => None,
        }
    }
}

/// What was measured on all curves.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Measures {
    /// Number of curves.
    pub curves: usize,
    /// Length of all curves, on the smoothed curves.
    pub total_length: f64,
    /// One sigma of it: depth noise, line ends and the error of the tilt angle.
    pub total_length_sigma: f64,
    /// Share of the length that is bridged or ill conditioned, 0 to 1.
    pub doubtful_share: f64,
    /// Depths the curves span; none without curves.
    pub depth: Option<DepthRange>,
    /// Surfaces of the foil.
    pub foil: Known<Foil>,
    /// Length per volume, or per projected area.
    pub density: Known<Density>,
    /// One entry a curve, in their order.
    pub per_curve: Vec<CurveMeasures>,
}

/// A range of depth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DepthRange {
    /// Length-weighted 2.5 percentile of z.
    pub low: f64,
    /// Length-weighted 97.5 percentile of z.
    pub high: f64,
    /// Length-weighted median of sigma_z, without the tilt error, which scales all z alike.
    pub sigma_z: f64,
}

/// What was measured on one curve.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CurveMeasures {
    /// Length of the smoothed curve.
    pub length: f64,
    /// Unit vector from the first to the last point; none where they coincide or the curve is closed.
    pub direction: Option<[f64; 3]>,
    /// Length-weighted mean of the curvature; it and the next two are none where the curve is too short.
    pub mean_curvature: Option<f64>,
    /// Largest curvature.
    pub max_curvature: Option<f64>,
    /// One sigma of the curvature at a point, from sigma_z: a mean below it is compatible with a straight line.
    pub sigma_curvature: Option<f64>,
    /// Smallest z.
    pub min_z: f64,
    /// Largest z.
    pub max_z: f64,
    /// Median of sigma_z over the points.
    pub sigma_z: f64,
}

/// Measures all curves; warnings say what could not be measured and why.
pub fn measure(
    curves: &[Curve3],
    frame: &Frame,
    rectified: &RectifiedPair,
    settings: &MeasureSettings,
) -> (Measures, Vec<Warning>) {
    let smooth: Vec<SmoothCurve> = curves.par_iter().map(|curve| SmoothCurve::new(curve, frame)).collect();
    let per_curve: Vec<CurveMeasures> = curves.iter().zip(&smooth).map(|(c, s)| measure_curve(c, s)).collect();
    let length = LengthBudget::new(curves, &smooth, frame);
    let foil = foil::fit(curves, &smooth, frame, settings);
    let density = density::density(&per_curve, &length, &foil, frame, rectified);
    let measures = Measures {
        curves: curves.len(),
        total_length: length.total,
        total_length_sigma: length.sigma(frame),
        doubtful_share: doubtful_share(curves),
        depth: depth_range(curves),
        foil,
        density,
        per_curve,
    };
    let warnings = warnings(&measures, frame);
    (measures, warnings)
}

/// The total length and where its error comes from.
struct LengthBudget {
    total: f64,
    /// Variance from depth noise and line ends.
    variance: f64,
    /// `d total / d ln(depth gain)`: the sum of `dz^2 / dl`, by which the error of the tilt angle acts.
    depth_part: f64,
}

impl LengthBudget {
    fn new(curves: &[Curve3], smooth: &[SmoothCurve], frame: &Frame) -> Self {
        let mut budget = Self { total: 0.0, variance: 0.0, depth_part: 0.0 };
        for (curve, smooth) in curves.iter().zip(smooth) {
            let length = smooth.length();
            let depth_part: f64 = smooth.steps().map(|step| step.z * step.z / step.norm().max(f64::MIN_POSITIVE)).sum();
            budget.total += length;
            budget.depth_part += depth_part;
            if !curve.closed && length > 0.0 {
                // Each end moves the length by the part of its depth error that lies along the line, and by the error
                // of where it was seen to end.
                let slope2 = depth_part / length;
                let sigma_z = smooth.median_sigma_z;
                budget.variance += 2.0 * (slope2 * sigma_z * sigma_z + (END_ERROR_PX * frame.pixel).powi(2));
            }
        }
        budget
    }

    fn sigma(&self, frame: &Frame) -> f64 {
        self.variance.sqrt().hypot(self.depth_part * frame.relative_tilt_error)
    }
}

fn measure_curve(curve: &Curve3, smooth: &SmoothCurve) -> CurveMeasures {
    let chord = match (curve.closed, curve.points.first(), curve.points.last()) {
        (false, Some(first), Some(last)) => last.position - first.position,
        _ => Vector3::zeros(),
    };
    let direction = Unit::try_new(chord, 1e-9).map(|unit| [unit.x, unit.y, unit.z]);
    let z = || curve.points.iter().map(|point| point.position.z);
    let curvature = smooth.curvature.as_ref();
    CurveMeasures {
        length: smooth.length(),
        direction,
        mean_curvature: curvature.map(|curvature| curvature.mean),
        max_curvature: curvature.map(|curvature| curvature.max),
        sigma_curvature: curvature.map(|curvature| curvature.sigma),
        min_z: z().fold(f64::INFINITY, f64::min),
        max_z: z().fold(f64::NEG_INFINITY, f64::max),
        sigma_z: smooth.median_sigma_z,
    }
}

/// Depth and sigma_z of every point with the length it stands for, seen along the beam.
fn weighted_points(curves: &[Curve3]) -> Vec<(&crate::curve::CurvePoint, f64)> {
    let mut points = Vec::new();
    for curve in curves {
        for pair in curve.points.windows(2) {
            let half = 0.5 * (pair[1].position.xy() - pair[0].position.xy()).norm();
            points.extend(pair.iter().map(|point| (point, half)));
        }
    }
    points
}

fn doubtful_share(curves: &[Curve3]) -> f64 {
    let points = weighted_points(curves);
    let total: f64 = points.iter().map(|(_, weight)| weight).sum();
    let doubtful: f64 = points.iter().filter(|(point, _)| point.flag != Flag::Ok).map(|(_, weight)| weight).sum();
    if total > 0.0 { doubtful / total } else { 0.0 }
}

fn depth_range(curves: &[Curve3]) -> Option<DepthRange> {
    let points = weighted_points(curves);
    let quantiles = |get: fn(&crate::curve::CurvePoint) -> f64, fractions: &[f64]| {
        weighted_quantiles(points.iter().map(|(point, weight)| (get(point), *weight)).collect(), fractions)
    };
    let z = quantiles(|point| point.position.z, &[0.025, 0.975])?;
    let sigma = quantiles(|point| point.sigma_z, &[0.5])?;
    Some(DepthRange { low: z[0], high: z[1], sigma_z: sigma[0] })
}

/// Weighted quantiles (no interpolation); none without weight.
fn weighted_quantiles(mut values: Vec<(f64, f64)>, fractions: &[f64]) -> Option<Vec<f64>> {
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = values.iter().map(|(_, weight)| weight).sum();
    let last = values.last()?.0;
    let quantile = |fraction: f64| {
        let mut sum = 0.0;
        values.iter().find(|(_, weight)| {
            sum += weight;
            sum >= fraction * total
        })
    };
    (total > 0.0)
        .then(|| fractions.iter().map(|&fraction| quantile(fraction).map_or(last, |(value, _)| *value)).collect())
}

fn warnings(measures: &Measures, frame: &Frame) -> Vec<Warning> {
    let mut warnings = Vec::new();
    if measures.curves == 0 {
        warnings.push(Warning::new(
            Stage::Measure,
            "no line was found in both images, so there are no curves; look at overlay.png and lines.csv, then try the \
             other contrast (--lines dark|bright) or a larger --max-disparity",
        ));
    }
    if measures.doubtful_share > MAX_DOUBTFUL_SHARE {
        warnings.push(Warning::new(
            Stage::Measure,
            format!(
                "{:.0} percent of the length is bridged or runs along the rows, where depth is poorly determined; lines \
                 at right angles to the tilt axis need a pair about another axis",
                100.0 * measures.doubtful_share
            ),
        ));
    }
    if measures.curves > 0 && frame.relative_tilt_error > MAX_RELATIVE_TILT_ERROR {
        warnings.push(Warning::new(
            Stage::Measure,
            format!(
                "all depths may be off by one factor: the tilt angle is known to {:.1} percent (one sigma); a larger \
                 angle between the views or a smaller measure.tilt_sigma_deg would help",
                100.0 * frame.relative_tilt_error
            ),
        ));
    }
    warnings
}

#[cfg(test)]
mod tests;

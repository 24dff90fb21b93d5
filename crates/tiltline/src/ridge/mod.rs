//! The classical line detector: a multi-scale ridge filter.

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use crate::curve::LineMap;
use crate::micrograph::View;
use crate::pipeline::Detect;
use crate::rectify::RectifiedPair;

/// Whether lines are darker or brighter than what surrounds them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LinePolarity {
    /// Dark lines (bright field).
    Dark,
    /// Bright lines (dark field, weak beam).
    Bright,
    /// Whichever gives the stronger lines, the same in both images.
    Auto,
}

/// Settings of the ridge detector.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RidgeSettings {
    /// Dark or bright lines.
    pub lines: LinePolarity,
}

impl Default for RidgeSettings {
    fn default() -> Self {
        Self { lines: LinePolarity::Auto }
    }
}

/// The ridge filter as a detector.
#[derive(Clone, Debug, Default)]
pub struct RidgeDetector {
    /// Its settings.
    pub settings: RidgeSettings,
}

impl Detect for RidgeDetector {
    fn detect(&self, pair: &RectifiedPair, view: View) -> LineMap {
        LineMap { probability: Array2::zeros(pair.view(view).dim()), line_width_px: 3.0 }
    }
}

//! Disparity along the lines.

mod unmatched;

use serde::{Deserialize, Serialize};

use crate::curve::{LineMap, MatchedCurve, TraceGraph};
pub use unmatched::unmatched_lines;

use crate::pipeline::Match;
use crate::rectify::RectifiedPair;

/// Settings of the classical matcher.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MatchSettings {
    /// Largest absolute disparity in rectified px; 0 takes it from the spread of the point matches.
    pub max_disparity_px: f64,
}

impl Default for MatchSettings {
    fn default() -> Self {
        Self { max_disparity_px: 0.0 }
    }
}

/// The classical matcher: dynamic programming along each left line.
#[derive(Clone, Debug, Default)]
pub struct ClassicalMatcher {
    /// Its settings.
    pub settings: MatchSettings,
}

impl Match for ClassicalMatcher {
    fn match_curves(
        &self,
        _pair: &RectifiedPair,
        _lines: &[LineMap; 2],
        _traces: &[TraceGraph; 2],
    ) -> Vec<MatchedCurve> {
        Vec::new()
    }
}

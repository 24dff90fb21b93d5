//! Disparity along the lines: the classical matcher, the baseline that needs no weights.
//!
//! For each left line, dynamic programming along its arc length chooses among the places on each row of the right image
//! where it may lie (`candidates`); the path as a whole is cheap where windows look alike, tangents agree and depth
//! changes slowly (`path`). The same is done from right to left. Candidates that the other direction gave to another line
//! cost more in the next round; stretches that still contradict it in the end are dropped. Disparities are in rectified
//! px, `x_R - x_L`.

mod appearance;
mod assemble;
pub(crate) mod candidates;
pub(crate) mod crossings;
mod known_traces;
pub(crate) mod path;
pub(crate) mod sigma;
mod solve;
mod unmatched;

#[cfg(test)]
pub(crate) mod tests;

use serde::{Deserialize, Serialize};

use crate::curve::{LineMap, MatchedCurve, TraceGraph};
pub use assemble::{Measured, assemble};
pub use known_traces::{TraceFaults, known_traces, trace_through};
pub use unmatched::unmatched_lines;

use crate::pipeline::Match;
use crate::rectify::{Rectification, RectifiedPair};

/// Disparity range in px on either side of zero where nothing is known of it.
const UNKNOWN_RANGE_PX: f64 = 32.0;
/// Least widening of the range of the point matches, px, and the share of its width by which it is widened: point
/// matches are few near the foil's surfaces.
const MIN_MARGIN_PX: f64 = 6.0;
const MARGIN_SHARE: f64 = 0.5;

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

impl MatchSettings {
    /// Lowest and highest disparity that is looked for, in rectified px.
    pub fn range_px(&self, rectification: &Rectification) -> [f64; 2] {
        let [low, high] = rectification.disparity_range_px;
        if self.max_disparity_px > 0.0 {
            [-self.max_disparity_px, self.max_disparity_px]
        } else if low.is_finite() && high > low {
            let margin = (MARGIN_SHARE * (high - low)).max(MIN_MARGIN_PX);
            [low - margin, high + margin]
        } else {
            [-UNKNOWN_RANGE_PX, UNKNOWN_RANGE_PX]
        }
    }
}

/// The classical matcher: dynamic programming along each left line.
#[derive(Clone, Debug, Default)]
pub struct ClassicalMatcher {
    /// Its settings.
    pub settings: MatchSettings,
}

impl Match for ClassicalMatcher {
    fn match_curves(&self, pair: &RectifiedPair, lines: &[LineMap; 2], traces: &[TraceGraph; 2]) -> Vec<MatchedCurve> {
        solve::solve(pair, lines, traces, self.settings.range_px(&pair.rectification))
    }
}

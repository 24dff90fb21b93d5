//! From line probability to sub-pixel centrelines.

use serde::{Deserialize, Serialize};

use crate::curve::{LineMap, TraceGraph};

/// Settings of tracing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TraceSettings {
    /// Probability above which a pixel starts a line.
    pub high: f32,
    /// Probability above which a connected pixel belongs to it.
    pub low: f32,
    /// Shortest line that is kept, in px.
    pub min_length_px: f64,
}

impl Default for TraceSettings {
    fn default() -> Self {
        Self { high: 0.5, low: 0.25, min_length_px: 15.0 }
    }
}

/// Centrelines and junctions of a line map.
pub fn trace(_lines: &LineMap, _settings: &TraceSettings) -> TraceGraph {
    TraceGraph::default()
}

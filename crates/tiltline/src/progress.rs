//! Typed progress events: the library reports, the shell renders.

use serde::{Deserialize, Serialize};

/// A stage of the pipeline, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Reading the images.
    Read,
    /// Making epipolar lines rows.
    Rectify,
    /// Line probability per pixel.
    Detect,
    /// Centrelines.
    Trace,
    /// Disparity along the lines.
    Match,
    /// Sub-pixel disparity.
    Refine,
    /// Depth.
    Triangulate,
    /// Lengths, thickness, density.
    Measure,
    /// Writing the results.
    Export,
    /// Making a tomogram; not a stage of the pipeline.
    Tomogram,
}

impl Stage {
    /// Every stage of the pipeline in the order they run.
    pub const ALL: [Stage; 9] = [
        Stage::Read,
        Stage::Rectify,
        Stage::Detect,
        Stage::Trace,
        Stage::Match,
        Stage::Refine,
        Stage::Triangulate,
        Stage::Measure,
        Stage::Export,
    ];

    /// The stage's name as the user reads it.
    pub fn word(self) -> &'static str {
        match self {
            Stage::Read => "read",
            Stage::Rectify => "rectify",
            Stage::Detect => "detect",
            Stage::Trace => "trace",
            Stage::Match => "match",
            Stage::Refine => "refine",
            Stage::Triangulate => "triangulate",
            Stage::Measure => "measure",
            Stage::Export => "export",
            Stage::Tomogram => "tomogram",
        }
    }
}

impl std::fmt::Display for Stage {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(self.word())
    }
}

/// What a long computation reports.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A stage began.
    Started(Stage),
    /// A stage ended, after so many seconds.
    Finished(Stage, f64),
    /// So many of so many like parts of a stage are done.
    Advanced(Stage, usize, usize),
}

/// Where events go; `&|_| ()` for nowhere.
pub type Progress<'a> = &'a (dyn Fn(Event) + Sync);

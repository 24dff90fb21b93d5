//! The result of the main job, with every stage kept so that each can be saved, viewed and tested.

use serde::{Deserialize, Serialize};

use crate::curve::{Curve3, LineMap, MatchedCurve, TraceGraph, UnmatchedLine};
use crate::measure::Measures;
use crate::micrograph::StereoPair;
use crate::rectify::RectifiedPair;
use crate::warning::Warning;

/// Unit of all 3D lengths of a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LengthUnit {
    /// Nanometres: the pixel size is known.
    Nm,
    /// Rectified pixels: it is not.
    Px,
}

impl LengthUnit {
    /// The suffix of column names: `nm` or `px`.
    pub fn word(self) -> &'static str {
        match self {
            LengthUnit::Nm => "nm",
            LengthUnit::Px => "px",
        }
    }
}

/// Scale and origin of the 3D points of a result.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// Unit of all lengths.
    pub unit: LengthUnit,
    /// Length of one rectified pixel in that unit (1 where the unit is px).
    pub pixel: f64,
    /// Centre of the rectified image, (x, y) in rectified px: the origin of x and y.
    pub centre_px: [f64; 2],
    /// Depth per disparity, `1 / (2 sin(phi / 2))`, with the sign of a flipped depth in it.
    pub depth_gain: f64,
    /// The length-weighted median that was subtracted from all z, in the unit.
    pub median_z: f64,
    /// Whether the user asked for the other sign of depth.
    pub depth_flipped: bool,
    /// Relative error of all z alike from the error of the tilt angle, `sigma_phi / phi`.
    pub relative_tilt_error: f64,
}

/// Everything the main job found, stage by stage.
#[derive(Clone, Debug)]
pub struct Reconstruction {
    /// The input.
    pub pair: StereoPair,
    /// Both images on a common grid whose rows are epipolar lines.
    pub rectified: RectifiedPair,
    /// Line probability of left and right on the rectified grid.
    pub lines: [LineMap; 2],
    /// Centrelines of left and right on the rectified grid.
    pub traces: [TraceGraph; 2],
    /// Lines found in both images, after refinement.
    pub matched: Vec<MatchedCurve>,
    /// The curves in the foil.
    pub curves: Vec<Curve3>,
    /// Detected lines that found no match.
    pub unmatched: Vec<UnmatchedLine>,
    /// Scale and origin of the curves.
    pub frame: Frame,
    /// Length, thickness, density.
    pub measures: Measures,
    /// Partial failures, in the order they were noticed.
    pub warnings: Vec<Warning>,
}

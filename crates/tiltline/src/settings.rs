//! Every setting of the main job with its default. Flags override a TOML file, which overrides these; a key that is
//! not here is an error.

use serde::{Deserialize, Serialize};

use crate::io::ReadOptions;
use crate::matching::MatchSettings;
use crate::measure::MeasureSettings;
use crate::rectify::RectifySettings;
use crate::refine::RefineSettings;
use crate::ridge::RidgeSettings;
use crate::trace::TraceSettings;

/// Settings of `tiltline reconstruct`, a section a stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Seed of everything random (RANSAC sampling).
    pub seed: u64,
    /// Depth sign: `true` reports -Z, for a user who knows that the tilts' sense is the other one.
    pub flip_depth: bool,
    /// How files are read where their format leaves a choice.
    pub read: ReadOptions,
    /// Making epipolar lines rows.
    pub rectify: RectifySettings,
    /// The classical line detector.
    pub ridge: RidgeSettings,
    /// Centrelines.
    pub trace: TraceSettings,
    /// The classical matcher.
    #[serde(rename = "match")]
    pub matching: MatchSettings,
    /// Sub-pixel disparity.
    pub refine: RefineSettings,
    /// Lengths, thickness, density.
    pub measure: MeasureSettings,
}

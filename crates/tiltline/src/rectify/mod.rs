//! Rectification: makes epipolar lines of a pair rows (paper, section "Image Rectification"; DESIGN section 3).
//!
//! PLACEHOLDER interface: the estimation is in the files of this folder.

mod descriptor;
mod keypoints;
mod point_matching;
mod scale_space;
mod sift;

pub use point_matching::{PointMatch, match_features};
pub use sift::{Feature, SiftSettings, sift};

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use crate::geometry::Similarity2;
use crate::micrograph::{StereoPair, View};
use crate::warning::Warning;

/// Settings of rectification.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RectifySettings {
    /// The geometry that is estimated.
    pub model: Model,
    /// One sigma of the prior on the direction of the tilt axis about the given one, in degrees.
    pub axis_prior_sigma_deg: f64,
}

impl Default for RectifySettings {
    fn default() -> Self {
        Self { model: Model::Affine, axis_prior_sigma_deg: 1.0 }
    }
}

/// The two-view geometry that is estimated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Model {
    /// The affine epipolar constraint: rotation, isotropic scale and shift of both images.
    Affine,
    /// The paper's: a shift, then one rotation of the right image.
    Paper,
}

/// How both images map onto the common rectified grid, and how well.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rectification {
    /// Left input px to rectified px.
    pub rectified_from_left: Similarity2,
    /// Right input px to rectified px.
    pub rectified_from_right: Similarity2,
    /// Rows and columns of the rectified grid.
    pub shape: [usize; 2],
    /// Point matches that agree with the geometry.
    pub inliers: usize,
    /// Point matches in all.
    pub matches: usize,
    /// Root mean square row difference of the inliers after rectification, in rectified px.
    pub rms_row_error_px: f64,
    /// One-sigma error of a row correspondence, in rectified px (enters sigma of disparity as `sigma_row cot psi`).
    pub sigma_row_px: f64,
    /// Tilt-axis direction in the left image, degrees clockwise on the screen from image y.
    pub axis_deg: f64,
    /// One sigma of it.
    pub axis_sigma_deg: f64,
    /// Whether the points could not show the axis (all in one plane), so that the prior holds it.
    pub axis_held_by_prior: bool,
    /// Rotation that takes right-image directions to left-image directions... see CONVENTIONS.md; degrees clockwise.
    pub relative_rotation_deg: f64,
    /// Size of the right image's features relative to the left's.
    pub relative_scale: f64,
    /// Disparity range of the inliers, [min, max] in rectified px.
    pub disparity_range_px: [f64; 2],
}

/// Both images on a common grid whose rows are epipolar lines.
#[derive(Clone, Debug, PartialEq)]
pub struct RectifiedPair {
    /// Left intensity `[row, column]`, robustly normalised; NaN where the left image has no data.
    pub left: Array2<f32>,
    /// Right intensity on the same grid; NaN where the right image has no data.
    pub right: Array2<f32>,
    /// The maps.
    pub rectification: Rectification,
}

impl RectifiedPair {
    /// The image of one view.
    pub fn view(&self, view: View) -> &Array2<f32> {
        match view {
            View::Left => &self.left,
            View::Right => &self.right,
        }
    }
}

/// Why a pair could not be rectified.
#[derive(Debug, thiserror::Error)]
pub enum RectifyError {
    /// Too few point matches.
    #[error("only {inliers} of {matches} point matches agree with a tilt (6 are needed)")]
    TooFewMatches {
        /// Matches in all.
        matches: usize,
        /// Matches that agree.
        inliers: usize,
    },
}

/// Estimates the geometry of a pair and resamples both images.
pub fn rectify(
    _pair: &StereoPair,
    _settings: &RectifySettings,
    _seed: u64,
) -> Result<(RectifiedPair, Vec<Warning>), RectifyError> {
    Err(RectifyError::TooFewMatches { matches: 0, inliers: 0 })
}

//! Rectification: makes epipolar lines of a pair rows (paper, section "Image Rectification"; CONVENTIONS.md for signs).
//!
//! The path: SIFT features of both images ([`mod@sift`]), matched by descriptor ([`point_matching`]), blocks matched by
//! area ([`area`]), the matches that share one geometry ([`ransac`]), that geometry with what is known of the axis ([`epipolar`]; the paper's own model is
//! in [`paper_model`]), and both images on one grid ([`mod@resample`]). All lengths are px of the left image's scale.
//!
//! Scale along the rows and shear along them change no epipolar line and cannot be seen in two views: only rotation,
//! isotropic scale and shift are applied.

pub mod align;
pub mod area;
pub mod blocks;
pub mod correlation;
pub mod descriptor;
pub mod epipolar;
pub mod estimate;
pub mod keypoints;
pub mod paper_model;
pub mod point_matching;
pub mod ransac;
pub mod resample;
pub mod scale_space;
pub mod sift;
pub mod texture;

pub use estimate::estimate;
pub use point_matching::{PointMatch, PointMatches, match_features};
pub use sift::{Feature, SiftSettings, sift};

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use crate::geometry::Similarity2;
use crate::micrograph::{StereoPair, View};
use crate::progress::Stage;
use crate::warning::Warning;
use area::match_areas;
use epipolar::AxisPrior;
use resample::resample;

#[cfg(test)]
mod tests;

/// Settings of rectification.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RectifySettings {
    /// The geometry that is estimated.
    pub model: Model,
    /// One sigma of the prior on the direction of the tilt axis about the given one, in degrees.
    pub axis_prior_sigma_deg: f64,
    /// The features whose matches show the geometry.
    pub sift: SiftSettings,
}

impl Default for RectifySettings {
    fn default() -> Self {
        Self { model: Model::Affine, axis_prior_sigma_deg: 1.0, sift: SiftSettings::default() }
    }
}

impl RectifySettings {
    /// What is known of the axis, given its direction.
    fn prior(&self, axis_rad: f64) -> AxisPrior {
        // A sigma of zero would be certainty; a ten-thousandth of a degree is as good.
        AxisPrior { axis_rad, sigma_rad: self.axis_prior_sigma_deg.max(1e-4).to_radians() }
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
    /// Root mean square row difference of the inliers after rectification, in rectified px: mostly the error of the
    /// points themselves.
    pub rms_row_error_px: f64,
    /// One-sigma systematic error of a row correspondence, root mean square over the image, in rectified px: how far
    /// rows may be off once the points' own errors have averaged out (enters sigma of disparity as `sigma_row cot psi`).
    pub sigma_row_px: f64,
    /// Tilt-axis direction in the left image, degrees clockwise on the screen from image y.
    pub axis_deg: f64,
    /// One sigma of it, points and prior together.
    pub axis_sigma_deg: f64,
    /// Whether the points say less about the axis than the prior does (all in one plane), so that the prior holds it.
    pub axis_held_by_prior: bool,
    /// Third eigenvalue of the inliers' 4x4 covariance over the fourth: near 1 the points lie in one plane.
    pub eigenvalue_ratio: Option<f64>,
    /// Direction of the tilt axis in the right image less that in the left, degrees clockwise on the screen: how far
    /// things are turned in the right image relative to the left one. Points in one plane show it too, given the axis.
    pub relative_rotation_deg: f64,
    /// Size along the tilt axis of things in the right image over that in the left (magnification of right over left).
    pub relative_scale: f64,
    /// Least squares similarity of the inliers, left input px to right input px. It ignores depth, and where the points'
    /// plane is tilted its rotation and scale differ a little from the two above, which follow the rows only.
    pub right_from_left: Similarity2,
    /// Disparities of the inliers, 1 and 99 percentile, in rectified px; their median is zero.
    pub disparity_range_px: [f64; 2],
    /// The inliers, in input px, for the report; `curves.json` has their number only.
    #[serde(skip)]
    pub points: Vec<PointMatch>,
}

impl Rectification {
    /// The rectification that two known maps, input px to rectified px, make; no match was needed.
    pub(crate) fn known([rectified_from_left, rectified_from_right]: [Similarity2; 2], shape: [usize; 2]) -> Self {
        let axis_rad = [&rectified_from_left, &rectified_from_right].map(|map| -map.isometry.rotation.angle());
        Self {
            rectified_from_left,
            rectified_from_right,
            shape,
            inliers: 0,
            matches: 0,
            rms_row_error_px: 0.0,
            sigma_row_px: 0.0,
            axis_deg: axis_rad[0].to_degrees(),
            axis_sigma_deg: 0.0,
            axis_held_by_prior: false,
            eigenvalue_ratio: None,
            relative_rotation_deg: (axis_rad[1] - axis_rad[0]).to_degrees(),
            relative_scale: rectified_from_left.scaling() / rectified_from_right.scaling(),
            right_from_left: rectified_from_right.inverse() * rectified_from_left,
            disparity_range_px: [0.0, 0.0],
            points: Vec::new(),
        }
    }

    /// The map of one view: its input px to rectified px.
    pub fn rectified_from(&self, view: View) -> &Similarity2 {
        match view {
            View::Left => &self.rectified_from_left,
            View::Right => &self.rectified_from_right,
        }
    }
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
    /// An image shows too little.
    #[error(
        "SIFT finds {left} features in the left and {right} in the right image, and {SMALLEST_INLIERS} in each are needed: \
         an image may be constant, blurred, or smaller than 16 px a side"
    )]
    TooFewFeatures {
        /// In the left image.
        left: usize,
        /// In the right image.
        right: usize,
    },
    /// Too few point matches.
    #[error(
        "only {inliers} of {matches} point matches agree with a tilt, and {SMALLEST_INLIERS} are needed: check that both \
         images show the same area in the same contrast and at about the same magnification; views closer in tilt match \
         better, and a lower rectify.sift.contrast_threshold finds more points"
    )]
    TooFewMatches {
        /// Matches in all.
        matches: usize,
        /// Matches that agree.
        inliers: usize,
    },
}

/// Fewer inliers are an error.
pub const SMALLEST_INLIERS: usize = 6;

/// Estimates the geometry of a pair and resamples both images. The same seed gives the same result.
pub fn rectify(
    pair: &StereoPair,
    settings: &RectifySettings,
    seed: u64,
) -> Result<(RectifiedPair, Vec<Warning>), RectifyError> {
    let images = View::BOTH.map(|view| pair.view(view).normalised());
    let [left, right] = images.each_ref().map(|image| sift(image, &settings.sift));
    let mut matches = match_features(&left, &right);
    if settings.model == Model::Affine {
        matches.distinct.extend(match_areas(&images, &matches.distinct, &settings.prior(pair.tilt_axis_rad), seed));
    }
    if left.len().min(right.len()).max(matches.distinct.len()) < SMALLEST_INLIERS {
        return Err(RectifyError::TooFewFeatures { left: left.len(), right: right.len() });
    }
    let shapes = images.each_ref().map(|image| [image.nrows(), image.ncols()]);
    let (rectification, mut warnings) = estimate(&matches, shapes, pair.tilt_axis_rad, settings, seed)?;
    let rectified = resampled(&images, rectification);
    if rectified.right.iter().all(|value| value.is_nan()) {
        warnings.push(Warning::new(Stage::Rectify, "the images do not overlap: no line can be matched"));
    }
    Ok((rectified, warnings))
}

/// Resamples a pair whose geometry is known.
pub fn rectify_known(pair: &StereoPair, rectification: Rectification) -> RectifiedPair {
    resampled(&View::BOTH.map(|view| pair.view(view).normalised()), rectification)
}

fn resampled(images: &[Array2<f32>; 2], rectification: Rectification) -> RectifiedPair {
    let maps = [&rectification.rectified_from_left, &rectification.rectified_from_right];
    let [left, right] = [0, 1].map(|view| resample(&images[view].view(), maps[view], rectification.shape));
    RectifiedPair { left, right, rectification }
}

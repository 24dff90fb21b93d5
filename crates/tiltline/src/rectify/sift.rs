//! SIFT features of a float image (Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 60, 2004).
//!
//! Written from the paper. Differences from it: descriptors are RootSIFT ([`super::descriptor`]), and the number of
//! features is capped, strongest first but spread over the image ([`super::keypoints::strongest_spread`]).

use ndarray::Array2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::descriptor::{LENGTH, orientations, root_sift};
use super::keypoints::{extrema, strongest_spread};
use super::scale_space::{Octave, Plane};

/// Settings of SIFT.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SiftSettings {
    /// Images of at most so many pixels are first sampled twice as finely: that finds spots below 2 px too, at four
    /// times the time. Large images have features enough without, and their smallest ones are mostly noise.
    pub double_up_to_pixels: usize,
    /// Weakest difference of Gaussians that counts, for intensities whose range is about 1.
    pub contrast_threshold: f32,
    /// Largest ratio of principal curvatures: above, the place along an edge or line is not known.
    pub edge_ratio: f32,
    /// Most keypoints; a keypoint with two clear orientations gives two features.
    pub max_keypoints: usize,
}

impl Default for SiftSettings {
    fn default() -> Self {
        Self { double_up_to_pixels: 600 * 600, contrast_threshold: 0.008, edge_ratio: 10.0, max_keypoints: 3000 }
    }
}

/// A SIFT feature. Two features share a place where the keypoint has two clear orientations.
#[derive(Clone, Debug, PartialEq)]
pub struct Feature {
    /// Column in px of the image, pixel centres at integers.
    pub x: f32,
    /// Row in px of the image.
    pub y: f32,
    /// Blur at which the feature stands out, px.
    pub sigma_px: f32,
    /// Direction of its strongest gradients, radians clockwise on the screen from image x.
    pub orientation_rad: f32,
    /// Difference of Gaussians at its centre: positive for dark features, negative for bright ones.
    pub contrast: f32,
    /// RootSIFT descriptor: non-negative, squares sum to one.
    pub descriptor: [f32; LENGTH],
}

/// SIFT features of an image `[row, column]` whose intensities are finite and have a range of about 1, strongest first.
///
/// The result depends on nothing but the arguments. Images below 16 px a side have no features.
pub fn sift(image: &Array2<f32>, settings: &SiftSettings) -> Vec<Feature> {
    let (height, width) = image.dim();
    if height < 16 || width < 16 {
        return Vec::new();
    }
    let plane = Plane { values: image.iter().copied().collect(), width, height };
    let mut octave = Some(Octave::first(&plane, height * width <= settings.double_up_to_pixels));
    let mut keypoints = Vec::new();
    let mut steps_px = Vec::new();
    // Levels of every octave are kept for the descriptors, which are computed for the chosen keypoints only.
    let mut levels: Vec<Vec<Plane>> = Vec::new();
    while let Some(current) = octave {
        keypoints.extend(extrema(&current, levels.len(), settings));
        steps_px.push(current.step_px);
        octave = current.next();
        levels.push(current.levels);
    }
    let chosen = strongest_spread(keypoints, &steps_px, settings.max_keypoints, [height, width]);
    chosen
        .par_iter()
        .with_min_len(8)
        .flat_map_iter(|keypoint| {
            let plane = &levels[keypoint.octave][keypoint.level];
            let step = steps_px[keypoint.octave] as f32;
            orientations(plane, keypoint).into_iter().map(move |orientation_rad| Feature {
                x: keypoint.column * step,
                y: keypoint.row * step,
                sigma_px: keypoint.sigma * step,
                orientation_rad,
                contrast: keypoint.contrast,
                descriptor: root_sift(plane, keypoint, orientation_rad),
            })
        })
        .collect()
}

//! What the networks are made of; travels in the metadata of their weights.

use serde::{Deserialize, Serialize};

/// The line detector, a U-Net (Ronneberger et al. 2015, arXiv:1505.04597).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DetectorConfig {
    /// Channels at full resolution, and of the last feature map; each level down doubles them.
    pub channels: usize,
    /// Levels below full resolution: sides are halved this many times.
    pub depth: usize,
}

impl Default for DetectorConfig {
    fn default() -> Self {
        Self { channels: 12, depth: 4 }
    }
}

impl DetectorConfig {
    /// Sides of an image must be multiples of this, px.
    pub fn multiple(&self) -> usize {
        1 << self.depth
    }
}

/// What the matcher sees of each image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MatcherInput {
    /// The image and the detector's probability: it stays useful when the detector is trained anew.
    #[default]
    Image,
    /// The detector's last feature map, as in the paper: it fits that one detector only.
    Features,
}

/// The matcher: Siamese features, a feature volume over disparities, stacked 3D hourglasses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MatcherConfig {
    /// What comes in.
    pub input: MatcherInput,
    /// Channels of what comes in: 2 for the image with its probability, the detector's for its features.
    pub input_channels: usize,
    /// Channels of the Siamese features, at the volume's resolution.
    pub features: usize,
    /// Image px per voxel along rows and columns: 4 or 2.
    pub downscale: usize,
    /// Channels of either image that are concatenated in the volume (the paper's way); 0 for none.
    pub concatenated: usize,
    /// Groups of features whose correlation goes into the volume (Guo et al. 2019, arXiv:1903.04025); 0 for none.
    pub groups: usize,
    /// Channels of the 3D network.
    pub channels: usize,
    /// Stacked hourglasses; each gives a cost volume.
    pub hourglasses: usize,
    /// Disparity levels of the volume, `downscale` px apart and half of them below zero; a multiple of 4.
    pub levels: usize,
}

impl Default for MatcherConfig {
    fn default() -> Self {
        Self {
            input: MatcherInput::Image,
            input_channels: 2,
            features: 32,
            downscale: 4,
            concatenated: 8,
            groups: 8,
            channels: 16,
            hourglasses: 2,
            levels: 16,
        }
    }
}

/// A configuration that no network can have.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{name} is {value}; it must be {wanted}")]
pub struct ConfigError {
    /// The key.
    pub name: &'static str,
    /// What was given.
    pub value: usize,
    /// What is possible.
    pub wanted: &'static str,
}

/// Most channels of a layer, and most levels: more than any machine this runs on can hold.
const MOST: usize = 1024;

fn check(checks: &[(&'static str, usize, bool, &'static str)]) -> Result<(), ConfigError> {
    match checks.iter().find(|(.., possible, _)| !possible) {
        Some(&(name, value, _, wanted)) => Err(ConfigError { name, value, wanted }),
        None => Ok(()),
    }
}

impl DetectorConfig {
    /// Checks every number.
    ///
    /// # Errors
    /// The first that is not possible.
    pub fn validate(&self) -> Result<(), ConfigError> {
        check(&[
            ("channels", self.channels, (1..=128).contains(&self.channels), "1 to 128"),
            ("depth", self.depth, (1..=6).contains(&self.depth), "1 to 6"),
        ])
    }
}

impl MatcherConfig {
    /// Sides of an image must be multiples of this, px: the volume is halved twice.
    pub fn multiple(&self) -> usize {
        4 * self.downscale
    }

    /// Lowest disparity level of the volume, in voxels.
    pub fn first_level(&self) -> isize {
        -((self.levels / 2) as isize)
    }

    /// Disparities that can be told, px: from the first level to the last.
    pub fn range_px(&self) -> [f64; 2] {
        let first = self.first_level() as f64 * self.downscale as f64;
        [first, first + ((self.levels - 1) * self.downscale) as f64]
    }

    /// Checks every number.
    ///
    /// # Errors
    /// The first that is not possible.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let Self { features, groups, concatenated, channels, levels, .. } = *self;
        check(&[
            ("input_channels", self.input_channels, (1..=MOST).contains(&self.input_channels), "1 to 1024"),
            (
                "input_channels",
                self.input_channels,
                self.input == MatcherInput::Features || self.input_channels == 2,
                "2, the image and its probability",
            ),
            ("features", features, (1..=MOST).contains(&features), "1 to 1024"),
            ("downscale", self.downscale, self.downscale == 2 || self.downscale == 4, "2 or 4"),
            ("groups", groups, groups == 0 || features.is_multiple_of(groups), "0 or a divisor of features"),
            ("concatenated", concatenated, concatenated <= MOST, "1024 at most"),
            ("concatenated", concatenated, concatenated + groups > 0, "above 0 if groups is 0"),
            ("channels", channels, (1..=MOST).contains(&channels), "1 to 1024"),
            ("hourglasses", self.hourglasses, (1..=8).contains(&self.hourglasses), "1 to 8"),
            ("levels", levels, levels.is_multiple_of(4) && (4..=MOST).contains(&levels), "a multiple of 4 up to 1024"),
        ])
    }
}

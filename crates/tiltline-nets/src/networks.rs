//! Detector and matcher together, as they are trained and used.

use burn::module::Module;
use burn::tensor::activation::sigmoid;
use burn::tensor::{Device, Tensor};

use crate::config::{DetectorConfig, MatcherConfig, MatcherInput};
use crate::detector::{Detected, Detector};
use crate::matcher::Matcher;

/// The detector, and the matcher if there is one.
#[derive(Module, Debug)]
pub struct Networks {
    /// Finds lines.
    pub detector: Detector,
    /// Finds disparities.
    pub matcher: Option<Matcher>,
}

impl Networks {
    /// Networks of these configurations, their weights still to be set.
    pub fn new(detector: &DetectorConfig, matcher: Option<&MatcherConfig>, device: &Device) -> Self {
        Self { detector: Detector::new(detector, device), matcher: matcher.map(|config| Matcher::new(config, device)) }
    }
}

/// What the matcher is given of images `[N, 1, H, W]` and what the detector said of them.
pub fn matcher_input(images: Tensor<4>, detected: Detected, config: &MatcherConfig) -> Tensor<4> {
    match config.input {
        MatcherInput::Image => Tensor::cat(vec![images, sigmoid(detected.logits)], 1),
        MatcherInput::Features => detected.features,
    }
}

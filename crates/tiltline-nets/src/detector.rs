//! The line detector: a U-Net (Ronneberger et al. 2015; paper, section "Pre-trained contour detection network").
//!
//! Each level is two 3x3 convolutions with batch norm and ReLU; 2x2 max-pool leads down, a 2x2 transposed convolution up,
//! where the features of the same level are put beside it.

use burn::module::Module;
use burn::tensor::{Device, Tensor};

use crate::config::DetectorConfig;
use crate::layers::{Conv, ConvNorm};
use crate::ops::{Kernel, max_pool};
use crate::weights::replace;

const SAME: Kernel = Kernel::Same { stride: 1 };

/// Two convolutions at one resolution.
#[derive(Module, Debug)]
struct Level {
    first: ConvNorm<4>,
    second: ConvNorm<4>,
}

impl Level {
    fn new(from: usize, to: usize, device: &Device) -> Self {
        Self { first: ConvNorm::new(SAME, [from, to], device), second: ConvNorm::new(SAME, [to, to], device) }
    }

    fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        self.second.forward(self.first.forward(input))
    }
}

/// The network.
#[derive(Module, Debug)]
pub struct Detector {
    /// From full resolution down; the last is the bottom.
    down: Vec<Level>,
    /// From the bottom up.
    up: Vec<Conv<4>>,
    /// After each way up.
    joined: Vec<Level>,
    head: Conv<4>,
}

/// What the detector says of a batch of images.
pub struct Detected {
    /// Log-odds of a line `[N, 1, H, W]`.
    pub logits: Tensor<4>,
    /// The last feature map `[N, channels, H, W]`.
    pub features: Tensor<4>,
}

impl Detector {
    /// The network of a configuration, its weights still to be set.
    pub fn new(config: &DetectorConfig, device: &Device) -> Self {
        let channels = |level: usize| config.channels << level;
        let down = (0..=config.depth)
            .map(|level| Level::new(if level == 0 { 1 } else { channels(level - 1) }, channels(level), device))
            .collect();
        let rising = (0..config.depth).rev();
        let up = rising
            .clone()
            .map(|level| Conv::new(Kernel::Double, [channels(level + 1), channels(level)], true, device))
            .collect();
        let joined = rising.map(|level| Level::new(2 * channels(level), channels(level), device)).collect();
        Self { down, up, joined, head: Conv::new(Kernel::Pointwise, [config.channels, 1], true, device) }
    }

    /// The network whose log-odds are higher by a number everywhere.
    #[must_use]
    pub fn shifted(self, by: f32) -> Self {
        // Through plain numbers: a weight must be a leaf of the graph, and the result of an addition is none.
        let bias: Vec<f32> = self.head_bias().into_iter().map(|bias| bias + by).collect();
        replace(self, |name, _| (name == "head.bias").then(|| bias.clone()))
    }

    /// The bias of the last layer.
    pub(crate) fn head_bias(&self) -> Vec<f32> {
        let bias = self.head.bias.as_ref().expect("the head has a bias").val().into_data();
        bias.try_to_vec().expect("weights are f32")
    }

    /// Images `[N, 1, H, W]`, flattened, with sides that are multiples of `DetectorConfig::multiple`.
    pub fn forward(&self, images: Tensor<4>) -> Detected {
        let [_, channels, height, width] = images.dims();
        let multiple = 1 << self.up.len();
        assert_eq!(channels, 1, "images have one channel");
        assert!(
            height.is_multiple_of(multiple) && width.is_multiple_of(multiple),
            "images of {width}x{height} px; sides must be multiples of {multiple}"
        );
        let mut kept = Vec::new();
        let mut features = images;
        for (index, level) in self.down.iter().enumerate() {
            if index > 0 {
                features = max_pool(features);
            }
            features = level.forward(features);
            kept.push(features.clone());
        }
        kept.pop();
        for (up, level) in self.up.iter().zip(&self.joined) {
            let same = kept.pop().expect("as many ways up as down");
            features = level.forward(Tensor::cat(vec![same, up.forward(features)], 1));
        }
        Detected { logits: self.head.forward(features.clone()), features }
    }
}

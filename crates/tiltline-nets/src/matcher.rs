//! The matcher: from two images to cost volumes (paper, sections "Feature Volume" and "3D CNN for Matching Cost Estimation").
//!
//! Shared features of both images -> feature volume over signed disparities -> stacked 3D hourglasses (Chang & Chen 2018,
//! arXiv:1803.08669, section 3.4) -> a cost volume each, the later adding to the earlier. `volume.rs` goes on from there.

use burn::module::Module;
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};

use crate::config::MatcherConfig;
use crate::layers::{Conv, ConvNorm};
use crate::ops::Kernel;
use crate::volume::{concatenation, correlation};

const SAME: Kernel = Kernel::Same { stride: 1 };
const HALVE: Kernel = Kernel::Same { stride: 2 };

/// Features of one image at the volume's resolution.
#[derive(Module, Debug)]
struct Encoder {
    layers: Vec<ConvNorm<4>>,
    /// Two convolutions whose result is added to their input.
    residual: Vec<ConvNorm<4>>,
    last: Conv<4>,
}

impl Encoder {
    fn new(config: &MatcherConfig, device: &Device) -> Self {
        let (features, half) = (config.features, config.features.div_ceil(2));
        let second = if config.downscale == 4 { HALVE } else { SAME };
        Self {
            layers: vec![
                ConvNorm::new(HALVE, [config.input_channels, half], device),
                ConvNorm::new(SAME, [half, half], device),
                ConvNorm::new(second, [half, features], device),
            ],
            residual: vec![
                ConvNorm::new(SAME, [features, features], device),
                ConvNorm::linear(SAME, [features, features], device),
            ],
            last: Conv::new(SAME, [features, features], true, device),
        }
    }

    /// `[N, C, H, W]` to `[N, F, H / downscale, W / downscale]`
    fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        let input = self.layers.iter().fold(input, |input, layer| layer.forward(input));
        let added = self.residual.iter().fold(input.clone(), |input, layer| layer.forward(input));
        self.last.forward(relu(input.add(added)))
    }
}

/// Down to a quarter of the volume's resolution and back up, with what was there added at each step.
#[derive(Module, Debug)]
struct Hourglass {
    down: Vec<ConvNorm<5>>,
    same: Vec<ConvNorm<5>>,
    up: Vec<ConvNorm<5>>,
}

impl Hourglass {
    fn new(channels: usize, device: &Device) -> Self {
        let double = 2 * channels;
        Self {
            down: vec![
                ConvNorm::new(HALVE, [channels, double], device),
                ConvNorm::new(HALVE, [double, double], device),
            ],
            same: vec![ConvNorm::new(SAME, [double, double], device), ConvNorm::new(SAME, [double, double], device)],
            up: vec![
                ConvNorm::linear(Kernel::Double, [double, double], device),
                ConvNorm::linear(Kernel::Double, [double, channels], device),
            ],
        }
    }

    fn forward(&self, input: Tensor<5>) -> Tensor<5> {
        let half = self.same[0].forward(self.down[0].forward(input.clone()));
        let quarter = self.same[1].forward(self.down[1].forward(half.clone()));
        let half = relu(self.up[0].forward(quarter).add(half));
        relu(self.up[1].forward(half).add(input))
    }
}

/// The network.
#[derive(Module, Debug)]
pub struct Matcher {
    encoder: Encoder,
    /// Fewer channels for the concatenated part of the volume.
    narrow: Option<Conv<4>>,
    entry: Vec<ConvNorm<5>>,
    hourglasses: Vec<Hourglass>,
    /// Before the cost of each hourglass, and that cost.
    heads: Vec<ConvNorm<5>>,
    costs: Vec<Conv<5>>,
    #[module(skip)]
    config: MatcherConfig,
}

impl Matcher {
    /// The network of a configuration, its weights still to be set.
    pub fn new(config: &MatcherConfig, device: &Device) -> Self {
        let MatcherConfig { features, concatenated, groups, channels, hourglasses, .. } = *config;
        let narrow = (concatenated > 0 && concatenated != features)
            .then(|| Conv::new(Kernel::Pointwise, [features, concatenated], true, device));
        Self {
            encoder: Encoder::new(config, device),
            narrow,
            entry: vec![
                ConvNorm::new(SAME, [2 * concatenated + groups, channels], device),
                ConvNorm::new(SAME, [channels, channels], device),
            ],
            hourglasses: (0..hourglasses).map(|_| Hourglass::new(channels, device)).collect(),
            heads: (0..hourglasses).map(|_| ConvNorm::new(SAME, [channels, channels], device)).collect(),
            costs: (0..hourglasses).map(|_| Conv::new(SAME, [channels, 1], false, device)).collect(),
            config: config.clone(),
        }
    }

    /// The feature volume of both images `[N, C, H, W]`: `[N, 2 concatenated + groups, d, h, w]`.
    fn volume(&self, left: Tensor<4>, right: Tensor<4>) -> Tensor<5> {
        let [n, ..] = left.dims();
        // As one batch: the same weights, and in training the same statistics.
        let features = self.encoder.forward(Tensor::cat(vec![left, right], 0));
        let halves = |both: Tensor<4>| (both.clone().narrow(0, 0, n), both.narrow(0, n, n));
        let mut parts = Vec::new();
        if self.config.concatenated > 0 {
            let narrow = match &self.narrow {
                Some(narrow) => narrow.forward(features.clone()),
                None => features.clone(),
            };
            let (left, right) = halves(narrow);
            parts.push(concatenation(left, right, &self.config));
        }
        if self.config.groups > 0 {
            let (left, right) = halves(features);
            parts.push(correlation(left, right, &self.config));
        }
        Tensor::cat(parts, 1)
    }

    /// Cost volumes of all hourglasses `[N, d, h, w]`, the last the best, of what the configuration wants of each image
    /// `[N, C, H, W]`; sides must be multiples of `MatcherConfig::multiple`.
    pub fn forward(&self, left: Tensor<4>, right: Tensor<4>) -> Vec<Tensor<4>> {
        let [n, channels, height, width] = left.dims();
        let multiple = self.config.multiple();
        assert_eq!(right.dims(), [n, channels, height, width], "both images have one size");
        assert!(
            height.is_multiple_of(multiple) && width.is_multiple_of(multiple),
            "images of {width}x{height} px; sides must be multiples of {multiple}"
        );
        let mut inner = self.volume(left, right);
        for layer in &self.entry {
            inner = layer.forward(inner);
        }
        let mut costs: Vec<Tensor<4>> = Vec::new();
        for ((hourglass, head), cost) in self.hourglasses.iter().zip(&self.heads).zip(&self.costs) {
            inner = hourglass.forward(inner);
            let own = cost.forward(head.forward(inner.clone()));
            let [n, _, levels, rows, columns] = own.dims();
            let own = own.reshape([n, levels, rows, columns]);
            costs.push(match costs.last() {
                Some(before) => own.add(before.clone()),
                None => own,
            });
        }
        costs
    }
}

//! The feature volume (paper, Figure 3), and from a cost volume to disparities (paper, Equation 1).
//!
//! Letters: N images, F features, G groups, D levels, H rows, W columns; lower case h, w, d at the volume's resolution.

use burn::tensor::activation::softmin;
use burn::tensor::{Device, Int, Tensor, TensorData};

use crate::config::MatcherConfig;

/// The right features as seen at each disparity level: `[N, F, d, h, w]`, where voxel `(d, v, u)` holds the features at
/// `(u + level d, v)`, zero outside the image.
pub fn shifted(right: Tensor<4>, config: &MatcherConfig) -> Tensor<5> {
    let [n, channels, rows, columns] = right.dims();
    let reach = config.levels / 2;
    let device = right.device();
    let border = || Tensor::<4>::zeros([n, channels, rows, reach], &device);
    // Column `u + level` of the image is column `u + level + reach` of the padded one, and levels start at -reach.
    let padded = Tensor::cat(vec![border(), right, border()], 3);
    let levels = (0..config.levels).map(|index| padded.clone().narrow(3, index, columns)).collect();
    Tensor::stack::<5>(levels, 2)
}

/// The features of both images put side by side: `[2F, d, h, w]` an image, as in the paper.
pub fn concatenation(left: Tensor<4>, right: Tensor<4>, config: &MatcherConfig) -> Tensor<5> {
    let left = left.unsqueeze_dim::<5>(2).repeat_dim(2, config.levels);
    Tensor::cat(vec![left, shifted(right, config)], 1)
}

/// Mean product of the features of each group: `[G, d, h, w]` an image (Guo et al. 2019, Equation 2).
pub fn correlation(left: Tensor<4>, right: Tensor<4>, config: &MatcherConfig) -> Tensor<5> {
    let [n, channels, rows, columns] = left.dims();
    let (groups, levels) = (config.groups, config.levels);
    let shape = [n * groups, channels / groups, levels, rows, columns];
    let product = left.unsqueeze_dim::<5>(2).mul(shifted(right, config));
    product.reshape(shape).mean_dim(1).reshape([n, groups, levels, rows, columns])
}

/// Weights of linear interpolation from `coarse` samples to `factor` times as many `[coarse, fine]`; samples are at the
/// centres of their cells, and constant beyond the first and last.
fn linear(coarse: usize, factor: usize, device: &Device) -> Tensor<2> {
    let fine = coarse * factor;
    let mut weights = vec![0.0_f32; coarse * fine];
    for to in 0..fine {
        let at = ((to as f64 + 0.5) / factor as f64 - 0.5).clamp(0.0, (coarse - 1) as f64);
        let from = (at.floor() as usize).min(coarse.saturating_sub(2));
        let share = at - from as f64;
        weights[from * fine + to] += (1.0 - share) as f32;
        if share > 0.0 {
            weights[(from + 1) * fine + to] += share as f32;
        }
    }
    Tensor::from_data(TensorData::new(weights, [coarse, fine]), device)
}

/// Weights of cubic interpolation (Catmull-Rom) from `coarse` levels to levels `factor` times as dense, from the first to the
/// last: `[coarse, factor (coarse - 1) + 1]`. Linear interpolation could have its minimum only on coarse levels.
fn cubic(coarse: usize, factor: usize, device: &Device) -> Tensor<2> {
    let fine = factor * (coarse - 1) + 1;
    let mut weights = vec![0.0_f32; coarse * fine];
    for to in 0..fine {
        let (from, t) = (to / factor, (to % factor) as f64 / factor as f64);
        let kernel = [
            -0.5 * t + t * t - 0.5 * t * t * t,
            1.0 - 2.5 * t * t + 1.5 * t * t * t,
            0.5 * t + 2.0 * t * t - 1.5 * t * t * t,
            -0.5 * t * t + 0.5 * t * t * t,
        ];
        for (offset, weight) in kernel.into_iter().enumerate() {
            let level = (from + offset).saturating_sub(1).min(coarse - 1);
            weights[level * fine + to] += weight as f32;
        }
    }
    Tensor::from_data(TensorData::new(weights, [coarse, fine]), device)
}

/// Disparity levels 1 px apart, px: `[levels]`, from the volume's first to its last.
pub fn levels_px(config: &MatcherConfig) -> Vec<f32> {
    let [first, last] = config.range_px();
    (first as i64..=last as i64).map(|level| level as f32).collect()
}

/// Costs `[N, d, h, w]` at the image's resolution: a row a pixel, `[N * H * W, d]`, still at the volume's levels.
pub fn at_pixels(cost: Tensor<4>, config: &MatcherConfig) -> Tensor<2> {
    let [n, levels, rows, columns] = cost.dims();
    let (factor, device) = (config.downscale, cost.device());
    let (height, width) = (rows * factor, columns * factor);
    let wide = cost.reshape([n * levels * rows, columns]).matmul(linear(columns, factor, &device));
    let columns_first = wide.reshape([n * levels, rows, width]).swap_dims(1, 2).reshape([n * levels * width, rows]);
    let high = columns_first.matmul(linear(rows, factor, &device));
    high.reshape([n, levels, width, height]).permute([0, 3, 2, 1]).reshape([n * height * width, levels])
}

/// Costs at some pixels only: those of the given indices into `[N, H, W]`.
pub fn at_some_pixels(cost: Tensor<4>, pixels: Tensor<1, Int>, config: &MatcherConfig) -> Tensor<2> {
    at_pixels(cost, config).select(0, pixels)
}

/// Costs at levels 1 px apart, from costs at the volume's levels: `[K, d]` to `[K, D]`.
pub fn at_levels(cost: Tensor<2>, config: &MatcherConfig) -> Tensor<2> {
    let device = cost.device();
    cost.matmul(cubic(config.levels, config.downscale, &device))
}

/// Probability of each level, the paper's `softmax(-cost)`, of costs `[K, D]`.
pub fn probabilities(cost: Tensor<2>) -> Tensor<2> {
    softmin(cost, 1)
}

/// Mean over the levels: the disparity, px, `[K]` (paper, Equation 1), of probabilities `[K, D]`.
pub fn soft_argmin(probabilities: Tensor<2>, config: &MatcherConfig) -> Tensor<1> {
    let [count, levels] = probabilities.dims();
    let column = Tensor::from_data(TensorData::new(levels_px(config), [levels, 1]), &probabilities.device());
    probabilities.matmul(column).reshape([count])
}

/// Mean squared deviation from a disparity `[K]`, px^2: from the truth it is the paper's Equation 4, from the soft-argmin the
/// variance.
pub fn spread(probabilities: Tensor<2>, about: Tensor<1>, config: &MatcherConfig) -> Tensor<1> {
    let [count, levels] = probabilities.dims();
    let row = Tensor::<2>::from_data(TensorData::new(levels_px(config), [1, levels]), &probabilities.device());
    let deviation = row.sub(about.reshape([count, 1]));
    probabilities.mul(deviation.square()).sum_dim(1).reshape([count])
}

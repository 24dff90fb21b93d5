//! The losses (paper, Equations 2 to 5). Each is a mean over what is labelled, and zero where nothing is.
//!
//! `L = g_disp L_disp + g_var L_var + g_warp L_warp`; beside them a sub-pixel cross-entropy, because L_var pulls sub-pixel
//! labels towards whole levels, and the detector's binary cross-entropy.

use burn::tensor::activation::{log_sigmoid, log_softmax};
use burn::tensor::{Device, Int, Tensor, TensorData};
use serde::{Deserialize, Serialize};

use crate::config::MatcherConfig;
use crate::volume::{levels_px, spread};

/// Weights of the terms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LossWeights {
    /// `g_disp`, smooth L1 of the disparity.
    pub disparity: f64,
    /// `g_var`, spread about the true disparity.
    pub variance: f64,
    /// Cross-entropy to the levels next to the true disparity.
    pub entropy: f64,
    /// `g_warp`, the warped right detection against the left lines.
    pub warp: f64,
    /// The detector's cross-entropy, in joint training.
    pub detection: f64,
    /// How much more a line pixel counts than one of the background in the detector's cross-entropy; 1 is the paper's.
    pub line: f64,
}

impl Default for LossWeights {
    fn default() -> Self {
        Self { disparity: 1.0, variance: 0.0, entropy: 0.5, warp: 0.0, detection: 1.0, line: 3.0 }
    }
}

/// Probabilities closer than this to 0 or 1 are taken as that close: the cross-entropy of a certain error is finite.
const LEAST_PROBABILITY: f64 = 1e-6;

/// Values of the labelled pixels, and where they are: indices into the flat map.
pub struct Labelled {
    /// Indices of the pixels.
    pub pixels: Vec<i64>,
    /// Their values.
    pub values: Vec<f32>,
}

impl Labelled {
    /// The pixels with a value (not NaN) inside `range`.
    pub fn of(map: &[f32], [low, high]: [f64; 2]) -> Self {
        let inside = |value: f32| f64::from(value) >= low && f64::from(value) <= high;
        let pixels: Vec<i64> = (0..map.len()).filter(|&index| inside(map[index])).map(|index| index as i64).collect();
        let values = pixels.iter().map(|&index| map[index as usize]).collect();
        Self { pixels, values }
    }

    /// Whether nothing is labelled.
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }

    /// The indices as a tensor `[K]`.
    pub fn indices(&self, device: &Device) -> Tensor<1, Int> {
        Tensor::from_data(TensorData::new(self.pixels.clone(), [self.pixels.len()]), device)
    }

    /// The values as a tensor `[K]`.
    pub fn tensor(&self, device: &Device) -> Tensor<1> {
        Tensor::from_data(TensorData::new(self.values.clone(), [self.values.len()]), device)
    }
}

/// L_disp: mean smooth L1 of disparities `[K]` (paper, Equation 3).
pub fn disparity_loss(disparity: Tensor<1>, truth: Tensor<1>) -> Tensor<1> {
    let error = disparity.sub(truth).abs();
    // 0.5 e^2 below 1, e - 0.5 above: with c = min(e, 1) both are c (e - c / 2).
    let capped = error.clone().clamp_max(1.0);
    capped.clone().mul(error.sub(capped.mul_scalar(0.5))).mean()
}

/// L_var: mean over the pixels of `sum over d of (d - truth)^2 p_d`, px^2, of probabilities `[K, D]` (paper, Equation 4).
pub fn variance_loss(probabilities: Tensor<2>, truth: Tensor<1>, config: &MatcherConfig) -> Tensor<1> {
    spread(probabilities, truth, config).mean()
}

/// Mean cross-entropy of costs `[K, D]` to the narrowest distribution over whole levels whose mean is the truth: the two
/// levels beside it, weighted linearly.
pub fn entropy_loss(cost: Tensor<2>, truth: &[f32], config: &MatcherConfig) -> Tensor<1> {
    let levels = levels_px(config);
    let [count, wide] = cost.dims();
    assert_eq!([count, wide], [truth.len(), levels.len()], "a row of costs a pixel, a column a level");
    let mut target = vec![0.0_f32; count * wide];
    for (row, truth) in target.chunks_exact_mut(wide).zip(truth) {
        let at = (truth - levels[0]).clamp(0.0, (wide - 1) as f32);
        let below = (at.floor() as usize).min(wide - 2);
        let share = at - below as f32;
        row[below] = 1.0 - share;
        row[below + 1] = share;
    }
    let target = Tensor::<2>::from_data(TensorData::new(target, [count, wide]), &cost.device());
    log_softmax(cost.neg(), 1).mul(target).sum().div_scalar(-(count as f64))
}

/// The right map as it lands on the left grid when each left pixel looks `disparity` px along its row: linear between
/// pixels, zero outside. All `[N, H, W]`.
pub fn warp(right: Tensor<3>, disparity: Tensor<3>) -> Tensor<3> {
    let [_, _, width] = right.dims();
    let device = right.device();
    let columns = Tensor::<1, Int>::arange(0..width as i64, &device).float().reshape([1, 1, width]);
    let at = disparity.add(columns);
    let floor = at.clone().detach().floor();
    let share = at.sub(floor.clone());
    let look = |column: Tensor<3>, weight: Tensor<3>| {
        let last = (width - 1) as f64;
        let outside = column.clone().lower_elem(0.0).bool_or(column.clone().greater_elem(last));
        let inside = column.clamp(0.0, last).int();
        right.clone().gather(2, inside).mul(weight).mask_fill(outside, 0.0)
    };
    look(floor.clone(), share.clone().neg().add_scalar(1.0)).add(look(floor.add_scalar(1.0), share))
}

/// A target with its gaps: NaN counts for nothing.
fn without_gaps(target: &[f32]) -> (Vec<f32>, Vec<f32>, f64) {
    let known: Vec<f32> = target.iter().map(|value| if value.is_nan() { 0.0 } else { 1.0 }).collect();
    let count: f64 = known.iter().map(|known| f64::from(*known)).sum();
    let target = target.iter().map(|value| if value.is_nan() { 0.0 } else { *value }).collect();
    (target, known, count.max(1.0))
}

/// L_warp: mean binary cross-entropy of warped probabilities `[N, H, W]` to the left lines (1, 0, or NaN for not known;
/// paper, Equation 5).
pub fn warp_loss(warped: Tensor<3>, lines: &[f32]) -> Tensor<1> {
    let (shape, device) = (warped.dims(), warped.device());
    let (target, known, count) = without_gaps(lines);
    let [target, known] = [target, known].map(|values| Tensor::<3>::from_data(TensorData::new(values, shape), &device));
    let p = warped.clamp(LEAST_PROBABILITY, 1.0 - LEAST_PROBABILITY);
    let line = target.clone().mul(p.clone().log());
    let background = target.neg().add_scalar(1.0).mul(p.neg().add_scalar(1.0).log());
    line.add(background).mul(known).sum().div_scalar(-count)
}

/// The detector's mean binary cross-entropy of logits `[N, 1, H, W]` to lines (1, 0, or NaN for not known); a line counts
/// `line` times.
pub fn detection_loss(logits: Tensor<4>, lines: &[f32], line: f64) -> Tensor<1> {
    let (shape, device) = (logits.dims(), logits.device());
    let (target, known, count) = without_gaps(lines);
    let weights = |of_line: f64| -> Tensor<4> {
        let values = target.iter().zip(&known);
        let values: Vec<f32> = values
            .map(|(target, known)| known * (if of_line > 0.0 { of_line as f32 * target } else { 1.0 - target }))
            .collect();
        Tensor::from_data(TensorData::new(values, shape), &device)
    };
    let lines = log_sigmoid(logits.clone()).mul(weights(line));
    let background = log_sigmoid(logits.neg()).mul(weights(0.0));
    lines.add(background).sum().div_scalar(-count)
}

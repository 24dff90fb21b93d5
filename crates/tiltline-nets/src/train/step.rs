//! The loss of one batch, for each kind of training.

use burn::tensor::activation::sigmoid;
use burn::tensor::{Device, Tensor, TensorData};

use super::TrainSettings;
use crate::data::Batch;
use crate::detector::Detector;
use crate::losses::{Labelled, detection_loss, disparity_loss, entropy_loss, variance_loss, warp, warp_loss};
use crate::matcher::Matcher;
use crate::networks::matcher_input;
use crate::volume::{at_levels, at_pixels, probabilities, soft_argmin};

/// Share of the loss of every cost volume but the last.
const EARLIER: f64 = 0.5;

/// A loss with its parts; `total` is what gradients are taken of.
pub struct Loss {
    /// The weighted sum; `None` where nothing in the batch is labelled.
    pub total: Option<Tensor<1>>,
    /// Name and value of each part, unweighted.
    pub parts: Vec<(&'static str, f64)>,
}

impl Loss {
    fn new() -> Self {
        Self { total: None, parts: Vec::new() }
    }

    fn add(&mut self, name: &'static str, weight: f64, loss: Tensor<1>) {
        if weight == 0.0 {
            return;
        }
        self.note(name, &loss);
        let loss = loss.mul_scalar(weight);
        self.total = Some(match self.total.take() {
            Some(total) => total.add(loss),
            None => loss,
        });
    }

    fn note(&mut self, name: &'static str, value: &Tensor<1>) {
        let value = scalar(value);
        match self.parts.iter_mut().find(|(known, _)| *known == name) {
            Some((_, known)) => *known = value,
            None => self.parts.push((name, value)),
        }
    }

    /// The weighted sum as a number.
    pub fn value(&self) -> f64 {
        self.total.as_ref().map_or(0.0, scalar)
    }
}

/// The one number of a tensor.
pub fn scalar(tensor: &Tensor<1>) -> f64 {
    let values: Vec<f32> = tensor.clone().into_data().convert::<f32>().try_to_vec().expect("converted to f32");
    values.first().map_or(0.0, |value| f64::from(*value))
}

/// Images of a batch as `[N, 1, side, side]`.
pub fn images(values: &[f32], batch: &Batch, device: &Device) -> Tensor<4> {
    Tensor::from_data(TensorData::new(values.to_vec(), [batch.count, 1, batch.side, batch.side]), device)
}

/// The detector's loss: left images, and right ones where there are any.
pub fn detector_loss(detector: &Detector, batch: &Batch, settings: &TrainSettings, device: &Device) -> Loss {
    let mut loss = Loss::new();
    let mut pixels = images(&batch.left, batch, device);
    let mut lines = batch.left_lines.clone();
    if !batch.right.is_empty() {
        pixels = Tensor::cat(vec![pixels, images(&batch.right, batch, device)], 0);
        lines.extend(&batch.right_lines);
    }
    let logits = detector.forward(pixels).logits;
    if lines.iter().any(|line| !line.is_nan()) {
        loss.add("detection", 1.0, detection_loss(logits, &lines, settings.losses.line));
    }
    loss
}

/// The matcher's loss. With `joint`, gradients reach the detector too, which then has a loss of its own; without, the detector must
/// be one for inference (`Module::valid`).
pub fn matcher_loss(
    detector: &Detector,
    matcher: &Matcher,
    batch: &Batch,
    settings: &TrainSettings,
    joint: bool,
    device: &Device,
) -> Loss {
    let mut loss = Loss::new();
    let (weights, config) = (&settings.losses, &settings.matcher);
    let (n, side) = (batch.count, batch.side);
    let both = Tensor::cat(vec![images(&batch.left, batch, device), images(&batch.right, batch, device)], 0);
    let detected = if joint {
        detector.forward(both.clone())
    } else {
        let mut detected = detector.forward(both.clone().inner());
        detected.logits = detected.logits.autodiff();
        detected.features = detected.features.autodiff();
        detected
    };
    let logits = detected.logits.clone();
    let inputs = matcher_input(both, detected, config);
    let costs = matcher.forward(inputs.clone().narrow(0, 0, n), inputs.narrow(0, n, n));

    let labelled = Labelled::of(&batch.disparity, config.range_px());
    let last = costs.len() - 1;
    for (index, cost) in costs.iter().enumerate().filter(|_| !labelled.is_empty()) {
        let share = if index == last { 1.0 } else { EARLIER };
        let rows = at_pixels(cost.clone(), config).select(0, labelled.indices(device));
        let cost = at_levels(rows, config);
        let truth = || labelled.tensor(device);
        loss.add("entropy", share * weights.entropy, entropy_loss(cost.clone(), &labelled.values, config));
        let probabilities = probabilities(cost);
        let disparity = soft_argmin(probabilities.clone(), config);
        loss.add("disparity", share * weights.disparity, disparity_loss(disparity.clone(), truth()));
        loss.add("variance", share * weights.variance, variance_loss(probabilities, truth(), config));
        if index == last {
            loss.note("epe", &disparity.sub(truth()).abs().mean());
        }
    }
    if weights.warp > 0.0 {
        let probabilities = probabilities(at_levels(at_pixels(costs[last].clone(), config), config));
        let disparity = soft_argmin(probabilities, config).reshape([n, side, side]);
        let right = sigmoid(logits.clone().narrow(0, n, n)).reshape([n, side, side]);
        let lines = with_detections(&batch.left_lines, &logits.clone().narrow(0, 0, n));
        loss.add("warp", weights.warp, warp_loss(warp(right, disparity), &lines));
    }
    if joint {
        let lines = [&batch.left_lines[..], &batch.right_lines].concat();
        if lines.iter().any(|line| !line.is_nan()) {
            loss.add("detection", weights.detection, detection_loss(logits, &lines, weights.line));
        }
    }
    loss
}

/// Left lines; in images without any mask, what the detector finds there.
fn with_detections(lines: &[f32], logits: &Tensor<4>) -> Vec<f32> {
    let mut lines = lines.to_vec();
    let [n, _, height, width] = logits.dims();
    let detected: Vec<f32> = sigmoid(logits.clone()).into_data().try_to_vec().expect("logits are f32");
    for (image, found) in lines.chunks_exact_mut(height * width).zip(detected.chunks_exact(height * width)).take(n) {
        if image.iter().all(|line| line.is_nan()) {
            image.copy_from_slice(found);
        }
    }
    lines
}

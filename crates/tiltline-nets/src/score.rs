//! Scores on validation crops, by the paper's protocol: errors on true left line pixels.

use std::collections::BTreeMap;

use burn::tensor::Device;
use burn::tensor::activation::sigmoid;

use crate::data::Batch;
use crate::losses::Labelled;
use crate::matcher::Matcher;
use crate::networks::{Networks, matcher_input};
use crate::train::{Task, TrainSettings};
use crate::volume::{at_levels, at_pixels, probabilities, soft_argmin};

/// Scores by name; `error` is what the best weights are chosen by, lower is better. Empty where nothing is labelled.
pub fn validate(
    networks: &Networks,
    batches: &[Batch],
    settings: &TrainSettings,
    device: &Device,
) -> BTreeMap<String, f64> {
    let mut values = match &networks.matcher {
        None => return detection(networks, batches, device),
        Some(_) => disparity(networks, batches, settings, device),
    };
    if settings.task == Task::Joint {
        let detection = detection(networks, batches, device);
        let error = values.get("error").copied().unwrap_or(0.0) + detection["error"];
        values.extend(detection);
        values.insert("error".into(), error);
    }
    values
}

/// Precision, recall and F1 of pixels at probability 1/2; `error` is `1 - F1`.
fn detection(networks: &Networks, batches: &[Batch], device: &Device) -> BTreeMap<String, f64> {
    let (mut right, mut found, mut lines) = (0.0, 0.0, 0.0);
    for batch in batches {
        let images = crate::train::images(&batch.left, batch, device);
        let logits: Vec<f32> =
            networks.detector.forward(images).logits.into_data().try_to_vec().expect("logits are f32");
        for (logit, line) in logits.iter().zip(&batch.left_lines).filter(|(_, line)| !line.is_nan()) {
            let (detected, line) = (f64::from(u8::from(*logit > 0.0)), f64::from(*line));
            right += detected * line;
            found += detected;
            lines += line;
        }
    }
    let [precision, recall] = [found, lines].map(|of| if of > 0.0 { right / of } else { 0.0 });
    let f1 = if precision + recall > 0.0 { 2.0 * precision * recall / (precision + recall) } else { 0.0 };
    [("precision", precision), ("recall", recall), ("f1", f1), ("error", 1.0 - f1)]
        .map(|(name, value)| (name.to_owned(), value))
        .into()
}

/// EPE and bad-1, -3, -5 of the dense matcher, disparities beyond its range included; `error` is bad-1 as a share plus a tenth of
/// the EPE.
fn disparity(
    networks: &Networks,
    batches: &[Batch],
    settings: &TrainSettings,
    device: &Device,
) -> BTreeMap<String, f64> {
    let matcher = networks.matcher.as_ref().expect("only called with a matcher");
    let mut errors = Vec::new();
    for batch in batches {
        let labelled = Labelled::of(&batch.disparity, [f64::NEG_INFINITY, f64::INFINITY]);
        if labelled.is_empty() {
            continue;
        }
        let found = found_disparity(networks, matcher, batch, settings, device);
        let pairs = labelled.pixels.iter().zip(&labelled.values);
        errors.extend(pairs.map(|(pixel, truth)| f64::from((found[*pixel as usize] - truth).abs())));
    }
    if errors.is_empty() {
        return BTreeMap::new();
    }
    let count = errors.len() as f64;
    let epe = errors.iter().sum::<f64>() / count;
    let bad = |above: f64| errors.iter().filter(|error| **error > above).count() as f64 / count;
    [("epe", epe), ("bad-1", bad(1.0)), ("bad-3", bad(3.0)), ("bad-5", bad(5.0)), ("error", bad(1.0) + 0.1 * epe)]
        .map(|(name, value)| (name.to_owned(), value))
        .into()
}

/// The matcher's disparity at every pixel of the left crops of a batch, px.
pub fn found_disparity(
    networks: &Networks,
    matcher: &Matcher,
    batch: &Batch,
    settings: &TrainSettings,
    device: &Device,
) -> Vec<f32> {
    let config = &settings.matcher;
    let [left, right] = [&batch.left, &batch.right].map(|values| {
        let images = crate::train::images(values, batch, device);
        matcher_input(images.clone(), networks.detector.forward(images), config)
    });
    let cost = matcher.forward(left, right).pop().expect("there is a hourglass at least");
    let rows = at_levels(at_pixels(cost, config), config);
    soft_argmin(probabilities(rows), config).into_data().try_to_vec().expect("disparities are f32")
}

/// Line probabilities of logits, for pictures.
pub fn probability(logits: burn::tensor::Tensor<4>) -> Vec<f32> {
    sigmoid(logits).into_data().try_to_vec().expect("logits are f32")
}

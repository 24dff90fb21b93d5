//! Folding of batch norm into the convolution before it, for inference.

/// What batch norm does in inference: `gamma (x - mean) / sqrt(variance + epsilon) + beta`, a value a channel each.
#[derive(Clone, Copy, Debug)]
pub struct BatchNormStatistics<'a> {
    /// Learned scale.
    pub gamma: &'a [f32],
    /// Learned offset.
    pub beta: &'a [f32],
    /// Running mean.
    pub mean: &'a [f32],
    /// Running variance.
    pub variance: &'a [f32],
    /// Keeps the root away from zero.
    pub epsilon: f64,
}

/// The weight `[out, ...]` and bias of one convolution that does what the given one and a batch norm after it do.
///
/// # Panics
///
/// If a slice has not one value a channel, or the weight does not divide into channels.
#[must_use]
pub fn fold_batch_norm(weight: &[f32], bias: Option<&[f32]>, norm: &BatchNormStatistics) -> (Vec<f32>, Vec<f32>) {
    let channels = norm.gamma.len();
    for (what, values) in [("beta", norm.beta), ("the mean", norm.mean), ("the variance", norm.variance)] {
        crate::shape::assert_len(what, values.len(), channels);
    }
    if let Some(bias) = bias {
        crate::shape::assert_len("the bias", bias.len(), channels);
    }
    assert!(
        channels > 0 && weight.len().is_multiple_of(channels),
        "the weight has {} elements, which do not divide into {channels} channels",
        weight.len()
    );
    let mut folded = weight.to_vec();
    let mut offsets = Vec::with_capacity(channels);
    for (channel, weight) in folded.chunks_exact_mut((weight.len() / channels).max(1)).enumerate() {
        let scale = f64::from(norm.gamma[channel]) / (f64::from(norm.variance[channel]) + norm.epsilon).sqrt();
        for weight in weight {
            *weight = (f64::from(*weight) * scale) as f32;
        }
        let bias = bias.map_or(0.0, |bias| f64::from(bias[channel]));
        offsets.push((f64::from(norm.beta[channel]) + (bias - f64::from(norm.mean[channel])) * scale) as f32);
    }
    (folded, offsets)
}

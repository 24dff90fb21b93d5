//! The layers that both networks are made of, over planes (`D` = 4) and volumes (`D` = 5).

use burn::module::{Module, Param};
use burn::nn::{BatchNorm, BatchNormConfig};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};

use crate::ops::{Kernel, convolve, is_cpu, normalise};

/// Added to variances.
const EPSILON: f64 = 1e-5;
/// Share of each batch in the running statistics. Batches are small and images differ much: with the usual 0.1 the statistics of the
/// last few decide what is seen at inference.
const MOMENTUM: f64 = 0.02;

/// A convolution of any kind, with or without bias.
#[derive(Module, Debug)]
pub struct Conv<const D: usize> {
    /// `[out, in, (depth,) row, column]`; `[in, out, ...]` where it is transposed.
    pub weight: Param<Tensor<D>>,
    /// One a channel.
    pub bias: Option<Param<Tensor<1>>>,
    #[module(skip)]
    kernel: Kernel,
}

impl<const D: usize> Conv<D> {
    /// A convolution whose weights are still to be set (`weights::initialise`).
    pub fn new(kernel: Kernel, channels: [usize; 2], bias: bool, device: &Device) -> Self {
        let side = match (kernel, D) {
            (Kernel::Pointwise, _) => 1,
            (Kernel::Double, 4) => 2,
            _ => 3,
        };
        let mut shape = [side; D];
        let [from, to] = channels;
        [shape[0], shape[1]] = if kernel == Kernel::Double { [from, to] } else { [to, from] };
        let bias = bias.then(|| Param::from_tensor(Tensor::zeros([to], device)));
        Self { weight: Param::from_tensor(Tensor::zeros(shape, device)), bias, kernel }
    }

    /// The convolution.
    pub fn forward(&self, input: Tensor<D>) -> Tensor<D> {
        convolve(self.kernel, input, self.weight.val(), self.bias.as_ref().map(Param::val), false)
    }
}

/// A convolution, batch norm, and ReLU if wanted: one pass over memory each in training, and one in all at inference.
#[derive(Module, Debug)]
pub struct ConvNorm<const D: usize> {
    conv: Conv<D>,
    norm: BatchNorm,
    #[module(skip)]
    relu: bool,
}

impl<const D: usize> ConvNorm<D> {
    /// With ReLU.
    pub fn new(kernel: Kernel, channels: [usize; 2], device: &Device) -> Self {
        let conv = Conv::new(kernel, channels, false, device);
        Self {
            conv,
            norm: BatchNormConfig::new(channels[1]).with_epsilon(EPSILON).with_momentum(MOMENTUM).init(device),
            relu: true,
        }
    }

    /// Without ReLU.
    pub fn linear(kernel: Kernel, channels: [usize; 2], device: &Device) -> Self {
        Self { relu: false, ..Self::new(kernel, channels, device) }
    }

    /// The layer; with the batch's own statistics on a device that takes gradients, else with the running ones.
    pub fn forward(&self, input: Tensor<D>) -> Tensor<D> {
        let device = input.device();
        if !device.is_autodiff() {
            return self.folded(input);
        }
        let output = self.conv.forward(input);
        if !is_cpu(&device) {
            let output = self.norm.forward(output);
            return if self.relu { relu(output) } else { output };
        }
        let count = output.shape().num_elements() / output.dims()[1];
        let (gamma, beta) = (self.norm.gamma.val(), self.norm.beta.val());
        let (output, mean, variance) = normalise(output, gamma, beta, EPSILON, self.relu);
        // Running averages are of the unbiased variance, as in PyTorch.
        let unbiased = variance.mul_scalar(count as f64 / (count.max(2) - 1) as f64);
        let momentum = self.norm.momentum;
        for (running, new) in [(&self.norm.running_mean, mean), (&self.norm.running_var, unbiased)] {
            let old = running.value_sync();
            let new = new.detach().inner();
            let old = if old.device().is_autodiff() { old.inner() } else { old };
            running.update(old.mul_scalar(1.0 - momentum).add(new.mul_scalar(momentum)));
            // At once: burn would keep it back until the next update, and a checkpoint would miss it.
            running.value_sync();
        }
        output
    }

    /// Batch norm put into the convolution before it: `w' = w s`, `b' = beta - mean s`, `s = gamma / sqrt(variance + epsilon)`.
    fn folded(&self, input: Tensor<D>) -> Tensor<D> {
        let [mean, variance] = [&self.norm.running_mean, &self.norm.running_var].map(|running| running.value());
        let scale = self.norm.gamma.val().div(variance.add_scalar(EPSILON).sqrt());
        let bias = self.norm.beta.val().sub(mean.mul(scale.clone()));
        let mut shape = [1; D];
        shape[if self.conv.kernel == Kernel::Double { 1 } else { 0 }] = scale.dims()[0];
        convolve(self.conv.kernel, input, self.conv.weight.val().mul(scale.reshape(shape)), Some(bias), self.relu)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::weights::initialise;
    use burn::tensor::TensorData;

    /// Trained long enough on one batch, running statistics are those of the batch: inference then gives what training gave, but for
    /// the unbiased variance (512 values here: 0.1 percent of the deviation).
    fn inference_agrees<const D: usize>(kernel: Kernel, shape: [usize; D]) {
        let device = Device::flex().autodiff();
        let layer = initialise(ConvNorm::<D>::new(kernel, [shape[1], 3], &device), 1);
        let count = shape.iter().product();
        let values: Vec<f32> = (0..count).map(|index| ((index * 7919) % 101) as f32 / 25.0 - 1.0).collect();
        let input = Tensor::<D>::from_data(TensorData::new(values, shape), &device);
        let mut trained = Vec::new();
        for _ in 0..600 {
            trained = layer.forward(input.clone()).inner().into_data().try_to_vec::<f32>().unwrap();
        }
        let inferred: Vec<f32> = layer.valid().forward(input.inner()).into_data().try_to_vec().unwrap();
        assert!(trained.iter().any(|value| *value > 0.5));
        for (trained, inferred) in trained.iter().zip(&inferred) {
            assert!((trained - inferred).abs() < 0.01, "{trained} in training, {inferred} at inference");
        }
    }

    #[test]
    fn inference_agrees_with_training() {
        inference_agrees(Kernel::Same { stride: 1 }, [2, 2, 16, 16]);
        inference_agrees(Kernel::Same { stride: 2 }, [2, 2, 8, 16, 16]);
        inference_agrees(Kernel::Double, [2, 3, 4, 8, 8]);
    }
}

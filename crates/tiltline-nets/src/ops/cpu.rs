//! Our kernels as operations of burn's CPU backend.

use burn::backend::flex::FlexTensor;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Flex, backend_extension};
use burn::tensor::{Shape, TensorData};
use tiltline_kernels::{Activation, BatchNorm, MaxPool, Path};

use super::Geometry;

/// What the CPU backend can do beyond burn, and the gradients of it.
///
/// An argument of an extension cannot be an optional tensor, hence two convolutions.
#[backend_extension(Flex, Autodiff)]
pub trait CpuOps: Backend {
    /// A convolution without bias.
    fn tiltline_conv(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        geometry: Geometry,
        relu: bool,
    ) -> FloatTensor<Self>;
    /// A convolution with bias.
    fn tiltline_conv_bias(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        geometry: Geometry,
        relu: bool,
    ) -> FloatTensor<Self>;
    /// Gradient for the input of a convolution.
    fn tiltline_conv_input(
        gradient: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        geometry: Geometry,
    ) -> FloatTensor<Self>;
    /// Gradient for its weight.
    fn tiltline_conv_weight(
        input: FloatTensor<Self>,
        gradient: FloatTensor<Self>,
        geometry: Geometry,
    ) -> FloatTensor<Self>;
    /// Gradient for its bias.
    fn tiltline_conv_shift(gradient: FloatTensor<Self>, geometry: Geometry) -> FloatTensor<Self>;
    /// Batch norm with ReLU: output, mean, variance.
    fn tiltline_norm(
        input: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        epsilon: f64,
        relu: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>);
    /// Gradients for input, gamma and beta; `statistics` are mean and variance.
    #[allow(clippy::too_many_arguments)]
    fn tiltline_norm_back(
        input: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        gradient: FloatTensor<Self>,
        epsilon: f64,
        relu: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>);
    /// 2x2 max-pool.
    fn tiltline_pool(input: FloatTensor<Self>) -> FloatTensor<Self>;
    /// Its gradient.
    fn tiltline_pool_back(input: FloatTensor<Self>, gradient: FloatTensor<Self>) -> FloatTensor<Self>;
}

/// Gradients may come as expanded views.
fn contiguous(tensor: FlexTensor) -> FlexTensor {
    if tensor.as_slice::<f32>().is_some() { tensor } else { tensor.to_contiguous() }
}

fn values(tensor: &FlexTensor) -> &[f32] {
    tensor.as_slice().expect("the tensor is contiguous and holds f32")
}

fn dims(tensor: &FlexTensor) -> Vec<usize> {
    tensor.layout().shape().to_vec()
}

fn tensor(values: Vec<f32>, shape: Vec<usize>) -> FlexTensor {
    FlexTensor::from_data(TensorData::new(values, Shape::from(shape)))
}

fn activation(relu: bool) -> Activation {
    if relu { Activation::Relu } else { Activation::Identity }
}

fn conv(input: FlexTensor, weight: FlexTensor, bias: Option<&[f32]>, geometry: Geometry, relu: bool) -> FlexTensor {
    let (input, weight) = (contiguous(input), contiguous(weight));
    let output = geometry.operator().forward(values(&input), values(&weight), bias, activation(relu));
    tensor(output, geometry.output_shape())
}

/// The shape of a batch norm over `[batch, channel, ...]`.
fn norm(input: &FlexTensor, epsilon: f64) -> BatchNorm {
    let shape = dims(input);
    BatchNorm::new(shape[0], shape[1], shape[2..].iter().product(), epsilon).expect("tensors have no size of zero")
}

fn pool(shape: &[usize]) -> MaxPool {
    MaxPool::new(shape[0] * shape[1], [shape[2], shape[3]]).expect("planes have at least two rows and columns")
}

impl CpuOps for Flex {
    fn tiltline_conv(input: FlexTensor, weight: FlexTensor, geometry: Geometry, relu: bool) -> FlexTensor {
        conv(input, weight, None, geometry, relu)
    }

    fn tiltline_conv_bias(
        input: FlexTensor,
        weight: FlexTensor,
        bias: FlexTensor,
        geometry: Geometry,
        relu: bool,
    ) -> FlexTensor {
        let bias = contiguous(bias);
        conv(input, weight, Some(values(&bias)), geometry, relu)
    }

    fn tiltline_conv_input(gradient: FlexTensor, weight: FlexTensor, geometry: Geometry) -> FlexTensor {
        let (gradient, weight) = (contiguous(gradient), contiguous(weight));
        let output = geometry.operator().input_gradient(values(&gradient), values(&weight));
        tensor(output, geometry.input_shape())
    }

    fn tiltline_conv_weight(input: FlexTensor, gradient: FlexTensor, geometry: Geometry) -> FlexTensor {
        let (input, gradient) = (contiguous(input), contiguous(gradient));
        let output = geometry.operator().weight_gradient(values(&input), values(&gradient));
        tensor(output, geometry.weight_shape())
    }

    fn tiltline_conv_shift(gradient: FlexTensor, geometry: Geometry) -> FlexTensor {
        let gradient = contiguous(gradient);
        let output = geometry.operator().bias_gradient(values(&gradient));
        tensor(output, vec![geometry.out_channels])
    }

    fn tiltline_norm(
        input: FlexTensor,
        gamma: FlexTensor,
        beta: FlexTensor,
        epsilon: f64,
        relu: bool,
    ) -> (FlexTensor, FlexTensor, FlexTensor) {
        let [input, gamma, beta] = [input, gamma, beta].map(contiguous);
        let norm = norm(&input, epsilon);
        let made = norm.forward(Path::best(), values(&input), values(&gamma), values(&beta), activation(relu));
        let channels = vec![made.mean.len()];
        (tensor(made.output, dims(&input)), tensor(made.mean, channels.clone()), tensor(made.variance, channels))
    }

    fn tiltline_norm_back(
        input: FlexTensor,
        gamma: FlexTensor,
        beta: FlexTensor,
        mean: FlexTensor,
        variance: FlexTensor,
        gradient: FlexTensor,
        epsilon: f64,
        relu: bool,
    ) -> (FlexTensor, FlexTensor, FlexTensor) {
        let [input, gamma, beta, gradient] = [input, gamma, beta, gradient].map(contiguous);
        let [mean, variance] = [mean, variance].map(contiguous);
        let norm = norm(&input, epsilon);
        let inverse: Vec<f32> =
            values(&variance).iter().map(|v| (1.0 / (f64::from(*v) + epsilon).sqrt()) as f32).collect();
        let gradients = norm.backward(
            Path::best(),
            values(&input),
            values(&gamma),
            values(&beta),
            values(&mean),
            &inverse,
            activation(relu),
            values(&gradient),
        );
        let channels = vec![gradients.gamma.len()];
        let (gamma, beta) = (tensor(gradients.gamma, channels.clone()), tensor(gradients.beta, channels));
        (tensor(gradients.input, dims(&input)), gamma, beta)
    }

    fn tiltline_pool(input: FlexTensor) -> FlexTensor {
        let input = contiguous(input);
        let shape = dims(&input);
        let output = pool(&shape).forward(Path::best(), values(&input));
        tensor(output, vec![shape[0], shape[1], shape[2] / 2, shape[3] / 2])
    }

    fn tiltline_pool_back(input: FlexTensor, gradient: FlexTensor) -> FlexTensor {
        let (input, gradient) = (contiguous(input), contiguous(gradient));
        let shape = dims(&input);
        let output = pool(&shape).input_gradient(Path::best(), values(&input), values(&gradient));
        tensor(output, shape)
    }
}

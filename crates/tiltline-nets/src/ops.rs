//! The operations of the networks: on the CPU our kernels (`tiltline-kernels`) with gradients of their own, on other devices
//! burn's.
//!
//! Tensors are `[batch, channel, (depth,) row, column]`. Which of the two runs is decided by the device alone, so nothing
//! falls back silently: a tensor on the CPU always takes our kernels.

mod cpu;
mod gradients;

use burn::backend::{Dispatch, DispatchDevice};
use burn::tensor::module::{conv_transpose2d, conv_transpose3d, conv2d, conv3d};
use burn::tensor::ops::{ConvOptions, ConvTransposeOptions, MaxPoolOptions};
use burn::tensor::{Device, Tensor};
use tiltline_kernels::{Activation, Conv, Path, TransposedConv};

use cpu::CpuOps;

/// A kind of convolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    /// 3x3, or 3x3x3 over volumes; stride 1 or 2.
    Same {
        /// 1 keeps the sides, 2 halves them.
        stride: usize,
    },
    /// 1x1.
    Pointwise,
    /// Transposed, twice the sides: 2x2 over planes (U-Net), 3x3x3 over volumes (hourglass).
    Double,
}

/// A convolution with all its sizes; how the kernels are called.
#[derive(Clone, Copy, Debug)]
pub struct Geometry {
    kernel: Kernel,
    /// Rank of the tensors: 4 for planes, 5 for volumes.
    rank: usize,
    batch: usize,
    in_channels: usize,
    out_channels: usize,
    /// `[depth, rows, columns]` of the input; a plane has depth 1.
    size: [usize; 3],
}

enum Operator {
    Conv(Conv),
    Transposed(TransposedConv),
}

const FITS: &str = "tensors have sizes of at least one, and fit into memory";

impl Geometry {
    fn new<const D: usize>(kernel: Kernel, input: &Tensor<D>, weight: &Tensor<D>) -> Self {
        let (x, w) = (input.dims(), weight.dims());
        let [in_channels, out_channels] = match kernel {
            Kernel::Double => [w[0], w[1]],
            _ => [w[1], w[0]],
        };
        assert_eq!(x[1], in_channels, "the input has {} channels, the weight wants {in_channels}", x[1]);
        let depth = if D == 5 { x[2] } else { 1 };
        Self { kernel, rank: D, batch: x[0], in_channels, out_channels, size: [depth, x[D - 2], x[D - 1]] }
    }

    fn operator(&self) -> Operator {
        let Self { batch, in_channels: from, out_channels: to, size, .. } = *self;
        let plane = [size[1], size[2]];
        match (self.kernel, self.rank) {
            (Kernel::Same { stride }, 5) => Operator::Conv(Conv::volume(batch, from, to, size, stride).expect(FITS)),
            (Kernel::Same { stride }, _) => Operator::Conv(Conv::plane(batch, from, to, plane, stride).expect(FITS)),
            (Kernel::Pointwise, _) => {
                Operator::Conv(Conv::pointwise(batch, from, to, size.iter().product()).expect(FITS))
            }
            (Kernel::Double, 5) => Operator::Transposed(TransposedConv::volume(batch, from, to, size).expect(FITS)),
            (Kernel::Double, _) => Operator::Transposed(TransposedConv::plane(batch, from, to, plane).expect(FITS)),
        }
    }

    fn shape(&self, channels: usize, size: [usize; 3]) -> Vec<usize> {
        let depth = if self.rank == 5 { &size[..] } else { &size[1..] };
        [&[self.batch, channels], depth].concat()
    }

    fn input_shape(&self) -> Vec<usize> {
        self.shape(self.in_channels, self.size)
    }

    fn output_shape(&self) -> Vec<usize> {
        let size = match (self.kernel, self.operator()) {
            (Kernel::Pointwise, _) => self.size,
            (_, Operator::Conv(conv)) => conv.output_size(),
            (_, Operator::Transposed(conv)) => conv.output_size(),
        };
        self.shape(self.out_channels, size)
    }

    fn weight_shape(&self) -> Vec<usize> {
        let channels = match self.kernel {
            Kernel::Double => [self.in_channels, self.out_channels],
            _ => [self.out_channels, self.in_channels],
        };
        let side = match (self.kernel, self.rank) {
            (Kernel::Pointwise, _) => 1,
            (Kernel::Double, 4) => 2,
            _ => 3,
        };
        [&channels[..], &vec![side; self.rank - 2]].concat()
    }
}

impl Operator {
    fn forward(&self, input: &[f32], weight: &[f32], bias: Option<&[f32]>, activation: Activation) -> Vec<f32> {
        match self {
            Self::Conv(conv) => conv.forward(Path::best(), input, weight, bias, activation),
            Self::Transposed(conv) => conv.forward(Path::best(), input, weight, bias, activation),
        }
    }

    fn input_gradient(&self, gradient: &[f32], weight: &[f32]) -> Vec<f32> {
        match self {
            Self::Conv(conv) => conv.input_gradient(Path::best(), gradient, weight),
            Self::Transposed(conv) => conv.input_gradient(Path::best(), gradient, weight),
        }
    }

    fn weight_gradient(&self, input: &[f32], gradient: &[f32]) -> Vec<f32> {
        match self {
            Self::Conv(conv) => conv.weight_gradient(Path::best(), input, gradient),
            Self::Transposed(conv) => conv.weight_gradient(Path::best(), input, gradient),
        }
    }

    fn bias_gradient(&self, gradient: &[f32]) -> Vec<f32> {
        match self {
            Self::Conv(conv) => conv.bias_gradient(Path::best(), gradient),
            Self::Transposed(conv) => conv.bias_gradient(Path::best(), gradient),
        }
    }
}

/// Whether a device is the CPU, on which our kernels run.
pub fn is_cpu(device: &Device) -> bool {
    matches!(device.clone().without_autodiff().as_dispatch(), DispatchDevice::Flex(_))
}

/// A convolution; with `relu`, negative values become zero (inference only: there is no gradient through it on the CPU).
pub fn convolve<const D: usize>(
    kernel: Kernel,
    input: Tensor<D>,
    weight: Tensor<D>,
    bias: Option<Tensor<1>>,
    relu: bool,
) -> Tensor<D> {
    let device = input.device();
    if !is_cpu(&device) {
        let output = burn_convolve(kernel, input, weight, bias);
        return if relu { burn::tensor::activation::relu(output) } else { output };
    }
    assert!(!relu || !device.is_autodiff(), "a ReLU fused into a convolution has no gradient");
    let geometry = Geometry::new(kernel, &input, &weight);
    let (input, weight) = (input.into_dispatch(), weight.into_dispatch());
    Tensor::from_dispatch(match bias {
        None => Dispatch::tiltline_conv(input, weight, geometry, relu),
        Some(bias) => Dispatch::tiltline_conv_bias(input, weight, bias.into_dispatch(), geometry, relu),
    })
}

/// The same by burn's own operations, on any device.
pub fn burn_convolve<const D: usize>(
    kernel: Kernel,
    input: Tensor<D>,
    weight: Tensor<D>,
    bias: Option<Tensor<1>>,
) -> Tensor<D> {
    let (input, weight) = (input.into_dispatch(), weight.into_dispatch());
    if D == 4 {
        let (input, weight) = (Tensor::<4>::from_dispatch(input), Tensor::<4>::from_dispatch(weight));
        let output = match kernel {
            Kernel::Same { stride } => conv2d(input, weight, bias, ConvOptions::new([stride; 2], [1; 2], [1; 2], 1)),
            Kernel::Pointwise => conv2d(input, weight, bias, ConvOptions::new([1; 2], [0; 2], [1; 2], 1)),
            Kernel::Double => {
                let options = ConvTransposeOptions::new([2; 2], [0; 2], [0; 2], [1; 2], 1);
                conv_transpose2d(input, weight, bias, options)
            }
        };
        return Tensor::from_dispatch(output.into_dispatch());
    }
    let (input, weight) = (Tensor::<5>::from_dispatch(input), Tensor::<5>::from_dispatch(weight));
    let output = match kernel {
        Kernel::Same { stride } => conv3d(input, weight, bias, ConvOptions::new([stride; 3], [1; 3], [1; 3], 1)),
        Kernel::Pointwise => conv3d(input, weight, bias, ConvOptions::new([1; 3], [0; 3], [1; 3], 1)),
        Kernel::Double => {
            let options = ConvTransposeOptions::new([2; 3], [1; 3], [1; 3], [1; 3], 1);
            conv_transpose3d(input, weight, bias, options)
        }
    };
    Tensor::from_dispatch(output.into_dispatch())
}

/// Batch norm with the batch's own statistics, then ReLU if wanted: output, mean, (biased) variance. CPU only.
pub fn normalise<const D: usize>(
    input: Tensor<D>,
    gamma: Tensor<1>,
    beta: Tensor<1>,
    epsilon: f64,
    relu: bool,
) -> (Tensor<D>, Tensor<1>, Tensor<1>) {
    let (output, mean, variance) =
        Dispatch::tiltline_norm(input.into_dispatch(), gamma.into_dispatch(), beta.into_dispatch(), epsilon, relu);
    (Tensor::from_dispatch(output), Tensor::from_dispatch(mean), Tensor::from_dispatch(variance))
}

/// The largest of each 2x2 block.
pub fn max_pool(input: Tensor<4>) -> Tensor<4> {
    if is_cpu(&input.device()) {
        Tensor::from_dispatch(Dispatch::tiltline_pool(input.into_dispatch()))
    } else {
        burn::tensor::module::max_pool2d(input, MaxPoolOptions::new([2; 2]).with_stride([2; 2]))
    }
}

#[cfg(test)]
mod tests;

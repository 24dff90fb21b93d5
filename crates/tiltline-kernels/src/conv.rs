//! Convolutions and their gradients.

use crate::correlate::correlate;
use crate::coupling::Coupling;
use crate::outer::weight_gradient;
use crate::path::Path;
use crate::shape::{ShapeError, assert_len, check};
use crate::sums::channel_sums;

/// What is done to a result before it is stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Activation {
    /// Nothing.
    #[default]
    Identity,
    /// Negative values become zero.
    Relu,
}

/// The shape of a convolution, cross-correlation as in every network library:
/// `y[n, o, q] = bias[o] + sum over c, k of weight[o, c, k] x[n, c, stride q + k - padding]`.
///
/// Inputs are `[batch, in, (depth,) row, column]`, weights `[out, in, (depth,) row, column]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Conv(Coupling);

impl Conv {
    /// 3x3, padding 1, stride 1 or 2, over planes `[rows, columns]`.
    ///
    /// # Errors
    ///
    /// A size of zero, a stride that is neither 1 nor 2, or more elements than can be addressed.
    pub fn plane(
        batch: usize,
        in_channels: usize,
        out_channels: usize,
        [rows, columns]: [usize; 2],
        stride: usize,
    ) -> Result<Self, ShapeError> {
        Self::new(batch, [in_channels, out_channels], [1, rows, columns], [1, 3, 3], [1, stride, stride])
    }

    /// 3x3x3, padding 1, stride 1 or 2, over volumes `[depth, rows, columns]`.
    ///
    /// # Errors
    ///
    /// As for [`Conv::plane`].
    pub fn volume(
        batch: usize,
        in_channels: usize,
        out_channels: usize,
        size: [usize; 3],
        stride: usize,
    ) -> Result<Self, ShapeError> {
        Self::new(batch, [in_channels, out_channels], size, [3; 3], [stride; 3])
    }

    /// 1x1 or 1x1x1 over any number of positions (rows times columns, times depth).
    ///
    /// # Errors
    ///
    /// As for [`Conv::plane`].
    pub fn pointwise(
        batch: usize,
        in_channels: usize,
        out_channels: usize,
        positions: usize,
    ) -> Result<Self, ShapeError> {
        Self::new(batch, [in_channels, out_channels], [1, 1, positions], [1; 3], [1; 3])
    }

    fn new(
        batch: usize,
        [in_channels, out_channels]: [usize; 2],
        size: [usize; 3],
        kernel: [usize; 3],
        stride: [usize; 3],
    ) -> Result<Self, ShapeError> {
        if !(1..=2).contains(&stride[2]) {
            return Err(ShapeError::Stride(stride[2]));
        }
        let [depth, rows, columns] = size;
        check(&[
            ("batch", batch),
            ("channels", in_channels.min(out_channels)),
            ("channels", in_channels.max(out_channels)),
            ("depth", depth),
            ("rows", rows),
            ("columns", columns),
        ])?;
        let padding = kernel.map(|kernel| kernel / 2);
        let mut coarse = [0; 3];
        for axis in 0..3 {
            coarse[axis] = (size[axis] + 2 * padding[axis] - kernel[axis]) / stride[axis] + 1;
        }
        Ok(Self(Coupling {
            batch,
            fine_channels: in_channels,
            coarse_channels: out_channels,
            fine: size,
            coarse,
            kernel,
            stride,
            padding,
        }))
    }

    /// Elements of the input.
    #[must_use]
    pub fn input_len(&self) -> usize {
        self.0.fine_len()
    }

    /// Elements of the output.
    #[must_use]
    pub fn output_len(&self) -> usize {
        self.0.coarse_len()
    }

    /// Elements of the weights.
    #[must_use]
    pub fn weight_len(&self) -> usize {
        self.0.weight_len()
    }

    /// `[depth, rows, columns]` of the output; a plane has depth 1.
    #[must_use]
    pub fn output_size(&self) -> [usize; 3] {
        self.0.coarse
    }

    /// The output.
    ///
    /// # Panics
    ///
    /// If a slice has not the length that the shape asks for. The same holds for all methods below.
    #[must_use]
    pub fn forward(
        &self,
        path: Path,
        input: &[f32],
        weight: &[f32],
        bias: Option<&[f32]>,
        activation: Activation,
    ) -> Vec<f32> {
        assert_len("the input", input.len(), self.input_len());
        assert_len("the weight", weight.len(), self.weight_len());
        if let Some(bias) = bias {
            assert_len("the bias", bias.len(), self.0.coarse_channels);
        }
        correlate(path, &self.0.downward(), input, weight, bias, activation)
    }

    /// The loss's gradient for the input, from that for the output (before any activation).
    #[must_use]
    pub fn input_gradient(&self, path: Path, output_gradient: &[f32], weight: &[f32]) -> Vec<f32> {
        assert_len("the output's gradient", output_gradient.len(), self.output_len());
        assert_len("the weight", weight.len(), self.weight_len());
        correlate(path, &self.0.upward(), output_gradient, weight, None, Activation::Identity)
    }

    /// The loss's gradient for the weights, from the input and the gradient for the output.
    #[must_use]
    pub fn weight_gradient(&self, path: Path, input: &[f32], output_gradient: &[f32]) -> Vec<f32> {
        assert_len("the input", input.len(), self.input_len());
        assert_len("the output's gradient", output_gradient.len(), self.output_len());
        weight_gradient(path, &self.0, input, output_gradient)
    }

    /// The loss's gradient for the bias, from that for the output.
    #[must_use]
    pub fn bias_gradient(&self, path: Path, output_gradient: &[f32]) -> Vec<f32> {
        assert_len("the output's gradient", output_gradient.len(), self.output_len());
        channel_sums(path, output_gradient, self.0.batch, self.0.coarse_channels)
    }
}

//! Transposed convolutions, which double the sides of their input, and their gradients.

use crate::conv::Activation;
use crate::correlate::correlate;
use crate::coupling::Coupling;
use crate::outer::weight_gradient;
use crate::path::Path;
use crate::shape::{ShapeError, assert_len, check};
use crate::sums::channel_sums;

/// The shape of a transposed convolution: the map whose transpose is the convolution of the same kernel, stride and padding.
///
/// Inputs are `[batch, in, (depth,) row, column]`, weights `[in, out, (depth,) row, column]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TransposedConv(Coupling);

impl TransposedConv {
    /// 2x2 with stride 2 and no padding over planes `[rows, columns]`: the U-Net's way up.
    ///
    /// # Errors
    ///
    /// A size of zero, or more elements than can be addressed.
    pub fn plane(
        batch: usize,
        in_channels: usize,
        out_channels: usize,
        [rows, columns]: [usize; 2],
    ) -> Result<Self, ShapeError> {
        Self::new(batch, [in_channels, out_channels], [1, rows, columns], [1, 2, 2], [0; 3])
    }

    /// 3x3x3 with stride 2, padding 1 and output padding 1 over volumes `[depth, rows, columns]`: the hourglass's way up.
    ///
    /// # Errors
    ///
    /// As for [`TransposedConv::plane`].
    pub fn volume(batch: usize, in_channels: usize, out_channels: usize, size: [usize; 3]) -> Result<Self, ShapeError> {
        Self::new(batch, [in_channels, out_channels], size, [3; 3], [1; 3])
    }

    fn new(
        batch: usize,
        [in_channels, out_channels]: [usize; 2],
        size: [usize; 3],
        kernel: [usize; 3],
        padding: [usize; 3],
    ) -> Result<Self, ShapeError> {
        let [depth, rows, columns] = size;
        check(&[
            ("batch", batch),
            ("channels", in_channels.min(out_channels)),
            ("channels", in_channels.max(out_channels)),
            ("depth", depth),
            ("rows", rows),
            ("columns", columns),
        ])?;
        let stride = kernel.map(|kernel| if kernel == 1 { 1 } else { 2 });
        Ok(Self(Coupling {
            batch,
            fine_channels: out_channels,
            coarse_channels: in_channels,
            fine: [depth * stride[0], rows * stride[1], columns * stride[2]],
            coarse: size,
            kernel,
            stride,
            padding,
        }))
    }

    /// Elements of the input.
    #[must_use]
    pub fn input_len(&self) -> usize {
        self.0.coarse_len()
    }

    /// Elements of the output.
    #[must_use]
    pub fn output_len(&self) -> usize {
        self.0.fine_len()
    }

    /// Elements of the weights.
    #[must_use]
    pub fn weight_len(&self) -> usize {
        self.0.weight_len()
    }

    /// `[depth, rows, columns]` of the output; a plane has depth 1.
    #[must_use]
    pub fn output_size(&self) -> [usize; 3] {
        self.0.fine
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
            assert_len("the bias", bias.len(), self.0.fine_channels);
        }
        correlate(path, &self.0.upward(), input, weight, bias, activation)
    }

    /// The loss's gradient for the input, from that for the output (before any activation).
    #[must_use]
    pub fn input_gradient(&self, path: Path, output_gradient: &[f32], weight: &[f32]) -> Vec<f32> {
        assert_len("the output's gradient", output_gradient.len(), self.output_len());
        assert_len("the weight", weight.len(), self.weight_len());
        correlate(path, &self.0.downward(), output_gradient, weight, None, Activation::Identity)
    }

    /// The loss's gradient for the weights, from the input and the gradient for the output.
    #[must_use]
    pub fn weight_gradient(&self, path: Path, input: &[f32], output_gradient: &[f32]) -> Vec<f32> {
        assert_len("the input", input.len(), self.input_len());
        assert_len("the output's gradient", output_gradient.len(), self.output_len());
        weight_gradient(path, &self.0, output_gradient, input)
    }

    /// The loss's gradient for the bias, from that for the output.
    #[must_use]
    pub fn bias_gradient(&self, path: Path, output_gradient: &[f32]) -> Vec<f32> {
        assert_len("the output's gradient", output_gradient.len(), self.output_len());
        channel_sums(path, output_gradient, self.0.batch, self.0.fine_channels)
    }
}

//! Batch norm in training, with ReLU in the same pass over memory.
//!
//! `y = activation(gamma (x - mean) / sqrt(variance + epsilon) + beta)`, with mean and (biased) variance over batch and positions
//! of each channel (Ioffe and Szegedy 2015, arXiv:1502.03167, algorithm 1; the gradients are those of its section 3). The backward
//! pass finds out again from `x` where the activation was active, so that no mask and no output need be kept.

use crate::conv::Activation;
use crate::lanes::{Lanes, MAX_COUNT};
use crate::path::{Kernel, Path};
use crate::scratch::{Output, fill_output};
use crate::shape::{ShapeError, assert_len, check};
use crate::sums::{RUN, Sum};
use rayon::prelude::*;

/// The shape of a batch norm over `[batch, channel, positions]`, and what is added to the variance.
#[derive(Clone, Debug, PartialEq)]
pub struct BatchNorm {
    batch: usize,
    channels: usize,
    positions: usize,
    epsilon: f64,
}

/// What the forward pass returns: the output, and a value a channel of each statistic.
#[derive(Clone, Debug, PartialEq)]
pub struct Normalised {
    /// `[batch, channel, positions]`
    pub output: Vec<f32>,
    /// Mean over batch and positions.
    pub mean: Vec<f32>,
    /// `1 / sqrt(variance + epsilon)`
    pub inverse_deviation: Vec<f32>,
    /// Biased variance; running averages by custom take it times `count / (count - 1)`.
    pub variance: Vec<f32>,
}

/// What the backward pass returns.
#[derive(Clone, Debug, PartialEq)]
pub struct BatchNormGradients {
    /// `[batch, channel, positions]`
    pub input: Vec<f32>,
    /// One a channel.
    pub gamma: Vec<f32>,
    /// One a channel.
    pub beta: Vec<f32>,
}

impl BatchNorm {
    /// Over `batch` times `positions` values of each channel.
    ///
    /// # Errors
    ///
    /// A size of zero, or more elements than can be addressed.
    pub fn new(batch: usize, channels: usize, positions: usize, epsilon: f64) -> Result<Self, ShapeError> {
        check(&[("batch", batch), ("channels", channels), ("positions", positions)])?;
        Ok(Self { batch, channels, positions, epsilon })
    }

    /// Elements of input and output.
    #[must_use]
    pub fn len(&self) -> usize {
        self.batch * self.channels * self.positions
    }

    /// Never: every size is at least 1.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        false
    }

    /// Normalises with the batch's own statistics.
    ///
    /// # Panics
    ///
    /// If a slice has not the length that the shape asks for.
    #[must_use]
    pub fn forward(
        &self,
        path: Path,
        input: &[f32],
        gamma: &[f32],
        beta: &[f32],
        activation: Activation,
    ) -> Normalised {
        assert_len("the input", input.len(), self.len());
        assert_len("gamma", gamma.len(), self.channels);
        assert_len("beta", beta.len(), self.channels);
        let mut statistics = vec![[0.0; 3]; self.channels];
        let count = (self.batch * self.positions) as f64;
        let fill = |output: Output| {
            statistics.par_iter_mut().enumerate().for_each(|(channel, statistics)| {
                let planes = || (0..self.batch).map(|n| self.plane(n, channel));
                let mean = planes().map(|start| path.run(Sum(&input[start..][..self.positions]))).sum::<f64>() / count;
                let mean = mean as f32;
                let squares = planes()
                    .map(|start| path.run(SquaredDeviations { values: &input[start..][..self.positions], mean }));
                let variance = squares.sum::<f64>() / count;
                let inverse_deviation = (1.0 / (variance + self.epsilon).sqrt()) as f32;
                *statistics = [mean, inverse_deviation, variance as f32];
                let affine = Affine::new(gamma[channel], beta[channel], mean, inverse_deviation);
                for start in planes() {
                    let (values, to) = (&input[start..][..self.positions], output.part(start, self.positions));
                    match activation {
                        Activation::Identity => path.run(Apply::<false> { values, affine, to }),
                        Activation::Relu => path.run(Apply::<true> { values, affine, to }),
                    }
                }
            });
        };
        // SAFETY: each channel's planes are written by one task, whole (`Apply`).
        let output = unsafe { fill_output(self.len(), fill) };
        let column = |i: usize| statistics.iter().map(|row| row[i]).collect();
        Normalised { output, mean: column(0), inverse_deviation: column(1), variance: column(2) }
    }

    /// The loss's gradients, from that for the output, the input, and the statistics that the forward pass found.
    ///
    /// # Panics
    ///
    /// If a slice has not the length that the shape asks for.
    #[expect(
        clippy::too_many_arguments,
        reason = "the operation has that many inputs, and no two belong together elsewhere"
    )]
    #[must_use]
    pub fn backward(
        &self,
        path: Path,
        input: &[f32],
        gamma: &[f32],
        beta: &[f32],
        mean: &[f32],
        inverse_deviation: &[f32],
        activation: Activation,
        output_gradient: &[f32],
    ) -> BatchNormGradients {
        assert_len("the input", input.len(), self.len());
        assert_len("the output's gradient", output_gradient.len(), self.len());
        for (what, values) in
            [("gamma", gamma), ("beta", beta), ("the mean", mean), ("the deviation", inverse_deviation)]
        {
            assert_len(what, values.len(), self.channels);
        }
        let mut sums = vec![[0.0; 2]; self.channels];
        let count = (self.batch * self.positions) as f64;
        let fill = |output: Output| {
            sums.par_iter_mut().enumerate().for_each(|(channel, sums)| {
                let (mean, inverse_deviation) = (mean[channel], inverse_deviation[channel]);
                let affine = Affine::new(gamma[channel], beta[channel], mean, inverse_deviation);
                let (mut gradient_sum, mut product_sum) = (0.0, 0.0);
                for start in (0..self.batch).map(|n| self.plane(n, channel)) {
                    let (values, gradient) =
                        (&input[start..][..self.positions], &output_gradient[start..][..self.positions]);
                    let (sum, product) = match activation {
                        Activation::Identity => path.run(GradientSums::<false> { values, gradient, affine, mean }),
                        Activation::Relu => path.run(GradientSums::<true> { values, gradient, affine, mean }),
                    };
                    gradient_sum += sum;
                    product_sum += product;
                }
                // Of gamma: the sum of the gradient times (x - mean) / deviation.
                let inverse = f64::from(inverse_deviation);
                *sums = [(product_sum * inverse) as f32, gradient_sum as f32];
                let scale = f64::from(affine.scale);
                let slope = (-scale * inverse * inverse * product_sum / count) as f32;
                let offset = (-scale * gradient_sum / count) as f32;
                for start in (0..self.batch).map(|n| self.plane(n, channel)) {
                    let (values, gradient) =
                        (&input[start..][..self.positions], &output_gradient[start..][..self.positions]);
                    let to = output.part(start, self.positions);
                    match activation {
                        Activation::Identity => {
                            path.run(InputGradient::<false> { values, gradient, affine, mean, slope, offset, to });
                        }
                        Activation::Relu => {
                            path.run(InputGradient::<true> { values, gradient, affine, mean, slope, offset, to });
                        }
                    }
                }
            });
        };
        // SAFETY: each channel's planes are written by one task, whole (`InputGradient`).
        let input = unsafe { fill_output(self.len(), fill) };
        BatchNormGradients {
            input,
            gamma: sums.iter().map(|sums| sums[0]).collect(),
            beta: sums.iter().map(|sums| sums[1]).collect(),
        }
    }

    /// Where a plane begins.
    fn plane(&self, n: usize, channel: usize) -> usize {
        (n * self.channels + channel) * self.positions
    }
}

/// `scale x + offset`: batch norm with known statistics. Both passes must use the very same two numbers, lest they disagree
/// about where the activation is active.
#[derive(Clone, Copy)]
struct Affine {
    scale: f32,
    offset: f32,
}

impl Affine {
    fn new(gamma: f32, beta: f32, mean: f32, inverse_deviation: f32) -> Self {
        let scale = gamma * inverse_deviation;
        Self { scale, offset: beta - mean * scale }
    }
}

/// Runs `$body` for each vector of equally long slices, beginning at `$start` with `$count` values; the last one is filled
/// up with `$pad`. A macro, since a closure would not be compiled for the path's instructions.
macro_rules! for_each_vector {
    ($lanes:ident, $len:expr, [$($vector:ident of $slice:expr, $pad:expr);+], |$start:ident, $count:ident| $body:block) => {
        let len: usize = $len;
        let mut $start = 0;
        while $start < len {
            let $count = (len - $start).min(L::COUNT);
            $(
                let slice: &[f32] = &$slice[$start..$start + $count];
                let $vector = if $count == L::COUNT {
                    // SAFETY: the slice has a whole vector.
                    unsafe { $lanes.load(slice.as_ptr()) }
                } else {
                    load_padded($lanes, slice, $pad)
                };
            )+
            $body
            $start += L::COUNT;
        }
    };
}

#[inline(always)]
fn load_padded<L: Lanes>(lanes: L, slice: &[f32], pad: f32) -> L::Vector {
    let mut padded = [pad; MAX_COUNT];
    padded[..slice.len()].copy_from_slice(slice);
    // SAFETY: `MAX_COUNT` floats are enough for any vector.
    unsafe { lanes.load(padded.as_ptr()) }
}

/// The sum of `(value - mean)^2`.
struct SquaredDeviations<'a> {
    values: &'a [f32],
    mean: f32,
}

impl Kernel for SquaredDeviations<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> f64 {
        let mean = lanes.splat(self.mean);
        let mut total = 0.0;
        for run in self.values.chunks(RUN) {
            let mut sums = [lanes.splat(0.0); 4];
            let (quads, rest) = run.split_at(run.len() / (4 * L::COUNT) * (4 * L::COUNT));
            for quad in quads.chunks_exact(4 * L::COUNT) {
                for i in 0..4 {
                    // SAFETY: the quad has four vectors.
                    let deviation = lanes.sub(unsafe { lanes.load(quad.as_ptr().add(i * L::COUNT)) }, mean);
                    sums[i] = lanes.mul_add(deviation, deviation, sums[i]);
                }
            }
            for_each_vector!(lanes, rest.len(), [value of rest, self.mean], |_start, _count| {
                let deviation = lanes.sub(value, mean);
                sums[0] = lanes.mul_add(deviation, deviation, sums[0]);
            });
            total += f64::from(lanes.sum(lanes.add(lanes.add(sums[0], sums[1]), lanes.add(sums[2], sums[3]))));
        }
        total
    }
}

/// `to = activation(scale value + offset)`
struct Apply<'a, const RELU: bool> {
    values: &'a [f32],
    affine: Affine,
    to: *mut f32,
}

impl<const RELU: bool> Kernel for Apply<'_, RELU> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let (scale, offset) = (lanes.splat(self.affine.scale), lanes.splat(self.affine.offset));
        for_each_vector!(lanes, self.values.len(), [value of self.values, 0.0], |start, count| {
            let result = lanes.mul_add(value, scale, offset);
            let result = if RELU { lanes.relu(result) } else { result };
            // SAFETY: `to` has as many elements as `values`.
            unsafe { store_first(lanes, self.to.add(start), result, count) };
        });
    }
}

/// # Safety
///
/// `to + 0..count` must be writable, `0 < count <= L::COUNT`.
#[inline(always)]
unsafe fn store_first<L: Lanes>(lanes: L, to: *mut f32, vector: L::Vector, count: usize) {
    // SAFETY: as the caller promises.
    unsafe {
        if count == L::COUNT {
            lanes.store(to, vector);
        } else {
            lanes.store_lanes(to, vector, 0, count);
        }
    }
}

/// The gradient as it comes through the activation.
#[inline(always)]
fn through<L: Lanes, const RELU: bool>(lanes: L, value: L::Vector, gradient: L::Vector, affine: Affine) -> L::Vector {
    if RELU {
        let result = lanes.mul_add(value, lanes.splat(affine.scale), lanes.splat(affine.offset));
        lanes.keep_where_positive(result, gradient)
    } else {
        gradient
    }
}

/// The sums of the gradient, and of the gradient times `value - mean`.
struct GradientSums<'a, const RELU: bool> {
    values: &'a [f32],
    gradient: &'a [f32],
    affine: Affine,
    mean: f32,
}

impl<const RELU: bool> Kernel for GradientSums<'_, RELU> {
    type Output = (f64, f64);

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> (f64, f64) {
        let mean = lanes.splat(self.mean);
        let (mut total, mut product_total) = (0.0, 0.0);
        for (values, gradients) in self.values.chunks(RUN).zip(self.gradient.chunks(RUN)) {
            let (mut sums, mut products) = ([lanes.splat(0.0); 2], [lanes.splat(0.0); 2]);
            for_each_vector!(lanes, values.len(), [value of values, 0.0; gradient of gradients, 0.0], |start, _count| {
                let gradient = through::<L, RELU>(lanes, value, gradient, self.affine);
                // Two sums of each hide some of the latency of the additions.
                let turn = start / L::COUNT % 2;
                sums[turn] = lanes.add(sums[turn], gradient);
                products[turn] = lanes.mul_add(gradient, lanes.sub(value, mean), products[turn]);
            });
            total += f64::from(lanes.sum(lanes.add(sums[0], sums[1])));
            product_total += f64::from(lanes.sum(lanes.add(products[0], products[1])));
        }
        (total, product_total)
    }
}

/// `to = scale gradient + slope (value - mean) + offset`
struct InputGradient<'a, const RELU: bool> {
    values: &'a [f32],
    gradient: &'a [f32],
    affine: Affine,
    mean: f32,
    slope: f32,
    offset: f32,
    to: *mut f32,
}

impl<const RELU: bool> Kernel for InputGradient<'_, RELU> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let (scale, mean) = (lanes.splat(self.affine.scale), lanes.splat(self.mean));
        let (slope, offset) = (lanes.splat(self.slope), lanes.splat(self.offset));
        let len = self.values.len();
        for_each_vector!(lanes, len, [value of self.values, 0.0; gradient of self.gradient, 0.0], |start, count| {
            let gradient = through::<L, RELU>(lanes, value, gradient, self.affine);
            let result = lanes.mul_add(slope, lanes.sub(value, mean), offset);
            let result = lanes.mul_add(gradient, scale, result);
            // SAFETY: `to` has as many elements as `values`.
            unsafe { store_first(lanes, self.to.add(start), result, count) };
        });
    }
}

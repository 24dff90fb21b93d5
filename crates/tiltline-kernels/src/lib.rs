//! CPU kernels for convolutional networks on slices of `f32`; no tensor library is known here.
//!
//! - [`Conv`]: 3x3 and 3x3x3 convolutions at stride 1 and 2, pointwise (1x1) ones, and their gradients.
//! - [`TransposedConv`]: kernel 2x2 with stride 2 (U-Net) and 3x3x3 with stride 2 (hourglass), and their gradients.
//! - [`BatchNorm`]: batch norm and ReLU in one, in training; [`fold_batch_norm`] puts it into a convolution for inference.
//! - [`MaxPool`]: the largest of 2x2.
//!
//! Arrays are contiguous, `[batch, channel, (depth,) row, column]`; weights are laid out as PyTorch and burn lay them out.
//!
//! Every kernel takes a [`Path`], the instruction set it runs on ([`Path::best`] for the machine's best one). For one path, results
//! are bit-equal for any number of threads: work is cut by shape alone, and partial sums are added in index order. Between
//! paths they differ by rounding.
//!
//! How it works: `coupling` says which fine element meets which coarse element through which weight; two drivers use it.
//! `correlate` computes convolutions and everything that is a convolution in disguise, `outer` the gradients of weights.
//! Both gather a block of their input into a dense, zero-padded buffer that fits the second-level cache (`gather`), in which
//! each weight is one fixed offset, and run a register tile over it. `lanes` is the only place that names instructions.
//!
//! ```
//! use tiltline_kernels::{Activation, Conv, Path};
//! # fn main() -> Result<(), tiltline_kernels::ShapeError> {
//! let conv = Conv::plane(1, 1, 1, [3, 3], 1)?;
//! let ones = [1.0; 9];
//! let neighbours = conv.forward(Path::best(), &ones, &ones, None, Activation::Identity);
//! assert_eq!(neighbours, [4.0, 6.0, 4.0, 6.0, 9.0, 6.0, 4.0, 6.0, 4.0]);
//! # Ok(())
//! # }
//! ```

// Register tiles are indexed by two counters at once; iterators over them say less.
#![allow(clippy::needless_range_loop)]

mod conv;
mod correlate;
mod coupling;
mod fold;
mod gather;
mod lanes;
mod memory;
mod norm;
mod outer;
mod path;
mod pool;
mod scratch;
mod shape;
mod sums;
mod tile;
mod transposed;

pub use conv::{Activation, Conv};
pub use fold::{BatchNormStatistics, fold_batch_norm};
pub use memory::keep_freed_memory;
pub use norm::{BatchNorm, BatchNormGradients, Normalised};
pub use path::{Instructions, Path};
pub use pool::MaxPool;
pub use shape::ShapeError;
pub use transposed::TransposedConv;

//! The detector and the matcher of Tiltline as networks: definition, losses, training, weights.
//!
//! The only crate that names the tensor library (burn). Tensors are `[batch, channel, (depth,) row, column]`.

pub mod config;
pub mod data;
pub mod detector;
pub mod device;
pub mod figures;
pub mod flatten;
pub mod infer;
pub mod layers;
pub mod losses;
pub mod matcher;
pub mod networks;
pub mod ops;
pub mod score;
pub mod train;
pub mod volume;
pub mod weights;

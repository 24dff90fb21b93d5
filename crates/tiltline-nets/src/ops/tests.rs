use super::*;
use burn::tensor::{Distribution, TensorData};

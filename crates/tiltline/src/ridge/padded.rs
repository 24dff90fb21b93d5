//! An image with a mirrored margin (`c b a | a b c`), for kernels given as lists of offsets. `[row, column]`, px.

use ndarray::Array2;
use rayon::prelude::*;

use crate::filter::mirror;

/// The image with a mirrored margin, so that rows can be read at any offset of the kernels.
pub(super) struct Padded {
    values: Vec<f32>,
    stride: usize,
    margin: usize,
}

impl Padded {
    /// An image with `margin` px of its mirror image on every side.
    pub fn new(image: &Array2<f32>, margin: usize) -> Self {
        let (height, width) = image.dim();
        let stride = width + 2 * margin;
        let mut values = vec![0.0; stride * (height + 2 * margin)];
        values.par_chunks_mut(stride).enumerate().for_each(|(row, out)| {
            let row = mirror(row as isize - margin as isize, height);
            for (column, value) in out.iter_mut().enumerate() {
                *value = image[[row, mirror(column as isize - margin as isize, width)]];
            }
        });
        Self { values, stride, margin }
    }

    /// `count` values of a row from a column on; both may lie in the margin.
    pub fn row(&self, row: isize, column: isize, count: usize) -> &[f32] {
        let start = (row + self.margin as isize) as usize * self.stride + (column + self.margin as isize) as usize;
        &self.values[start..start + count]
    }
}

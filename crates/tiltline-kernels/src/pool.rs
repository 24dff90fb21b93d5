//! 2x2 max-pool.

use crate::lanes::Lanes;
use crate::path::{Kernel, Path};
use crate::scratch::{Output, fill_output};
use crate::shape::{ShapeError, assert_len, check};
use rayon::prelude::*;

/// The shape of a 2x2 max-pool with stride 2 over `[planes, rows, columns]`; an odd last row or column is left out, as in PyTorch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MaxPool {
    planes: usize,
    rows: usize,
    columns: usize,
}

impl MaxPool {
    /// Over `planes` (batch times channels) of `[rows, columns]`.
    ///
    /// # Errors
    ///
    /// No planes, a side below 2, or more elements than can be addressed.
    pub fn new(planes: usize, [rows, columns]: [usize; 2]) -> Result<Self, ShapeError> {
        check(&[("planes", planes), ("pairs of rows", rows / 2), ("pairs of columns", columns / 2)])?;
        Ok(Self { planes, rows, columns })
    }

    /// Elements of the input.
    #[must_use]
    pub fn input_len(&self) -> usize {
        self.planes * self.rows * self.columns
    }

    /// Elements of the output.
    #[must_use]
    pub fn output_len(&self) -> usize {
        self.planes * (self.rows / 2) * (self.columns / 2)
    }

    /// The largest of each 2x2 block; NaN if there is one in it.
    ///
    /// # Panics
    ///
    /// If the input has not the length that the shape asks for.
    #[must_use]
    pub fn forward(&self, path: Path, input: &[f32]) -> Vec<f32> {
        assert_len("the input", input.len(), self.input_len());
        let plane_len = (self.rows / 2) * (self.columns / 2);
        let fill = |output: Output| {
            (0..self.planes).into_par_iter().for_each(|plane| {
                let to = output.part(plane * plane_len, plane_len);
                path.run(PoolPlane { from: &input[plane * self.rows * self.columns..], pool: self, to });
            });
        };
        // SAFETY: each plane is written by one task, whole.
        unsafe { fill_output(self.output_len(), fill) }
    }

    /// The loss's gradient for the input, from that for the output: it goes to the largest value of the block, to the
    /// first in row-major order where several are.
    ///
    /// # Panics
    ///
    /// If a slice has not the length that the shape asks for.
    #[must_use]
    pub fn input_gradient(&self, path: Path, input: &[f32], output_gradient: &[f32]) -> Vec<f32> {
        assert_len("the input", input.len(), self.input_len());
        assert_len("the output's gradient", output_gradient.len(), self.output_len());
        let (plane_len, pooled_len) = (self.rows * self.columns, (self.rows / 2) * (self.columns / 2));
        let fill = |output: Output| {
            (0..self.planes).into_par_iter().for_each(|plane| {
                path.run(UnpoolPlane {
                    from: &input[plane * plane_len..][..plane_len],
                    gradient: &output_gradient[plane * pooled_len..][..pooled_len],
                    pool: self,
                    to: output.part(plane * plane_len, plane_len),
                });
            });
        };
        // SAFETY: each plane is written by one task, whole.
        unsafe { fill_output(self.input_len(), fill) }
    }
}

/// Keeps NaN, unlike `f32::max`.
fn larger(a: f32, b: f32) -> f32 {
    if b > a || b.is_nan() { b } else { a }
}

struct PoolPlane<'a> {
    from: &'a [f32],
    pool: &'a MaxPool,
    to: *mut f32,
}

impl Kernel for PoolPlane<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let (columns, pooled) = (self.pool.columns, self.pool.columns / 2);
        for row in 0..self.pool.rows / 2 {
            let (upper, lower) = self.from[2 * row * columns..][..2 * columns].split_at(columns);
            let to = self.to.wrapping_add(row * pooled);
            let mut column = 0;
            // SAFETY: `column + L::COUNT <= pooled`, and rows have at least twice `pooled` values; `to` is a row of this
            // plane's output, of `pooled` values.
            unsafe {
                while column + L::COUNT <= pooled {
                    let [a, b] = lanes.load_deinterleaved(upper.as_ptr().add(2 * column));
                    let [c, d] = lanes.load_deinterleaved(lower.as_ptr().add(2 * column));
                    lanes.store(to.add(column), lanes.max(lanes.max(a, b), lanes.max(c, d)));
                    column += L::COUNT;
                }
            }
            for column in column..pooled {
                let [a, b, c, d] = [upper[2 * column], upper[2 * column + 1], lower[2 * column], lower[2 * column + 1]];
                // SAFETY: as above.
                unsafe { to.add(column).write(larger(larger(a, b), larger(c, d))) };
            }
        }
    }
}

struct UnpoolPlane<'a> {
    from: &'a [f32],
    gradient: &'a [f32],
    pool: &'a MaxPool,
    to: *mut f32,
}

impl Kernel for UnpoolPlane<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let (rows, columns, pooled) = (self.pool.rows, self.pool.columns, self.pool.columns / 2);
        for row in 0..rows / 2 {
            let (upper, lower) = self.from[2 * row * columns..][..2 * columns].split_at(columns);
            let gradient = &self.gradient[row * pooled..][..pooled];
            // Two rows of the output.
            let to = self.to.wrapping_add(2 * row * columns);
            let mut column = 0;
            // SAFETY: `column + L::COUNT <= pooled`, `gradient` has `pooled` values, and rows of input and output have at
            // least twice as many.
            unsafe {
                while column + L::COUNT <= pooled {
                    let [a, b] = lanes.load_deinterleaved(upper.as_ptr().add(2 * column));
                    let [c, d] = lanes.load_deinterleaved(lower.as_ptr().add(2 * column));
                    let largest = lanes.max(lanes.max(a, b), lanes.max(c, d));
                    // What no earlier value of the block has taken.
                    let not_a = lanes.load(gradient.as_ptr().add(column));
                    let not_b = lanes.keep_where_unequal(a, largest, not_a);
                    let not_c = lanes.keep_where_unequal(b, largest, not_b);
                    let not_d = lanes.keep_where_unequal(c, largest, not_c);
                    let (a, b) = (lanes.keep_where_equal(a, largest, not_a), lanes.keep_where_equal(b, largest, not_b));
                    lanes.store_interleaved(to.add(2 * column), a, b);
                    lanes.store_interleaved(
                        to.add(columns + 2 * column),
                        lanes.keep_where_equal(c, largest, not_c),
                        not_d,
                    );
                    column += L::COUNT;
                }
            }
            for column in column..pooled {
                let block = [upper[2 * column], upper[2 * column + 1], lower[2 * column], lower[2 * column + 1]];
                let largest = larger(larger(block[0], block[1]), larger(block[2], block[3]));
                let first = if block[0] == largest {
                    0
                } else if block[1] == largest {
                    1
                } else if block[2] == largest {
                    2
                } else {
                    3
                };
                let mut shares = [0.0; 4];
                shares[first] = gradient[column];
                // SAFETY: both pairs lie in the two rows of the output.
                unsafe {
                    to.add(2 * column).cast::<[f32; 2]>().write([shares[0], shares[1]]);
                    to.add(columns + 2 * column).cast::<[f32; 2]>().write([shares[2], shares[3]]);
                }
            }
            if columns % 2 == 1 {
                // SAFETY: the last column of the two rows.
                unsafe {
                    to.add(columns - 1).write(0.0);
                    to.add(2 * columns - 1).write(0.0);
                }
            }
        }
        if rows % 2 == 1 {
            for column in 0..columns {
                // SAFETY: the last row of this plane.
                unsafe { self.to.add((rows - 1) * columns + column).write(0.0) };
            }
        }
    }
}

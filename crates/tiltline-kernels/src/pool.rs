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
#[inline(always)]
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
    fn run<L: Lanes>(self, _: L) {
        let (columns, pooled) = (self.pool.columns, self.pool.columns / 2);
        for row in 0..self.pool.rows / 2 {
            let (upper, lower) = self.from[2 * row * columns..][..2 * columns].split_at(columns);
            let pairs = upper.as_chunks::<2>().0.iter().zip(lower.as_chunks::<2>().0);
            for (column, (upper, lower)) in pairs.enumerate() {
                let value = larger(larger(upper[0], upper[1]), larger(lower[0], lower[1]));
                // SAFETY: `to` is this plane of the output, `rows / 2` by `columns / 2`; an odd last column has no pair.
                unsafe { self.to.add(row * pooled + column).write(value) };
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
    fn run<L: Lanes>(self, _: L) {
        let (rows, columns) = (self.pool.rows, self.pool.columns);
        for row in 0..rows / 2 {
            let (upper, lower) = self.from[2 * row * columns..][..2 * columns].split_at(columns);
            let pairs = upper.as_chunks::<2>().0.iter().zip(lower.as_chunks::<2>().0);
            let gradient = &self.gradient[row * (columns / 2)..][..columns / 2];
            for (column, ((upper, lower), &gradient)) in pairs.zip(gradient).enumerate() {
                let largest = larger(larger(upper[0], upper[1]), larger(lower[0], lower[1]));
                let first = upper[0] == largest;
                let second = !first & (upper[1] == largest);
                let third = !first & !second & (lower[0] == largest);
                let fourth = !first & !second & !third;
                let upper = [if first { gradient } else { 0.0 }, if second { gradient } else { 0.0 }];
                let lower = [if third { gradient } else { 0.0 }, if fourth { gradient } else { 0.0 }];
                let to = self.to.wrapping_add(2 * row * columns + 2 * column);
                // SAFETY: `to` is this plane of the output, as large as the input's; both pairs lie in it.
                unsafe {
                    to.cast::<[f32; 2]>().write(upper);
                    to.add(columns).cast::<[f32; 2]>().write(lower);
                }
            }
            if columns % 2 == 1 {
                for row in [2 * row, 2 * row + 1] {
                    // SAFETY: the last column of a row of this plane.
                    unsafe { self.to.add((row + 1) * columns - 1).write(0.0) };
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

//! Cross-correlation of square windows by the fast Fourier transform.

use std::sync::Arc;

use rustfft::num_complex::Complex32;
use rustfft::{Fft, FftPlanner};

/// Plans for windows of one size; shared between threads.
#[derive(Clone)]
pub struct Correlator {
    side: usize,
    forward: Arc<dyn Fft<f32>>,
    inverse: Arc<dyn Fft<f32>>,
}

/// Buffers of one thread.
pub struct Workspace {
    /// `[row * side + column]`: the left window as real, the right one as imaginary part; afterwards the correlation.
    pub window: Vec<Complex32>,
    turned: Vec<Complex32>,
    scratch: Vec<Complex32>,
}

impl Correlator {
    /// For windows of `side` x `side` px.
    pub fn new(side: usize) -> Self {
        let mut planner = FftPlanner::new();
        Self { side, forward: planner.plan_fft_forward(side), inverse: planner.plan_fft_inverse(side) }
    }

    /// Buffers, all zero.
    pub fn workspace(&self) -> Workspace {
        let zeros = |count| vec![Complex32::default(); count];
        let scratch = self.forward.get_inplace_scratch_len().max(self.inverse.get_inplace_scratch_len());
        Workspace {
            window: zeros(self.side * self.side),
            turned: zeros(self.side * self.side),
            scratch: zeros(scratch),
        }
    }

    /// Replaces the window by `sum over p of left(p) right(p + d)` (real part) at `[d.y mod side, d.x mod side]`.
    pub fn correlate(&self, workspace: &mut Workspace) {
        let side = self.side;
        let Workspace { window, turned, scratch } = workspace;
        self.forward.process_with_scratch(window, scratch);
        transpose(window, turned, side);
        self.forward.process_with_scratch(turned, scratch);
        // Both spectra from that of left + i right: the parts of it that are even and odd under conjugation.
        let gain = 1.0 / (side * side) as f32;
        for row in 0..side {
            let opposite_row = (side - row) % side;
            for column in 0..side {
                let here = turned[row * side + column];
                let opposite = turned[opposite_row * side + (side - column) % side].conj();
                let left = (here + opposite) * 0.5;
                let right = (here - opposite) * Complex32::new(0.0, -0.5);
                window[row * side + column] = left.conj() * right * gain;
            }
        }
        self.inverse.process_with_scratch(window, scratch);
        transpose(window, turned, side);
        self.inverse.process_with_scratch(turned, scratch);
        std::mem::swap(window, turned);
    }
}

fn transpose(from: &[Complex32], to: &mut [Complex32], side: usize) {
    /// Squares of so many px fit the first-level cache.
    const TILE: usize = 16;
    for rows in (0..side).step_by(TILE) {
        for columns in (0..side).step_by(TILE) {
            for row in rows..(rows + TILE).min(side) {
                for column in columns..(columns + TILE).min(side) {
                    to[column * side + row] = from[row * side + column];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    #[test]
    fn it_is_the_sum_of_products_at_every_shift() {
        let side = 20;
        let mut rng = Pcg64::seed_from_u64(1);
        let correlator = Correlator::new(side);
        let mut workspace = correlator.workspace();
        workspace.window.fill_with(|| Complex32::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0)));
        let input = workspace.window.clone();
        correlator.correlate(&mut workspace);
        for (dy, dx) in [(0, 0), (3, 17), (19, 1), (10, 10)] {
            let mut sum = 0.0;
            for (y, x) in (0..side).flat_map(|y| (0..side).map(move |x| (y, x))) {
                sum += input[y * side + x].re * input[(y + dy) % side * side + (x + dx) % side].im;
            }
            // 400 products of numbers up to 1 in single precision.
            assert!((workspace.window[dy * side + dx].re - sum).abs() < 1e-4, "{dy} {dx}");
            assert!(workspace.window[dy * side + dx].im.abs() < 1e-4);
        }
    }
}

//! Shift between two images by phase correlation (Kuglin and Hines 1975).
//!
//! The spectra's phases alone are compared, so that slow changes of grey and contrast count no more than the lines; high
//! frequencies, which are noise, are damped, and the images fade out towards their rims.

use std::f64::consts::PI;
use std::sync::Arc;

use ndarray::Array2;
use rustfft::num_complex::Complex32;
use rustfft::{Fft, FftPlanner};

use crate::geometry::Vector2;

/// Standard deviation of the damping of high frequencies, cycles per px.
const LOW_PASS: f64 = 0.12;
/// Frequencies below this are slow changes of grey, cycles per px.
const HIGH_PASS: f64 = 0.01;
/// The rim over which images fade out, as a share of their sides.
const RIM: f64 = 0.15;

/// Plans for square windows of one size.
pub(super) struct PhaseCorrelator {
    side: usize,
    forward: Arc<dyn Fft<f32>>,
    inverse: Arc<dyn Fft<f32>>,
}

/// The shift found, and how far it stands out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Shift {
    /// What is at p in the first image is at p + shift in the second, px.
    pub shift: Vector2,
    /// Height of the peak over the root mean square of the rest.
    pub contrast: f64,
}

impl PhaseCorrelator {
    /// For images of up to `side` x `side` px.
    pub fn new(side: usize) -> Self {
        let mut planner = FftPlanner::new();
        Self { side, forward: planner.plan_fft_forward(side), inverse: planner.plan_fft_inverse(side) }
    }

    /// Spectrum `[column frequency, row frequency]` of an image without its mean, faded out at the rims.
    pub fn spectrum(&self, image: &Array2<f32>) -> Vec<Complex32> {
        let side = self.side;
        let (height, width) = image.dim();
        let fade = |at: usize, length: usize| {
            let rim = (RIM * length as f64).max(1.0);
            let inside = (at.min(length - 1 - at) as f64 + 0.5) / rim;
            if inside >= 1.0 { 1.0 } else { 0.5 - 0.5 * (PI * inside).cos() }
        };
        let columns: Vec<f32> = (0..width).map(|column| fade(column, width) as f32).collect();
        let mean = image.mean().unwrap_or(0.0);
        let mut values = vec![Complex32::default(); side * side];
        for (row, line) in image.rows().into_iter().enumerate() {
            let weight = fade(row, height) as f32;
            for (column, value) in line.iter().enumerate() {
                values[row * side + column] = Complex32::new((value - mean) * weight * columns[column], 0.0);
            }
        }
        self.forward.process(&mut values);
        let mut turned = transposed(&values, side);
        self.forward.process(&mut turned);
        turned
    }

    /// The shift from the first image to the second, from their spectra.
    pub fn shift(&self, first: &[Complex32], second: &[Complex32]) -> Shift {
        let side = self.side;
        let frequency = |index: usize| {
            let index = index as f64;
            (if index > 0.5 * side as f64 { index - side as f64 } else { index }) / side as f64
        };
        let mut cross: Vec<Complex32> = Vec::with_capacity(side * side);
        for (index, (a, b)) in first.iter().zip(second).enumerate() {
            let (fx, fy) = (frequency(index / side), frequency(index % side));
            let squared = fx * fx + fy * fy;
            let pass = 1.0 - (-0.5 * squared / (HIGH_PASS * HIGH_PASS)).exp();
            let weight = (-0.5 * squared / (LOW_PASS * LOW_PASS)).exp() * pass;
            let product = a.conj() * b;
            let size = product.norm();
            cross.push(if size > 0.0 { product * (weight as f32 / size) } else { Complex32::default() });
        }
        self.inverse.process(&mut cross);
        let mut map = transposed(&cross, side);
        self.inverse.process(&mut map);
        let (mut best, mut squares) = (0, 0.0);
        for (index, value) in map.iter().enumerate() {
            squares += f64::from(value.re * value.re);
            if value.re > map[best].re {
                best = index;
            }
        }
        let rms = (squares / (side * side) as f64).sqrt().max(f64::MIN_POSITIVE);
        let (row, column) = (best / side, best % side);
        let at = |row: usize, column: usize| f64::from(map[(row % side) * side + column % side].re);
        let peak = at(row, column);
        let x = vertex(at(row, column + side - 1), peak, at(row, column + 1));
        let y = vertex(at(row + side - 1, column), peak, at(row + 1, column));
        let signed = |index: usize| frequency(index) * side as f64;
        Shift { shift: Vector2::new(signed(column) + x, signed(row) + y), contrast: peak / rms }
    }
}

/// Place of the vertex of a parabola through three neighbours, from the middle one.
fn vertex(before: f64, middle: f64, after: f64) -> f64 {
    let bend = 2.0 * middle - before - after;
    if bend > 0.0 { (0.5 * (after - before) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}

fn transposed(values: &[Complex32], side: usize) -> Vec<Complex32> {
    let mut turned = vec![Complex32::default(); values.len()];
    for row in 0..side {
        for column in 0..side {
            turned[column * side + row] = values[row * side + column];
        }
    }
    turned
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::{Scene, SceneSettings, ViewSettings, render};

    #[test]
    fn a_shifted_image_is_found_to_a_fraction_of_a_px() {
        let scene = Scene::random(&SceneSettings { size_px: 256.0, ..SceneSettings::default() });
        let view = |shift_px: [f64; 2], seed| {
            render(&scene, &ViewSettings { shape: [200, 256], shift_px, seed, ..ViewSettings::default() }).pixels
        };
        let correlator = PhaseCorrelator::new(256);
        let [first, second] = [view([0.0, 0.0], 1), view([17.3, -9.6], 2)].map(|image| correlator.spectrum(&image));
        let found = correlator.shift(&first, &second);
        // What was at p is now at p + (17.3, -9.6).
        assert!((found.shift - Vector2::new(17.3, -9.6)).norm() < 0.25, "{found:?}");
        assert!(found.contrast > 10.0, "{found:?}");
    }
}

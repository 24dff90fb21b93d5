//! Smooth random fields over the foil: backgrounds, roughness, strain.

use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// A random field of mean 0 and variance about 1, smooth on the scale of its grid; it repeats far outside the foil.
#[derive(Clone, Debug)]
pub struct SmoothField {
    per_px: f64,
    side: usize,
    values: Vec<f32>,
}

/// Cubic B-spline weights leave this standard deviation of white grid values (mean over a cell, in two dimensions); the
/// values are divided by it.
const SPLINE_DEVIATION: f32 = 0.479;

impl SmoothField {
    /// A field over about `extent_px` whose features are `length_px` in size.
    pub fn new(rng: &mut Pcg64, extent_px: f64, length_px: f64) -> Self {
        let side = ((extent_px / length_px).ceil() as usize + 4).clamp(4, 2048);
        let values = (0..side * side).map(|_| {
            let value: f32 = StandardNormal.sample(rng);
            value / SPLINE_DEVIATION
        });
        Self { per_px: 1.0 / length_px, side, values: values.collect() }
    }

    /// The field at a point of the foil (origin at its centre), by cubic B-splines.
    pub fn at(&self, x: f64, y: f64) -> f32 {
        let half = 0.5 * self.side as f64;
        let (u, v) = (x * self.per_px + half, y * self.per_px + half);
        let (column, row) = (u.floor(), v.floor());
        let (weights_x, weights_y) = (spline_weights((u - column) as f32), spline_weights((v - row) as f32));
        let wrap = |index: f64| (index as i64).rem_euclid(self.side as i64) as usize;
        let columns: [usize; 4] = std::array::from_fn(|i| wrap(column - 1.0 + i as f64));
        let mut sum = 0.0;
        for (i, weight_y) in weights_y.iter().enumerate() {
            let line = wrap(row - 1.0 + i as f64) * self.side;
            let mut part = 0.0;
            for (weight_x, column) in weights_x.iter().zip(columns) {
                part += weight_x * self.values[line + column];
            }
            sum += weight_y * part;
        }
        sum
    }
}

fn spline_weights(t: f32) -> [f32; 4] {
    let s = 1.0 - t;
    let (t2, t3) = (t * t, t * t * t);
    [s * s * s / 6.0, (3.0 * t3 - 6.0 * t2 + 4.0) / 6.0, (-3.0 * t3 + 3.0 * t2 + 3.0 * t + 1.0) / 6.0, t3 / 6.0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn a_field_has_mean_zero_variance_one_and_no_jumps() {
        let field = SmoothField::new(&mut Pcg64::seed_from_u64(1), 4000.0, 10.0);
        let values: Vec<f64> = (0..90_000)
            .map(|i| f64::from(field.at((i % 300) as f64 * 11.3 - 1700.0, (i / 300) as f64 * 11.3 - 1700.0)))
            .collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64;
        // 300 x 300 nearly independent values: three standard errors of the mean are 0.01, of the variance 0.014; the
        // splines' own correlation triples that.
        assert!(mean.abs() < 0.05 && (variance - 1.0).abs() < 0.08, "{mean} {variance}");
        for i in 0..1000 {
            let x = i as f64 * 0.5 - 250.0;
            assert!((field.at(x + 0.01, 3.0) - field.at(x, 3.0)).abs() < 0.02);
        }
    }
}

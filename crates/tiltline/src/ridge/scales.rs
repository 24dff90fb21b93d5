//! The scale space of an image: Gaussian-blurred copies, the coarse ones on coarser grids.
//!
//! Scales are standard deviations in px of the rectified image; a level halves the grid (2x2 mean after a blur that
//! keeps aliasing below a percent), so that level pixel `i` lies at `2^level (i + 1/2) - 1/2` of the full grid.

use ndarray::Array2;

use crate::filter::{gaussian_blur, sample_cubic};
use crate::geometry::{Point2, Vector2};

/// Blur before a grid is halved, px of that grid.
const BLUR_BEFORE_HALVING: f64 = 0.9;
/// Variance of the 2x2 mean, px^2 of the fine grid.
const VARIANCE_OF_MEAN: f64 = 0.25;

/// One scale of an image.
pub(super) struct Scale {
    /// Standard deviation of the blur in px of the full grid.
    pub sigma_px: f64,
    /// Grid spacing is `2^level` px.
    pub level: u32,
    /// The blurred image on the grid of its level.
    pub image: Array2<f32>,
}

impl Scale {
    /// Grid spacing in px.
    pub fn spacing(&self) -> f64 {
        f64::from(1_u32 << self.level)
    }

    /// Standard deviation in px of its own grid.
    pub fn sigma_on_grid(&self) -> f64 {
        self.sigma_px / self.spacing()
    }

    /// Intensity at a point of the full grid (cubic interpolation); the nearest inside it at the border.
    pub fn sample(&self, point: Point2) -> f32 {
        let (height, width) = self.image.dim();
        let to_grid = |value: f64, count: usize| ((value + 0.5) / self.spacing() - 0.5).clamp(0.0, count as f64 - 1.0);
        let (x, y) = (to_grid(point.x, width), to_grid(point.y, height));
        sample_cubic(&self.image.view(), x, y).unwrap_or(0.0)
    }

    /// Values at `-step, 0, step` along a unit direction.
    pub fn across(&self, point: Point2, direction: Vector2, step_px: f64) -> [f32; 3] {
        [-step_px, 0.0, step_px].map(|offset| self.sample(point + direction * offset))
    }
}

/// The scales `sigmas_px` (ascending) of an image.
pub(super) fn scale_space(image: &Array2<f32>, sigmas_px: &[f64]) -> Vec<Scale> {
    let mut scales = Vec::with_capacity(sigmas_px.len());
    let (mut base, mut variance, mut level) = (image.clone(), 0.0, 0_u32);
    for &sigma_px in sigmas_px {
        // On its own grid a scale has between 1 and 2 px, so that differences of neighbours are good derivatives.
        while sigma_px / f64::from(1_u32 << level) >= 1.9 && base.dim().0 >= 16 && base.dim().1 >= 16 {
            let spacing2 = f64::from(1_u32 << (2 * level));
            base = halve(&gaussian_blur(&base, BLUR_BEFORE_HALVING));
            variance += spacing2 * (BLUR_BEFORE_HALVING.powi(2) + VARIANCE_OF_MEAN);
            level += 1;
        }
        let missing = (sigma_px * sigma_px - variance).max(0.0).sqrt() / f64::from(1_u32 << level);
        scales.push(Scale { sigma_px, level, image: gaussian_blur(&base, missing) });
    }
    scales
}

/// Mean of blocks of 2x2; a last odd row or column is repeated.
pub(super) fn halve(image: &Array2<f32>) -> Array2<f32> {
    let (height, width) = image.dim();
    Array2::from_shape_fn((height.div_ceil(2), width.div_ceil(2)), |(row, column)| {
        let rows = [2 * row, (2 * row + 1).min(height - 1)];
        let columns = [2 * column, (2 * column + 1).min(width - 1)];
        let sum: f32 = rows.iter().flat_map(|row| columns.map(|column| image[[*row, column]])).sum();
        0.25 * sum
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn every_scale_of_a_gaussian_line_has_the_variance_of_line_and_blur() {
        // A vertical line of sigma 2 at x = 40.3; blurred by s its peak is 2 / sqrt(4 + s^2).
        let image = Array2::from_shape_fn((96, 96), |(_, x)| (-0.5 * ((x as f32 - 40.3) / 2.0).powi(2)).exp());
        for scale in scale_space(&image, &[1.0, 1.5, 2.0, 3.0, 4.0, 6.0]) {
            let expected = 2.0 / (4.0 + scale.sigma_px.powi(2)).sqrt();
            let peak = scale.sample(Point2::new(40.3, 48.0));
            // Cubic interpolation of a profile of sigma 1.1 grid px loses up to 2.5 percent at its peak.
            assert_relative_eq!(f64::from(peak), expected, max_relative = 0.03);
            let [left, _, right] = scale.across(Point2::new(40.3, 48.0), Vector2::x(), scale.sigma_px);
            assert_relative_eq!(left, right, max_relative = 0.05);
        }
    }
}

//! Images of other magnifications: halved until lines are as wide as the detector knows them, and maps brought back.
//!
//! Pixel `(x, y)` of a halved image covers pixels `2x, 2x + 1` of the image: its centre lies at `2x + 1/2`.

use ndarray::Array2;
use tiltline::filter::{gaussian_blur, sample_linear};

/// Blur before halving, px: less would alias grain, more would widen lines.
const BLUR_PX: f64 = 0.6;

/// Half the sides (an odd last row or column is left out); NaN where any of the four pixels is.
pub fn halved(image: &Array2<f32>) -> Array2<f32> {
    let filled = image.mapv(|value| if value.is_finite() { value } else { 0.0 });
    let mut smooth = gaussian_blur(&filled, BLUR_PX);
    if image.iter().any(|value| !value.is_finite()) {
        // What has no data counts for nothing.
        let known = gaussian_blur(&image.mapv(|value| f32::from(u8::from(value.is_finite()))), BLUR_PX);
        smooth.zip_mut_with(&known, |value, share| *value /= share.max(1e-6));
    }
    Array2::from_shape_fn((image.nrows() / 2, image.ncols() / 2), |(row, column)| {
        let four = [[0, 0], [0, 1], [1, 0], [1, 1]].map(|[down, right]| [2 * row + down, 2 * column + right]);
        if four.iter().any(|at| !image[*at].is_finite()) {
            return f32::NAN;
        }
        four.iter().map(|at| smooth[*at]).sum::<f32>() / 4.0
    })
}

/// Where a place of an image lies in the image halved `octave` times, px.
pub fn halved_at(at: f64, octave: u32) -> f64 {
    (at + 0.5) / f64::from(1_u32 << octave) - 0.5
}

/// A map of an image that was halved `octave` times, on the grid of the image.
pub fn enlarged(map: &Array2<f32>, octave: u32, shape: (usize, usize)) -> Array2<f32> {
    if octave == 0 {
        return map.clone();
    }
    let (last_row, last_column) = (map.nrows().saturating_sub(1) as f64, map.ncols().saturating_sub(1) as f64);
    Array2::from_shape_fn(shape, |(row, column)| {
        let at = |index: usize, last: f64| halved_at(index as f64, octave).clamp(0.0, last);
        sample_linear(&map.view(), at(column, last_column), at(row, last_row)).unwrap_or(0.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ramp halved and enlarged is the ramp: nothing is shifted by half a pixel.
    #[test]
    fn nothing_moves() {
        let ramp = Array2::from_shape_fn((64, 48), |(row, column)| row as f32 + 10.0 * column as f32);
        let back = enlarged(&halved(&halved(&ramp)), 2, ramp.dim());
        for row in 8..56 {
            for column in 8..40 {
                assert!((back[[row, column]] - ramp[[row, column]]).abs() < 1e-2, "{row} {column}");
            }
        }
    }

    #[test]
    fn no_data_stays_no_data() {
        let mut image = Array2::zeros((8, 8));
        image[[3, 5]] = f32::NAN;
        let half = halved(&image);
        assert!(half[[1, 2]].is_nan() && half.iter().filter(|value| value.is_nan()).count() == 1);
    }
}

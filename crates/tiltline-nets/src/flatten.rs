//! What networks see of an image: its deviation from the mean about each pixel, in units of the deviation about it.
//!
//! A dislocation is a small change on a background that may be anything: in a dark lamella its contrast is a hundredth of the
//! image's range. Seen against its surroundings it looks the same everywhere, and against noise as clear as it is.

use ndarray::{Array2, Zip};
use tiltline::filter::gaussian_blur;

/// Standard deviation of the Gaussian that means are taken over, px: several times as wide as a line.
const SURROUNDINGS_PX: f64 = 12.0;
/// Added to deviations, so that faint grain in flat parts stays faint; the image's range is 1.
const LEAST_DEVIATION: f32 = 0.02;
/// Largest value either way.
const LARGEST: f32 = 4.0;

/// The flattened image `[row, column]`, without unit, of a normalised one; 0 where there is no data (NaN), which counts for nothing.
pub fn flattened(image: &Array2<f32>) -> Array2<f32> {
    let known = image.mapv(|value| f32::from(u8::from(value.is_finite())));
    let complete = known.iter().all(|known| *known == 1.0);
    let share = (!complete).then(|| gaussian_blur(&known, SURROUNDINGS_PX));
    let mean_of = |values: &Array2<f32>| {
        let mut mean = gaussian_blur(values, SURROUNDINGS_PX);
        if let Some(share) = &share {
            mean.zip_mut_with(share, |mean, share| *mean /= share.max(1e-6));
        }
        mean
    };
    let mut deviation = image.mapv(|value| if value.is_finite() { value } else { 0.0 });
    let mean = mean_of(&deviation);
    Zip::from(&mut deviation)
        .and(&mean)
        .and(&known)
        .for_each(|value, mean, known| *value = if *known == 1.0 { *value - mean } else { 0.0 });
    let variance = mean_of(&deviation.mapv(|value| value * value));
    deviation.zip_mut_with(&variance, |value, variance| {
        *value = (*value / (variance.max(0.0).sqrt() + LEAST_DEVIATION)).clamp(-LARGEST, LARGEST);
    });
    deviation
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A line of half the contrast on a background of half the brightness looks nearly the same: only what is added to deviations
    /// tells them apart (2.6 and 2.4 deviations).
    #[test]
    fn faint_and_strong_lines_look_alike() {
        let line = |background: f32, depth: f32| {
            Array2::from_shape_fn((80, 80), |(_, column)| {
                background - depth * (-0.5 * (column as f32 - 40.0).powi(2) / 4.0).exp()
            })
        };
        let [strong, faint] = [line(0.9, 0.8), line(0.45, 0.4)].map(|image| flattened(&image)[[40, 40]]);
        assert!(strong < -2.0 && (strong - faint).abs() < 0.3, "{strong} {faint}");
    }

    #[test]
    fn what_has_no_data_is_zero_and_leaves_no_edge() {
        let mut image =
            Array2::from_shape_fn((60, 60), |(row, column)| 0.5 + 0.1 * ((row * 7 + column * 3) % 5) as f32);
        let whole = flattened(&image);
        image.slice_mut(ndarray::s![.., 40..]).fill(f32::NAN);
        let cut = flattened(&image);
        assert!(cut.slice(ndarray::s![.., 40..]).iter().all(|value| *value == 0.0));
        // The same texture on both sides: what lies beyond the border hardly changes what lies before it.
        for (a, b) in whole.slice(ndarray::s![.., ..40]).iter().zip(cut.slice(ndarray::s![.., ..40])) {
            assert!((a - b).abs() < 0.2, "{a} {b}");
        }
    }
}

//! Signal-to-noise ratio and contrast of an image, after the paper's Table 3 ("SnR (disloc.)", "SnR (backgr.)", "Contrast").
//!
//! The paper says that the ratio is measured separately on dislocations and background, and that contrast is the average
//! grey difference of dislocation cores and nearby background, but not how. Ours, on grey levels 0 to 255 (0.5 and 99.5
//! percentile stretched to the ends, so that the scale of the file does not matter):
//!
//! - noise of a region: 1.4826 times the median absolute response of the mask `[1 -2 1; -2 4 -2; 1 -2 1] / 6` (Immerkaer,
//!   "Fast noise variance estimation", CVIU 64, 1996, eq. 2), which planes and straight steps along x or y do not excite;
//! - signal-to-noise ratio of a region in dB: `20 log10(mean grey / noise)`, for the pixels of lines, and for those more than
//!   3 px off every line;
//! - contrast: mean over line pixels of (local background - grey), local background being the mean of the background pixels
//!   in a square of 25 px. Dark lines have positive contrast.
//!
//! Figures for the paper's images can be compared in size only. Noise that detector or scan correlates over neighbouring
//! pixels, or that resampling smoothed, is underestimated; curvature of lines under 3 px wide counts as noise of lines.

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use crate::filter::percentiles;
use crate::score::ScoreError;

/// Background pixels are further from every line than this, px.
const GAP_PX: usize = 3;
/// Half side of the square that local background is averaged over, px.
const NEAR_PX: usize = 12;
/// Noise below this share of a grey level cannot be told from none: images of 8 bits have steps of 1.
const LEAST_NOISE: f64 = 1e-3;

/// Statistics of one image with known lines.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImageStatistics {
    /// Share of pixels on lines.
    pub line_share: f64,
    /// Signal-to-noise ratio of the lines in dB; none without line pixels.
    pub snr_lines_db: Option<f64>,
    /// Signal-to-noise ratio of the background in dB; none without background.
    pub snr_background_db: Option<f64>,
    /// Mean of nearby background less line, grey levels of 255; none without lines beside background.
    pub contrast_grey: Option<f64>,
    /// Noise of the background in grey levels of 255.
    pub noise_background_grey: Option<f64>,
}

/// Statistics of an image `[row, column]` (any scale; pixels that are not finite are left out) whose lines are the true
/// pixels of `mask`: a mask 3 px wide from truth ([`crate::truth::curve_mask`]) or from detected lines.
///
/// # Errors
/// Where image and mask differ in size.
pub fn image_statistics(image: &Array2<f32>, mask: &Array2<bool>) -> Result<ImageStatistics, ScoreError> {
    if image.dim() != mask.dim() {
        return Err(ScoreError::MaskSize { image: image.dim().into(), mask: mask.dim().into() });
    }
    let [low, high] = percentiles(image, [0.005, 0.995]).map(f64::from);
    let gain = if high > low { 255.0 / (high - low) } else { 0.0 };
    let grey = image.mapv(|value| (f64::from(value) - low) * gain);
    let near_line = BoxSums::new(&mask.mapv(|line| f64::from(u8::from(line))));
    let is_background = Array2::from_shape_fn(grey.dim(), |(row, column)| {
        grey[[row, column]].is_finite() && near_line.around(row, column, GAP_PX) == 0.0
    });
    let zero_elsewhere =
        |(row, column): (usize, usize)| if is_background[[row, column]] { grey[[row, column]] } else { 0.0 };
    let background_sum = BoxSums::new(&Array2::from_shape_fn(grey.dim(), zero_elsewhere));
    let background_count = BoxSums::new(&is_background.mapv(|inside| f64::from(u8::from(inside))));
    let mut differences = Mean::default();
    for ((row, column), _) in mask.indexed_iter().filter(|(at, line)| **line && grey[*at].is_finite()) {
        let count = background_count.around(row, column, NEAR_PX);
        // A single stray pixel is not a background.
        if count >= NEAR_PX as f64 {
            differences.add(background_sum.around(row, column, NEAR_PX) / count - grey[[row, column]]);
        }
    }
    let lines = region(&grey, |at| mask[at]);
    let background = region(&grey, |at| is_background[at]);
    let ratio = |(mean, noise): (f64, f64)| 20.0 * (mean.max(LEAST_NOISE) / noise.max(LEAST_NOISE)).log10();
    Ok(ImageStatistics {
        line_share: mask.iter().filter(|line| **line).count() as f64 / mask.len().max(1) as f64,
        snr_lines_db: lines.map(ratio),
        snr_background_db: background.map(ratio),
        contrast_grey: differences.value(),
        noise_background_grey: background.map(|(_, noise)| noise),
    })
}

/// Mean and noise of a region.
fn region(grey: &Array2<f64>, inside: impl Fn((usize, usize)) -> bool) -> Option<(f64, f64)> {
    let (height, width) = grey.dim();
    let (mut mean, mut responses) = (Mean::default(), Vec::new());
    for ((row, column), value) in grey.indexed_iter().filter(|(at, value)| value.is_finite() && inside(*at)) {
        mean.add(*value);
        if row == 0 || column == 0 || row + 1 == height || column + 1 == width {
            continue;
        }
        let at = |down: usize, right: usize| grey[[row + down - 1, column + right - 1]];
        let corners = at(0, 0) + at(0, 2) + at(2, 0) + at(2, 2);
        let sides = at(0, 1) + at(1, 0) + at(1, 2) + at(2, 1);
        let response = (corners - 2.0 * sides + 4.0 * value) / 6.0;
        if response.is_finite() {
            responses.push(response.abs());
        }
    }
    if responses.is_empty() {
        return None;
    }
    let middle = responses.len() / 2;
    let (_, median, _) = responses.select_nth_unstable_by(middle, f64::total_cmp);
    Some((mean.value()?, 1.4826 * *median))
}

/// A running mean.
#[derive(Default)]
struct Mean {
    sum: f64,
    count: usize,
}

impl Mean {
    fn add(&mut self, value: f64) {
        (self.sum, self.count) = (self.sum + value, self.count + 1);
    }

    fn value(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / self.count as f64)
    }
}

/// Sums over squares in constant time (a summed-area table).
struct BoxSums {
    /// `[row, column]`: the sum over all pixels above and to the left.
    table: Array2<f64>,
}

impl BoxSums {
    fn new(values: &Array2<f64>) -> Self {
        let (height, width) = values.dim();
        let mut table = Array2::zeros([height + 1, width + 1]);
        for row in 0..height {
            let mut sum = 0.0;
            for column in 0..width {
                sum += values[[row, column]];
                table[[row + 1, column + 1]] = table[[row, column + 1]] + sum;
            }
        }
        Self { table }
    }

    /// The sum over the square of `2 radius + 1` pixels about a pixel, cut at the border.
    fn around(&self, row: usize, column: usize, radius: usize) -> f64 {
        let (height, width) = (self.table.nrows() - 1, self.table.ncols() - 1);
        let (top, bottom) = (row.saturating_sub(radius), (row + radius + 1).min(height));
        let (left, right) = (column.saturating_sub(radius), (column + radius + 1).min(width));
        let sum = &self.table;
        sum[[bottom, right]] - sum[[top, right]] - sum[[bottom, left]] + sum[[top, left]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    /// Grey 200 with noise 2, a slope of 10 from left to right, lines of grey 120, and ends of the scale at 0 and 255.
    fn image(noise: f64) -> (Array2<f32>, Array2<bool>) {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(5);
        let normal = Normal::new(0.0, noise).unwrap();
        let mask = Array2::from_shape_fn([240, 240], |(_, column)| column % 40 < 5 && column > 10);
        let image = Array2::from_shape_fn([240, 240], |(row, column)| match row {
            // One percent each, so that the percentiles meet them.
            0..3 => 0.0,
            237..240 => 255.0,
            _ => {
                let level = if mask[[row, column]] { 120.0 } else { 200.0 };
                (level + 10.0 * (column as f64 / 239.0 - 0.5) + normal.sample(&mut rng)) as f32
            }
        });
        (image, mask)
    }

    #[test]
    fn known_noise_and_contrast_are_measured() {
        let (image, mask) = image(2.0);
        let found = image_statistics(&image, &mask).unwrap();
        // Noise from 20,000 pixels to 2 percent, and the rows at the ends of the scale (2.5 percent of all): 0.4 dB.
        assert_abs_diff_eq!(found.snr_background_db.unwrap(), 20.0 * (200.0_f64 / 2.0).log10(), epsilon = 0.4);
        // Two of five columns of a line respond to its edges as well, where the edge is not straight: it is.
        assert_abs_diff_eq!(found.snr_lines_db.unwrap(), 20.0 * (120.0_f64 / 2.0).log10(), epsilon = 0.4);
        // The rows at the ends of the scale have no contrast: 2.5 percent of 80, and what they do to their neighbours.
        assert_abs_diff_eq!(found.contrast_grey.unwrap(), 80.0 * 0.975, epsilon = 1.5);
        assert_abs_diff_eq!(found.line_share, 25.0 / 240.0, epsilon = 1e-9);
    }

    #[test]
    fn the_scale_of_the_file_does_not_matter() {
        let (image, mask) = image(2.0);
        let scaled = image.mapv(|value| 3.0 * value + 1000.0);
        let (a, b) = (image_statistics(&image, &mask).unwrap(), image_statistics(&scaled, &mask).unwrap());
        // Rounding of f32 at 1700.
        assert_abs_diff_eq!(a.snr_background_db.unwrap(), b.snr_background_db.unwrap(), epsilon = 1e-2);
        assert_abs_diff_eq!(a.contrast_grey.unwrap(), b.contrast_grey.unwrap(), epsilon = 1e-2);
    }

    #[test]
    fn what_cannot_be_measured_is_none() {
        let (image, mask) = image(1.0);
        let nothing = image_statistics(&image, &mask.mapv(|_| false)).unwrap();
        assert_eq!((nothing.snr_lines_db, nothing.contrast_grey), (None, None));
        let everything = image_statistics(&image, &mask.mapv(|_| true)).unwrap();
        assert_eq!((everything.snr_background_db, everything.contrast_grey), (None, None));
        assert!(image_statistics(&image, &Array2::from_elem([3, 3], true)).is_err());
        assert!(image_statistics(&image.mapv(|_| f32::NAN), &mask).unwrap().snr_background_db.is_none());
        assert!(image_statistics(&image.mapv(|_| 7.0), &mask).unwrap().snr_background_db.unwrap().is_finite());
    }
}

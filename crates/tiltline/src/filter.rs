//! Small image operations many rooms use: Gaussian blur, percentiles, interpolation.
//!
//! Images are `[row, column]` f32 in standard (row-major) layout. Borders are mirrored about the edge pixel's outer side
//! (`c b a | a b c`), so that a constant image stays constant.

use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;

/// Normalised Gaussian taps `[0..=radius]` of one half, centre first; the radius is `ceil(4 sigma)`.
pub fn gaussian_half_kernel(sigma: f64) -> Vec<f32> {
    let radius = (4.0 * sigma).ceil().max(1.0) as usize;
    let taps: Vec<f64> = (0..=radius).map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp()).collect();
    let sum = taps[0] + 2.0 * taps[1..].iter().sum::<f64>();
    taps.iter().map(|tap| (tap / sum) as f32).collect()
}

/// Gaussian blur of standard deviation `sigma` px; `sigma <= 0` copies.
pub fn gaussian_blur(image: &Array2<f32>, sigma: f64) -> Array2<f32> {
    if sigma <= 0.0 || image.is_empty() {
        return image.clone();
    }
    convolve_separable(image, &gaussian_half_kernel(sigma))
}

/// Convolves rows, then columns, with a symmetric kernel given by its half (centre first).
pub fn convolve_separable(image: &Array2<f32>, half: &[f32]) -> Array2<f32> {
    let (height, width) = image.dim();
    let radius = half.len() - 1;
    let image = image.as_standard_layout();
    let source = image.as_slice().expect("standard layout is contiguous");
    let mut rows = vec![0.0_f32; height * width];
    rows.par_chunks_mut(width).enumerate().for_each_init(
        || vec![0.0_f32; width + 2 * radius],
        |padded, (row, out)| {
            let line = &source[row * width..(row + 1) * width];
            pad_mirrored(line, radius, padded);
            convolve_padded(padded, half, out);
        },
    );
    let mut out = vec![0.0_f32; height * width];
    out.par_chunks_mut(width).enumerate().for_each(|(row, out)| {
        let line = |index: isize| {
            let row = mirror(index, height);
            &rows[row * width..(row + 1) * width]
        };
        let row = row as isize;
        for (value, centre) in out.iter_mut().zip(line(row)) {
            *value = half[0] * centre;
        }
        for (offset, &tap) in half.iter().enumerate().skip(1) {
            let (above, below) = (line(row - offset as isize), line(row + offset as isize));
            for ((value, a), b) in out.iter_mut().zip(above).zip(below) {
                *value += tap * (a + b);
            }
        }
    });
    Array2::from_shape_vec((height, width), out).expect("the buffer has height * width values")
}

fn pad_mirrored(line: &[f32], radius: usize, padded: &mut [f32]) {
    padded[radius..radius + line.len()].copy_from_slice(line);
    for i in 0..radius {
        padded[radius - 1 - i] = line[mirror(-1 - i as isize, line.len())];
        padded[radius + line.len() + i] = line[mirror((line.len() + i) as isize, line.len())];
    }
}

fn convolve_padded(padded: &[f32], half: &[f32], out: &mut [f32]) {
    let (radius, width) = (half.len() - 1, out.len());
    for (value, centre) in out.iter_mut().zip(&padded[radius..radius + width]) {
        *value = half[0] * centre;
    }
    for (offset, &tap) in half.iter().enumerate().skip(1) {
        let left = &padded[radius - offset..radius - offset + width];
        let right = &padded[radius + offset..radius + offset + width];
        for ((value, a), b) in out.iter_mut().zip(left).zip(right) {
            *value += tap * (a + b);
        }
    }
}

/// Index mirrored into `0..length` (`c b a | a b c | c b a`), for any distance outside.
pub fn mirror(index: isize, length: usize) -> usize {
    let period = 2 * length as isize;
    let folded = index.rem_euclid(period);
    if folded < length as isize { folded as usize } else { (period - 1 - folded) as usize }
}

/// Values at the given fractions (0 to 1) of the sorted finite pixels; zeros if there are none.
pub fn percentiles<const N: usize>(image: &Array2<f32>, fractions: [f64; N]) -> [f32; N] {
    // A stride keeps this cheap on large images without moving a percentile noticeably.
    let stride = (image.len() / 1_000_000).max(1);
    let mut values: Vec<f32> = image.iter().step_by(stride).copied().filter(|value| value.is_finite()).collect();
    if values.is_empty() {
        return [0.0; N];
    }
    values.par_sort_unstable_by(f32::total_cmp);
    fractions.map(|fraction| values[((values.len() - 1) as f64 * fraction.clamp(0.0, 1.0)).round() as usize])
}

/// Sums over blocks of `step` x `step` pixels, at least one block; what is left at the right and below is left out.
pub fn block_sums(image: &Array2<f32>, step: usize) -> Array2<f32> {
    let (height, width) = (image.nrows() / step, image.ncols() / step);
    Array2::from_shape_fn((height.max(1), width.max(1)), |(row, column)| {
        let mut sum = 0.0;
        for y in row * step..((row + 1) * step).min(image.nrows()) {
            for x in column * step..((column + 1) * step).min(image.ncols()) {
                sum += image[[y, x]];
            }
        }
        sum
    })
}

/// Linear interpolation at (x, y); `None` outside the centres of the border pixels or next to a pixel that is not finite.
pub fn sample_linear(image: &ArrayView2<'_, f32>, x: f64, y: f64) -> Option<f32> {
    let (height, width) = image.dim();
    if !(x >= 0.0 && y >= 0.0 && x <= (width - 1) as f64 && y <= (height - 1) as f64) {
        return None;
    }
    let (column, row) = ((x as usize).min(width.saturating_sub(2)), (y as usize).min(height.saturating_sub(2)));
    let (u, v) = ((x - column as f64) as f32, (y - row as f64) as f32);
    let (next_column, next_row) = ((column + 1).min(width - 1), (row + 1).min(height - 1));
    let top = image[[row, column]] * (1.0 - u) + image[[row, next_column]] * u;
    let bottom = image[[next_row, column]] * (1.0 - u) + image[[next_row, next_column]] * u;
    let value = top * (1.0 - v) + bottom * v;
    value.is_finite().then_some(value)
}

/// Cubic interpolation (Keys 1981, a = -1/2, i.e. Catmull-Rom) at (x, y); falls back to [`sample_linear`] where the
/// 4x4 neighbourhood leaves the image or holds a pixel that is not finite.
pub fn sample_cubic(image: &ArrayView2<'_, f32>, x: f64, y: f64) -> Option<f32> {
    let (height, width) = image.dim();
    let (column, row) = (x.floor(), y.floor());
    let inside = column >= 1.0 && row >= 1.0 && column + 2.0 < width as f64 && row + 2.0 < height as f64;
    if !inside {
        return sample_linear(image, x, y);
    }
    let weights_x = cubic_weights((x - column) as f32);
    let weights_y = cubic_weights((y - row) as f32);
    let (column, row) = (column as usize - 1, row as usize - 1);
    let mut value = 0.0;
    for (i, weight_y) in weights_y.iter().enumerate() {
        let mut line = 0.0;
        for (j, weight_x) in weights_x.iter().enumerate() {
            line += weight_x * image[[row + i, column + j]];
        }
        value += weight_y * line;
    }
    if value.is_finite() { Some(value) } else { sample_linear(image, x, y) }
}

fn cubic_weights(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [0.5 * (-t3 + 2.0 * t2 - t), 0.5 * (3.0 * t3 - 5.0 * t2 + 2.0), 0.5 * (-3.0 * t3 + 4.0 * t2 + t), 0.5 * (t3 - t2)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn a_constant_image_stays_constant_under_blur() {
        let image = Array2::from_elem((7, 5), 3.0_f32);
        for value in &gaussian_blur(&image, 2.5) {
            assert_relative_eq!(*value, 3.0, epsilon = 1e-5);
        }
    }

    #[test]
    fn blur_adds_variances() {
        let mut image = Array2::zeros((61, 61));
        image[[30, 30]] = 1.0_f32;
        let twice = gaussian_blur(&gaussian_blur(&image, 3.0), 4.0);
        let once = gaussian_blur(&image, 5.0);
        for (a, b) in twice.iter().zip(&once) {
            assert_relative_eq!(*a, *b, epsilon = 2e-5);
        }
    }

    #[test]
    fn cubic_interpolation_reproduces_a_parabola_and_linear_a_plane() {
        let image = Array2::from_shape_fn((8, 9), |(y, x)| (x * x) as f32 + 2.0 * y as f32);
        let cubic = sample_cubic(&image.view(), 3.25, 2.5).expect("inside");
        assert_relative_eq!(cubic, 3.25 * 3.25 + 5.0, epsilon = 1e-4);
        let plane = Array2::from_shape_fn((4, 4), |(y, x)| x as f32 - 3.0 * y as f32);
        assert_relative_eq!(sample_linear(&plane.view(), 3.0, 2.75).expect("inside"), 3.0 - 8.25, epsilon = 1e-5);
        assert_eq!(sample_linear(&plane.view(), 3.01, 0.0), None);
        assert_eq!(sample_cubic(&plane.view(), f64::NAN, 0.0), None);
    }

    #[test]
    fn mirroring_repeats_the_border_pixel() {
        let indices: Vec<usize> = (-4..8).map(|i| mirror(i, 3)).collect();
        assert_eq!(indices, [2, 2, 1, 0, 0, 1, 2, 2, 1, 0, 0, 1].map(|i: usize| i));
    }
}

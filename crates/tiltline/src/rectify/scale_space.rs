//! Gaussian scale space (Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 60, 2004, section 3).
//!
//! An octave holds images blurred to `1.6 * 2^(s/3)` octave px, `s = 0..=5`; the next octave starts from every second
//! pixel of level 3, whose blur is twice the base. Pixel (i, j) of an octave lies at `(i, j) * step_px` of the input.

use rayon::prelude::*;

use crate::filter::{gaussian_half_kernel, mirror};

/// Blur of level 0 of each octave, in octave px (Lowe, section 3.3).
pub const BASE_SIGMA: f64 = 1.6;
/// Levels per factor of two of scale (Lowe, section 3.2).
pub const INTERVALS: usize = 3;
/// Gaussian levels of an octave: extrema are sought in `INTERVALS` differences, each between two more.
const LEVELS: usize = INTERVALS + 3;
/// Blur that a recorded image is taken to have already (Lowe, section 3.3), in input px.
const INPUT_SIGMA: f64 = 0.5;
/// Octaves end when a side has fewer px than this.
const SMALLEST_SIDE: usize = 16;

/// A grey image in row-major order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plane {
    /// `height * width` values.
    pub values: Vec<f32>,
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Plane {
    /// One row.
    pub fn row(&self, row: usize) -> &[f32] {
        &self.values[row * self.width..(row + 1) * self.width]
    }

    /// The value of a pixel.
    pub fn at(&self, row: usize, column: usize) -> f32 {
        self.values[row * self.width + column]
    }
}

/// The images of one octave.
pub struct Octave {
    /// Gaussian levels, blur `BASE_SIGMA * 2^(s / INTERVALS)`.
    pub levels: Vec<Plane>,
    /// `levels[s + 1] - levels[s]`.
    pub differences: Vec<Plane>,
    /// Input px per octave px.
    pub step_px: f64,
}

impl Octave {
    /// The first octave; `double` samples the image twice as finely (Lowe, section 3.3), which finds smaller spots.
    pub fn first(image: &Plane, double: bool) -> Self {
        let (image, step_px) = if double { (&doubled(image), 0.5) } else { (image, 1.0) };
        let present = INPUT_SIGMA / step_px;
        let base = blur(image, (BASE_SIGMA * BASE_SIGMA - present * present).sqrt());
        Self::from_base(base, step_px)
    }

    /// The octave above, or `None` where it would be too small.
    pub fn next(&self) -> Option<Self> {
        let base = halved(&self.levels[INTERVALS]);
        (base.width.min(base.height) >= SMALLEST_SIDE).then(|| Self::from_base(base, 2.0 * self.step_px))
    }

    fn from_base(base: Plane, step_px: f64) -> Self {
        let mut levels = Vec::with_capacity(LEVELS);
        let mut differences = Vec::with_capacity(LEVELS - 1);
        levels.push(base);
        let ratio = 2.0_f64.powf(1.0 / INTERVALS as f64);
        for level in 1..LEVELS {
            let present = BASE_SIGMA * ratio.powi(level as i32 - 1);
            let below: &Plane = &levels[level - 1];
            let above = blur(below, present * (ratio * ratio - 1.0).sqrt());
            differences.push(difference(&above, below));
            levels.push(above);
        }
        Self { levels, differences, step_px }
    }
}

fn difference(above: &Plane, below: &Plane) -> Plane {
    let mut values = vec![0.0_f32; above.values.len()];
    let width = above.width;
    values.par_chunks_mut(width * 64).enumerate().for_each(|(band, out)| {
        let start = band * width * 64;
        let (above, below) = (&above.values[start..start + out.len()], &below.values[start..start + out.len()]);
        for ((value, a), b) in out.iter_mut().zip(above).zip(below) {
            *value = a - b;
        }
    });
    Plane { values, width, height: above.height }
}

/// Twice the pixels each way by linear interpolation: output pixel i lies at input i / 2.
fn doubled(image: &Plane) -> Plane {
    let (width, height) = (image.width, image.height);
    let mut values = vec![0.0_f32; 4 * width * height];
    values.par_chunks_mut(2 * width).enumerate().for_each(|(row, out)| {
        let (above, below) = (image.row(row / 2), image.row(row.div_ceil(2).min(height - 1)));
        for (column, pair) in out.chunks_exact_mut(2).enumerate() {
            let next = (column + 1).min(width - 1);
            let here = 0.5 * (above[column] + below[column]);
            pair[0] = here;
            pair[1] = 0.5 * (here + 0.5 * (above[next] + below[next]));
        }
    });
    Plane { values, width: 2 * width, height: 2 * height }
}

/// Every second pixel of every second row.
fn halved(image: &Plane) -> Plane {
    let (width, height) = (image.width.div_ceil(2), image.height.div_ceil(2));
    let mut values = Vec::with_capacity(width * height);
    for row in 0..height {
        values.extend(image.row(2 * row).iter().step_by(2));
    }
    Plane { values, width, height }
}

/// Columns that are summed together, so that their sums stay in registers.
const LANES: usize = 16;

/// Gaussian blur, borders mirrored. Rows and columns are convolved band by band, so that a band stays in the cache.
pub fn blur(image: &Plane, sigma: f64) -> Plane {
    let half = gaussian_half_kernel(sigma);
    let radius = half.len() - 1;
    let (width, height) = (image.width, image.height);
    // The rows above and below a band are convolved twice; a band of eight radii keeps that to a quarter.
    let band_rows = (8 * radius).max(32);
    let mut values = vec![0.0_f32; width * height];
    values.par_chunks_mut(band_rows * width).enumerate().for_each(|(band, out)| {
        let first = band * band_rows;
        let rows = out.len() / width;
        let mut padded = vec![0.0_f32; width + 2 * radius];
        let mut convolved = vec![0.0_f32; (rows + 2 * radius) * width];
        for (index, line) in convolved.chunks_exact_mut(width).enumerate() {
            let source = image.row(mirror((first + index) as isize - radius as isize, height));
            padded[radius..radius + width].copy_from_slice(source);
            for i in 0..radius {
                padded[radius - 1 - i] = source[mirror(-1 - i as isize, width)];
                padded[radius + width + i] = source[mirror((width + i) as isize, width)];
            }
            symmetric_sum(&padded, radius, 1, &half, line);
        }
        for (index, line) in out.chunks_exact_mut(width).enumerate() {
            let centre = (index + radius) * width;
            symmetric_sum(&convolved, centre, width, &half, line);
        }
    });
    Plane { values, width, height }
}

/// `out[i] = half[0] s[c + i] + sum_k half[k] (s[c + i - k stride] + s[c + i + k stride])`.
fn symmetric_sum(source: &[f32], centre: usize, stride: usize, half: &[f32], out: &mut [f32]) {
    let whole = out.len() - out.len() % LANES;
    let (wide, rest) = out.split_at_mut(whole);
    for (chunk, out) in wide.chunks_exact_mut(LANES).enumerate() {
        let at = centre + chunk * LANES;
        let mut sum = [0.0_f32; LANES];
        for (value, centre) in sum.iter_mut().zip(&source[at..at + LANES]) {
            *value = half[0] * centre;
        }
        for (offset, &tap) in half.iter().enumerate().skip(1) {
            let (before, after) = (at - offset * stride, at + offset * stride);
            let (before, after) = (&source[before..before + LANES], &source[after..after + LANES]);
            for lane in 0..LANES {
                sum[lane] += tap * (before[lane] + after[lane]);
            }
        }
        out.copy_from_slice(&sum);
    }
    for (index, value) in rest.iter_mut().enumerate() {
        let at = centre + whole + index;
        *value = half[0] * source[at];
        for (offset, &tap) in half.iter().enumerate().skip(1) {
            *value += tap * (source[at - offset * stride] + source[at + offset * stride]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::filter::gaussian_blur;
    use approx::assert_relative_eq;
    use ndarray::Array2;

    fn plane(height: usize, width: usize, value: impl Fn(usize, usize) -> f32) -> Plane {
        let values = (0..height * width).map(|i| value(i / width, i % width)).collect();
        Plane { values, width, height }
    }

    #[test]
    fn blur_agrees_with_the_plain_one_at_every_border() {
        let pattern = |row: usize, column: usize| ((row * 7 + column * 13) % 11) as f32;
        let image = plane(45, 37, pattern);
        let fast = blur(&image, 2.3);
        let plain = gaussian_blur(&Array2::from_shape_fn((45, 37), |(row, column)| pattern(row, column)), 2.3);
        for (a, b) in fast.values.iter().zip(&plain) {
            assert_relative_eq!(*a, *b, epsilon = 1e-5);
        }
    }

    #[test]
    fn doubling_puts_pixel_i_at_half_i() {
        let ramp = plane(4, 5, |row, column| column as f32 + 10.0 * row as f32);
        let twice = doubled(&ramp);
        assert_eq!(twice.at(3, 3), 1.5 + 15.0);
        assert_eq!(twice.at(2, 4), 2.0 + 10.0);
        assert_eq!(halved(&twice), ramp);
    }

    #[test]
    fn level_three_has_twice_the_blur_of_level_zero() {
        // A point blurred to sigma has the height 1 / (2 pi sigma^2): a quarter after a factor of two. The input is
        // taken to have a blur of 0.5 px already, which a true point has not: sigma^2 is 0.25 less at both levels.
        let octave = Octave::first(&plane(65, 65, |row, column| f32::from(row == 32 && column == 32)), false);
        let expected = (BASE_SIGMA.powi(2) - 0.25) / (4.0 * BASE_SIGMA.powi(2) - 0.25);
        let measured = octave.levels[INTERVALS].at(32, 32) / octave.levels[0].at(32, 32);
        assert_relative_eq!(f64::from(measured), expected, max_relative = 2e-3);
    }
}

//! Oriented ridge responses of one scale: second derivative across, Gaussian mean along the tangent, in 12 directions,
//! in units of the image's own noise.
//!
//! An elongated kernel adds up evidence along the line, which raises signal to noise by the square root of its length
//! (Freeman and Adelson, PAMI 1991; Geusebroek et al., IEEE TIP 2003 for the factorised anisotropic Gaussian). Noise
//! is measured on the responses themselves, per direction and per neighbourhood, as median absolute deviation: texture,
//! resampled noise and streaks then count as what they are.

use ndarray::Array2;
use rayon::prelude::*;

use crate::ridge::padded::Padded;
use crate::ridge::scales::Scale;

/// Number of tangent directions in half a turn.
pub(super) const DIRECTIONS: usize = 12;
/// Standard deviation of the kernel along the line in units of that across, at a scale of 1 px.
const ELONGATION: f64 = 4.0;

/// Elongation at a scale: the length grows with the root of the scale, since curves do not straighten with width.
fn elongation(sigma_px: f64) -> f64 {
    (ELONGATION / sigma_px.sqrt()).clamp(1.8, ELONGATION)
}
/// Every how many rows the noise is measured.
const NOISE_ROW_STEP: usize = 12;
/// Side in grid px of the tiles of local noise.
const NOISE_TILE: usize = 48;
/// Smallest standard deviation of a response, for images without noise: a line of 1 percent contrast then stands at
/// about 5.
const NOISE_FLOOR: f32 = 7e-4;

/// Tangent of a direction: the angle from x towards y is `index * pi / DIRECTIONS`.
pub(super) fn tangent(index: usize) -> (f64, f64) {
    let (sin, cos) = (index as f64 * std::f64::consts::PI / DIRECTIONS as f64).sin_cos();
    (cos, sin)
}

/// The strongest response at each pixel of a scale's grid.
pub(super) struct Response {
    /// Response in standard deviations of the noise `[row, column]`; positive for lines of the wanted polarity.
    pub significance: Array2<f32>,
    /// Index of the tangent direction.
    pub direction: Array2<u8>,
    noise: Noise,
}

impl Response {
    /// Standard deviation of the responses at a pixel of the scale's grid, in units of intensity.
    pub fn noise_at(&self, [row, column]: [usize; 2]) -> f32 {
        let direction = usize::from(self.direction[[row, column]]);
        let tiles = self.noise.tiles.dim();
        let tile = [(row / NOISE_TILE).min(tiles.0 - 1), (column / NOISE_TILE).min(tiles.1 - 1)];
        self.noise.by_direction[direction] * self.noise.tiles[tile]
    }
}

/// A kernel along a tangent: offsets (down, right) and weights, symmetric about the centre.
fn taps(direction: usize, sigma: f64, elongation: f64) -> Vec<(isize, isize, f32)> {
    let (x, y) = tangent(direction);
    // The scale's own blur counts to the length; what is left is added here, in steps that the blur spans.
    let along_sigma = sigma * (elongation * elongation - 1.0).sqrt();
    let step = 1.5 * sigma;
    let reach = (2.3 * along_sigma / step).round() as isize;
    let mut taps: Vec<(isize, isize, f32)> = (-reach..=reach)
        .map(|index| {
            let along = index as f64 * step;
            let weight = (-0.5 * (along / along_sigma).powi(2)).exp() as f32;
            ((along * y).round() as isize, (along * x).round() as isize, weight)
        })
        .collect();
    let sum: f32 = taps.iter().map(|tap| tap.2).sum();
    taps.iter_mut().for_each(|tap| tap.2 /= sum);
    taps
}

/// One direction's kernels for one scale.
struct Kernel {
    taps: Vec<(isize, isize, f32)>,
    /// Weights of the second derivatives along xx, xy, yy, times sigma^2 and the sign of the polarity.
    steer: [f32; 3],
}

impl Kernel {
    fn new(direction: usize, sigma: f64, elongation: f64, sign: f32) -> Self {
        let (x, y) = tangent(direction);
        // The normal is (-y, x).
        let gain = sigma * sigma * f64::from(sign);
        let steer = [gain * y * y, -2.0 * gain * x * y, gain * x * x].map(|weight| weight as f32);
        Self { taps: taps(direction, sigma, elongation), steer }
    }

    /// Mean along the tangent at row `row`, columns -1 to width.
    fn mean_row(&self, image: &Padded, row: isize, out: &mut [f32]) {
        out.fill(0.0);
        let count = out.len();
        for &(down, right, weight) in &self.taps {
            for (value, source) in out.iter_mut().zip(image.row(row + down, right - 1, count)) {
                *value += weight * source;
            }
        }
    }

    /// Second derivative across the tangent from three rows of means.
    fn second_derivative(&self, [above, here, below]: [&[f32]; 3], out: &mut [f32]) {
        let [xx, xy, yy] = self.steer;
        let quarter = 0.25 * xy;
        let width = out.len();
        let (above, here, below) = (&above[..width + 2], &here[..width + 2], &below[..width + 2]);
        for (column, value) in out.iter_mut().enumerate() {
            let centre = 2.0 * here[column + 1];
            *value = xx * (here[column] + here[column + 2] - centre)
                + yy * (above[column + 1] + below[column + 1] - centre)
                + quarter * (below[column + 2] - below[column] - above[column + 2] + above[column]);
        }
    }
}

/// Responses of a scale to lines of a polarity: `sign` is +1 for dark lines and -1 for bright ones.
pub(super) fn respond(scale: &Scale, sign: f32, distance_to_gap: &Array2<f32>) -> Response {
    let (height, width) = scale.image.dim();
    let sigma = scale.sigma_on_grid();
    let elongation = elongation(scale.sigma_px);
    let kernels: Vec<Kernel> =
        (0..DIRECTIONS).map(|direction| Kernel::new(direction, sigma, elongation, sign)).collect();
    let margin = kernels.iter().flat_map(|kernel| &kernel.taps).map(|tap| tap.0.abs().max(tap.1.abs())).max();
    let image = Padded::new(&scale.image, margin.unwrap_or(0) as usize + 2);
    let noise = Noise::measure(&image, &kernels, [height, width], |row, column| {
        let at = [row, column].map(|index| (index << scale.level) + (1 << scale.level) / 2);
        let (rows, columns) = distance_to_gap.dim();
        distance_to_gap[[at[0].min(rows - 1), at[1].min(columns - 1)]] > 3.0 * scale.sigma_px as f32
    });

    const BLOCK: usize = 16;
    let mut significance = vec![0.0_f32; height * width];
    let mut direction = vec![0_u8; height * width];
    significance.par_chunks_mut(BLOCK * width).zip(direction.par_chunks_mut(BLOCK * width)).enumerate().for_each(
        |(block, (best, which))| {
            let rows = best.len() / width;
            let first = (block * BLOCK) as isize;
            let mut means = vec![0.0_f32; (rows + 2) * (width + 2)];
            let mut values = vec![0.0_f32; width];
            for (index, kernel) in kernels.iter().enumerate() {
                for (row, out) in means.chunks_mut(width + 2).enumerate() {
                    kernel.mean_row(&image, first + row as isize - 1, out);
                }
                let gain = 1.0 / noise.by_direction[index];
                for row in 0..rows {
                    let line = |row: usize| &means[row * (width + 2)..(row + 1) * (width + 2)];
                    kernel.second_derivative([line(row), line(row + 1), line(row + 2)], &mut values);
                    let span = row * width..(row + 1) * width;
                    for ((value, best), which) in values.iter().zip(&mut best[span.clone()]).zip(&mut which[span]) {
                        let value = value * gain;
                        *which = if value > *best { index as u8 } else { *which };
                        *best = best.max(value);
                    }
                }
            }
            for row in 0..rows {
                let local = noise.local_row(block * BLOCK + row, width);
                for (value, local) in best[row * width..(row + 1) * width].iter_mut().zip(local) {
                    *value /= local;
                }
            }
        },
    );
    let shape = (height, width);
    Response {
        significance: Array2::from_shape_vec(shape, significance).expect("one value a pixel"),
        direction: Array2::from_shape_vec(shape, direction).expect("one value a pixel"),
        noise,
    }
}

/// Standard deviation of the responses: per direction, times a factor that varies slowly over the image.
struct Noise {
    by_direction: Vec<f32>,
    /// Factor at the centres of tiles `[row, column]`.
    tiles: Array2<f32>,
}

impl Noise {
    fn measure(
        image: &Padded,
        kernels: &[Kernel],
        [height, width]: [usize; 2],
        trusted: impl Fn(usize, usize) -> bool + Sync,
    ) -> Self {
        let rows: Vec<usize> = (0..height).skip(NOISE_ROW_STEP.min(height) / 2).step_by(NOISE_ROW_STEP).collect();
        let columns: Vec<Vec<usize>> =
            rows.iter().map(|&row| (0..width).filter(|&column| trusted(row, column)).collect()).collect();
        // [direction][sampled row][trusted column] of |response|
        let magnitudes: Vec<Vec<Vec<f32>>> = kernels
            .par_iter()
            .map(|kernel| {
                let mut means = [vec![0.0_f32; width + 2], vec![0.0; width + 2], vec![0.0; width + 2]];
                let mut values = vec![0.0_f32; width];
                rows.iter()
                    .zip(&columns)
                    .map(|(&row, columns)| {
                        for (offset, mean) in means.iter_mut().enumerate() {
                            kernel.mean_row(image, row as isize + offset as isize - 1, mean);
                        }
                        kernel.second_derivative([&means[0], &means[1], &means[2]], &mut values);
                        columns.iter().map(|&column| values[column].abs()).collect()
                    })
                    .collect()
            })
            .collect();
        let by_direction: Vec<f32> = magnitudes
            .par_iter()
            .map(|rows| {
                let mut all: Vec<f32> = rows.iter().flatten().copied().collect();
                (median(&mut all).unwrap_or(0.0) / 0.6745).max(NOISE_FLOOR)
            })
            .collect();
        let shape = (height.div_ceil(NOISE_TILE), width.div_ceil(NOISE_TILE));
        let mut samples = vec![Vec::new(); shape.0 * shape.1];
        for (direction, rows_of) in magnitudes.iter().enumerate() {
            for ((&row, columns), values) in rows.iter().zip(&columns).zip(rows_of) {
                for (&column, value) in columns.iter().zip(values) {
                    let tile = (row / NOISE_TILE) * shape.1 + column / NOISE_TILE;
                    samples[tile].push(value / by_direction[direction]);
                }
            }
        }
        // Half to twice the image's noise: a neighbourhood full of lines must not hide them.
        let factors: Vec<f32> = samples
            .par_iter_mut()
            .map(|samples| median(samples).map_or(1.0, |median| (median / 0.6745).clamp(0.5, 1.7)))
            .collect();
        let tiles = Array2::from_shape_vec(shape, factors).expect("one factor a tile");
        Self { by_direction, tiles }
    }

    /// The local factor along a row, interpolated between tile centres.
    fn local_row(&self, row: usize, width: usize) -> impl Iterator<Item = f32> + '_ {
        let (rows, columns) = self.tiles.dim();
        let place = |index: usize, count: usize| {
            let at = ((index as f32 + 0.5) / NOISE_TILE as f32 - 0.5).clamp(0.0, (count - 1) as f32);
            let low = (at as usize).min(count.saturating_sub(2));
            (low, (low + 1).min(count - 1), at - low as f32)
        };
        let (top, bottom, v) = place(row, rows);
        (0..width).map(move |column| {
            let (left, right, u) = place(column, columns);
            let mix = |row: usize| self.tiles[[row, left]] * (1.0 - u) + self.tiles[[row, right]] * u;
            mix(top) * (1.0 - v) + mix(bottom) * v
        })
    }
}

fn median(values: &mut [f32]) -> Option<f32> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    Some(*values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ridge::scales::scale_space;

    #[test]
    fn the_strongest_direction_of_a_line_is_its_own() {
        for degrees in [0.0_f64, 15.0, 40.0, 75.0, 90.0, 130.0, 165.0] {
            let (sin, cos) = degrees.to_radians().sin_cos();
            let image = Array2::from_shape_fn((96, 96), |(row, column)| {
                let across = -(column as f64 - 48.0) * sin + (row as f64 - 48.0) * cos;
                1.0 - (-0.5 * (across / 1.5).powi(2)).exp() as f32
            });
            let far = Array2::from_elem((96, 96), 1e6);
            for scale in &scale_space(&image, &[1.0, 1.5]) {
                let response = respond(scale, 1.0, &far);
                let (x, y) = tangent(usize::from(response.direction[[48, 48]]));
                let off = (x * sin - y * cos).abs().asin().to_degrees();
                // Directions are 15 degrees apart.
                assert!(off <= 7.6, "{degrees}: off by {off}");
                let dark = response.significance[[48, 48]];
                assert!(dark > 20.0);
                // Kernels that lie across the line see a little of its bright flanks.
                assert!(respond(scale, -1.0, &far).significance[[48, 48]] < 0.1 * dark);
            }
        }
    }

    #[test]
    fn responses_to_white_noise_have_unit_deviation() {
        use rand::{RngExt, SeedableRng};
        let mut rng = rand_pcg::Pcg64::seed_from_u64(1);
        let image = Array2::from_shape_simple_fn((256, 256), || rng.random_range(-0.1..0.1_f32));
        let far = Array2::from_elem((256, 256), 1e6);
        for scale in &scale_space(&image, &[1.0, 2.0]) {
            let response = respond(scale, 1.0, &far);
            let share = |threshold: f32| {
                let above = response.significance.iter().filter(|value| **value > threshold).count();
                above as f64 / response.significance.len() as f64
            };
            // The largest of 12 correlated normal values: its median is between 1 and 2, and 5 is nearly never passed.
            assert!(share(1.0) > 0.5 && share(2.0) < 0.5, "{} {}", share(1.0), share(2.0));
            assert!(share(5.0) < 1e-4);
        }
    }
}

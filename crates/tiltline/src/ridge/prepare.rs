//! Makes an image fit for filtering: fills missing data smoothly, finds data that must not be trusted (NaN, black
//! borders of an earlier alignment), and takes out scan-line streaks.
//!
//! Missing data are filled by normalised convolution (Knutsson and Westin, CVPR 1993) with widening Gaussians.
//! Distances are in px of the rectified image; intensities are those of the image.

use ndarray::Array2;
use rayon::prelude::*;

use crate::filter::gaussian_blur;
use crate::ridge::padded::Padded;

/// Largest share of the image that a flat region may have to be taken for a border without data; a flat background
/// of a drawn image is larger.
const LARGEST_FLAT_SHARE: f64 = 0.4;
/// Smallest flat region in px that is a border without data.
const SMALLEST_FLAT_PX: usize = 64;
/// Standard deviation along a streak of the mean that is taken as the streak, px.
const STREAK_SIGMA_PX: f64 = 32.0;
/// How much stronger the means along the scan direction must scatter than those 8 degrees off it to be streaks.
const STREAK_RATIO: f64 = 1.6;

/// An image without gaps and where it can be trusted.
pub(super) struct Prepared {
    /// Finite everywhere `[row, column]`.
    pub image: Array2<f32>,
    /// Distance in px (chamfer, within 5 percent) to the nearest pixel without data; large where there is none.
    pub distance_to_gap: Array2<f32>,
    /// Directions in radians (tangent, from x towards y) along which streaks were found and taken out.
    pub streaks_rad: Vec<f64>,
}

/// Prepares an image whose input rows run along `rows_rad` (radians from x towards y) in it.
pub(super) fn prepare(image: &Array2<f32>, rows_rad: f64) -> Prepared {
    let has_data = data_mask(image);
    let distance_to_gap = distance_to_false(&has_data);
    let mut image = fill(image, &has_data);
    let mut streaks_rad = Vec::new();
    for direction in [rows_rad, rows_rad + std::f64::consts::FRAC_PI_2] {
        if let Some(streaks) = streaks(&image, &has_data, direction) {
            image -= &streaks;
            streaks_rad.push(direction);
        }
    }
    Prepared { image, distance_to_gap, streaks_rad }
}

/// Where the image has data: finite, and not in a flat darkest region that touches the border of the image or a gap.
pub(crate) fn data_mask(image: &Array2<f32>) -> Array2<bool> {
    let (height, width) = image.dim();
    let mut has_data = image.mapv(f32::is_finite);
    let finite = image.iter().filter(|value| value.is_finite());
    let [low, high] =
        finite.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], value| [low.min(*value), high.max(*value)]);
    let darkest = low + 0.02 * (high - low);
    let flat = |row: usize, column: usize| {
        let value = image[[row, column]];
        value <= darkest
            && [(row + 1, column), (row, column + 1)].iter().all(|&(row, column)| {
                // A neighbour outside the image or without data does not make a pixel uneven.
                let step = image.get([row, column]).map_or(0.0, |other| (other - value).abs());
                step.is_nan() || step <= 1e-6
            })
    };
    let mut seen = Array2::from_elem((height, width), false);
    for start_row in 0..height {
        for start_column in 0..width {
            if seen[[start_row, start_column]] || !flat(start_row, start_column) {
                continue;
            }
            let mut region = vec![(start_row, start_column)];
            let mut touches = false;
            seen[[start_row, start_column]] = true;
            let mut next = 0;
            while next < region.len() {
                let (row, column) = region[next];
                next += 1;
                touches |= row == 0 || column == 0 || row + 1 == height || column + 1 == width;
                for (row, column) in neighbours4(row, column, height, width) {
                    touches |= !image[[row, column]].is_finite();
                    if !seen[[row, column]] && flat(row, column) {
                        seen[[row, column]] = true;
                        region.push((row, column));
                    }
                }
            }
            let share = region.len() as f64 / image.len() as f64;
            if touches && region.len() >= SMALLEST_FLAT_PX && share <= LARGEST_FLAT_SHARE {
                for (row, column) in region {
                    has_data[[row, column]] = false;
                }
            }
        }
    }
    has_data
}

fn neighbours4(row: usize, column: usize, height: usize, width: usize) -> impl Iterator<Item = (usize, usize)> {
    let steps = [(-1_isize, 0_isize), (1, 0), (0, -1), (0, 1)];
    steps.into_iter().filter_map(move |(down, right)| {
        let (row, column) = (row.checked_add_signed(down)?, column.checked_add_signed(right)?);
        (row < height && column < width).then_some((row, column))
    })
}

/// Chamfer distance (1, sqrt 2) in px to the nearest `false`; 1e6 where there is none.
pub(super) fn distance_to_false(mask: &Array2<bool>) -> Array2<f32> {
    let (height, width) = mask.dim();
    let mut distance = mask.mapv(|inside| if inside { 1e6_f32 } else { 0.0 });
    if mask.iter().all(|inside| *inside) {
        return distance;
    }
    let diagonal = std::f32::consts::SQRT_2;
    let mut relax = |row: usize, column: usize, sign: isize| {
        let mut best = distance[[row, column]];
        for (down, right, step) in [(0, -1, 1.0), (-1, 0, 1.0), (-1, -1, diagonal), (-1, 1, diagonal)] {
            let neighbour = (row.checked_add_signed(sign * down), column.checked_add_signed(sign * right));
            if let (Some(row), Some(column)) = neighbour
                && row < height
                && column < width
            {
                best = best.min(distance[[row, column]] + step);
            }
        }
        distance[[row, column]] = best;
    };
    for row in 0..height {
        for column in 0..width {
            relax(row, column, 1);
        }
    }
    for row in (0..height).rev() {
        for column in (0..width).rev() {
            relax(row, column, -1);
        }
    }
    distance
}

/// Replaces what has no data by a normalised Gaussian mean of the data near it.
fn fill(image: &Array2<f32>, has_data: &Array2<bool>) -> Array2<f32> {
    let mut filled = image.clone();
    if has_data.iter().all(|inside| *inside) {
        return filled;
    }
    let known = Array2::from_shape_fn(image.dim(), |at| if has_data[at] { image[at] } else { 0.0 });
    let weight = has_data.mapv(|inside| if inside { 1.0_f32 } else { 0.0 });
    let count: f32 = weight.sum().max(1.0);
    let mean = known.sum() / count;
    let mut missing = has_data.mapv(|inside| !inside);
    for sigma in [2.0, 8.0, 32.0] {
        let (values, weights) = (gaussian_blur(&known, sigma), gaussian_blur(&weight, sigma));
        for (at, open) in missing.indexed_iter_mut() {
            if *open && weights[at] > 0.02 {
                filled[at] = values[at] / weights[at];
                *open = false;
            }
        }
    }
    for (at, open) in missing.indexed_iter() {
        if *open {
            filled[at] = mean;
        }
    }
    filled
}

/// The streaks along a direction, if there are any: the robust mean along it of what is sharp across it.
fn streaks(image: &Array2<f32>, has_data: &Array2<bool>, direction_rad: f64) -> Option<Array2<f32>> {
    let (height, width) = image.dim();
    if height < 64 || width < 64 {
        return None;
    }
    let mut sharp = image - &gaussian_blur(image, 2.5);
    let limit = 3.0 * median_absolute(&sharp, has_data)? / 0.6745;
    // Lines and dirt are clipped: they must not leave a trail along the streak.
    sharp.zip_mut_with(has_data, |value, inside| {
        *value = if *inside { value.clamp(-limit, limit) } else { 0.0 };
    });
    let padded = Padded::new(&sharp, 2 * STREAK_SIGMA_PX as usize + 1);
    let row_step = (height / 96).max(1);
    let scatter = |angle: f64| {
        let mean = mean_along(&padded, [height, width], angle, row_step);
        let mut values: Vec<f32> = mean.iter().map(|value| value.abs()).collect();
        let middle = values.len() / 2;
        f64::from(*values.select_nth_unstable_by(middle, f32::total_cmp).1)
    };
    let off = 8.0_f64.to_radians();
    let here = scatter(direction_rad);
    let aside = scatter(direction_rad + off).max(scatter(direction_rad - off));
    (here > STREAK_RATIO * aside && here > 1e-6).then(|| mean_along(&padded, [height, width], direction_rad, 1))
}

fn median_absolute(image: &Array2<f32>, has_data: &Array2<bool>) -> Option<f32> {
    let stride = (image.len() / 200_000).max(1);
    let pairs = image.iter().zip(has_data).step_by(stride);
    let mut values: Vec<f32> = pairs.filter(|(_, inside)| **inside).map(|(value, _)| value.abs()).collect();
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    Some(*values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// Gaussian mean along a direction, on every `row_step`-th row.
fn mean_along(image: &Padded, [height, width]: [usize; 2], direction_rad: f64, row_step: usize) -> Array2<f32> {
    let (sin, cos) = direction_rad.sin_cos();
    // Steps of 2 px: streaks do not change faster than that along themselves.
    let reach = STREAK_SIGMA_PX as isize;
    let mut taps: Vec<(isize, isize, f32)> = (-reach..=reach)
        .map(|step| {
            let along = 2.0 * step as f64;
            let weight = (-0.5 * (along / STREAK_SIGMA_PX).powi(2)).exp();
            ((along * sin).round() as isize, (along * cos).round() as isize, weight as f32)
        })
        .collect();
    let sum: f32 = taps.iter().map(|tap| tap.2).sum();
    taps.iter_mut().for_each(|tap| tap.2 /= sum);
    let rows = height.div_ceil(row_step);
    let mut out = vec![0.0_f32; rows * width];
    out.par_chunks_mut(width).enumerate().for_each(|(index, out)| {
        let row = (index * row_step) as isize;
        for &(down, right, weight) in &taps {
            for (value, source) in out.iter_mut().zip(image.row(row + down, right, width)) {
                *value += weight * source;
            }
        }
    });
    Array2::from_shape_vec((rows, width), out).expect("the buffer has rows * width values")
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn noise(shape: (usize, usize), seed: u64) -> Array2<f32> {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        Array2::from_shape_simple_fn(shape, || rng.random_range(-0.05..0.05))
    }

    #[test]
    fn a_filled_plane_keeps_its_level_beside_the_gap_and_leaves_the_data_alone() {
        let plane = Array2::from_shape_fn((64, 80), |(row, column)| 0.01 * row as f32 + 0.02 * column as f32);
        let mut holed = plane.clone();
        for ((row, column), value) in holed.indexed_iter_mut() {
            if (20..40).contains(&row) && (30..60).contains(&column) {
                *value = f32::NAN;
            }
        }
        let prepared = prepare(&holed, 0.0);
        assert!(prepared.image.iter().all(|value| value.is_finite()));
        assert_eq!(prepared.image[[5, 5]], plane[[5, 5]]);
        // One px into the gap the mean lies about sigma = 2 px back on the data's side: 2 px of the steepest slope.
        assert!((prepared.image[[30, 30]] - plane[[30, 30]]).abs() < 0.06);
        assert_eq!(prepared.distance_to_gap[[30, 27]], 3.0);
    }

    #[test]
    fn a_black_border_has_no_data_and_a_flat_background_has() {
        let mut image = noise((64, 64), 3);
        image.columns_mut().into_iter().take(10).for_each(|mut column| column.fill(-0.5));
        let mask = data_mask(&image);
        assert!(!mask[[30, 4]] && mask[[30, 12]]);
        let mut drawn = Array2::zeros((64, 64));
        drawn.row_mut(32).fill(1.0_f32);
        assert!(data_mask(&drawn).iter().all(|inside| *inside));
    }

    #[test]
    fn streaks_are_found_along_the_turned_rows_and_taken_out() {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(5);
        let offsets: Vec<f32> = (0..400).map(|_| rng.random_range(-0.1..0.1)).collect();
        let angle = 1.5_f64.to_radians();
        let mut image = noise((200, 200), 4);
        for ((row, column), value) in image.indexed_iter_mut() {
            let input_row = row as f64 * angle.cos() - column as f64 * angle.sin() + 100.0;
            *value += offsets[input_row.round() as usize];
        }
        let before = median_absolute(&(&image - &gaussian_blur(&image, 2.5)), &image.mapv(|_| true)).unwrap();
        let prepared = prepare(&image, angle);
        assert_eq!(prepared.streaks_rad, [angle]);
        let after = median_absolute(&(&prepared.image - &gaussian_blur(&prepared.image, 2.5)), &image.mapv(|_| true));
        // Noise alone has median 0.025; with the streaks it was about 0.05.
        assert!(after.unwrap() < 0.75 * before, "{before} {after:?}");
        assert!(prepare(&noise((200, 200), 6), 0.0).streaks_rad.is_empty());
    }
}

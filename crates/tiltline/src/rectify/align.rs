//! Point matches to a fraction of a pixel: a window about each match is shifted until both images agree (least-squares
//! matching, Lucas and Kanade 1981; Foerstner and Guelch 1987), with gain and offset free.
//!
//! A SIFT keypoint is placed to about a pixel where the image is noisy or its blobs are broad; the window about it holds
//! many times more evidence. In a transparent foil what lies at other depths moves along the rows, so it blurs the
//! shift along them but not across, which is the one that counts here.

use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;

use super::point_matching::PointMatch;
use crate::filter::{gaussian_blur, sample_cubic};
use crate::geometry::{Point2, Similarity2, Vector2};

/// Half side of the window, px.
const RADIUS: usize = 12;
/// Side of the window with a rim for differences.
const SIDE: usize = 2 * RADIUS + 3;
/// Standard deviation of the window's Gaussian weight, px.
const WEIGHT_SIGMA_PX: f64 = 6.0;
/// Blur before alignment, px: differences of neighbouring pixels are then a gradient.
const BLUR_PX: f64 = 1.2;
/// Furthest a match may move, px.
const MAX_SHIFT_PX: f64 = 4.0;
/// Smallest correlation of the windows after alignment.
const MIN_CORRELATION: f64 = 0.6;
/// Largest standard deviation of the shift across the rows and along them that is kept, px.
const MAX_SIGMA_PX: [f64; 2] = [0.4, 1.0];
/// Matches nearer to each other than this share most of their window: one of them is kept, px.
const SPACING_PX: f64 = 6.0;
const ITERATIONS: usize = 12;

/// The matches that can be aligned, best first: left points as they were, right points moved to where the windows agree.
///
/// `images` are left and right; `right_from_left` gives the rotation and scale between windows, whose shift is each
/// match's own.
pub fn align(images: [&Array2<f32>; 2], matches: &[PointMatch], right_from_left: &Similarity2) -> Vec<PointMatch> {
    let [left, right] = images.map(|image| gaussian_blur(image, BLUR_PX));
    let mut aligned: Vec<(f64, PointMatch)> = matches
        .par_iter()
        .filter_map(|pair| align_one([left.view(), right.view()], pair, right_from_left))
        .collect();
    aligned.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut kept: Vec<PointMatch> = Vec::new();
    for (_, pair) in aligned {
        if kept.iter().all(|other| (other.left - pair.left).norm() >= SPACING_PX) {
            kept.push(pair);
        }
    }
    kept
}

/// A square window of `SIDE` samples with the weighted mean 0 and variance 1 over its inner part.
struct Window {
    values: Vec<f64>,
}

impl Window {
    fn sample(image: &ArrayView2<'_, f32>, at: impl Fn(Vector2) -> Point2, weights: &[f64]) -> Option<Self> {
        let half = (SIDE / 2) as f64;
        let mut values = Vec::with_capacity(SIDE * SIDE);
        for row in 0..SIDE {
            for column in 0..SIDE {
                let point = at(Vector2::new(column as f64 - half, row as f64 - half));
                values.push(f64::from(sample_cubic(image, point.x, point.y)?));
            }
        }
        let sum: f64 = weights.iter().sum();
        let mean = values.iter().zip(weights).map(|(value, weight)| value * weight).sum::<f64>() / sum;
        let variance = values.iter().zip(weights).map(|(value, weight)| (value - mean).powi(2) * weight).sum::<f64>() / sum;
        if variance < 1e-10 {
            return None;
        }
        let gain = 1.0 / variance.sqrt();
        values.iter_mut().for_each(|value| *value = (*value - mean) * gain);
        Some(Self { values })
    }
}

/// Gaussian weights of the inner part of a window; the rim has none.
fn weights() -> Vec<f64> {
    let half = (SIDE / 2) as f64;
    let weight = |index: usize| {
        let (y, x) = ((index / SIDE) as f64 - half, (index % SIDE) as f64 - half);
        let inside = x.abs().max(y.abs()) <= RADIUS as f64;
        if inside { (-0.5 * (x * x + y * y) / (WEIGHT_SIGMA_PX * WEIGHT_SIGMA_PX)).exp() } else { 0.0 }
    };
    (0..SIDE * SIDE).map(weight).collect()
}

/// The correlation of the aligned windows and the match, or nothing where alignment fails or means little.
fn align_one(
    [left, right]: [ArrayView2<'_, f32>; 2],
    pair: &PointMatch,
    right_from_left: &Similarity2,
) -> Option<(f64, PointMatch)> {
    let weights = weights();
    let turn = |offset: Vector2| right_from_left.isometry.rotation * offset * right_from_left.scaling();
    let fixed = Window::sample(&left, |offset| pair.left + offset, &weights)?;
    let mut shift = Vector2::zeros();
    for _ in 0..ITERATIONS {
        let moving = Window::sample(&right, |offset| pair.right + turn(offset + shift), &weights)?;
        let mut normal = nalgebra::Matrix2::<f64>::zeros();
        let mut target = Vector2::zeros();
        let (mut correlation, mut total) = (0.0, 0.0);
        for (index, &weight) in weights.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
            let values = &moving.values;
            let gradient = 0.5
                * Vector2::new(values[index + 1] - values[index - 1], values[index + SIDE] - values[index - SIDE]);
            normal += weight * gradient * gradient.transpose();
            target += weight * gradient * (fixed.values[index] - values[index]);
            correlation += weight * fixed.values[index] * values[index];
            total += weight;
        }
        correlation /= total;
        let inverse = normal.try_inverse()?;
        let step: Vector2 = inverse * target;
        if step.norm() < 0.01 {
            // The residual's variance is 2 (1 - correlation); the blur makes about pi (2 BLUR)^2 pixels agree.
            let independent = std::f64::consts::PI * (2.0 * BLUR_PX).powi(2);
            let variance = 2.0 * (1.0 - correlation).max(0.0) * independent;
            let good = correlation >= MIN_CORRELATION
                && shift.norm() <= MAX_SHIFT_PX
                && variance * inverse[(1, 1)] <= MAX_SIGMA_PX[0].powi(2)
                && variance * inverse[(0, 0)] <= MAX_SIGMA_PX[1].powi(2);
            return good.then(|| (correlation, PointMatch { left: pair.left, right: pair.right + turn(shift) }));
        }
        shift += if step.norm() > 1.0 { step.normalize() } else { step };
        if shift.norm() > 2.0 * MAX_SHIFT_PX {
            return None;
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::{Scene, SceneSettings, ViewSettings, render};

    #[test]
    fn windows_find_the_shift_that_was_made() {
        // Specks in one plane, the right view turned by a degree, moved, darker by half and noisy.
        let mut scene =
            Scene::random(&SceneSettings { size_px: 256.0, thickness_px: 0.1, curves: 0, specks: 700, seed: 5 });
        scene.specks.iter_mut().for_each(|speck| speck.position.z = 0.0);
        let base = ViewSettings { shape: [256, 256], noise: 0.02, ..ViewSettings::default() };
        let moved = ViewSettings {
            axis_rad: 1.0_f64.to_radians(),
            shift_px: [3.3, -1.7],
            scale: 1.01,
            seed: 2,
            ..base.clone()
        };
        let right_from_left = moved.image_from_projection() * base.image_from_projection().inverse();
        let (left, mut right) = (render(&scene, &base).pixels, render(&scene, &moved).pixels);
        right.mapv_inplace(|value| 0.5 * value + 0.1);
        let mut matches = Vec::new();
        for index in 0..100 {
            let point = Point2::new(30.0 + 20.0 * (index % 10) as f64, 30.0 + 20.0 * (index / 10) as f64);
            // As badly placed as SIFT would at worst.
            let wrong = Vector2::new((index % 5) as f64 - 2.0, (index % 3) as f64 - 1.0) * 0.7;
            matches.push(PointMatch { left: point, right: right_from_left * point + wrong });
        }
        let aligned = align([&left, &right], &matches, &right_from_left);
        assert!(aligned.len() > 60, "{}", aligned.len());
        let mut errors: Vec<f64> =
            aligned.iter().map(|pair| (right_from_left * pair.left - pair.right).norm()).collect();
        errors.sort_by(f64::total_cmp);
        // Noise of 0.02 on specks of contrast 0.1: a tenth of a px is what the windows' gradients allow.
        assert!(errors[errors.len() / 2] < 0.1, "{}", errors[errors.len() / 2]);
        assert!(errors[errors.len() * 9 / 10] < 0.3, "{}", errors[errors.len() * 9 / 10]);
    }

    #[test]
    fn what_is_flat_or_outside_is_left_out() {
        let flat = Array2::<f32>::from_elem((100, 100), 1.0);
        let at = |x: f64, y: f64| PointMatch { left: Point2::new(x, y), right: Point2::new(x, y) };
        assert!(align([&flat, &flat], &[at(50.0, 50.0), at(3.0, 3.0), at(200.0, 3.0)], &Similarity2::identity()).is_empty());
    }
}

//! What area matching compares: an image without its slow changes of grey and its finest noise, and where it has data.

use ndarray::Array2;
use rayon::prelude::*;

use crate::filter::{gaussian_blur, sample_cubic};
use crate::geometry::{Point2, Similarity2, Vector2};

/// Standard deviation of the blur that removes the finest noise, px.
const FINE_PX: f64 = 1.2;
/// Standard deviation of the blur that slow changes of grey survive, px.
const COARSE_PX: f64 = 7.0;
/// Values are cut at so many robust standard deviations: one speck of dirt must not outweigh the lines.
const CUT: f32 = 5.0;
/// The scale is measured on every so many px: that is exact enough.
const STRIDE: usize = 7;
/// So many equal px from the rim inwards are a border.
const SAME_PX: usize = 4;

/// A band-passed image.
#[derive(Clone, Debug)]
pub struct Texture {
    /// Band-passed intensity `[row, column]`, about zero, in robust standard deviations; zero where there is no data.
    pub values: Array2<f32>,
    /// 1 where there is data, else 0.
    pub valid: Array2<f32>,
    /// Input px per px of the texture.
    pub step: usize,
}

impl Texture {
    /// The texture of an image, averaged over `step` x `step` px first.
    pub fn of(image: &Array2<f32>, step: usize) -> Self {
        let (image, valid) = reduced(image, &with_data(image), step);
        let masked = &image * &valid;
        let mut values = smooth(&masked, &valid, FINE_PX) - smooth(&masked, &valid, COARSE_PX);
        values *= &valid;
        let mut sizes: Vec<f32> = values
            .iter()
            .zip(&valid)
            .step_by(STRIDE)
            .filter(|(_, valid)| **valid > 0.5)
            .map(|(value, _)| value.abs())
            .collect();
        let middle = sizes.len() / 2;
        let scale =
            if sizes.is_empty() { 0.0 } else { 1.4826 * *sizes.select_nth_unstable_by(middle, f32::total_cmp).1 };
        let gain = if scale > 0.0 { 1.0 / scale } else { 0.0 };
        values.mapv_inplace(|value| (value * gain).clamp(-CUT, CUT));
        Self { values, valid, step }
    }

    /// Rows and columns.
    pub fn shape(&self) -> [usize; 2] {
        self.values.dim().into()
    }

    /// Texture px of a point in input px.
    pub fn from_input(&self, point: &Point2) -> Point2 {
        let half = 0.5 * (self.step as f64 - 1.0);
        Point2::from((point.coords - Vector2::new(half, half)) / self.step as f64)
    }

    /// Input px of a point in texture px.
    pub fn to_input(&self, point: &Point2) -> Point2 {
        let half = 0.5 * (self.step as f64 - 1.0);
        Point2::from(point.coords * self.step as f64 + Vector2::new(half, half))
    }

    /// This texture as seen on another grid of `shape`, where `here_from_there` maps that grid's px to px of this texture.
    pub fn warped(&self, here_from_there: &Similarity2, shape: [usize; 2]) -> Self {
        let mut values = Array2::zeros(shape);
        let mut valid = Array2::zeros(shape);
        let (view, mask) = (self.values.view(), &self.valid);
        let rows = values.as_slice_mut().expect("a new array is contiguous").par_chunks_mut(shape[1].max(1));
        let masks = valid.as_slice_mut().expect("a new array is contiguous").par_chunks_mut(shape[1].max(1));
        rows.zip(masks).enumerate().for_each(|(row, (line, valid))| {
            let start = here_from_there * Point2::new(0.0, row as f64);
            let step = here_from_there * Vector2::new(1.0, 0.0);
            for column in 0..line.len() {
                let point = start + step * column as f64;
                if let Some(value) = sample_cubic(&view, point.x, point.y) {
                    valid[column] = mask[[point.y.round() as usize, point.x.round() as usize]];
                    line[column] = value * valid[column];
                }
            }
        });
        Self { values, valid, step: self.step }
    }
}

/// 1 where an image has data: borders of one grey level, as alignment leaves them, are none.
fn with_data(image: &Array2<f32>) -> Array2<f32> {
    let (height, width) = image.dim();
    let mut valid = Array2::ones((height, width));
    let mut clear = |at: &dyn Fn(usize) -> (usize, usize), length: usize| {
        let same = (0..length).take_while(|i| image[at(*i)] == image[at(0)]).count();
        // Two equal neighbours happen in any image of few grey levels.
        if same >= SAME_PX {
            (0..same).for_each(|i| valid[at(i)] = 0.0);
        }
    };
    for row in 0..height {
        clear(&|i| (row, i), width);
        clear(&|i| (row, width - 1 - i), width);
    }
    for column in 0..width {
        clear(&|i| (i, column), height);
        clear(&|i| (height - 1 - i, column), height);
    }
    valid
}

/// Means of `step` x `step` px that have data; cells with less than half of it have none.
fn reduced(image: &Array2<f32>, valid: &Array2<f32>, step: usize) -> (Array2<f32>, Array2<f32>) {
    if step <= 1 {
        return (image.clone(), valid.clone());
    }
    let shape = (image.nrows() / step, image.ncols() / step);
    let (mut out, mut mask) = (Array2::zeros(shape), Array2::zeros(shape));
    for ((row, column), value) in out.indexed_iter_mut() {
        let (mut sum, mut weight) = (0.0, 0.0);
        for y in row * step..(row + 1) * step {
            for x in column * step..(column + 1) * step {
                sum += image[[y, x]] * valid[[y, x]];
                weight += valid[[y, x]];
            }
        }
        if 2.0 * weight >= (step * step) as f32 {
            *value = sum / weight;
            mask[[row, column]] = 1.0;
        }
    }
    (out, mask)
}

/// Blur that takes nothing from where there is no data.
fn smooth(masked: &Array2<f32>, valid: &Array2<f32>, sigma: f64) -> Array2<f32> {
    let mut out = gaussian_blur(masked, sigma);
    if valid.iter().all(|valid| *valid == 1.0) {
        return out;
    }
    out.zip_mut_with(&gaussian_blur(valid, sigma), |value, weight| *value /= weight.max(1e-3));
    out
}

//! Costs of disparities at places of the left image, read off cost volumes as training reads them: linear between voxels
//! along the image, cubic (Catmull-Rom) between levels.

use burn::tensor::Tensor;
use ndarray::Array3;

use super::tiles::Tile;
use crate::config::MatcherConfig;
use crate::volume::levels_px;

/// The cost volume of a whole image `[level, row, column]` at the matcher's resolution; infinite where it was not computed.
pub struct Costs {
    volume: Array3<f32>,
    config: MatcherConfig,
    /// Disparity of each fine level, px.
    pub levels_px: Vec<f32>,
}

impl Costs {
    /// Costs of an image of rows and columns, none computed yet.
    pub fn new((rows, columns): (usize, usize), config: &MatcherConfig) -> Self {
        let shape = (config.levels, rows.div_ceil(config.downscale), columns.div_ceil(config.downscale));
        let volume = Array3::from_elem(shape, f32::INFINITY);
        Self { volume, config: config.clone(), levels_px: levels_px(config) }
    }

    /// Takes over what is kept of a tile `[1, level, row, column]`.
    pub fn put(&mut self, cost: Tensor<4>, rows: &Tile, columns: &Tile) {
        let factor = self.config.downscale;
        let [_, levels, height, width] = cost.dims();
        let values: Vec<f32> = cost.into_data().try_to_vec().expect("costs are f32");
        let part = |tile: &Tile| tile.keep.start / factor..tile.keep.end.div_ceil(factor);
        for level in 0..levels {
            for row in part(rows) {
                for column in part(columns) {
                    let (r, c) = (row - rows.start / factor, column - columns.start / factor);
                    self.volume[[level, row, column]] = values[(level * height + r) * width + c];
                }
            }
        }
    }

    /// Costs of all fine levels at a place (px of the image); `None` where they were not computed.
    pub fn at(&self, x: f64, y: f64) -> Option<Vec<f32>> {
        let factor = self.config.downscale;
        let (levels, rows, columns) = self.volume.dim();
        let place = |at: f64, count: usize| {
            let at = ((at + 0.5) / factor as f64 - 0.5).clamp(0.0, (count - 1) as f64);
            let from = (at.floor() as usize).min(count.saturating_sub(2));
            (from, (from + 1).min(count - 1), (at - from as f64) as f32)
        };
        let ((top, bottom, v), (left, right, u)) = (place(y, rows), place(x, columns));
        let coarse: Vec<f32> = (0..levels)
            .map(|level| {
                let value = |row: usize, column: usize| self.volume[[level, row, column]];
                let upper = mix(value(top, left), value(top, right), u);
                let lower = mix(value(bottom, left), value(bottom, right), u);
                mix(upper, lower, v)
            })
            .collect();
        coarse.iter().all(|cost| cost.is_finite()).then(|| self.fine(&coarse))
    }

    fn fine(&self, coarse: &[f32]) -> Vec<f32> {
        let factor = self.config.downscale;
        let at = |level: usize, offset: isize| coarse[level.saturating_add_signed(offset).min(coarse.len() - 1)];
        (0..self.levels_px.len())
            .map(|to| {
                let (from, t) = (to / factor, (to % factor) as f32 / factor as f32);
                let [a, b, c, d] = [-1, 0, 1, 2].map(|offset| at(from, offset));
                b + 0.5 * t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a)))
            })
            .collect()
    }
}

/// Between two values; one that was not computed does not matter where its share is zero.
fn mix(a: f32, b: f32, share: f32) -> f32 {
    if share <= 0.0 {
        a
    } else if share >= 1.0 {
        b
    } else {
        a + (b - a) * share
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::{at_levels, at_pixels};
    use burn::tensor::{Device, TensorData};

    /// What is read here is what training saw.
    #[test]
    fn costs_are_read_as_in_training() {
        let config = MatcherConfig { levels: 8, ..MatcherConfig::default() };
        let shape = [1, 8, 4, 6];
        let values: Vec<f32> = (0..8 * 4 * 6).map(|index| ((index * 37) % 29) as f32 / 7.0).collect();
        let cost = Tensor::<4>::from_data(TensorData::new(values, shape), &Device::flex());
        let expected: Vec<f32> = at_levels(at_pixels(cost.clone(), &config), &config).into_data().try_to_vec().unwrap();
        let mut costs = Costs::new((16, 24), &config);
        let tile = |count| Tile { start: 0, length: count, keep: 0..count };
        costs.put(cost, &tile(16), &tile(24));
        let levels = costs.levels_px.len();
        for row in 0..16 {
            for column in 0..24 {
                let found = costs.at(column as f64, row as f64).unwrap();
                for (found, expected) in found.iter().zip(&expected[(row * 24 + column) * levels..]) {
                    assert!((found - expected).abs() < 1e-4, "{found} {expected} at {row}, {column}");
                }
            }
        }
    }
}

//! Ridge points: pixels where the response is largest across the line, moved to the sub-pixel crest.
//!
//! The crest is where the intensity itself is extreme across the line (Steger, PAMI 1998), taken on the isotropic
//! scale, since the elongated kernels cut corners on curved lines. Positions are in px of the rectified image.

use ndarray::Array2;
use rayon::prelude::*;

use crate::filter::sample_linear;
use crate::geometry::{Point2, Vector2};
use crate::ridge::oriented::{Response, tangent};
use crate::ridge::scales::Scale;

/// Response below which nothing is looked at, in standard deviations.
const LOWEST_SIGNIFICANCE: f32 = 2.5;

/// A point on the crest of a response.
#[derive(Clone, Debug)]
pub(super) struct RidgePoint {
    /// The pixel `[row, column]` it was found at.
    pub pixel: [usize; 2],
    /// Position; the crest of the responses at first, then that of the intensity ([`RidgePoint::refine`]).
    pub position: Point2,
    /// Unit tangent (either sense).
    pub tangent: Vector2,
    /// Response in standard deviations of the noise, less for wide scales.
    pub significance: f32,
    /// Response in intensity: `sigma^2` times the second derivative across, averaged by the elongated kernel.
    pub response: f32,
    /// Index of the scale it responds to most.
    pub scale: usize,
}

impl RidgePoint {
    /// Moves the point to where the intensity at a scale is extreme across its tangent.
    pub fn refine(&mut self, scale: &Scale) {
        self.position = crest(scale, self.position, self.across());
    }

    /// Unit normal of the line.
    pub fn across(&self) -> Vector2 {
        Vector2::new(-self.tangent.y, self.tangent.x)
    }
}

/// The strongest response over all scales on the full grid.
pub(super) struct Strongest {
    significance: Array2<f32>,
    /// Noise of the response that is strongest.
    noise: Array2<f32>,
    direction: Array2<u8>,
    scale: Array2<u8>,
}

impl Strongest {
    /// Nothing yet, for an image of a shape.
    pub fn new(shape: (usize, usize)) -> Self {
        Self {
            significance: Array2::zeros(shape),
            noise: Array2::zeros(shape),
            direction: Array2::zeros(shape),
            scale: Array2::zeros(shape),
        }
    }

    /// Takes in the responses of a scale where they are stronger.
    pub fn add(&mut self, index: usize, scale: &Scale, response: &Response) {
        let (height, width) = self.significance.dim();
        let (grid_height, grid_width) = response.significance.dim();
        let significance = self.significance.as_slice_mut().expect("made in standard layout");
        let noise = self.noise.as_slice_mut().expect("made in standard layout");
        let direction = self.direction.as_slice_mut().expect("made in standard layout");
        let which = self.scale.as_slice_mut().expect("made in standard layout");
        let spacing = scale.spacing() as f32;
        // White noise favours kernels wider than the line: a price on width keeps neighbouring lines apart.
        let price = scale.sigma_px.powf(-0.3) as f32;
        let place = move |index: usize, count: usize| {
            let at = ((index as f32 + 0.5) / spacing - 0.5).clamp(0.0, (count - 1) as f32);
            let low = (at as usize).min(count.saturating_sub(2));
            (low, (low + 1).min(count - 1), at - low as f32)
        };
        let columns: Vec<_> = (0..width).map(|column| place(column, grid_width)).collect();
        let rows = significance.par_chunks_mut(width).zip(direction.par_chunks_mut(width));
        let rows = rows.zip(which.par_chunks_mut(width)).zip(noise.par_chunks_mut(width));
        rows.enumerate().for_each(|(row, (((best, direction), which), noise))| {
            debug_assert!(row < height);
            let (top, bottom, v) = place(row, grid_height);
            for (column, &(left, right, u)) in columns.iter().enumerate() {
                let mix = |row: usize| {
                    response.significance[[row, left]] * (1.0 - u) + response.significance[[row, right]] * u
                };
                let value = match scale.level {
                    0 => response.significance[[row, column]],
                    _ => mix(top) * (1.0 - v) + mix(bottom) * v,
                } * price;
                if value > best[column] {
                    best[column] = value;
                    let nearest = [if v < 0.5 { top } else { bottom }, if u < 0.5 { left } else { right }];
                    direction[column] = response.direction[nearest];
                    noise[column] = response.noise_at(nearest) / price;
                    which[column] = index as u8;
                }
            }
        });
    }

    /// Crest points, row by row.
    pub fn points(&self, scales: &[Scale], distance_to_gap: &Array2<f32>) -> Vec<RidgePoint> {
        let (height, width) = self.significance.dim();
        let rows: Vec<Vec<RidgePoint>> = (0..height)
            .into_par_iter()
            .map(|row| (0..width).filter_map(|column| self.point(row, column, scales, distance_to_gap)).collect())
            .collect();
        rows.into_iter().flatten().collect()
    }

    fn point(&self, row: usize, column: usize, scales: &[Scale], gap: &Array2<f32>) -> Option<RidgePoint> {
        let significance = self.significance[[row, column]];
        if significance < LOWEST_SIGNIFICANCE {
            return None;
        }
        let index = usize::from(self.scale[[row, column]]);
        let scale = &scales[index];
        if f64::from(gap[[row, column]]) < 3.0 + 1.5 * scale.sigma_px {
            return None;
        }
        let (x, y) = tangent(usize::from(self.direction[[row, column]]));
        let (along, across) = (Vector2::new(x, y), Vector2::new(-y, x));
        let pixel = Point2::new(column as f64, row as f64);
        if runs_along_border(pixel, along, self.significance.dim(), 1.0 + 1.5 * scale.sigma_px) {
            return None;
        }
        let map = self.significance.view();
        let beside = |side: f64| {
            let point = pixel + across * side;
            sample_linear(&map, point.x, point.y).unwrap_or(0.0)
        };
        let (after, before) = (beside(1.0), beside(-1.0));
        if significance < after || significance <= before {
            return None;
        }
        let curvature = before + after - 2.0 * significance;
        let offset = if curvature < 0.0 { 0.5 * (before - after) / curvature } else { 0.0 };
        let position = pixel + across * f64::from(offset.clamp(-0.5, 0.5));
        let response = significance * self.noise[[row, column]];
        Some(RidgePoint { pixel: [row, column], position, tangent: along, significance, response, scale: index })
    }
}

/// Whether a pixel is near the image's border and its line runs along it: mirroring makes such ridges.
fn runs_along_border(point: Point2, tangent: Vector2, (height, width): (usize, usize), reach: f64) -> bool {
    let near_side = point.x < reach || point.x > width as f64 - 1.0 - reach;
    let near_top = point.y < reach || point.y > height as f64 - 1.0 - reach;
    // 45 degrees and more off the border may pass.
    (near_side && tangent.y.abs() > 0.72) || (near_top && tangent.x.abs() > 0.72)
}

/// Moves a point across the line to where the intensity is extreme; stays if that is not near.
fn crest(scale: &Scale, start: Point2, across: Vector2) -> Point2 {
    let step = 0.75 * scale.sigma_px;
    let limit = 1.2 * scale.spacing().max(1.0);
    let mut offset = 0.0;
    for _ in 0..3 {
        let [before, here, after] = scale.across(start + across * offset, across, step);
        let curvature = before + after - 2.0 * here;
        let slope = 0.5 * (after - before);
        // The polarity does not matter: an extreme point is one in both.
        let shift = if curvature == 0.0 { 0.0 } else { f64::from(-slope / curvature) * step };
        offset += shift.clamp(-step, step);
        if offset.is_nan() || offset.abs() > limit {
            return start;
        }
        if shift.abs() < 0.005 {
            break;
        }
    }
    start + across * offset
}

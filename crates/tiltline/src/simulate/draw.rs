//! Draws polylines with a Gaussian profile, with sub-pixel accuracy.

use ndarray::Array2;

use crate::geometry::Point2;

/// Calls `paint(row, column, value)` once for each pixel near a polyline, with `value = exp(-distance^2 / (2 sigma^2))`
/// of the pixel centre's distance to it; pixels further than 4 sigma away are left out.
pub fn profile(shape: [usize; 2], polyline: &[Point2], sigma: f64, mut paint: impl FnMut(usize, usize, f32)) {
    let reach = 4.0 * sigma;
    // Squared distances of the pixels in reach, in the order they were first met.
    let mut nearest = std::collections::BTreeMap::<(usize, usize), f64>::new();
    for ends in polyline.windows(2) {
        let (a, b) = (ends[0], ends[1]);
        let along = b - a;
        let length2 = along.norm_squared().max(1e-12);
        let Some(columns) = pixel_range(a.x.min(b.x) - reach, a.x.max(b.x) + reach, shape[1]) else { continue };
        let Some(rows) = pixel_range(a.y.min(b.y) - reach, a.y.max(b.y) + reach, shape[0]) else { continue };
        for row in rows {
            for column in columns.clone() {
                let offset = Point2::new(column as f64, row as f64) - a;
                let foot = (offset.dot(&along) / length2).clamp(0.0, 1.0);
                let distance2 = (offset - along * foot).norm_squared();
                if distance2 <= reach * reach {
                    let best = nearest.entry((row, column)).or_insert(distance2);
                    *best = best.min(distance2);
                }
            }
        }
    }
    for ((row, column), distance2) in nearest {
        paint(row, column, (-0.5 * distance2 / (sigma * sigma)).exp() as f32);
    }
}

/// The largest profile over all polylines at each pixel `[row, column]`.
pub fn union_of_profiles(shape: [usize; 2], polylines: &[Vec<Point2>], sigma: f64) -> Array2<f32> {
    let mut image = Array2::<f32>::zeros(shape);
    for polyline in polylines {
        profile(shape, polyline, sigma, |row, column, value| {
            let pixel = &mut image[[row, column]];
            *pixel = pixel.max(value);
        });
    }
    image
}

fn pixel_range(low: f64, high: f64, count: usize) -> Option<std::ops::RangeInclusive<usize>> {
    let (low, high) = (low.ceil().max(0.0), high.floor().min(count as f64 - 1.0));
    (low <= high).then_some(low as usize..=high as usize)
}

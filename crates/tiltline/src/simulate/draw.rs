//! Draws along polylines with sub-pixel accuracy: each pixel near the line is painted once, knowing its distance, its
//! side and the place along the line it belongs to.

use ndarray::Array2;

use crate::geometry::Point2;

/// Where a pixel lies with respect to a polyline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Near {
    /// Distance of the pixel's centre to the polyline, px.
    pub distance: f32,
    /// Signed distance across: positive on the right-hand side when walking along the line with y down (clockwise).
    pub across: f32,
    /// Fractional index of the nearest place: `i + t` lies between points `i` and `i + 1`.
    pub place: f32,
}

/// Calls `paint(row, column, near)` once for each pixel within `reach` px of a polyline, row by row.
pub fn stroke(shape: [usize; 2], polyline: &[Point2], reach: f64, mut paint: impl FnMut(usize, usize, Near)) {
    let bounds = |coordinate: fn(&Point2) -> f64| {
        polyline
            .iter()
            .map(coordinate)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
    };
    let ((left, right), (top, bottom)) = (bounds(|point| point.x), bounds(|point| point.y));
    let Some(columns) = pixel_range(left - reach, right + reach, shape[1]) else { return };
    let Some(rows) = pixel_range(top - reach, bottom + reach, shape[0]) else { return };
    let (first_column, first_row) = (*columns.start(), *rows.start());
    let width = columns.end() - first_column + 1;
    let height = rows.end() - first_row + 1;
    let reach2 = (reach * reach) as f32;
    // (squared distance, signed distance, place); nothing nearer than the reach yet.
    let mut nearest = vec![(f32::INFINITY, 0.0_f32, 0.0_f32); width * height];
    for (index, ends) in polyline.windows(2).enumerate() {
        let (a, b) = (ends[0], ends[1]);
        let along = b - a;
        let length2 = along.norm_squared().max(1e-12);
        let (per_length2, per_length) = ((1.0 / length2) as f32, (1.0 / length2.sqrt()) as f32);
        let Some(columns) = pixel_range(a.x.min(b.x) - reach, a.x.max(b.x) + reach, shape[1]) else { continue };
        let Some(rows) = pixel_range(a.y.min(b.y) - reach, a.y.max(b.y) + reach, shape[0]) else { continue };
        let (along_x, along_y) = (along.x as f32, along.y as f32);
        for row in rows {
            let offset_y = (row as f64 - a.y) as f32;
            let line = &mut nearest[(row - first_row) * width..(row - first_row + 1) * width];
            for column in columns.clone() {
                let offset_x = (column as f64 - a.x) as f32;
                let foot = ((offset_x * along_x + offset_y * along_y) * per_length2).clamp(0.0, 1.0);
                let (dx, dy) = (offset_x - foot * along_x, offset_y - foot * along_y);
                let distance2 = dx * dx + dy * dy;
                let best = &mut line[column - first_column];
                if distance2 < best.0 && distance2 <= reach2 {
                    *best = (distance2, (along_x * offset_y - along_y * offset_x) * per_length, index as f32 + foot);
                }
            }
        }
    }
    for (row, line) in nearest.chunks(width).enumerate() {
        for (column, &(distance2, across, place)) in line.iter().enumerate() {
            if distance2 <= reach2 {
                paint(first_row + row, first_column + column, Near { distance: distance2.sqrt(), across, place });
            }
        }
    }
}

/// Calls `paint(row, column, value)` once for each pixel near a polyline, with `value = exp(-distance^2 / (2 sigma^2))`;
/// pixels further than 4 sigma away are left out.
pub fn profile(shape: [usize; 2], polyline: &[Point2], sigma: f64, mut paint: impl FnMut(usize, usize, f32)) {
    let gain = (-0.5 / (sigma * sigma)) as f32;
    stroke(shape, polyline, 4.0 * sigma, |row, column, near| {
        paint(row, column, (gain * near.distance * near.distance).exp());
    });
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_knows_its_distance_side_and_place() {
        let line = [Point2::new(2.0, 5.0), Point2::new(12.0, 5.0), Point2::new(12.0, 15.0)];
        let mut seen = Vec::new();
        stroke([20, 20], &line, 3.0, |row, column, near| seen.push((row, column, near)));
        let at = |row, column| seen.iter().find(|(r, c, _)| (*r, *c) == (row, column)).map(|(.., near)| *near);
        // Two rows below the first leg, which runs to the right: its right-hand side on a screen with y down.
        assert_eq!(at(7, 7), Some(Near { distance: 2.0, across: 2.0, place: 0.5 }));
        assert_eq!(at(3, 7), Some(Near { distance: 2.0, across: -2.0, place: 0.5 }));
        assert_eq!(at(10, 14), Some(Near { distance: 2.0, across: -2.0, place: 1.5 }));
        assert_eq!(at(9, 7), None);
        let mut pixels: Vec<_> = seen.iter().map(|(row, column, _)| (*row, *column)).collect();
        pixels.dedup();
        assert_eq!(pixels.len(), seen.len());
    }

    #[test]
    fn lines_outside_the_image_paint_nothing() {
        let line = [Point2::new(-50.0, -50.0), Point2::new(-10.0, 90.0)];
        stroke([20, 20], &line, 3.0, |_, _, _| panic!("nothing is within reach"));
        stroke([20, 20], &[], 3.0, |_, _, _| panic!("nothing to draw"));
    }
}

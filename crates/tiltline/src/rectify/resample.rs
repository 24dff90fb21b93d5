//! The common rectified grid and the images on it. Cubic interpolation; NaN where an image has no data.

use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;

use crate::filter::sample_cubic;
use crate::geometry::{Point2, Similarity2, Vector2};

/// The grid may have at most so many times the left image's pixels.
pub const LARGEST_GROWTH: f64 = 2.5;

/// A grid on which both images lie.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Rows and columns.
    pub shape: [usize; 2],
    /// Added to rectified coordinates so that the grid's first pixel is (0, 0); whole px.
    pub shift: Vector2,
    /// Whether the right image was left out of it, because both together are too large.
    pub left_only: bool,
}

/// The grid of all pixels of both images, or of the left one's where that would be too large. `shapes` are rows and
/// columns of the images, `maps` take their px to rectified px.
pub fn common_grid(shapes: [[usize; 2]; 2], maps: [&Similarity2; 2]) -> Grid {
    let boxes = [0, 1].map(|view| bounds(shapes[view], maps[view]));
    let low = boxes[0].0.inf(&boxes[1].0);
    let high = boxes[0].1.sup(&boxes[1].1);
    let union = grid(low, high);
    let most = LARGEST_GROWTH * (shapes[0][0] * shapes[0][1]) as f64;
    // In floating point: two images far apart span more than an index can hold.
    if (high.x - low.x + 1.0) * (high.y - low.y + 1.0) <= most {
        union
    } else {
        Grid { left_only: true, ..grid(boxes[0].0, boxes[0].1) }
    }
}

fn grid(low: Point2, high: Point2) -> Grid {
    // Rounding of a map must not add an empty row.
    let low = low.map(|value| (value + 1e-6).floor());
    let size = high.map(|value| (value - 1e-6).ceil()) - low + Vector2::new(1.0, 1.0);
    Grid { shape: [size.y.max(1.0) as usize, size.x.max(1.0) as usize], shift: -low.coords, left_only: false }
}

/// The box of an image on the other side of a map: its least and largest corner.
pub fn bounds(shape: [usize; 2], map: &Similarity2) -> (Point2, Point2) {
    let (x, y) = ((shape[1] - 1) as f64, (shape[0] - 1) as f64);
    let corners = [(0.0, 0.0), (x, 0.0), (0.0, y), (x, y)].map(|(x, y)| map * Point2::new(x, y));
    corners.iter().fold((corners[0], corners[0]), |(low, high), corner| (low.inf(corner), high.sup(corner)))
}

/// The image on the grid; NaN outside the centres of its border pixels.
pub fn resample(image: &ArrayView2<'_, f32>, rectified_from_image: &Similarity2, shape: [usize; 2]) -> Array2<f32> {
    let (height, width) = image.dim();
    let image_from_rectified = rectified_from_image.inverse();
    let step = image_from_rectified * Vector2::new(1.0, 0.0);
    let mut values = vec![f32::NAN; shape[0] * shape[1]];
    values.par_chunks_mut(shape[1]).enumerate().for_each(|(row, line)| {
        let start = image_from_rectified * Point2::new(0.0, row as f64);
        let columns = span(start.x, step.x, width, shape[1]).zip(span(start.y, step.y, height, shape[1]));
        let Some(((a, b), (c, d))) = columns else { return };
        for (column, value) in line.iter_mut().enumerate().take((b.min(d) + 1).min(shape[1])).skip(a.max(c)) {
            let point = start + step * column as f64;
            // Rounding must not lose the border pixels of an image that is only shifted.
            let x = snapped(point.x, (width - 1) as f64);
            let y = snapped(point.y, (height - 1) as f64);
            *value = sample_cubic(image, x, y).unwrap_or(f32::NAN);
        }
    });
    Array2::from_shape_vec((shape[0], shape[1]), values).expect("the buffer has rows * columns values")
}

/// First and last column at which `start + column * step` may lie in `[0, size - 1]`; a column too many on either side.
fn span(start: f64, step: f64, size: usize, columns: usize) -> Option<(usize, usize)> {
    let last = (size - 1) as f64;
    let (mut low, mut high) = (0.0, columns as f64 - 1.0);
    if step.abs() > 1e-9 {
        let (a, b) = (-start / step, (last - start) / step);
        low = a.min(b).max(low);
        high = a.max(b).min(high);
    } else if start < -0.5 || start > last + 0.5 {
        return None;
    }
    (low <= high + 1.0).then(|| ((low - 1.0).max(0.0) as usize, (high + 1.0).max(0.0) as usize))
}

fn snapped(value: f64, last: f64) -> f64 {
    const SLACK: f64 = 1e-6;
    if value < 0.0 && value > -SLACK {
        0.0
    } else if value > last && value < last + SLACK {
        last
    } else {
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn an_image_that_is_not_moved_is_kept_exactly_and_its_neighbour_widens_the_grid() {
        let image = Array2::from_shape_fn((20, 30), |(row, column)| (row * 31 + column * 7 % 5) as f32);
        let (left, right) = (Similarity2::identity(), Similarity2::new(Vector2::new(-6.0, 3.0), 0.0, 1.0));
        let grid = common_grid([[20, 30], [20, 30]], [&left, &right]);
        assert_eq!(grid, Grid { shape: [23, 36], shift: Vector2::new(6.0, 0.0), left_only: false });
        let shift = Similarity2::new(grid.shift, 0.0, 1.0);
        let out = resample(&image.view(), &(shift * left), grid.shape);
        for ((row, column), value) in out.indexed_iter() {
            if row < 20 && column >= 6 {
                assert_relative_eq!(*value, image[[row, column - 6]], epsilon = 1e-5);
            } else {
                assert!(value.is_nan());
            }
        }
    }

    #[test]
    fn a_turned_plane_is_sampled_at_the_mapped_places_and_covers_its_pixels() {
        let image = Array2::from_shape_fn((40, 50), |(row, column)| row as f32 - 2.0 * column as f32);
        let map = Similarity2::new(Vector2::new(3.0, -2.0), 0.6, 1.1);
        let grid = common_grid([[40, 50], [40, 50]], [&map, &map]);
        let map = Similarity2::new(grid.shift, 0.0, 1.0) * map;
        let out = resample(&image.view(), &map, grid.shape);
        let mut seen = 0;
        for ((row, column), value) in out.indexed_iter() {
            let source = map.inverse() * Point2::new(column as f64, row as f64);
            let inside = source.x >= 0.0 && source.x <= 49.0 && source.y >= 0.0 && source.y <= 39.0;
            assert_eq!(inside, value.is_finite(), "{row} {column}");
            if inside {
                seen += 1;
                assert_relative_eq!(f64::from(*value), source.y - 2.0 * source.x, epsilon = 1e-4);
            }
        }
        // The area between the border centres, enlarged by 1.1 each way, to within its rim.
        assert!((f64::from(seen) / (39.0 * 49.0 * 1.21) - 1.0).abs() < 0.03, "{seen}");
    }

    #[test]
    fn images_far_apart_are_clipped_to_the_left_one() {
        let (left, right) = (Similarity2::identity(), Similarity2::new(Vector2::new(1e12, 0.0), 0.0, 1.0));
        let grid = common_grid([[20, 30], [20, 30]], [&left, &right]);
        assert_eq!((grid.shape, grid.left_only), ([20, 30], true));
        let out = resample(&Array2::zeros((20, 30)).view(), &right, grid.shape);
        assert!(out.iter().all(|value| value.is_nan()));
    }
}

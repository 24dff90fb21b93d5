//! Points in square cells: neighbours of a point in a few tens of nanoseconds, where an R-tree needs a microsecond. A score
//! asks some hundred thousand times.

use crate::geometry::Point2;

/// Side of a cell in px: about the radius that is asked for.
const CELL_PX: f64 = 2.5;
/// Most cells along a side; curves that lie further out get larger cells.
const MAX_CELLS: usize = 1024;

/// Indices of points, by cell.
pub(crate) struct Grid {
    origin: Point2,
    per_px: f64,
    columns: usize,
    rows: usize,
    /// Where the indices of each cell start in `points`, and where the last cell's end.
    starts: Vec<usize>,
    /// Points and their indices, cell by cell.
    points: Vec<(Point2, usize)>,
}

impl Grid {
    /// A grid over points, known by their index.
    pub fn new(points: Vec<Point2>) -> Self {
        let infinity = f64::INFINITY;
        let start = (Point2::new(infinity, infinity), Point2::new(-infinity, -infinity));
        let (low, high) = points.iter().fold(start, |(low, high), point| (low.inf(point), high.sup(point)));
        let extent = (high.x - low.x).max(high.y - low.y).max(0.0);
        let cell = CELL_PX.max(extent / (MAX_CELLS - 1) as f64);
        let cells = |length: f64| ((length / cell).max(0.0) as usize).min(MAX_CELLS - 1) + 1;
        let mut grid = Self {
            origin: low,
            per_px: 1.0 / cell,
            columns: cells(high.x - low.x),
            rows: cells(high.y - low.y),
            starts: Vec::new(),
            points: vec![(low, 0); points.len()],
        };
        // Counting sort: cells in order, and points in order within each.
        let cell_of: Vec<usize> = points
            .iter()
            .map(|point| {
                grid.clamped(point.y - low.y, grid.rows) * grid.columns + grid.clamped(point.x - low.x, grid.columns)
            })
            .collect();
        grid.starts = vec![0; grid.columns * grid.rows + 1];
        cell_of.iter().for_each(|cell| grid.starts[cell + 1] += 1);
        (1..grid.starts.len()).for_each(|cell| grid.starts[cell] += grid.starts[cell - 1]);
        let mut next = grid.starts.clone();
        for (index, cell) in cell_of.into_iter().enumerate() {
            grid.points[next[cell]] = (points[index], index);
            next[cell] += 1;
        }
        grid
    }

    /// Calls `visit` with every point within `radius` and its squared distance.
    pub fn visit(&self, point: &Point2, radius: f64, mut visit: impl FnMut(usize, f64)) {
        if self.points.is_empty() {
            return;
        }
        let (x, y) = (point.x - self.origin.x, point.y - self.origin.y);
        let (extent_x, extent_y) = (self.columns as f64 / self.per_px, self.rows as f64 / self.per_px);
        if x + radius < 0.0 || y + radius < 0.0 || x - radius > extent_x || y - radius > extent_y {
            return;
        }
        let (first, last) = (self.clamped(x - radius, self.columns), self.clamped(x + radius, self.columns));
        for row in self.clamped(y - radius, self.rows)..=self.clamped(y + radius, self.rows) {
            let cells = row * self.columns;
            // The cells of a row lie one after another.
            for (near, index) in &self.points[self.starts[cells + first]..self.starts[cells + last + 1]] {
                let distance2 = (near - point).norm_squared();
                if distance2 <= radius * radius {
                    visit(*index, distance2);
                }
            }
        }
    }

    fn clamped(&self, offset: f64, count: usize) -> usize {
        ((offset * self.per_px).max(0.0) as usize).min(count - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn all_points_within_the_radius_and_only_they_are_visited(
            points in proptest::collection::vec((-50.0..900.0_f64, -20.0..700.0_f64), 0..60),
            at in (-100.0..1000.0_f64, -100.0..800.0_f64),
            radius in 0.1..300.0_f64,
        ) {
            let points: Vec<Point2> = points.into_iter().map(|(x, y)| Point2::new(x, y)).collect();
            let at = Point2::new(at.0, at.1);
            let mut found = vec![0; points.len()];
            Grid::new(points.clone()).visit(&at, radius, |index, _| found[index] += 1);
            for (point, times) in points.iter().zip(found) {
                prop_assert!(times <= 1);
                prop_assert_eq!(times == 1, (point - at).norm_squared() <= radius * radius);
            }
        }
    }
}

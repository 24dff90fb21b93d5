//! The noise-free image of a foil in one view, computed at full resolution only where it varies.
//!
//! Background (perfect crystal) and change by the lines are each computed on a grid of every eighth pixel, which is halved
//! three times. A new point is computed if a line is near or if the grid's second and third differences there exceed the
//! tolerance, and interpolated (four points, cubic) otherwise. Points do not depend on each other's order: the result
//! is the same for any number of threads. Intensities, `[row, column]`, incident intensity 1.

use ndarray::Array2;
use rayon::prelude::*;

use crate::filter::gaussian_blur;
use crate::geometry::Point2;
use crate::simulate::{Camera, Foil};

use super::column::{Columns, Scratch};
use super::truth::{self, ViewTruth};
use super::{PhysicsError, PhysicsSettings, beam};

/// Step of the coarsest grid, px.
const COARSE_PX: usize = 8;
/// Points nearer to a line than this many steps of their grid are computed.
const NEAR_STEPS: f64 = 2.5;

/// A physical image and its truth.
#[derive(Clone, Debug, PartialEq)]
pub struct PhysicsImage {
    /// Recorded intensity `[row, column]`, blurred, noise-free; the incident beam is 1.
    pub intensity: Array2<f32>,
    /// The same of the crystal without lines: thickness fringes and bend contours.
    pub background: Array2<f32>,
    /// Where the contrast of each line lies.
    pub truth: ViewTruth,
}

/// The image of `foil` as seen by a camera, whose scale is px per nm.
///
/// # Errors
/// [`PhysicsError`] for parameters that are not numbers or absurd, and for lines without Burgers vector.
///
/// # Example
/// ```
/// use tiltline::geometry::{Point3, Vector3};
/// use tiltline::simulate::physics::{PhysicsSettings, image};
/// use tiltline::simulate::{Camera, Dislocation, Foil};
///
/// let line = Dislocation {
///     points: vec![Point3::new(0.0, -30.0, -50.0), Point3::new(0.0, 30.0, 50.0)],
///     closed: false,
///     burgers_nm: Some(Vector3::new(0.0, 0.25, 0.0)),
///     plane_normal: None,
/// };
/// let foil = Foil { thickness_nm: 100.0, size_nm: [200.0, 200.0], dislocations: vec![line] };
/// let view = Camera { scale: 0.5, ..Camera::new([64, 64]) };
/// let picture = image(&foil, &PhysicsSettings::default(), &view)?;
/// assert_eq!(picture.intensity.dim(), (64, 64));
/// # Ok::<(), tiltline::simulate::physics::PhysicsError>(())
/// ```
pub fn image(foil: &Foil, settings: &PhysicsSettings, view: &Camera) -> Result<PhysicsImage, PhysicsError> {
    beam::validate_view(view)?;
    let columns = Columns::new(foil, settings, view.tilt_rad)?;
    let projection_from_image = view.image_from_projection().inverse();
    let place = |[row, column]: [f64; 2]| {
        let point = projection_from_image * Point2::new(column, row);
        [point.x, point.y]
    };
    let background =
        refine(view.shape, settings.interpolation_tolerance, |_, _, _| false, |at, _| columns.background(place(at)));
    let change = if foil.dislocations.is_empty() {
        Array2::zeros(view.shape)
    } else {
        let near = |at: [f64; 2], step_px: f64, scratch: &mut Scratch| {
            let limit = NEAR_STEPS * step_px / view.scale;
            columns.distance_to_lines(place(at), limit, scratch) < limit
        };
        refine(view.shape, settings.interpolation_tolerance, near, |at, scratch| columns.change(place(at), scratch))
    };
    let blur_px = settings.blur_nm * view.scale;
    let background = gaussian_blur(&background, blur_px);
    let change = gaussian_blur(&change, blur_px);
    let truth = truth::measure(foil, settings, view, &background, &change);
    Ok(PhysicsImage { intensity: &background + &change, background, truth })
}

/// Values of `compute` at the pixels `[row, column]` of an image, see the module; `near(place, step, scratch)` forces it.
fn refine(
    shape: [usize; 2],
    tolerance: f64,
    near: impl Fn([f64; 2], f64, &mut Scratch) -> bool + Sync,
    compute: impl Fn([f64; 2], &mut Scratch) -> f64 + Sync,
) -> Array2<f32> {
    // One coarse step beyond the image on every side, so that every pixel has neighbours to interpolate between.
    let padded = shape.map(|extent| (extent.div_ceil(COARSE_PX) + 2) * COARSE_PX + 1);
    let place = |row: usize, column: usize| [row as f64 - COARSE_PX as f64, column as f64 - COARSE_PX as f64];
    let mut grid = Array2::<f64>::zeros(padded);
    let coarse =
        fill(&grid, 0, COARSE_PX, 0, COARSE_PX, |row, column, _, scratch| compute(place(row, column), scratch));
    store(&mut grid, coarse);
    let largest = grid.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
    let tolerance = tolerance * largest.max(1e-12);
    let mut step = COARSE_PX;
    while step > 1 {
        let half = step / 2;
        // First between neighbours in a row, then between rows.
        for along_row in [true, false] {
            let value = |row: usize, column: usize, grid: &Array2<f64>, scratch: &mut Scratch| {
                let at = place(row, column);
                let inside = at[0] >= -1.0 && at[1] >= -1.0 && at[0] <= shape[0] as f64 && at[1] <= shape[1] as f64;
                let (interpolated, doubt) = between(grid, [row, column], half, along_row);
                if inside && (doubt > tolerance || near(at, half as f64, scratch)) {
                    compute(at, scratch)
                } else {
                    interpolated
                }
            };
            let new = if along_row {
                fill(&grid, 0, step, half, step, |r, c, g, s| value(r, c, g, s))
            } else {
                fill(&grid, half, step, 0, half, |r, c, g, s| value(r, c, g, s))
            };
            store(&mut grid, new);
        }
        step = half;
    }
    Array2::from_shape_fn(shape, |(row, column)| grid[[row + COARSE_PX, column + COARSE_PX]] as f32)
}

/// Values at rows `first_row, + row_step, ...` and columns likewise.
fn fill(
    grid: &Array2<f64>,
    first_row: usize,
    row_step: usize,
    first_column: usize,
    column_step: usize,
    value: impl Fn(usize, usize, &Array2<f64>, &mut Scratch) -> f64 + Sync,
) -> Vec<(usize, usize, f64)> {
    let (rows, columns) = grid.dim();
    let rows: Vec<usize> = (first_row..rows).step_by(row_step).collect();
    rows.par_iter()
        .with_max_len(1)
        .map_init(Scratch::default, |scratch, &row| {
            let columns = (first_column..columns).step_by(column_step);
            columns.map(|column| (row, column, value(row, column, grid, scratch))).collect::<Vec<_>>()
        })
        .flatten_iter()
        .collect()
}

fn store(grid: &mut Array2<f64>, values: Vec<(usize, usize, f64)>) {
    for (row, column, value) in values {
        grid[[row, column]] = value;
    }
}

/// Cubic interpolation half-way between grid points `half` px away along the row or column, and a measure of its doubt from
/// second and third differences; linear at the rim.
fn between(grid: &Array2<f64>, [row, column]: [usize; 2], half: usize, along_row: bool) -> (f64, f64) {
    let (index, extent) = if along_row { (column, grid.ncols()) } else { (row, grid.nrows()) };
    let at = |index: usize| if along_row { grid[[row, index]] } else { grid[[index, column]] };
    let (before, after) = (at(index - half), at(index + half));
    let linear = 0.5 * (before + after);
    if index < 3 * half || index + 3 * half >= extent {
        return (linear, 0.0);
    }
    let (first, last) = (at(index - 3 * half), at(index + 3 * half));
    let correction = (before + after - first - last) / 16.0;
    // At an inflection the correction vanishes by chance; the third difference does not.
    let third = (last - first - 3.0 * (after - before)) / 32.0;
    (linear + correction, correction.abs() + third.abs())
}

#[cfg(test)]
mod unit_tests {
    use super::*;

    /// A narrow spot on a wave: found at full resolution where `near` says so, interpolated within the tolerance
    /// elsewhere, at a fraction of the cost.
    #[test]
    fn refinement_reproduces_the_function_and_saves_most_of_the_work() {
        let counted = std::sync::atomic::AtomicUsize::new(0);
        let function = |[row, column]: [f64; 2]| {
            let spot2 = (row - 40.3).powi(2) + (column - 60.7).powi(2);
            (0.05 * row + 0.03 * column).sin() + (-spot2 / 2.0).exp()
        };
        let image = refine(
            [97, 130],
            0.003,
            |[row, column], step, _| (row - 40.3).hypot(column - 60.7) < 6.0 * step,
            |at, _| {
                counted.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                function(at)
            },
        );
        for ((row, column), value) in image.indexed_iter() {
            let expected = function([row as f64, column as f64]) as f32;
            // The tolerance bounds the correction; three halvings of both axes add up to a few of it at most.
            assert!((value - expected).abs() < 0.01, "{row} {column} {value} {expected}");
        }
        assert!(counted.into_inner() * 5 < 97 * 130);
    }
}

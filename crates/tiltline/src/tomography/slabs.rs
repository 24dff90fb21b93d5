//! The volume in slabs of rows: each is made by one thread and handed on, so that no more than one slab a thread is in memory.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use ndarray::{Array2, Array3, ArrayView2, Axis, concatenate, s};
use rayon::prelude::*;

use super::projector::{LANES, Lanes, Projector};
use super::sirt::Sirt;
use super::wbp::Wbp;
use super::{Geometry, Method, TomographyError};
use crate::progress::{Event, Progress, Stage};

/// Rows of the volume that are complete.
#[derive(Clone, Debug, PartialEq)]
pub struct Slab {
    /// The first row, y.
    pub first_row: usize,
    /// Values `[z, y, x]`.
    pub values: Array3<f32>,
}

enum Solver {
    Wbp(Wbp),
    Sirt(Sirt),
}

/// Makes the volume of views (`[row, column]` each, tilt axis along the rows' normal) and gives each slab to `take`, in any
/// order. Reports [`Event::Advanced`] after each.
///
/// # Errors
/// Where tilts, shapes, pixels or settings are not possible, or `take` fails.
pub fn reconstruct(
    views: &[Array2<f32>],
    geometry: &Geometry,
    method: &Method,
    progress: Progress<'_>,
    take: &(dyn Fn(Slab) -> Result<(), TomographyError> + Sync),
) -> Result<(), TomographyError> {
    let rows = check(views, geometry)?;
    let solver = match method {
        Method::Wbp(settings) => Solver::Wbp(Wbp::new(geometry, settings)?),
        Method::Sirt(settings) => Solver::Sirt(Sirt::new(geometry, settings)?),
    };
    let count = rows.div_ceil(LANES);
    let done = AtomicUsize::new(0);
    (0..count).into_par_iter().with_max_len(1).try_for_each(|index| {
        let first_row = index * LANES;
        let lanes = gathered(views.iter().map(|view| view.view()), geometry.width, first_row);
        let volume = match &solver {
            Solver::Wbp(solver) => solver.reconstruct(&lanes),
            Solver::Sirt(solver) => solver.reconstruct(&lanes).0,
        };
        drop(lanes);
        take(Slab { first_row, values: scattered(&volume, geometry.width, LANES.min(rows - first_row)) })?;
        progress(Event::Advanced(Stage::Tomogram, done.fetch_add(1, Ordering::Relaxed) + 1, count));
        Ok(())
    })
}

/// The whole volume `[z, y, x]` in memory.
///
/// # Errors
/// As for [`reconstruct`].
pub fn volume(views: &[Array2<f32>], geometry: &Geometry, method: &Method) -> Result<Array3<f32>, TomographyError> {
    let rows = check(views, geometry)?;
    let volume = Mutex::new(Array3::zeros((geometry.depth, rows, geometry.width)));
    reconstruct(views, geometry, method, &|_| (), &|slab| {
        let last = slab.first_row + slab.values.dim().1;
        let mut volume = volume.lock().expect("no thread panics while it holds the lock");
        volume.slice_mut(s![.., slab.first_row..last, ..]).assign(&slab.values);
        Ok(())
    })?;
    Ok(volume.into_inner().expect("no thread panics while it holds the lock"))
}

/// What a volume `[z, y, x]` looks like at the tilts of a geometry that has its width and depth: `[view, row, column]`.
///
/// # Panics
/// Where the volume's shape is another than the geometry's, or it has no rows.
pub fn projections(volume: &Array3<f32>, geometry: &Geometry) -> Array3<f32> {
    let (depth, rows, width) = volume.dim();
    assert_eq!([depth, width], [geometry.depth, geometry.width], "a volume is as large as its geometry");
    let projector = Projector::new(geometry);
    let project = |index: usize| {
        let first_row = index * LANES;
        let mut views = vec![[0.0; LANES]; projector.views_len()];
        projector.project(&gathered(volume.outer_iter(), width, first_row), &mut views);
        scattered(&views, width, LANES.min(rows - first_row))
    };
    let slabs: Vec<Array3<f32>> = (0..rows.div_ceil(LANES)).into_par_iter().with_max_len(1).map(project).collect();
    let slabs: Vec<_> = slabs.iter().map(|slab| slab.view()).collect();
    concatenate(Axis(1), &slabs).expect("slabs differ in their rows only")
}

/// Rows of the views, which must all be alike.
fn check(views: &[Array2<f32>], geometry: &Geometry) -> Result<usize, TomographyError> {
    if views.len() != geometry.tilts_rad.len() {
        return Err(TomographyError::TiltCount { views: views.len(), tilts: geometry.tilts_rad.len() });
    }
    super::coverage(&geometry.tilts_rad)?;
    let (rows, columns) = views[0].dim();
    for (view, image) in views.iter().enumerate() {
        if image.dim() != (rows, columns) {
            let (own_rows, own_columns) = image.dim();
            return Err(TomographyError::Shape {
                view,
                columns: own_columns,
                rows: own_rows,
                first_columns: columns,
                first_rows: rows,
            });
        }
        let count = image.iter().filter(|value| !value.is_finite()).count();
        if count > 0 {
            return Err(TomographyError::NotFinite { view, count });
        }
    }
    if geometry.width != columns {
        let expected = "it must be the number of columns of the views";
        return Err(TomographyError::Value { name: "the width of the volume", value: geometry.width as f64, expected });
    }
    if geometry.depth == 0 {
        return Err(TomographyError::Value {
            name: "the depth of the volume",
            value: 0.0,
            expected: "use at least 1 px",
        });
    }
    Ok(rows)
}

/// Rows of all views, or layers, side by side, `[view][column]`; lanes beyond the last row are 0.
fn gathered<'a>(
    views: impl ExactSizeIterator<Item = ArrayView2<'a, f32>>,
    width: usize,
    first_row: usize,
) -> Vec<Lanes> {
    let mut lanes = vec![[0.0; LANES]; views.len() * width];
    for (view, bins) in views.zip(lanes.chunks_exact_mut(width)) {
        for (lane, row) in view.rows().into_iter().skip(first_row).take(LANES).enumerate() {
            for (bin, value) in bins.iter_mut().zip(row) {
                bin[lane] = *value;
            }
        }
    }
    lanes
}

/// Layers of a slab, or views of it, as an array of `rows` rows.
fn scattered(layers: &[Lanes], width: usize, rows: usize) -> Array3<f32> {
    let mut values = Array3::zeros((layers.len() / width, rows, width));
    for (mut layer, source) in values.outer_iter_mut().zip(layers.chunks_exact(width)) {
        for (lane, mut row) in layer.rows_mut().into_iter().enumerate() {
            row.iter_mut().zip(source).for_each(|(value, lanes)| *value = lanes[lane]);
        }
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bright voxel lands at `x = X cos a + Z sin a` in its row, also where rows fill more than one slab.
    #[test]
    fn projections_show_a_voxel_where_the_geometry_says() {
        let tilts_rad = vec![-0.7, 0.0, 0.5];
        let geometry = Geometry::centred(tilts_rad.clone(), 61, 21);
        let rows = LANES + 9;
        for [z, y, x] in [[3, 5, 20], [15, LANES + 4, 40]] {
            let mut volume = Array3::zeros((21, rows, 61));
            volume[[z, y, x]] = 1.0;
            let shown = projections(&volume, &geometry);
            assert_eq!(shown.dim(), (3, rows, 61));
            for (view, tilt) in shown.outer_iter().zip(&tilts_rad) {
                let total: f32 = view.sum();
                let place = |(at, value): (usize, f32)| at as f64 * f64::from(value / total);
                let across: f64 = view.indexed_iter().map(|((_, column), value)| place((column, *value))).sum();
                let down: f64 = view.indexed_iter().map(|((row, _), value)| place((row, *value))).sum();
                let (from_axis, depth) = (x as f64 - geometry.axis_column, z as f64 - geometry.middle_layer());
                let expected = geometry.axis_column + from_axis * tilt.cos() + depth * tilt.sin();
                // A shadow that lies within one bin says no more of its place.
                let least = 0.5 * (1.0 - tilt.cos()) + 1e-4;
                assert!(
                    (across - expected).abs() < least && (down - y as f64).abs() < 1e-4,
                    "{across} {expected} {down}"
                );
            }
        }
    }
}

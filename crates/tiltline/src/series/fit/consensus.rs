//! Views moved to where the tomogram of the others shows them (projection matching): no curves are needed, only what the detector sees
//! in every view, however faint.
//!
//! Views are dealt into groups by their tilts. Each group is held against a tomogram of the others, projected at its tilts, so
//! that no view is drawn to itself; it moves by the shift at which the two agree best.

use ndarray::{Array2, ArrayView2, Axis, s};
use rayon::prelude::*;

use super::FitView;
use super::grid::Grid;
use crate::filter::gaussian_blur;
use crate::geometry::{Point2, Vector2};
use crate::series::ViewPose;
use crate::tomography::{Method, WbpSettings, projections, volume};

/// Voxels of a tomogram: places are found between them.
const MOST_VOXELS: f64 = 4e6;
/// Groups of views, at most.
const GROUPS: usize = 5;
/// Views that a tomogram needs to say anything.
const LEAST_VIEWS: usize = 5;
/// Rounds: blur, voxels, and the largest shift, px.
const ROUNDS: [(f64, f64); 5] = [(2.0, 12.0), (1.5, 8.0), (1.0, 5.0), (0.7, 3.0), (0.7, 3.0)];
/// What a tomogram has below so many times its root mean square is noise.
const NOISE: f64 = 2.0;

/// The views where they and their lines agree best, at first within 12 px of where they are; the frame stays where it is.
pub(super) fn in_consensus(views: &[FitView], depth: [f64; 2]) -> Vec<ViewPose> {
    let mut moved: Vec<FitView> = views.to_vec();
    if views.len() < LEAST_VIEWS || views.iter().any(|view| view.lines.lines().probability.is_empty()) {
        return views.iter().map(|view| view.pose).collect();
    }
    let grid = Grid::new(&views[0], depth, MOST_VOXELS);
    let mut order: Vec<usize> = (0..views.len()).collect();
    order.sort_by(|&a, &b| views[a].pose.tilt_rad.total_cmp(&views[b].pose.tilt_rad));
    let groups = GROUPS.min(views.len());
    for (blur, reach_px) in ROUNDS {
        // Small probabilities count for more by their roots: they are of faint lines.
        let images: Vec<Array2<f32>> = moved
            .par_iter()
            .map(|view| gaussian_blur(&grid.image(view).mapv_into(|value| value.max(0.0).sqrt()), blur))
            .collect();
        let mut shifts = vec![Vector2::zeros(); views.len()];
        for group in 0..groups {
            let is_in = |place: &usize| place % groups == group;
            let of = |inside: bool| -> Vec<usize> {
                (0..order.len()).filter(|place| is_in(place) == inside).map(|place| order[place]).collect()
            };
            let (held, others) = (of(true), of(false));
            let tilts = |of: &[usize]| of.iter().map(|view| moved[*view].pose.tilt_rad).collect();
            let known: Vec<Array2<f32>> = others.iter().map(|view| images[*view].clone()).collect();
            let Ok(mut tomogram) = volume(&known, &grid.geometry(tilts(&others)), &Method::Wbp(WbpSettings::default()))
            else {
                continue;
            };
            let squares: f64 = tomogram.iter().map(|value| f64::from(*value).powi(2)).sum();
            let noise = (NOISE * (squares / tomogram.len() as f64).sqrt()) as f32;
            tomogram.mapv_inplace(|value| (value - noise).max(0.0));
            let expected = projections(&tomogram, &grid.geometry(tilts(&held)));
            let reach = (reach_px / grid.px).ceil() as usize;
            let shift = |at: usize| best_shift(&images[held[at]], expected.index_axis(Axis(0), at), reach);
            let found: Vec<Vector2> = (0..held.len()).into_par_iter().map(shift).collect();
            for (view, shift) in held.into_iter().zip(found) {
                shifts[view] = shift * grid.px;
            }
        }
        hold_frame(&mut shifts, &moved);
        for (view, shift) in moved.iter_mut().zip(&shifts) {
            let ViewPose { tilt_rad, image_from_projection } = view.pose;
            let origin = image_from_projection * Point2::from(*shift);
            view.pose = ViewPose::new(tilt_rad, view.pose.axis_rad(), view.pose.scale(), origin);
        }
    }
    moved.into_iter().map(|view| view.pose).collect()
}

/// By how much (columns, rows; pixels of the grid) an image is displaced against what is expected: where their correlation is largest
/// within `reach`, between pixels by a parabola; 0 where it is largest at the edge of that.
fn best_shift(image: &Array2<f32>, expected: ArrayView2<'_, f32>, reach: usize) -> Vector2 {
    let (height, width) = image.dim();
    let side = 2 * reach + 1;
    if height <= side || width <= side {
        return Vector2::zeros();
    }
    let inside = expected.slice(s![reach..height - reach, reach..width - reach]);
    let mean = inside.mean().unwrap_or(0.0);
    let correlation = Array2::from_shape_fn((side, side), |(down, right)| {
        let part = image.slice(s![down..height - 2 * reach + down, right..width - 2 * reach + right]);
        let mut sum = 0.0_f64;
        for (row, expected) in part.rows().into_iter().zip(inside.rows()) {
            let products = row.iter().zip(expected).map(|(value, expected)| value * (expected - mean));
            sum += f64::from(products.sum::<f32>());
        }
        sum
    });
    let ((row, column), _) =
        correlation.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).expect("it has at least one place");
    if row == 0 || column == 0 || row + 1 == side || column + 1 == side {
        return Vector2::zeros();
    }
    let peak = |before: f64, at: f64, after: f64| {
        let curvature = before - 2.0 * at + after;
        if curvature < 0.0 { 0.5 * (before - after) / curvature } else { 0.0 }
    };
    let at = |row: usize, column: usize| correlation[[row, column]];
    let between = Vector2::new(
        peak(at(row, column - 1), at(row, column), at(row, column + 1)),
        peak(at(row - 1, column), at(row, column), at(row + 1, column)),
    );
    Vector2::new(column as f64, row as f64) + between - Vector2::from_element(reach as f64)
}

/// Takes out of shifts what only moves the foil: `x = X cos a + Z sin a`, `y = Y`, by least squares.
fn hold_frame(shifts: &mut [Vector2], views: &[FitView]) {
    let [mut cc, mut cs, mut ss, mut cx, mut sx, mut y] = [0.0; 6];
    for (shift, view) in shifts.iter().zip(views) {
        let (sin, cos) = view.pose.tilt_rad.sin_cos();
        cc += cos * cos;
        cs += cos * sin;
        ss += sin * sin;
        cx += cos * shift.x;
        sx += sin * shift.x;
        y += shift.y / shifts.len() as f64;
    }
    let determinant = cc * ss - cs * cs;
    let [x, z] = if determinant > 1e-9 {
        [(cx * ss - sx * cs) / determinant, (sx * cc - cx * cs) / determinant]
    } else {
        [0.0; 2]
    };
    for (shift, view) in shifts.iter_mut().zip(views) {
        let (sin, cos) = view.pose.tilt_rad.sin_cos();
        *shift -= Vector2::new(x * cos + z * sin, y);
    }
}

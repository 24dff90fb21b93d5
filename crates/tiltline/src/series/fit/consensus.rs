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
/// Groups of views.
const GROUPS: usize = 5;
/// Views that are needed to say anything: one for each group.
const LEAST_VIEWS: usize = GROUPS;
/// Rounds: blur, voxels, and the largest shift, px.
const ROUNDS: [(f64, f64); 5] = [(2.0, 12.0), (1.5, 8.0), (1.0, 5.0), (0.7, 3.0), (0.7, 3.0)];
/// What a tomogram has below so many times its root mean square is noise.
const NOISE: f64 = 2.0;

/// The views where they and their lines agree best, at first within 12 px of where they are; the frame stays where it is, and so do views
/// whose probabilities are not known.
pub(super) fn in_consensus(views: &[FitView], depth: [f64; 2]) -> Vec<ViewPose> {
    let mut poses: Vec<ViewPose> = views.iter().map(|view| view.pose).collect();
    let shown: Vec<usize> =
        (0..views.len()).filter(|view| !views[*view].lines.lines().probability.is_empty()).collect();
    if shown.len() >= LEAST_VIEWS {
        let those: Vec<FitView> = shown.iter().map(|view| views[*view].clone()).collect();
        for (view, pose) in shown.into_iter().zip(matched(those, depth)) {
            poses[view] = pose;
        }
    }
    poses
}

/// Poses of at least [`LEAST_VIEWS`] views after all rounds.
fn matched(views: Vec<FitView>, depth: [f64; 2]) -> Vec<ViewPose> {
    let mut moved = views;
    let count = moved.len();
    let grid = Grid::new(&moved[0], depth, MOST_VOXELS);
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|&a, &b| moved[a].pose.tilt_rad.total_cmp(&moved[b].pose.tilt_rad));
    for (blur, reach_px) in ROUNDS {
        // Small probabilities count for more by their roots: they are of faint lines.
        let images: Vec<Array2<f32>> = moved
            .par_iter()
            .map(|view| gaussian_blur(&grid.image(view).mapv_into(|value| value.max(0.0).sqrt()), blur))
            .collect();
        let mut shifts = vec![Vector2::zeros(); count];
        for group in 0..GROUPS {
            let is_in = |place: &usize| place % GROUPS == group;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::curve::TraceGraph;
    use crate::geometry::Point3;
    use crate::series::{LineIndex, ViewLines};
    use crate::simulate::draw::union_of_profiles;

    /// What lies 3.4 px to the right and 1.7 px up of where it is expected is found there; what is further away than the reach is not.
    #[test]
    fn a_shift_is_found_with_its_signs() {
        let drawn = |x: f64, y: f64| {
            let at = |a: f64, b: f64| Point2::new(a + x, b + y);
            union_of_profiles(
                [80, 90],
                &[vec![at(30.0, 20.0), at(60.0, 55.0)], vec![at(60.0, 25.0), at(35.0, 60.0)]],
                2.0,
            )
        };
        let found = best_shift(&drawn(3.4, -1.7), drawn(0.0, 0.0).view(), 6);
        assert!((found - Vector2::new(3.4, -1.7)).norm() < 0.1, "{found}");
        let far = best_shift(&drawn(12.0, 0.0), drawn(0.0, 0.0).view(), 4);
        assert!(far.norm() < 4.0);
        assert_eq!(best_shift(&drawn(0.0, 0.0), drawn(0.0, 0.0).view(), 40), Vector2::zeros());
    }

    /// A foil that moves as a whole moves no view against another.
    #[test]
    fn the_frame_does_not_move() {
        let view = |index: usize| {
            let tilt_rad = 0.2 * index as f64 - 0.5;
            let lines = LineIndex::new(ViewLines::new(TraceGraph::default(), [64, 64]));
            FitView::new(index, ViewPose::new(tilt_rad, 0.0, 1.0, Point2::origin()), lines)
        };
        let views: Vec<FitView> = (0..6).map(view).collect();
        let of_foil = |view: &FitView| view.pose.project(&Point3::new(3.0, -2.0, 7.0)).coords;
        let mut shifts: Vec<Vector2> = views.iter().map(of_foil).collect();
        hold_frame(&mut shifts, &views);
        assert!(shifts.iter().all(|shift| shift.norm() < 1e-9), "{shifts:?}");
        // One view by itself does move.
        let mut shifts = vec![Vector2::zeros(); 6];
        shifts[2] = Vector2::new(1.0, 1.0);
        hold_frame(&mut shifts, &views);
        assert!(shifts[2].norm() > 0.8 && shifts[2].norm() < 1.4);
    }
}

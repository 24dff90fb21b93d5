//! Views moved to where the tomogram of the others shows them (projection matching): no curves are needed, only the evidence for lines in
//! every view, however faint.
//!
//! Views are dealt into groups by their tilts. Each group is held against a tomogram of the others, projected at its tilts, so
//! that no view is drawn to itself; it moves by the shift, turn and magnification at which the two agree best.

use std::collections::BTreeMap;

use ndarray::{Array2, Axis};
use rayon::prelude::*;

use super::grid::Grid;
use super::likeness::{Displaced, Expected, correlation, displaced};
use super::{FitSettings, FitView};
use crate::filter::gaussian_blur;
use crate::geometry::Vector2;
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

/// The views, those of the pair first, where they and their lines agree best, at first within 12 px of where they are; the frame stays where
/// it is, and so do views whose probabilities are not known.
pub(super) fn in_consensus(views: &[FitView], depth: [f64; 2], settings: &FitSettings) -> Vec<ViewPose> {
    let mut poses: Vec<ViewPose> = views.iter().map(|view| view.pose).collect();
    let shown: Vec<usize> =
        (0..views.len()).filter(|view| !views[*view].lines.lines().probability.is_empty()).collect();
    // Without one of the pair there is no frame to hold.
    if shown.len() >= LEAST_VIEWS && shown[..2] == [0, 1] {
        let those: Vec<FitView> = shown.iter().map(|view| views[*view].clone()).collect();
        for (view, pose) in shown.into_iter().zip(matched(those, depth, settings)) {
            poses[view] = pose;
        }
    }
    poses
}

/// Poses of at least [`LEAST_VIEWS`] views after all rounds.
fn matched(views: Vec<FitView>, depth: [f64; 2], settings: &FitSettings) -> Vec<ViewPose> {
    let mut moved = views;
    let count = moved.len();
    let grid = Grid::new(&moved[0], depth, MOST_VOXELS);
    let starts: Vec<ViewPose> = moved.iter().map(|view| view.pose).collect();
    let turn_sigma = settings.turn_sigma_deg.max(1e-6).to_radians();
    for (blur, reach_px) in ROUNDS {
        let views: Vec<&FitView> = moved.iter().collect();
        let images = shown(&views, &grid, blur);
        // What views turn together is more likely the axis than each of them: of their mean this share.
        let turned: Vec<f64> = moved.iter().zip(&starts).map(|(view, start)| turn(start, &view.pose)).collect();
        let [of_view, of_axis] = [turn_sigma, settings.axis_sigma_deg.to_radians()].map(|sigma| sigma * sigma);
        let share = count as f64 * of_axis / (of_view + count as f64 * of_axis);
        let together = share * turned.iter().sum::<f64>() / count as f64;
        let reach = (reach_px / grid.px).ceil() as usize;
        let found = by_groups(&views, &images, &grid).into_par_iter().map(|(view, expected)| {
            let prior = Expected {
                turn_rad: together - turned[view],
                turn_sigma,
                log_scale: (starts[view].scale() / moved[view].pose.scale()).ln(),
                scale_sigma: settings.scale_sigma.max(1e-9),
            };
            let found = displaced(&images[view], expected.view(), reach, blur, &prior);
            (view, Displaced { shift: found.shift * grid.px, ..found })
        });
        let mut moves = vec![Displaced::NONE; count];
        for (view, found) in found.collect::<Vec<_>>() {
            moves[view] = found;
        }
        hold_frame(&mut moves, &moved);
        hold_pair(&mut moves);
        for (view, by) in moved.iter_mut().zip(&moves) {
            let image_from_projection = view.pose.image_from_projection * by.map(&grid.middle(view));
            view.pose = ViewPose { image_from_projection, ..view.pose };
        }
    }
    moved.into_iter().map(|view| view.pose).collect()
}

/// By how much a pose is turned against another, radians.
fn turn(from: &ViewPose, to: &ViewPose) -> f64 {
    let turned = to.axis_rad() - from.axis_rad();
    turned.sin().atan2(turned.cos())
}

/// The evidence of views on the grid, blurred.
fn shown(views: &[&FitView], grid: &Grid, blur: f64) -> Vec<Array2<f32>> {
    views.iter().map(|view| gaussian_blur(&grid.evidence(view), blur)).collect()
}

/// For each view what is expected there: the tomogram of the views of other groups, projected.
fn by_groups(views: &[&FitView], images: &[Array2<f32>], grid: &Grid) -> Vec<(usize, Array2<f32>)> {
    let mut order: Vec<usize> = (0..views.len()).collect();
    order.sort_by(|&a, &b| views[a].pose.tilt_rad.total_cmp(&views[b].pose.tilt_rad));
    let mut all = Vec::new();
    for group in 0..GROUPS {
        let is_in = |place: &usize| place % GROUPS == group;
        let of = |inside: bool| -> Vec<usize> {
            (0..order.len()).filter(|place| is_in(place) == inside).map(|place| order[place]).collect()
        };
        let (held, others) = (of(true), of(false));
        let tilts = |of: &[usize]| of.iter().map(|view| views[*view].pose.tilt_rad).collect();
        let known: Vec<Array2<f32>> = others.iter().map(|view| images[*view].clone()).collect();
        let Ok(mut tomogram) = volume(&known, &grid.geometry(tilts(&others)), &Method::Wbp(WbpSettings::default()))
        else {
            continue;
        };
        let squares: f64 = tomogram.iter().map(|value| f64::from(*value).powi(2)).sum();
        let noise = (NOISE * (squares / tomogram.len() as f64).sqrt()) as f32;
        tomogram.mapv_inplace(|value| (value - noise).max(0.0));
        let expected = projections(&tomogram, &grid.geometry(tilts(&held)));
        let each = held.into_iter().enumerate().map(|(at, view)| (view, expected.index_axis(Axis(0), at).to_owned()));
        all.extend(each);
    }
    all
}

/// How well each view, by its place in the series, agrees with the others: the correlation of what it shows with what the tomogram of the
/// others, projected, has there, on the grid of `first`. Nothing with fewer than [`LEAST_VIEWS`].
pub(super) fn agreement(views: &[FitView], first: &FitView, depth: [f64; 2]) -> BTreeMap<usize, f64> {
    let views: Vec<&FitView> = views.iter().filter(|view| !view.lines.lines().probability.is_empty()).collect();
    if views.len() < LEAST_VIEWS {
        return BTreeMap::new();
    }
    let grid = Grid::new(first, depth, MOST_VOXELS);
    let [.., (blur, _)] = ROUNDS;
    let images = shown(&views, &grid, blur);
    let each = by_groups(&views, &images, &grid);
    each.into_iter().map(|(view, expected)| (views[view].view, correlation(&images[view], expected.view()))).collect()
}

/// Takes out of moves what only moves the foil, `x = X cos a + Z sin a`, `y = Y`, by least squares, and what only magnifies it.
fn hold_frame(moves: &mut [Displaced], views: &[FitView]) {
    let count = moves.len() as f64;
    let [mut cc, mut cs, mut ss, mut cx, mut sx] = [0.0; 5];
    for (by, view) in moves.iter().zip(views) {
        let (sin, cos) = view.pose.tilt_rad.sin_cos();
        cc += cos * cos;
        cs += cos * sin;
        ss += sin * sin;
        cx += cos * by.shift.x;
        sx += sin * by.shift.x;
    }
    let y = moves.iter().map(|by| by.shift.y).sum::<f64>() / count;
    let log_scale = moves.iter().map(|by| by.log_scale).sum::<f64>() / count;
    let determinant = cc * ss - cs * cs;
    let [x, z] = if determinant > 1e-9 {
        [(cx * ss - sx * cs) / determinant, (sx * cc - cx * cs) / determinant]
    } else {
        [0.0; 2]
    };
    for (by, view) in moves.iter_mut().zip(views) {
        let (sin, cos) = view.pose.tilt_rad.sin_cos();
        by.shift -= Vector2::new(x * cos + z * sin, y);
        by.log_scale -= log_scale;
    }
}

/// The first two views, the pair, keep their rows: they turn, grow and move along the axis as one.
fn hold_pair(moves: &mut [Displaced]) {
    if let [left, right, ..] = moves {
        let turn_rad = 0.5 * (left.turn_rad + right.turn_rad);
        let log_scale = 0.5 * (left.log_scale + right.log_scale);
        let down = 0.5 * (left.shift.y + right.shift.y);
        for by in [left, right] {
            *by = Displaced { shift: Vector2::new(by.shift.x, down), turn_rad, log_scale };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::curve::TraceGraph;
    use crate::geometry::{Point2, Point3};
    use crate::series::{LineIndex, ViewLines};

    /// A foil that moves and grows as a whole moves no view against another.
    #[test]
    fn the_frame_does_not_move() {
        let view = |index: usize| {
            let tilt_rad = 0.2 * index as f64 - 0.5;
            let lines = LineIndex::new(ViewLines::new(TraceGraph::default(), [64, 64]));
            FitView::new(index, ViewPose::new(tilt_rad, 0.0, 1.0, Point2::origin()), lines)
        };
        let views: Vec<FitView> = (0..6).map(view).collect();
        let of_foil = |view: &FitView| Displaced {
            shift: view.pose.project(&Point3::new(3.0, -2.0, 7.0)).coords,
            turn_rad: 0.0,
            log_scale: 0.01,
        };
        let mut moves: Vec<Displaced> = views.iter().map(of_foil).collect();
        hold_frame(&mut moves, &views);
        assert!(moves.iter().all(|by| by.shift.norm() < 1e-9 && by.log_scale.abs() < 1e-12), "{moves:?}");
        // One view by itself does move.
        let mut moves = vec![Displaced::NONE; 6];
        moves[2].shift = Vector2::new(1.0, 1.0);
        hold_frame(&mut moves, &views);
        assert!(moves[2].shift.norm() > 0.8 && moves[2].shift.norm() < 1.4);
    }

    /// The rows of the pair stay what they are; against each other its views move along them only.
    #[test]
    fn the_pair_moves_as_one() {
        let by = |x: f64, y: f64, turn_rad: f64| Displaced { shift: Vector2::new(x, y), turn_rad, log_scale: turn_rad };
        let mut moves = [by(1.0, 2.0, 0.02), by(-1.0, 0.0, 0.0), by(5.0, 5.0, 0.1)];
        hold_pair(&mut moves);
        assert_eq!(moves, [by(1.0, 1.0, 0.01), by(-1.0, 1.0, 0.01), by(5.0, 5.0, 0.1)]);
    }
}

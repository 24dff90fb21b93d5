//! The pose of a view from the curves themselves: where re-projected points lie best on the lines found in it.
//!
//! First shift and turn by search (the share of points near a line, on a map of distances to lines), then shift, turn and
//! magnification by robust least squares of the distances across the lines. Turn and magnification are held near those of the
//! start by priors. A factor on all depths can be freed too: it tells whether tilts agree ([`super::checks`]).

use nalgebra::{SMatrix, SVector};
use ndarray::Array2;

use super::{LineIndex, ViewPose};
use crate::geometry::{Point2, Point3, Vector2, Vector3, project_at_tilt};

/// Points that take part in the search.
const SEARCHED_POINTS: usize = 1500;
/// Points that take part in the least squares.
const FITTED_POINTS: usize = 6000;
/// Distances up to which points count as near a line, px: coarse, fine.
const NEAR_PX: [f64; 2] = [8.0, 3.0];
/// Steps of the shift, px.
const SHIFT_STEP_PX: [f64; 2] = [4.0, 1.0];
/// Turns that are tried at first, degrees.
const TURNS_DEG: [f64; 5] = [0.0, -0.75, 0.75, -1.5, 1.5];
/// Reach of the least squares about each line, px: from the first round to the last.
const REACH_PX: [f64; 2] = [6.0, 3.0];
const ROUNDS: usize = 12;
/// One-sigma priors of the turn (degrees) and of the relative magnification.
const TURN_SIGMA_DEG: f64 = 1.0;
const SCALE_SIGMA: f64 = 0.01;
/// One-sigma prior of the factor on all depths, where it is free.
const DEPTH_SIGMA: f64 = 0.5;
/// Residuals beyond this many px are weighted down.
const HUBER_PX: f64 = 1.0;
/// Errors of traced points are alike over so many px.
const CORRELATION_PX: f64 = 4.0;
/// Sine of the angle up to which a line runs along a re-projected curve.
const MOST_TURN: f64 = 0.5;
/// A factor on depths never leaves these.
const DEPTH_RANGE: [f64; 2] = [0.3, 3.0];

/// The pose found, and how well points lie on lines then.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Registration {
    /// The pose.
    pub pose: ViewPose,
    /// By how much the image of the points' centre moved from where it was expected, px.
    pub moved_px: Vector2,
    /// Share of the points in the image within 3 px of a line.
    pub near: f64,
    /// Share that would be by chance: that of the image's area.
    pub chance: f64,
    /// The factor on all depths, and one sigma of it; exactly 1 and 0 where it was held.
    pub depth: [f64; 2],
}

impl Registration {
    /// Whether clearly more points lie on lines than would by chance.
    pub fn is_supported(&self) -> bool {
        self.near > self.chance + 0.25 * (1.0 - self.chance)
    }
}

/// Share of a view within 3 px of a line: how much of any curve would lie there by chance.
pub fn chance_near_lines(lines: &LineIndex) -> f64 {
    DistanceMap::new(lines).share_near()
}

/// Finds the pose of a view near `start`; `search_px` is how far shifts are looked for. `None` where no point lies in the image
/// or it has no lines.
pub fn register(
    points: &[(Point3, Vector3)],
    lines: &LineIndex,
    start: &ViewPose,
    search_px: f64,
    free_depth: bool,
) -> Option<Registration> {
    let map = DistanceMap::new(lines);
    let few = thinned(points, SEARCHED_POINTS);
    let pivot = pivot(&few, start)?;
    let mut best = (score(&few, start, &map, NEAR_PX[0]), *start);
    let shifts = |step: f64, reach: f64| {
        let count = (reach / step).ceil() as i32;
        (-count..=count)
            .flat_map(move |y| (-count..=count).map(move |x| Vector2::new(f64::from(x), f64::from(y)) * step))
    };
    for turn in TURNS_DEG {
        for shift in shifts(SHIFT_STEP_PX[0], search_px) {
            let pose = start.changed(0.0, turn.to_radians(), 0.0, shift, &pivot);
            // Of equals the nearer one.
            let held = 1.0 - 0.02 * (shift.norm() / search_px.max(1.0)).powi(2);
            let score = held * score(&few, &pose, &map, NEAR_PX[0]);
            if score > best.0 {
                best = (score, pose);
            }
        }
    }
    let middle = best.1;
    let mut best = (score(&few, &middle, &map, NEAR_PX[1]), middle);
    for shift in shifts(SHIFT_STEP_PX[1], SHIFT_STEP_PX[0]) {
        let pose = middle.changed(0.0, 0.0, 0.0, shift, &pivot);
        let score = score(&few, &pose, &map, NEAR_PX[1]);
        if score > best.0 {
            best = (score, pose);
        }
    }
    let (pose, depth) = fit(&thinned(points, FITTED_POINTS), lines, start, best.1, &pivot, free_depth);
    let scaled: Vec<(Point3, Vector3)> =
        few.iter().map(|(point, tangent)| (Point3::new(point.x, point.y, depth[0] * point.z), *tangent)).collect();
    let near = score_within(&scaled, &pose, &map)?;
    let at = |pose: &ViewPose| pose.image_from_projection * pivot;
    Some(Registration { pose, moved_px: at(&pose) - at(start), near, chance: map.share_near(), depth })
}

fn thinned<T: Copy>(points: &[T], most: usize) -> Vec<T> {
    points.iter().step_by(points.len().div_ceil(most).max(1)).copied().collect()
}

/// Mean of the projected points: what turns and changes of magnification leave in place.
fn pivot(points: &[(Point3, Vector3)], pose: &ViewPose) -> Option<Point2> {
    let sum =
        points.iter().fold(Vector2::zeros(), |sum, (point, _)| sum + project_at_tilt(point, pose.tilt_rad).coords);
    (!points.is_empty()).then(|| Point2::from(sum / points.len() as f64))
}

/// Shift, turn, magnification and, if it is free, the factor on depths, by iteratively reweighted least squares.
fn fit(
    points: &[(Point3, Vector3)],
    lines: &LineIndex,
    start: &ViewPose,
    found: ViewPose,
    pivot: &Point2,
    free_depth: bool,
) -> (ViewPose, [f64; 2]) {
    let (mut pose, mut depth, mut depth_sigma) = (found, 1.0, 0.0);
    let spacing = spacing_px(points, &found);
    for round in 0..ROUNDS {
        let reach = REACH_PX[0] + (REACH_PX[1] - REACH_PX[0]) * round as f64 / (ROUNDS - 1) as f64;
        // x, y, turn, log of the magnification, depth.
        let mut matrix = SMatrix::<f64, 5, 5>::zeros();
        let mut right = SVector::<f64, 5>::zeros();
        let mut squares = (0.0, 0.0);
        let (sin, _) = pose.tilt_rad.sin_cos();
        let fixed = pose.image_from_projection * pivot;
        for (point, tangent) in points {
            let scaled = Point3::new(point.x, point.y, depth * point.z);
            let landed = pose.project(&scaled);
            let direction = pose.project(&(scaled + Vector3::new(tangent.x, tangent.y, depth * tangent.z))) - landed;
            let Some(direction) = direction.try_normalize(1e-9) else { continue };
            let Some(near) = lines.nearest_along(&landed, &direction, reach, MOST_TURN) else { continue };
            let normal = Vector2::new(-near.tangent.y, near.tangent.x);
            let residual = normal.dot(&(near.place - landed));
            let arm = landed - fixed;
            let deeper = pose.image_from_projection * Vector2::new(point.z * sin, 0.0);
            let row = SVector::<f64, 5>::new(
                normal.x,
                normal.y,
                normal.dot(&Vector2::new(-arm.y, arm.x)),
                normal.dot(&arm),
                if free_depth { normal.dot(&deeper) } else { 0.0 },
            );
            let weight = (HUBER_PX / residual.abs().max(1e-9)).min(1.0);
            matrix += row * row.transpose() * weight;
            right += row * (residual * weight);
            squares = (squares.0 + residual * residual * weight, squares.1 + weight);
        }
        if squares.1 < 10.0 {
            break;
        }
        // Points are closer than errors are independent.
        let variance = (squares.0 / squares.1).max(0.01) * (CORRELATION_PX / spacing).max(1.0);
        let turned = pose.axis_rad() - start.axis_rad();
        let turned = turned.sin().atan2(turned.cos());
        let grown = (pose.scale() / start.scale()).ln();
        for (place, off, sigma) in [
            (2, turned, TURN_SIGMA_DEG.to_radians()),
            (3, grown, SCALE_SIGMA),
            (4, depth - 1.0, if free_depth { DEPTH_SIGMA } else { 1e-9 }),
        ] {
            matrix[(place, place)] += variance / (sigma * sigma);
            right[place] -= off * variance / (sigma * sigma);
        }
        let Some(inverse) = matrix.try_inverse() else { break };
        let step = inverse * right;
        pose = pose.changed(0.0, step[2], step[3], Vector2::new(step[0], step[1]), pivot);
        if free_depth {
            depth = (depth + step[4]).clamp(DEPTH_RANGE[0], DEPTH_RANGE[1]);
            depth_sigma = (variance * inverse[(4, 4)]).sqrt();
        }
    }
    (pose, [depth, depth_sigma])
}

/// Usual distance of neighbours in the image, px.
fn spacing_px(points: &[(Point3, Vector3)], pose: &ViewPose) -> f64 {
    let mut steps: Vec<f64> =
        points.windows(2).map(|pair| (pose.project(&pair[1].0) - pose.project(&pair[0].0)).norm()).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied().unwrap_or(1.0).max(0.1)
}

/// Mean over the points in the image of `1 - (distance / near)^2`, none below zero; points outside count a little, so that a pose
/// gains nothing by moving bad points out.
fn score(points: &[(Point3, Vector3)], pose: &ViewPose, map: &DistanceMap, near_px: f64) -> f64 {
    let sum: f64 = points
        .iter()
        .map(|(point, _)| match map.distance(&pose.project(point)) {
            Some(distance) => (1.0 - (distance / near_px).powi(2)).max(0.0),
            None => 0.3,
        })
        .sum();
    sum / points.len().max(1) as f64
}

/// Share of the points in the image within [`NEAR_PX`] of a line.
fn score_within(points: &[(Point3, Vector3)], pose: &ViewPose, map: &DistanceMap) -> Option<f64> {
    let distances: Vec<f64> = points.iter().filter_map(|(point, _)| map.distance(&pose.project(point))).collect();
    let near = distances.iter().filter(|distance| **distance <= NEAR_PX[1]).count();
    (!distances.is_empty()).then(|| near as f64 / distances.len() as f64)
}

/// Distance to the nearest line at every pixel, exact between pixels of lines (Felzenszwalb and Huttenlocher 2012).
struct DistanceMap {
    distances: Array2<f32>,
}

impl DistanceMap {
    fn new(lines: &LineIndex) -> Self {
        let [height, width] = lines.lines().shape;
        let mut squared = Array2::<f64>::from_elem((height, width), f64::INFINITY);
        for point in lines.lines().traces.traces.iter().flat_map(|trace| &trace.points) {
            let (row, column) = (point.position.y.round(), point.position.x.round());
            if row >= 0.0 && column >= 0.0 && row < height as f64 && column < width as f64 {
                squared[[row as usize, column as usize]] = 0.0;
            }
        }
        for mut line in squared.columns_mut() {
            let values = lower_envelope(&line.to_vec());
            line.iter_mut().zip(values).for_each(|(place, value)| *place = value);
        }
        for mut line in squared.rows_mut() {
            let values = lower_envelope(&line.to_vec());
            line.iter_mut().zip(values).for_each(|(place, value)| *place = value);
        }
        Self { distances: squared.mapv(|value| value.sqrt() as f32) }
    }

    /// Distance at the pixel nearest to a point; `None` outside.
    fn distance(&self, point: &Point2) -> Option<f64> {
        let (row, column) = (point.y.round(), point.x.round());
        let (height, width) = self.distances.dim();
        let inside = row >= 0.0 && column >= 0.0 && row < height as f64 && column < width as f64;
        inside.then(|| f64::from(self.distances[[row as usize, column as usize]]))
    }

    fn share_near(&self) -> f64 {
        let near = self.distances.iter().filter(|distance| f64::from(**distance) <= NEAR_PX[1]).count();
        near as f64 / self.distances.len().max(1) as f64
    }
}

/// At each place the least of `values[other] + (place - other)^2`.
fn lower_envelope(values: &[f64]) -> Vec<f64> {
    let mut hull: Vec<(usize, f64)> = Vec::new();
    for (place, value) in values.iter().enumerate().filter(|(_, value)| value.is_finite()) {
        let meets = |other: usize| {
            let (p, q) = (place as f64, other as f64);
            (value + p * p - values[other] - q * q) / (2.0 * (p - q))
        };
        while let Some(&(other, from)) = hull.last() {
            if meets(other) > from {
                break;
            }
            hull.pop();
        }
        let from = hull.last().map_or(f64::NEG_INFINITY, |&(other, _)| meets(other));
        hull.push((place, from));
    }
    let mut at = 0;
    (0..values.len())
        .map(|place| {
            while at + 1 < hull.len() && hull[at + 1].1 <= place as f64 {
                at += 1;
            }
            hull.get(at).map_or(f64::INFINITY, |&(other, _)| values[other] + (place as f64 - other as f64).powi(2))
        })
        .collect()
}

//! Sub-pixel centrelines: the crest of the probability across the line, smoothed along it.
//!
//! Across: vertex of the parabola through the logarithm of three samples, exact for a Gaussian profile; the centroid
//! where the profile is flat on top. Along: local quadratic regression (Savitzky and Golay 1964, with Gaussian
//! weights), which does not shrink curves as a mean would: on a circle of radius R its bias is of order h^4 / R^3.
//! Positions and lengths in px.

use ndarray::{Array2, ArrayView2};

use crate::curve::TracePoint;
use crate::filter::sample_cubic;
use crate::geometry::{Point2, Vector2};

/// Standard deviation in px of the weights along the line.
const SMOOTHING_PX: f64 = 2.5;
/// Least one-sigma error of a centreline: interpolation and sampling of the profile.
const SIGMA_FLOOR_PX: f64 = 0.05;
/// Share of the raw scatter that is left after smoothing.
const SCATTER_LEFT: f64 = 0.7;
/// Error of a line at probability 1/2 in units of its width.
const SIGMA_PER_WIDTH: f64 = 0.12;
/// Half the arc length in px over which scatter is averaged.
const SCATTER_REACH_PX: f64 = 8.0;

/// Cubic interpolation of the map, 0 outside.
fn sample(map: &ArrayView2<'_, f32>, point: Point2) -> f64 {
    sample_cubic(map, point.x, point.y).map_or(0.0, |value| f64::from(value.max(0.0)))
}

/// Moves the pixels of a branch to the crest of the map.
pub(super) fn crest(map: &Array2<f32>, pixels: &[Point2], closed: bool, width_px: f64) -> Vec<Point2> {
    let view = map.view();
    let count = pixels.len() as isize;
    let at = |index: isize| {
        if closed { pixels[index.rem_euclid(count) as usize] } else { pixels[index.clamp(0, count - 1) as usize] }
    };
    let window = 3_isize;
    (0..count)
        .map(|index| {
            let Some(along) = (at(index + window) - at(index - window)).try_normalize(1e-9) else { return at(index) };
            let across = Vector2::new(-along.y, along.x);
            // A pixel path jumps from side to side: start from its mean.
            let near = (-2..=2).map(|offset| at(index + offset).coords);
            let mean = Point2::from(near.sum::<Vector2>() / 5.0);
            let start = at(index) + across * across.dot(&(mean - at(index)));
            crest_across(&view, start, across, width_px).unwrap_or(start)
        })
        .collect()
}

/// The crest of the map on a line across a curve; `None` if there is none within about 2 px.
fn crest_across(map: &ArrayView2<'_, f32>, start: Point2, across: Vector2, width_px: f64) -> Option<Point2> {
    let mut offset: f64 = 0.0;
    for _ in 0..6 {
        let [left, centre, right] = [-1.0, 0.0, 1.0].map(|step| sample(map, start + across * (offset + step)));
        if left.min(centre).min(right) <= 1e-4 {
            return None;
        }
        let (before, here, after) = (left.ln(), centre.ln(), right.ln());
        let curvature = before + after - 2.0 * here;
        if curvature > -0.02 {
            return centroid(map, start, across, width_px);
        }
        let shift = (0.5 * (before - after) / curvature).clamp(-1.0, 1.0);
        offset += shift;
        if offset.abs() > 2.0 {
            return None;
        }
        if shift.abs() < 1e-3 {
            break;
        }
    }
    Some(start + across * offset)
}

/// The centre of mass across a profile that is flat on top.
fn centroid(map: &ArrayView2<'_, f32>, start: Point2, across: Vector2, width_px: f64) -> Option<Point2> {
    let reach = (0.75 * width_px).max(2.0);
    let steps = (2.0 * reach).ceil() as i32;
    let top = sample(map, start);
    let mut sums = [0.0, 0.0];
    for sense in [-1.0, 1.0] {
        for step in i32::from(sense > 0.0)..=steps {
            let offset = sense * f64::from(step) / f64::from(steps) * reach;
            let value = sample(map, start + across * offset);
            // Only this line's own profile: what lies beyond a dip is another's.
            if value < 0.3 * top {
                break;
            }
            sums[0] += value;
            sums[1] += value * offset;
        }
    }
    (sums[0] > 0.0).then(|| start + across * (sums[1] / sums[0]))
}

/// How far beyond (or, negative, before) its last point a free line ends: where the map falls to half its crest along
/// the line, less the same distance across it.
pub(super) fn overhang(map: &Array2<f32>, end: Point2, outward: Vector2, inner: Point2) -> f64 {
    const STEP: f64 = 0.25;
    const LONGEST: f64 = 8.0;
    let view = map.view();
    let (rows, columns) = map.dim();
    let top = sample(&view, inner);
    let across = Vector2::new(-outward.y, outward.x);
    let half_width = |direction: Vector2, from: Point2| {
        let mut distance = 0.0;
        while distance < LONGEST && sample(&view, from + direction * distance) > 0.5 * top {
            distance += STEP;
        }
        distance
    };
    let side = half_width(across, inner).min(half_width(-across, inner));
    let back = (inner - end).norm();
    let ahead = half_width(outward, inner);
    let reached = inner + outward * ahead;
    let outside =
        reached.x < 0.0 || reached.y < 0.0 || reached.x > columns as f64 - 1.0 || reached.y > rows as f64 - 1.0;
    // A line that runs out of the image is cut there and has no rounded end.
    (ahead - if outside { STEP } else { side } - back).clamp(-4.0, 4.0)
}

/// A smooth curve of points 1 px apart through raw points, with the map's probability and the error of each.
pub(super) fn smooth_curve(map: &Array2<f32>, raw: &[Point2], closed: bool, width_px: f64) -> Vec<TracePoint> {
    let raw = dense(raw, closed);
    let arcs = arc_lengths(&raw, closed);
    let total = arcs[raw.len()];
    if raw.len() < 2 || total < 1.0 {
        return Vec::new();
    }
    // Smoothed at half-px steps first, whose true length then gives the even spacing.
    let steps = (2.0 * total).round().max(2.0) as usize;
    let fine: Vec<Point2> =
        (0..=steps).map(|step| local_quadratic(&raw, &arcs, closed, total * step as f64 / steps as f64).0).collect();
    let fine_arcs = arc_lengths(&fine, false);
    let length = fine_arcs[fine.len() - 1];
    let count = length.round().max(1.0) as usize;
    let places: Vec<f64> = (0..if closed { count } else { count + 1 })
        .map(|index| {
            let arc = length * index as f64 / count as f64;
            let above = fine_arcs[..fine.len()].partition_point(|value| *value < arc).clamp(1, fine.len() - 1);
            let span = (fine_arcs[above] - fine_arcs[above - 1]).max(1e-12);
            let share = ((arc - fine_arcs[above - 1]) / span).clamp(0.0, 1.0);
            total * (above as f64 - 1.0 + share) / steps as f64
        })
        .collect();

    // Scatter of the raw points about the smooth curve, by squared distance at each raw point.
    let scatter: Vec<f64> = (0..raw.len())
        .map(|index| {
            let (point, tangent) = local_quadratic(&raw, &arcs, closed, arcs[index]);
            tangent.perp(&(raw[index] - point)).powi(2)
        })
        .collect();
    let view = map.view();
    places
        .into_iter()
        .map(|arc| {
            let (position, tangent) = local_quadratic(&raw, &arcs, closed, arc);
            let probability = sample(&view, position).clamp(0.0, 1.0);
            let near = neighbourhood(&arcs[..raw.len()], total, closed, arc, SCATTER_REACH_PX);
            let (sum, number) = near.fold((0.0, 0), |(sum, number), (index, _)| (sum + scatter[index], number + 1));
            let scatter2 = sum / f64::from(number.max(1));
            let odds = (1.0 - probability) / probability.max(0.02);
            let variance =
                SIGMA_FLOOR_PX.powi(2) + SCATTER_LEFT.powi(2) * scatter2 + (SIGMA_PER_WIDTH * width_px).powi(2) * odds;
            TracePoint { position, tangent, probability: probability as f32, sigma_perp_px: variance.sqrt() }
        })
        .collect()
}

/// Fills stretches without points (crossings, bridges) by points on their chord, so that every window holds some.
fn dense(raw: &[Point2], closed: bool) -> Vec<Point2> {
    let mut points: Vec<Point2> = Vec::with_capacity(raw.len());
    let next = raw.iter().skip(1).chain(if closed { raw.first() } else { None });
    for (from, to) in raw.iter().zip(next) {
        points.push(*from);
        let steps = ((to - from).norm() / 1.5).floor() as usize;
        points.extend((1..=steps).map(|step| from + (to - from) * (step as f64 / (steps + 1) as f64)));
    }
    if let (false, Some(last)) = (closed, raw.last()) {
        points.push(*last);
    }
    points
}

/// Arc length at each point of the path (of its running mean, since raw points zigzag), and the total after them.
fn arc_lengths(points: &[Point2], closed: bool) -> Vec<f64> {
    let count = points.len();
    let mut arcs = Vec::with_capacity(count + 1);
    let mut arc = 0.0;
    for (index, point) in points.iter().enumerate() {
        if index > 0 {
            arc += (point - points[index - 1]).norm();
        }
        arcs.push(arc);
    }
    if let (true, Some(first), Some(last)) = (closed, points.first(), points.last()) {
        arc += (first - last).norm();
    }
    arcs.push(arc);
    arcs
}

/// Indices of points within `reach` of an arc length, and their signed distance along the curve.
fn neighbourhood(
    arcs: &[f64],
    total: f64,
    closed: bool,
    arc: f64,
    reach: f64,
) -> impl Iterator<Item = (usize, f64)> + '_ {
    let reach = if closed { reach.min(0.49 * total) } else { reach };
    let shifts = if closed { vec![-total, 0.0, total] } else { vec![0.0] };
    shifts.into_iter().flat_map(move |shift| {
        let first = arcs.partition_point(|value| value + shift < arc - reach);
        let last = arcs.partition_point(|value| value + shift <= arc + reach);
        (first..last).map(move |index| (index, arcs[index] + shift - arc))
    })
}

/// Position and unit tangent of the quadratic fitted around an arc length.
fn local_quadratic(raw: &[Point2], arcs: &[f64], closed: bool, arc: f64) -> (Point2, Vector2) {
    let total = arcs[raw.len()];
    // Moments of the weights, and of x and y with them.
    let mut m = [0.0; 5];
    let (mut b0, mut b1, mut b2) = (Vector2::zeros(), Vector2::zeros(), Vector2::zeros());
    for (index, along) in neighbourhood(&arcs[..raw.len()], total, closed, arc, 3.0 * SMOOTHING_PX) {
        let u = along / SMOOTHING_PX;
        let weight = (-0.5 * u * u).exp();
        let mut power = weight;
        for moment in &mut m {
            *moment += power;
            power *= u;
        }
        let point = raw[index].coords;
        b0 += point * weight;
        b1 += point * (weight * u);
        b2 += point * (weight * u * u);
    }
    let normal = nalgebra::Matrix3::new(m[0], m[1], m[2], m[1], m[2], m[3], m[2], m[3], m[4]);
    if let Some(inverse) = normal.try_inverse().filter(|_| normal.determinant() > 1e-9 * m[0].powi(3)) {
        let row = |index: usize| b0 * inverse[(index, 0)] + b1 * inverse[(index, 1)] + b2 * inverse[(index, 2)];
        if let Some(tangent) = row(1).try_normalize(1e-9) {
            return (Point2::from(row(0)), tangent);
        }
    }
    // Two or three points: a straight line.
    let (first, last) = (raw[0], raw[raw.len() - 1]);
    let tangent = (last - first).try_normalize(1e-9).unwrap_or_else(Vector2::x);
    (Point2::from(b0 / m[0].max(1e-300)), tangent)
}

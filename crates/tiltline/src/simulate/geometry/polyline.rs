//! Polylines in space: length, resampling, splines, corner cutting, and clipping to a convex region.

use crate::geometry::{Point3, Vector3};

/// The points with `normal . p <= offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfSpace {
    /// Outward unit normal.
    pub normal: Vector3,
    /// Distance of the plane from the origin along the normal.
    pub offset: f64,
}

impl HalfSpace {
    /// Signed distance from the plane, positive outside.
    pub fn outside_by(&self, point: &Point3) -> f64 {
        self.normal.dot(&point.coords) - self.offset
    }
}

/// The six half spaces of a box with opposite corners `low` and `high`.
pub fn box_region(low: Point3, high: Point3) -> [HalfSpace; 6] {
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
    std::array::from_fn(|side| {
        let axis = axes[side / 2];
        if side % 2 == 0 {
            HalfSpace { normal: axis, offset: high.coords.dot(&axis) }
        } else {
            HalfSpace { normal: -axis, offset: -low.coords.dot(&axis) }
        }
    })
}

/// A part of a polyline inside a region.
#[derive(Clone, Debug, PartialEq)]
pub struct Piece {
    /// Its points.
    pub points: Vec<Point3>,
    /// Whether the last point joins the first.
    pub closed: bool,
    /// Whether the first and the last point were made by cutting.
    pub cut: [bool; 2],
}

/// Length of a polyline.
pub fn length(points: &[Point3], closed: bool) -> f64 {
    let open: f64 = points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    match (closed, points.first(), points.last()) {
        (true, Some(first), Some(last)) => open + (first - last).norm(),
        _ => open,
    }
}

/// Length of the parts of a polyline inside a convex region.
pub fn length_inside(points: &[Point3], closed: bool, region: &[HalfSpace]) -> f64 {
    let inside = |start: &Point3, end: &Point3| {
        span_inside(start, end, region).map_or(0.0, |[enter, leave]| (leave - enter) * (end - start).norm())
    };
    let open: f64 = points.windows(2).map(|pair| inside(&pair[0], &pair[1])).sum();
    match (closed, points.first(), points.last()) {
        (true, Some(first), Some(last)) => open + inside(last, first),
        _ => open,
    }
}

/// The same polyline with points at equal arc lengths, at most `spacing` apart; the ends are kept exactly. A closed
/// polyline has its first point once.
pub fn resample(points: &[Point3], closed: bool, spacing: f64) -> Vec<Point3> {
    let total = length(points, closed);
    let (Some(&first), Some(&last)) = (points.first(), points.last()) else { return Vec::new() };
    if total <= 0.0 || !total.is_finite() {
        return vec![first];
    }
    let steps = ((total / spacing).ceil() as usize).max(if closed { 3 } else { 1 });
    let step = total / steps as f64;
    let mut resampled = Vec::with_capacity(steps + 1);
    resampled.push(first);
    let (mut travelled, mut start) = (0.0, first);
    for &end in points[1..].iter().chain(closed.then_some(&first)) {
        let segment = (end - start).norm();
        while resampled.len() < steps && resampled.len() as f64 * step <= travelled + segment {
            let fraction = (resampled.len() as f64 * step - travelled) / segment;
            resampled.push(start + (end - start) * fraction);
        }
        travelled += segment;
        start = end;
    }
    if !closed {
        resampled.push(last);
    }
    resampled
}

/// A smooth curve through knots (Catmull-Rom, chord-length parametrised per segment), points at most about `spacing`
/// apart. Open curves start and end at the first and last knot.
pub fn spline(knots: &[Point3], closed: bool, spacing: f64) -> Vec<Point3> {
    let count = knots.len();
    if count < 3 {
        return knots.to_vec();
    }
    let knot = |index: isize| {
        let last = count as isize - 1;
        if closed { knots[index.rem_euclid(count as isize) as usize] } else { knots[index.clamp(0, last) as usize] }
    };
    // The tangent at a knot weighs its two chords by the other's length, so that uneven knots give no overshoot.
    let tangent = |index: isize| {
        let (before, after) = (knot(index) - knot(index - 1), knot(index + 1) - knot(index));
        let (back, forth) = (before.norm(), after.norm());
        match (back > 0.0, forth > 0.0) {
            (true, true) => (before * (forth / back) + after * (back / forth)) / (back + forth),
            (true, false) => before / back,
            (false, true) => after / forth,
            (false, false) => Vector3::zeros(),
        }
    };
    let segments = if closed { count } else { count - 1 };
    let mut points = Vec::new();
    for segment in 0..segments as isize {
        let (start, end) = (knot(segment), knot(segment + 1));
        let chord = (end - start).norm();
        let (leave, arrive) = (tangent(segment) * chord, tangent(segment + 1) * chord);
        let steps = ((1.3 * chord / spacing).ceil() as usize).max(1);
        for step in 0..steps {
            // Cubic Hermite basis.
            let t = step as f64 / steps as f64;
            let (t2, t3) = (t * t, t * t * t);
            points
                .push(start + (end - start) * (3.0 * t2 - 2.0 * t3) + leave * (t3 - 2.0 * t2 + t) + arrive * (t3 - t2));
        }
    }
    if !closed {
        points.push(knots[count - 1]);
    }
    points
}

/// Rounds corners: each pass replaces every inner corner by two points at a quarter of its edges (Chaikin 1974).
pub fn round_corners(points: &[Point3], closed: bool, passes: usize) -> Vec<Point3> {
    let mut points = points.to_vec();
    for _ in 0..passes {
        let count = points.len();
        if count < 3 {
            break;
        }
        let edges = if closed { count } else { count - 1 };
        let mut rounded = Vec::with_capacity(2 * count);
        for edge in 0..edges {
            let (start, end) = (points[edge], points[(edge + 1) % count]);
            let (first, last) = (!closed && edge == 0, !closed && edge == edges - 1);
            rounded.push(if first { start } else { start + (end - start) * 0.25 });
            rounded.push(if last { end } else { start + (end - start) * 0.75 });
        }
        points = rounded;
    }
    points
}

/// The parts of a polyline inside a convex region, in order (Cyrus and Beck 1978, segment by segment). A cut end lies on
/// the plane that cut it, to rounding.
pub fn clip(points: &[Point3], closed: bool, region: &[HalfSpace]) -> Vec<Piece> {
    let mut pieces: Vec<Piece> = Vec::new();
    let mut open = false;
    let count = points.len();
    let segments = if closed && count > 1 { count } else { count.saturating_sub(1) };
    for index in 0..segments {
        let (start, end) = (points[index], points[(index + 1) % count]);
        let Some([enter, leave]) = span_inside(&start, &end, region) else {
            open = false;
            continue;
        };
        let at = |fraction: f64| start + (end - start) * fraction;
        match pieces.last_mut() {
            Some(piece) if open && enter == 0.0 => piece.cut[1] = false,
            _ => pieces.push(Piece { points: vec![at(enter)], closed: false, cut: [enter > 0.0, false] }),
        }
        let piece = pieces.last_mut().expect("a piece was pushed or is open");
        piece.points.push(if leave == 1.0 { end } else { at(leave) });
        piece.cut[1] = leave < 1.0;
        open = leave == 1.0;
    }
    if closed && count > 1 {
        let untouched = pieces.len() == 1 && pieces[0].cut == [false, false] && pieces[0].points.len() == count + 1;
        let wraps =
            pieces.len() > 1 && open && pieces[0].cut == [false, pieces[0].cut[1]] && pieces[0].points[0] == points[0];
        if untouched {
            pieces[0].points.pop();
            pieces[0].closed = true;
        } else if wraps {
            let head = pieces.remove(0);
            let tail = pieces.last_mut().expect("more than one piece before one was removed");
            tail.points.extend(&head.points[1..]);
            tail.cut[1] = head.cut[1];
        }
    }
    pieces
}

/// The fractions of a segment between which it lies inside; none if it misses the region or only touches it.
fn span_inside(start: &Point3, end: &Point3, region: &[HalfSpace]) -> Option<[f64; 2]> {
    let (mut enter, mut leave) = (0.0f64, 1.0f64);
    for half_space in region {
        let (from, to) = (half_space.outside_by(start), half_space.outside_by(end));
        if from > 0.0 && to >= 0.0 || from >= 0.0 && to > 0.0 {
            return None;
        }
        if from > 0.0 {
            enter = enter.max(from / (from - to));
        } else if to > 0.0 {
            leave = leave.min(from / (from - to));
        }
    }
    (enter < leave).then_some([enter, leave])
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;

    use super::*;

    fn circle(radius: f64, count: usize) -> Vec<Point3> {
        let turn = std::f64::consts::TAU / count as f64;
        (0..count)
            .map(|i| Point3::new(radius * (i as f64 * turn).cos(), 0.0, radius * (i as f64 * turn).sin()))
            .collect()
    }

    fn slab(half: f64) -> [HalfSpace; 6] {
        box_region(Point3::new(-1e3, -1e3, -half), Point3::new(1e3, 1e3, half))
    }

    #[test]
    fn resampling_keeps_ends_length_and_the_bound_on_spacing() {
        let bent = [Point3::origin(), Point3::new(3.0, 0.0, 0.0), Point3::new(3.0, 4.0, 0.0)];
        let points = resample(&bent, false, 0.5);
        assert_eq!((points.len(), points[0], points[14]), (15, bent[0], bent[2]));
        assert_eq!(points[6], bent[1]);
        assert_relative_eq!(length(&points, false), 7.0, epsilon = 1e-12);
        let ring = resample(&circle(10.0, 400), true, 2.0);
        // 2 pi 10 / 2 rounds up to 32 steps; the chord is at most the arc.
        assert_eq!(ring.len(), 32);
        assert!((0..32).all(|i| (ring[(i + 1) % 32] - ring[i]).norm() <= 2.0));
    }

    #[test]
    fn a_spline_goes_through_its_knots_and_keeps_a_straight_line_straight() {
        let knots: Vec<Point3> = [0.0, 1.0, 5.0, 6.0].iter().map(|&x| Point3::new(x, 2.0 * x, 0.0)).collect();
        for point in spline(&knots, false, 0.3) {
            assert_relative_eq!(point.y, 2.0 * point.x, epsilon = 1e-12);
        }
        let bent = [Point3::origin(), Point3::new(3.0, 0.0, 0.0), Point3::new(3.0, 4.0, 1.0)];
        let points = spline(&bent, false, 0.3);
        assert!(bent.iter().all(|knot| points.iter().any(|point| (point - knot).norm() < 1e-12)));
    }

    #[test]
    fn a_circle_cut_by_a_slab_gives_two_arcs_of_the_known_length() {
        let arcs = clip(&circle(10.0, 4000), true, &slab(5.0));
        // Two arcs of 60 degrees: between -30 and 30 degrees of latitude.
        assert_eq!(arcs.len(), 2);
        for arc in &arcs {
            assert_eq!((arc.closed, arc.cut), (false, [true, true]));
            assert_relative_eq!(length(&arc.points, false), 10.0 * std::f64::consts::FRAC_PI_3, epsilon = 1e-4);
            for end in [arc.points[0], arc.points[arc.points.len() - 1]] {
                assert_relative_eq!(end.z.abs(), 5.0, epsilon = 1e-12);
            }
        }
        let whole = clip(&circle(4.0, 40), true, &slab(5.0));
        assert_eq!((whole.len(), whole[0].closed, whole[0].points.len()), (1, true, 40));
        assert!(
            clip(&circle(4.0, 40), true, &box_region(Point3::new(50.0, 0.0, 0.0), Point3::new(60.0, 1.0, 1.0)))
                .is_empty()
        );
    }

    #[test]
    fn the_length_inside_is_that_of_the_pieces() {
        let ring = circle(10.0, 4000);
        let pieces: f64 = clip(&ring, true, &slab(5.0)).iter().map(|piece| length(&piece.points, false)).sum();
        assert_relative_eq!(length_inside(&ring, true, &slab(5.0)), pieces, epsilon = 1e-9);
        assert_relative_eq!(length_inside(&ring, true, &slab(50.0)), length(&ring, true), epsilon = 1e-9);
    }

    #[test]
    fn clipping_by_a_region_and_its_complement_keeps_the_length() {
        let wiggle: Vec<Point3> = (0..500)
            .map(|i| Point3::new(0.1 * f64::from(i), (0.37 * f64::from(i)).sin(), 3.0 * (0.11 * f64::from(i)).cos()))
            .collect();
        let below = HalfSpace { normal: Vector3::new(0.0, 0.6, 0.8), offset: 0.5 };
        let above = HalfSpace { normal: -below.normal, offset: -below.offset };
        let total: f64 = [below, above]
            .iter()
            .flat_map(|half| clip(&wiggle, false, &[*half]))
            .map(|piece| length(&piece.points, false))
            .sum();
        assert_relative_eq!(total, length(&wiggle, false), epsilon = 1e-9);
    }
}

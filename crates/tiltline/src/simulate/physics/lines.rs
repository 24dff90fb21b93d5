//! The dislocations of a foil in the frame of a tilted view: turned, prolonged beyond the surfaces, and simplified with
//! the distance they are looked at from.
//!
//! Lengths are nm in the view's frame: x right before the image is turned, y along the tilt axis, z along the beam.

use crate::geometry::{Point3, Vector3};
use crate::simulate::{Dislocation, Foil};

use super::segment::Contrast;
use super::{PhysicsError, PhysicsSettings};

/// Far enough that a half-line beyond a surface looks infinite, near enough for f64.
const PROLONGED_NM: f64 = 1e6;
/// A chord replaces the points between its ends where they deviate by less than this share of the distance to it (or by
/// [`CHORD_NM`]): a change of beta of about the same share.
const CHORD_SHARE: f64 = 0.008;
const CHORD_NM: f64 = 0.03;

/// One dislocation in a view.
#[derive(Clone, Debug)]
pub struct Line {
    /// Burgers vector, g and the rest.
    pub contrast: Contrast,
    points: Vec<Point3>,
    chords: Vec<Chord>,
    before: Option<Point3>,
    after: Option<Point3>,
    low: [f64; 2],
    high: [f64; 2],
}

/// A chord between two points of a line, and the index of its halves (0: none; the root is nobody's half).
#[derive(Clone, Debug)]
struct Chord {
    ends: [usize; 2],
    /// Squared lateral distance from which it may stand for its points (0: always).
    good_from_nm2: f64,
    halves: [usize; 2],
}

/// Turns a vector of the untilted specimen into the view at `tilt_rad`: `x = X cos a + Z sin a`.
pub fn view_from_specimen(vector: &Vector3, tilt_rad: f64) -> Vector3 {
    let (sin, cos) = tilt_rad.sin_cos();
    Vector3::new(vector.x * cos + vector.z * sin, vector.y, vector.z * cos - vector.x * sin)
}

impl Line {
    /// A dislocation of `foil` in the view at `tilt_rad`.
    ///
    /// Ends at a surface or at the side of the foil go straight on beyond it; ends inside (at a node) stay, since there
    /// the other arms carry on.
    ///
    /// # Errors
    /// [`PhysicsError::UnknownBurgers`] and [`PhysicsError::TooFewPoints`] with the line's number.
    pub fn new(foil: &Foil, line: usize, settings: &PhysicsSettings, tilt_rad: f64) -> Result<Self, PhysicsError> {
        let Dislocation { points, closed, burgers_nm, .. } = &foil.dislocations[line];
        let burgers = burgers_nm.ok_or(PhysicsError::UnknownBurgers { line })?;
        let turned = |point: &Point3| Point3::from(view_from_specimen(&point.coords, tilt_rad));
        let mut own: Vec<Point3> = Vec::with_capacity(points.len() + 1);
        own.extend(points.iter().map(turned));
        // Neighbours that coincide have no direction.
        own.dedup_by(|a, b| (*a - *b).norm() < 1e-9);
        if own.len() < 2 {
            return Err(PhysicsError::TooFewPoints { line, points: own.len() });
        }
        let (mut before, mut after) = (None, None);
        if *closed {
            if (own[0] - own[own.len() - 1]).norm() > 1e-9 {
                own.push(own[0]);
            }
        } else {
            let prolonged = |end: Point3, inner: Point3| end + (end - inner).normalize() * PROLONGED_NM;
            let last = own.len() - 1;
            before = leaves(foil, &points[0]).then(|| prolonged(own[0], own[1]));
            after = leaves(foil, &points[points.len() - 1]).then(|| prolonged(own[last], own[last - 1]));
        }
        let contrast = Contrast {
            burgers_nm: view_from_specimen(&burgers, tilt_rad),
            g_per_nm: view_from_specimen(&settings.g_per_nm, tilt_rad),
            poisson_ratio: settings.poisson_ratio,
        };
        let bound =
            |axis: usize, pick: fn(f64, f64) -> f64, start: f64| own.iter().map(|point| point[axis]).fold(start, pick);
        let low = [bound(0, f64::min, f64::INFINITY), bound(1, f64::min, f64::INFINITY)];
        let high = [bound(0, f64::max, f64::NEG_INFINITY), bound(1, f64::max, f64::NEG_INFINITY)];
        let mut chords = Vec::new();
        split(&own, 0, own.len() - 1, &mut chords);
        Ok(Self { contrast, points: own, chords, before, after, low, high })
    }

    /// Lateral distance of the column (x, y) to the line's bounding box: never more than to the line.
    pub fn distance_to_box(&self, [x, y]: [f64; 2]) -> f64 {
        let dx = (self.low[0] - x).max(x - self.high[0]).max(0.0);
        let dy = (self.low[1] - y).max(y - self.high[1]).max(0.0);
        squared([dx, dy]).sqrt()
    }

    /// The vertices of the line as seen from the column (x, y), appended to `out`; returns the vector (dx, dy) to the
    /// nearest place of it that is inside the foil.
    pub fn seen_from(&self, column: [f64; 2], out: &mut Vec<Point3>) -> [f64; 2] {
        out.extend(self.before);
        out.push(self.points[0]);
        let mut nearest = [f64::INFINITY; 2];
        self.descend(0, column, out, &mut nearest);
        out.extend(self.after);
        nearest
    }

    /// `z^ x u`, normalised, of the piece of the line nearest to the column; x for one along the beam.
    pub fn across_near(&self, column: [f64; 2]) -> [f64; 2] {
        let distance = |ends: &[Point3]| squared(lateral_offset(&ends[0], &ends[1], column));
        let nearest = self.points.windows(2).min_by(|a, b| distance(a).total_cmp(&distance(b)));
        let along = nearest.map_or(Vector3::z(), |ends| ends[1] - ends[0]);
        let lateral = along.x.hypot(along.y);
        if lateral > 1e-9 { [-along.y / lateral, along.x / lateral] } else { [1.0, 0.0] }
    }

    fn descend(&self, index: usize, column: [f64; 2], out: &mut Vec<Point3>, nearest: &mut [f64; 2]) {
        let chord = &self.chords[index];
        let [start, end] = chord.ends;
        let offset = lateral_offset(&self.points[start], &self.points[end], column);
        let distance2 = squared(offset);
        if distance2 >= chord.good_from_nm2 {
            if distance2 < squared(*nearest) {
                *nearest = offset;
            }
            out.push(self.points[end]);
        } else {
            self.descend(chord.halves[0], column, out, nearest);
            self.descend(chord.halves[1], column, out, nearest);
        }
    }
}

/// Whether an end is at (or beyond) a surface or a side of the foil; to 2 nm or 2 percent.
fn leaves(foil: &Foil, end: &Point3) -> bool {
    let beyond = |value: f64, extent: f64| extent > 0.0 && value.abs() >= 0.5 * extent - (0.01 * extent).max(2.0);
    beyond(end.z, foil.thickness_nm) || beyond(end.x, foil.size_nm[0]) || beyond(end.y, foil.size_nm[1])
}

/// Builds the tree of chords over `points[start..=end]` (split where the deviation is largest); returns its index.
fn split(points: &[Point3], start: usize, end: usize, chords: &mut Vec<Chord>) -> usize {
    let index = chords.len();
    chords.push(Chord { ends: [start, end], good_from_nm2: 0.0, halves: [0, 0] });
    let mut deviation = 0.0;
    let mut middle = start;
    for (i, point) in points.iter().enumerate().take(end).skip(start + 1) {
        let distance = distance_to_segment(&points[start], &points[end], point);
        // Equal deviations (a straight piece): the one nearest the middle, so that the tree stays shallow.
        let centred = i.abs_diff(start + end - i) < middle.abs_diff((start + end).saturating_sub(middle));
        if middle == start || distance > deviation + 1e-12 || (distance > deviation - 1e-12 && centred) {
            deviation = distance.max(deviation);
            middle = i;
        }
    }
    if middle > start {
        let halves = [split(points, start, middle, chords), split(points, middle, end, chords)];
        // A closed line's root has no length: it must be divided, whatever its points' distance.
        let length = (points[end] - points[start]).norm();
        chords[index].good_from_nm2 = if length < 1e-9 {
            f64::INFINITY
        } else if deviation <= CHORD_NM {
            0.0
        } else {
            // The points may be nearer than the chord by the deviation.
            (deviation * (1.0 + 1.0 / CHORD_SHARE)).powi(2)
        };
        chords[index].halves = halves;
    }
    index
}

fn distance_to_segment(start: &Point3, end: &Point3, point: &Point3) -> f64 {
    let along = end - start;
    let foot = ((point - start).dot(&along) / along.norm_squared().max(1e-30)).clamp(0.0, 1.0);
    (point - start - along * foot).norm()
}

fn squared([dx, dy]: [f64; 2]) -> f64 {
    dx * dx + dy * dy
}

/// From the column to the nearest point of a segment, across the beam.
fn lateral_offset(start: &Point3, end: &Point3, [x, y]: [f64; 2]) -> [f64; 2] {
    let (ax, ay) = (end.x - start.x, end.y - start.y);
    let (px, py) = (x - start.x, y - start.y);
    let foot = ((px * ax + py * ay) / (ax * ax + ay * ay).max(1e-30)).clamp(0.0, 1.0);
    [foot * ax - px, foot * ay - py]
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn bowed(closed: bool) -> Foil {
        let count = 80;
        let turn = if closed { std::f64::consts::TAU } else { 2.0 };
        let points = (0..count)
            .map(|i| turn * i as f64 / count as f64)
            .map(|angle| Point3::new(60.0 * angle.cos(), 60.0 * angle.sin(), 20.0 * angle.sin()))
            .collect();
        let burgers_nm = Some(Vector3::new(0.2, 0.1, 0.0));
        Foil {
            thickness_nm: 100.0,
            size_nm: [500.0, 500.0],
            dislocations: vec![Dislocation { points, closed, burgers_nm, plane_normal: None }],
        }
    }

    #[test]
    fn a_line_is_fine_nearby_and_coarse_from_afar_and_always_connects_its_ends() {
        for closed in [false, true] {
            let foil = bowed(closed);
            let line = Line::new(&foil, 0, &PhysicsSettings::default(), 0.1).unwrap();
            let (mut near, mut far) = (Vec::new(), Vec::new());
            let first = line.points[0];
            let [dx, dy] = line.seen_from([first.x, first.y], &mut near);
            assert!(dx.hypot(dy) < 1e-9);
            let [dx, dy] = line.seen_from([700.0, 0.0], &mut far);
            let distance = dx.hypot(dy);
            assert!(far.len() < near.len() && near.len() <= line.points.len());
            assert_relative_eq!(distance, 700.0 - line.high[0], max_relative = CHORD_SHARE);
            for vertices in [near, far] {
                assert_eq!(vertices[0], line.points[0]);
                assert_eq!(vertices[vertices.len() - 1], line.points[line.points.len() - 1]);
            }
        }
    }

    #[test]
    fn ends_at_a_surface_go_on_beyond_it_and_ends_inside_do_not() {
        let mut foil = bowed(false);
        foil.dislocations[0].points =
            vec![Point3::new(0.0, 0.0, -50.0), Point3::new(10.0, 0.0, 0.0), Point3::new(20.0, 5.0, 10.0)];
        let line = Line::new(&foil, 0, &PhysicsSettings::default(), 0.0).unwrap();
        assert!(line.before.is_some_and(|point| point.z < -1e5) && line.after.is_none());
    }
}

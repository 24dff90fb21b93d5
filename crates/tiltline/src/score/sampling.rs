//! Curves cut into pieces of equal length, so that every score is weighted by length and knows nothing of how densely a
//! file's points were set.

use crate::geometry::{Point2, Vector2};
use crate::score::grid::Grid;

/// Length of a piece in px: fine beside every tolerance.
pub(crate) const PIECE_PX: f64 = 0.5;
/// Furthest that a chord reaches from its middle, with room for rounding.
const HALF_PIECE_PX: f64 = 0.5 * PIECE_PX + 1e-9;

/// Where a piece's ends lie on the polyline: segment index and fraction along it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Place {
    pub segment: usize,
    pub fraction: f64,
}

impl Place {
    /// Interpolates a value given at the points of the polyline (cyclic for closed ones).
    pub fn interpolate(&self, value: impl Fn(usize) -> f64, count: usize) -> f64 {
        let (a, b) = (value(self.segment), value((self.segment + 1) % count));
        a + (b - a) * self.fraction
    }

    /// Interpolates between points.
    pub fn point(&self, points: &[Point2]) -> Point2 {
        let (a, b) = (points[self.segment], points[(self.segment + 1) % points.len()]);
        a + (b - a) * self.fraction
    }

    /// Whether a property holds at both neighbouring points.
    pub fn holds(&self, property: impl Fn(usize) -> bool, count: usize) -> bool {
        // At a vertex, the other end of the segment does not matter.
        (self.fraction == 1.0 || property(self.segment))
            && (self.fraction == 0.0 || property((self.segment + 1) % count))
    }
}

/// A piece of a polyline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Piece {
    pub start: Place,
    pub middle: Place,
    pub end: Place,
    pub length: f64,
}

/// Cuts a polyline into pieces of equal length, at most [`PIECE_PX`] long; none if it has no length.
pub(crate) fn pieces(points: &[Point2], closed: bool) -> Vec<Piece> {
    let count = points.len();
    let segments = (count + usize::from(closed && count > 2)).saturating_sub(1);
    let mut reached = vec![0.0];
    for segment in 0..segments {
        reached.push(reached[segment] + (points[(segment + 1) % count] - points[segment]).norm());
    }
    let total = reached[segments];
    if total.is_nan() || total <= 1e-9 {
        return Vec::new();
    }
    // Less a hair, so that a length of 10 px is cut into 20 pieces whatever its rounding.
    let number = (total / PIECE_PX - 1e-6).ceil().max(1.0) as usize;
    let length = total / number as f64;
    let mut segment = 0;
    let mut place_at = |at: f64| {
        while segment + 1 < segments && reached[segment + 1] < at {
            segment += 1;
        }
        let step = reached[segment + 1] - reached[segment];
        let fraction = if step > 0.0 { ((at - reached[segment]) / step).clamp(0.0, 1.0) } else { 0.0 };
        Place { segment, fraction }
    };
    let mut start = place_at(0.0);
    (0..number)
        .map(|index| {
            let middle = place_at((index as f64 + 0.5) * length);
            let end = place_at((index as f64 + 1.0) * length);
            let piece = Piece { start, middle, end, length };
            start = end;
            piece
        })
        .collect()
}

/// Chords of the pieces of many curves, with a grid over them.
pub(crate) struct Chords {
    /// Both ends of each piece.
    pub ends: Vec<[Point2; 2]>,
    /// Which curve it belongs to; the pieces of a curve lie one after another.
    pub curve: Vec<usize>,
    /// Whether an open curve starts or ends with this piece.
    open: Vec<[bool; 2]>,
    /// The middles of the chords.
    grid: Grid,
}

/// Where a point meets a piece.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Foot {
    /// Index of the piece.
    pub piece: usize,
    /// Fraction along it.
    pub fraction: f64,
    /// Distance of the point in px.
    pub distance: f64,
    /// Whether the point lies beyond the end of the curve, by more than a piece: then it is not beside it.
    pub beyond: bool,
}

impl Chords {
    /// The chords of curves, given as points and their pieces.
    pub fn new<'a>(curves: impl Iterator<Item = (&'a [Point2], bool, &'a [Piece])>) -> Self {
        let (mut ends, mut curve, mut open) = (Vec::new(), Vec::new(), Vec::new());
        for (index, (points, closed, pieces)) in curves.enumerate() {
            for (at, piece) in pieces.iter().enumerate() {
                ends.push([piece.start.point(points), piece.end.point(points)]);
                curve.push(index);
                open.push([!closed && at == 0, !closed && at + 1 == pieces.len()]);
            }
        }
        let grid = Grid::new(ends.iter().map(|[start, end]| nalgebra::center(start, end)).collect());
        Self { ends, curve, open, grid }
    }

    /// The foot of a point on every stretch of curve that comes within `radius` of it, into `found`: one for each time a
    /// curve passes by, in the order of pieces.
    pub fn feet(&self, point: &Point2, radius: f64, found: &mut Vec<Foot>) {
        found.clear();
        // A distance of exactly the radius, but for rounding, is within it; chords reach half a piece from their middle.
        let within = radius + 1e-9;
        let mut near: Vec<(usize, f64)> = Vec::with_capacity(32);
        self.grid.visit(point, within + HALF_PIECE_PX, |piece, distance2| near.push((piece, distance2.sqrt())));
        near.sort_unstable_by_key(|(piece, _)| *piece);
        for run in near.chunk_by(|(a, _), (b, _)| a + 1 == *b && self.curve[*a] == self.curve[*b]) {
            let Some((middle, _)) = run.iter().min_by(|a, b| a.1.total_cmp(&b.1)) else { continue };
            let mut nearest = self.foot(*middle, point);
            // Only a chord whose middle is hardly further away can come nearer.
            for (piece, distance) in run.iter().filter(|(piece, _)| piece != middle) {
                if distance - HALF_PIECE_PX < nearest.distance {
                    let foot = self.foot(*piece, point);
                    nearest = if foot.distance < nearest.distance { foot } else { nearest };
                }
            }
            if nearest.distance <= within && !nearest.beyond {
                found.push(nearest);
            }
        }
    }

    /// Distance to the nearest piece, `cap` where none is nearer.
    pub fn capped_distance(&self, point: &Point2, cap: f64) -> f64 {
        let mut nearest = cap;
        // Most points lie beside a line: look near first.
        for radius in [0.2 * cap, cap] {
            self.grid.visit(point, radius + HALF_PIECE_PX, |piece, distance2| {
                if distance2 < (nearest + HALF_PIECE_PX).powi(2) {
                    nearest = nearest.min(self.foot(piece, point).distance);
                }
            });
            if nearest <= radius {
                break;
            }
        }
        nearest
    }

    fn foot(&self, piece: usize, point: &Point2) -> Foot {
        let [start, end] = self.ends[piece];
        let along = end - start;
        let length2 = along.norm_squared().max(1e-18);
        let free = (point - start).dot(&along) / length2;
        let fraction = free.clamp(0.0, 1.0);
        let overshoot = (free - fraction) * length2.sqrt();
        let [first, last] = self.open[piece];
        let beyond = (first && -overshoot > PIECE_PX) || (last && overshoot > PIECE_PX);
        Foot { piece, fraction, distance: (point - (start + along * fraction)).norm(), beyond }
    }
}

/// Sine of the angle between two directions.
pub(crate) fn sine_between(a: &Vector2, b: &Vector2) -> f64 {
    let norms = a.norm() * b.norm();
    if norms > 0.0 { (a.perp(b) / norms).abs() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn pieces_share_the_length_and_do_not_see_the_points() {
        let coarse = [Point2::new(0.0, 0.0), Point2::new(6.0, 0.0), Point2::new(6.0, 4.3)];
        let mut fine = vec![coarse[0]];
        for pair in coarse.windows(2) {
            fine.extend((1..=37).map(|i| pair[0] + (pair[1] - pair[0]) * (f64::from(i) / 37.0)));
        }
        let (a, b) = (pieces(&coarse, false), pieces(&fine, false));
        assert_eq!(a.len(), 21);
        assert_eq!(a.len(), b.len());
        assert_relative_eq!(a.iter().map(|piece| piece.length).sum::<f64>(), 10.3, epsilon = 1e-12);
        for (a, b) in a.iter().zip(&b) {
            assert_relative_eq!((a.middle.point(&coarse) - b.middle.point(&fine)).norm(), 0.0, epsilon = 1e-9);
        }
        let ring = pieces(&coarse, true);
        assert_relative_eq!(
            ring.iter().map(|piece| piece.length).sum::<f64>(),
            10.3 + 6.0_f64.hypot(4.3),
            epsilon = 1e-12
        );
        assert!(pieces(&coarse[..1], false).is_empty());
    }
}

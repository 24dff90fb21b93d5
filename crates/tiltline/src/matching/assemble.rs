//! From the chosen candidates of a line to matched curves: splitting where depth jumps or the match is lost, bridging
//! short gaps and ill-conditioned stretches from the same curve's neighbours, and stating sigma and flag of every point.

use super::path::MAX_SLOPE;
use super::sigma::{ill_conditioned, sigma_of_row_px};
use crate::curve::{Flag, MatchedCurve, MatchedPoint, Trace, TraceEnd};
use crate::geometry::Vector2;

/// Longest gap that is bridged inside a curve, px.
const MAX_GAP_PX: f64 = 15.0;
/// The same where the line runs along the row for most of the gap: both sides are one line by its very shape.
const MAX_ILL_GAP_PX: f64 = 60.0;
/// Longest stretch that is continued beyond the last measured point, px, and the same for an ill-conditioned one.
const MAX_TAIL_PX: f64 = 5.0;
const MAX_ILL_TAIL_PX: f64 = 15.0;
/// Fewest measured points of a curve, and its shortest length in px.
const MIN_MEASURED: usize = 5;
const MIN_LENGTH_PX: f64 = 8.0;
/// Prior one-sigma curvature of disparity along arc length, 1/px: a line bowed to a radius of 70 px in depth, at 8 degrees.
pub(crate) const CURVATURE_SIGMA: f64 = 0.002;
/// Prior one-sigma slope of disparity along arc length: a line inclined by 45 degrees, at 8 degrees.
pub(crate) const SLOPE_SIGMA: f64 = 0.14;

/// What was measured at a point of a left line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// Disparity, px.
    pub disparity_px: f64,
    /// Error of it from tracing, px; without the row error.
    pub sigma_px: f64,
    /// Tangent of the right line, if traced.
    pub tangent_right: Option<Vector2>,
}

/// Matched curves along one left trace; `measured` has one entry per point.
///
/// `sigma_row_px` is the error of the rectification, `spread_px` the one-sigma spread of all disparities, the most that a
/// sigma can be.
pub fn assemble(
    left_trace: usize,
    trace: &Trace,
    measured: &[Option<Measured>],
    sigma_row_px: f64,
    spread_px: f64,
) -> Vec<MatchedCurve> {
    let line = Line::new(trace, measured, sigma_row_px, spread_px);
    let (stretches, closed) = line.stretches();
    stretches.into_iter().filter_map(|(first, last)| line.curve(left_trace, first, last, closed)).collect()
}

/// A left line with what was measured on it. Indices of a closed line run on past its end ("unrolled").
struct Line<'a> {
    trace: &'a Trace,
    measured: &'a [Option<Measured>],
    arc_px: Vec<f64>,
    loop_px: f64,
    sigma_row_px: f64,
    spread_px: f64,
}

impl<'a> Line<'a> {
    fn new(trace: &'a Trace, measured: &'a [Option<Measured>], sigma_row_px: f64, spread_px: f64) -> Self {
        let arc_px = super::crossings::arc_lengths(trace);
        Self { trace, measured, arc_px, loop_px: trace.length_px(), sigma_row_px, spread_px }
    }

    fn count(&self) -> usize {
        self.trace.points.len()
    }

    fn arc(&self, index: usize) -> f64 {
        self.arc_px[index % self.count()] + (index / self.count()) as f64 * self.loop_px
    }

    fn at(&self, index: usize) -> Option<Measured> {
        self.measured[index % self.count()]
    }

    /// Whether the line runs along the row at a point, in either view.
    fn ill(&self, index: usize) -> bool {
        let right = self.at(index).and_then(|measured| measured.tangent_right);
        ill_conditioned(&self.trace.points[index % self.count()].tangent)
            || right.is_some_and(|right| ill_conditioned(&right))
    }

    /// One sigma of a measured disparity with the row error, px.
    fn sigma(&self, index: usize, measured: &Measured) -> f64 {
        let tangent = measured.tangent_right.unwrap_or(self.trace.points[index % self.count()].tangent);
        measured.sigma_px.hypot(sigma_of_row_px(&tangent, self.sigma_row_px)).min(self.spread_px)
    }

    /// First and last measured point of each stretch without a jump or a long gap; whether it is the whole closed line.
    fn stretches(&self) -> (Vec<(usize, usize)>, bool) {
        let mut points: Vec<usize> = (0..self.count()).filter(|&index| self.measured[index].is_some()).collect();
        let Some(&start) = points.first() else { return (Vec::new(), false) };
        if self.trace.closed {
            points.push(start + self.count());
            let Some(cut) = points.windows(2).position(|pair| !self.bridgeable(pair[0], pair[1])) else {
                return (vec![(start, start + self.count() - 1)], true);
            };
            points.pop();
            // Start just after a cut, and run round once.
            let after_cut = (cut + 1) % points.len();
            points.rotate_left(after_cut);
            let first = points[0];
            points.iter_mut().filter(|index| **index < first).for_each(|index| *index += self.measured.len());
        }
        let stretches = points.chunk_by(|&a, &b| self.bridgeable(a, b));
        (stretches.map(|stretch| (stretch[0], stretch[stretch.len() - 1])).collect(), false)
    }

    /// Whether two measured points, with none between them, belong to one curve.
    fn bridgeable(&self, a: usize, b: usize) -> bool {
        let (Some(from), Some(to)) = (self.at(a), self.at(b)) else { return false };
        let gap_px = self.arc(b) - self.arc(a);
        let noise = from.sigma_px.hypot(to.sigma_px);
        let change = (to.disparity_px - from.disparity_px).abs();
        if b == a + 1 {
            return change <= MAX_SLOPE * gap_px + 0.5 + 3.0 * noise;
        }
        let ill = (a + 1..b).filter(|&index| self.ill(index)).count();
        let reach_px = if 2 * ill > b - a - 1 { MAX_ILL_GAP_PX } else { MAX_GAP_PX };
        gap_px <= reach_px && change <= 0.5 * gap_px + 0.5 + 3.0 * noise
    }

    /// The curve between two measured points, continued over short tails.
    fn curve(&self, left_trace: usize, first: usize, last: usize, closed: bool) -> Option<MatchedCurve> {
        let count = (first..=last).filter(|&index| self.at(index).is_some()).count();
        let (first_out, last_out) = if self.trace.closed { (first, last) } else { self.with_tails(first, last) };
        if count < MIN_MEASURED || self.arc(last_out) - self.arc(first_out) < MIN_LENGTH_PX {
            return None;
        }
        let anchors = self.anchors(first, last, closed);
        let points = (first_out..=last_out).map(|index| self.point(index, &anchors)).collect();
        let end = |reached: bool, end: TraceEnd| if reached && !self.trace.closed { end } else { TraceEnd::Free };
        let ends = [end(first_out == 0, self.trace.ends[0]), end(last_out + 1 == self.count(), self.trace.ends[1])];
        Some(MatchedCurve { left_trace, points, closed, ends })
    }

    /// Extends a stretch of an open line to the line's own ends where they are near.
    fn with_tails(&self, first: usize, last: usize) -> (usize, usize) {
        let near = |from: usize, to: usize| {
            let length = self.arc(to) - self.arc(from);
            let ill = (from..=to).filter(|&index| self.ill(index)).count();
            length <= if 2 * ill > to - from { MAX_ILL_TAIL_PX } else { MAX_TAIL_PX }
        };
        let end = self.count() - 1;
        (if near(0, first) { 0 } else { first }, if near(last, end) { end } else { last })
    }

    /// The well-conditioned measured points of a stretch, or all measured ones if there are none.
    fn anchors(&self, first: usize, last: usize, closed: bool) -> Vec<usize> {
        let measured = || (first..=last).filter(|&index| self.at(index).is_some());
        let mut anchors: Vec<usize> = measured().filter(|&index| !self.ill(index)).collect();
        if anchors.is_empty() {
            anchors = measured().collect();
        }
        if closed {
            let next = anchors[0] + self.count();
            anchors.push(next);
        }
        anchors
    }

    /// A point of the curve: measured, or interpolated where that is surer or nothing was measured.
    fn point(&self, index: usize, anchors: &[usize]) -> MatchedPoint {
        let left = &self.trace.points[index % self.count()];
        let measured = self.at(index).map(|measured| (measured, self.sigma(index, &measured)));
        let ill = self.ill(index);
        let make = |disparity_px: f64, sigma_px: f64, flag: Flag, tangent_right: Option<Vector2>| MatchedPoint {
            left: left.position,
            tangent_left: left.tangent,
            tangent_right,
            disparity_px,
            sigma_px: sigma_px.min(self.spread_px),
            flag,
        };
        match measured {
            Some((measured, sigma)) if !ill => make(measured.disparity_px, sigma, Flag::Ok, measured.tangent_right),
            measured => {
                let (disparity, bridged_sigma) = self.interpolate(index, anchors);
                match measured {
                    Some((measured, sigma)) if sigma <= bridged_sigma => {
                        make(measured.disparity_px, sigma, Flag::IllConditioned, measured.tangent_right)
                    }
                    _ => make(disparity, bridged_sigma, Flag::Bridged, None),
                }
            }
        }
    }

    /// Disparity and sigma at a point from the anchors beside it: linear between two (error of a parabola of the prior
    /// curvature), constant beyond the last (error of the prior slope).
    fn interpolate(&self, index: usize, anchors: &[usize]) -> (f64, f64) {
        let value = |anchor: usize| {
            let measured = self.at(anchor).expect("anchors are measured");
            (measured.disparity_px, self.sigma(anchor, &measured))
        };
        let next = anchors.partition_point(|&anchor| anchor < index);
        let s = self.arc(index);
        match (next.checked_sub(1).map(|before| anchors[before]), anchors.get(next)) {
            (Some(before), Some(&after)) => {
                let (a, b) = (s - self.arc(before), self.arc(after) - s);
                let weight = if a + b > 0.0 { a / (a + b) } else { 0.5 };
                let ((d0, s0), (d1, s1)) = (value(before), value(after));
                let ends = s0 * (1.0 - weight) + s1 * weight;
                (d0 + (d1 - d0) * weight, ends.hypot(0.5 * CURVATURE_SIGMA * a * b))
            }
            (Some(anchor), None) | (None, Some(&anchor)) => {
                let (disparity, sigma) = value(anchor);
                (disparity, sigma.hypot(SLOPE_SIGMA * (s - self.arc(anchor)).abs()))
            }
            (None, None) => (0.0, self.spread_px),
        }
    }
}

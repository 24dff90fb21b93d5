//! Where a row cuts the traced lines of one image: the candidates of the classical matcher, to sub-pixel.

use crate::curve::Trace;
use crate::geometry::Vector2;

/// A trace end may be cut this far (px of its own length) beyond its last point: both views see a line end on the same
/// row only to within the error of tracing.
const END_TOLERANCE_PX: f64 = 0.75;

/// A row cutting a traced line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Crossing {
    /// Index of the trace.
    pub trace: usize,
    /// Arc length from the trace's first point, px.
    pub arc_px: f64,
    /// Where the row cuts it, px.
    pub x: f64,
    /// Unit tangent of the line there.
    pub tangent: Vector2,
    /// Line probability there.
    pub probability: f32,
    /// One sigma across the line, px.
    pub sigma_perp_px: f64,
}

/// Traced lines sorted by the rows they cut.
pub(crate) struct RowIndex<'a> {
    traces: &'a [Trace],
    /// Arc length of each point of each trace, px.
    arcs_px: Vec<Vec<f64>>,
    /// Total length of each trace, px (with the closing segment).
    lengths_px: Vec<f64>,
    /// For each integer row the segments (trace, index of its first point) that touch `[row, row + 1)`.
    rows: Vec<Vec<(u32, u32)>>,
    first_row: i64,
}

impl<'a> RowIndex<'a> {
    /// Sorts all segments by row.
    pub fn new(traces: &'a [Trace]) -> Self {
        let ys = || traces.iter().flat_map(|trace| trace.points.iter().map(|point| point.position.y));
        let first_row = ys().fold(f64::INFINITY, f64::min).floor().max(-1e6) as i64 - 1;
        let last_row = ys().fold(f64::NEG_INFINITY, f64::max).ceil().min(1e6) as i64 + 1;
        let mut rows = vec![Vec::new(); (last_row - first_row + 1).max(0) as usize];
        for (index, trace) in traces.iter().enumerate() {
            for segment in 0..segments(trace) {
                let (a, b) = segment_ends(trace, segment);
                let (low, high) = (a.y.min(b.y) - END_TOLERANCE_PX, a.y.max(b.y) + END_TOLERANCE_PX);
                for row in low.floor() as i64..=high.floor() as i64 {
                    if let Some(row) = usize::try_from(row - first_row).ok().and_then(|row| rows.get_mut(row)) {
                        row.push((index as u32, segment as u32));
                    }
                }
            }
        }
        let arcs_px = traces.iter().map(arc_lengths).collect();
        Self { traces, arcs_px, lengths_px: traces.iter().map(Trace::length_px).collect(), rows, first_row }
    }

    /// All crossings of row `y` with `x` in `[low, high]`, in the order of traces and along each.
    pub fn crossings(&self, y: f64, [low, high]: [f64; 2]) -> Vec<Crossing> {
        let mut found: Vec<Crossing> = Vec::new();
        let row = usize::try_from(y.floor() as i64 - self.first_row).ok().and_then(|row| self.rows.get(row));
        for &(index, segment) in row.into_iter().flatten() {
            let (index, segment) = (index as usize, segment as usize);
            let Some(crossing) = self.cut(index, segment, y, [low, high]) else { continue };
            let repeated = found.last().is_some_and(|last| {
                last.trace == index && arc_distance(last.arc_px, crossing.arc_px, self.loop_px(index)) < 1e-6
            });
            if !repeated {
                found.push(crossing);
            }
        }
        found
    }

    /// Distance along a trace between two arc lengths, px; the shorter way round a closed one.
    pub fn distance_px(&self, trace: usize, a: f64, b: f64) -> f64 {
        arc_distance(a, b, self.loop_px(trace))
    }

    /// The point of a trace nearest to an arc length.
    pub fn point_at(&self, trace: usize, arc_px: f64) -> usize {
        let arcs = &self.arcs_px[trace];
        let next = arcs.partition_point(|arc| *arc < arc_px).min(arcs.len() - 1);
        if next > 0 && arc_px - arcs[next - 1] < arcs[next] - arc_px { next - 1 } else { next }
    }

    fn loop_px(&self, trace: usize) -> Option<f64> {
        self.traces[trace].closed.then(|| self.lengths_px[trace])
    }

    fn cut(&self, index: usize, segment: usize, y: f64, [low, high]: [f64; 2]) -> Option<Crossing> {
        let trace = &self.traces[index];
        let (first, second) = (segment, (segment + 1) % trace.points.len());
        let (a, b) = (&trace.points[first], &trace.points[second]);
        let along = b.position - a.position;
        if along.y.abs() < 1e-9 {
            return None;
        }
        let t = (y - a.position.y) / along.y;
        let x = a.position.x + t * along.x;
        if !(low..=high).contains(&x) {
            return None;
        }
        let length = along.norm();
        let beyond = |end: bool| if end && !trace.closed { END_TOLERANCE_PX / length } else { 0.0 };
        let (before, after) = (beyond(segment == 0), beyond(segment + 2 == trace.points.len()));
        if t < -before - 1e-9 || t > 1.0 + after + 1e-9 {
            return None;
        }
        let inner = t.clamp(0.0, 1.0);
        // Traced tangents are smoother than the chord; the chord decides where they disagree by more than a right angle.
        let tangent = a.tangent * (1.0 - inner) + b.tangent * inner;
        let tangent = if tangent.norm() > 0.5 { tangent.normalize() } else { along / length };
        Some(Crossing {
            trace: index,
            arc_px: self.arcs_px[index][first] + t * length,
            x,
            tangent,
            probability: a.probability + (b.probability - a.probability) * inner as f32,
            sigma_perp_px: a.sigma_perp_px + (b.sigma_perp_px - a.sigma_perp_px) * inner,
        })
    }
}

/// Arc length of each point from the first, px.
pub(crate) fn arc_lengths(trace: &Trace) -> Vec<f64> {
    let mut arc = 0.0;
    let steps = trace.points.windows(2).map(|pair| {
        arc += (pair[1].position - pair[0].position).norm();
        arc
    });
    std::iter::once(0.0).chain(steps).collect()
}

fn arc_distance(a: f64, b: f64, loop_px: Option<f64>) -> f64 {
    let straight = (a - b).abs();
    loop_px.map_or(straight, |length| straight.min((length - straight).abs()))
}

fn segments(trace: &Trace) -> usize {
    if trace.closed { trace.points.len() } else { trace.points.len().saturating_sub(1) }
}

fn segment_ends(trace: &Trace, segment: usize) -> (crate::geometry::Point2, crate::geometry::Point2) {
    let next = (segment + 1) % trace.points.len();
    (trace.points[segment].position, trace.points[next].position)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point2;
    use crate::matching::known_traces::trace_through;
    use approx::assert_relative_eq;

    #[test]
    fn a_row_cuts_a_v_twice_and_a_vertex_once() {
        // Down the left limb from (0, 0) to (10, 20), up to (30, 0).
        let v = trace_through(&[Point2::new(0.0, 0.0), Point2::new(10.0, 20.0), Point2::new(30.0, 0.0)], false, 0.1);
        let traces = [v];
        let index = RowIndex::new(&traces);
        let cut = index.crossings(8.0, [-100.0, 100.0]);
        assert_eq!(cut.len(), 2);
        assert_relative_eq!(cut[0].x, 4.0, epsilon = 1e-9);
        assert_relative_eq!(cut[1].x, 22.0, epsilon = 1e-9);
        // Out of reach of the range, and of the line.
        assert_eq!(index.crossings(8.0, [5.0, 21.0]), []);
        assert_eq!(index.crossings(25.0, [-100.0, 100.0]), []);
        assert_eq!(index.crossings(0.0, [-1.0, 1.0]).len(), 1);
    }

    #[test]
    fn the_shorter_way_round_a_loop_counts() {
        let square = [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]].map(|[x, y]| Point2::new(x, y));
        let traces = [trace_through(&square, true, 0.1)];
        let index = RowIndex::new(&traces);
        assert_relative_eq!(index.distance_px(0, 1.0, 39.0), 2.0, epsilon = 1e-9);
        // The closing segment, from (0, 10) back to (0, 0), is cut too.
        assert_eq!(index.crossings(5.0, [-1.0, 11.0]).len(), 2);
    }
}

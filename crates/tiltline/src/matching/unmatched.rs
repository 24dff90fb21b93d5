//! Detected lines that found no match: reported, never dropped in silence and never given a depth.

use rstar::RTree;

use crate::curve::{MatchedCurve, TraceGraph, UnmatchedLine};
use crate::geometry::{Point2, length2};
use crate::micrograph::View;
use crate::rectify::Rectification;

/// A traced point this close to a matched one (px) is taken as matched.
const REACH_PX: f64 = 2.5;
/// Shortest unmatched stretch worth reporting, px.
const MIN_LENGTH_PX: f64 = 5.0;

/// Stretches of left and right traces that no matched curve covers, in the pixels of their own input file.
pub fn unmatched_lines(
    matched: &[MatchedCurve],
    traces: &[TraceGraph; 2],
    rectification: &Rectification,
) -> Vec<UnmatchedLine> {
    let mut lines = Vec::new();
    for view in View::BOTH {
        let covered = matched.iter().flat_map(|curve| &curve.points).map(|point| {
            let position = if view == View::Left { point.left } else { point.right() };
            [position.x, position.y]
        });
        let covered = RTree::bulk_load(covered.collect());
        let input_from_rectified = match view {
            View::Left => rectification.rectified_from_left.inverse(),
            View::Right => rectification.rectified_from_right.inverse(),
        };
        for trace in &traces[view.index()].traces {
            let free = |point: &Point2| {
                covered
                    .nearest_neighbor_iter_with_distance_2([point.x, point.y])
                    .next()
                    .is_none_or(|(_, d2)| d2 > REACH_PX * REACH_PX)
            };
            let points: Vec<Point2> = trace.points.iter().map(|point| point.position).collect();
            for stretch in points.split(|point| !free(point)) {
                if length2(stretch) >= MIN_LENGTH_PX {
                    let points_input = stretch.iter().map(|point| input_from_rectified * point).collect();
                    lines.push(UnmatchedLine { view, points_input });
                }
            }
        }
    }
    lines
}

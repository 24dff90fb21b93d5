//! The paper's refinement: each left point, warped by its disparity, snaps to the closest detected right point within
//! 3 px; points without one are removed ("Disparity Refinement"). All in rectified px.
//!
//! Nearest is meant in the image plane, so that the point found may lie on another row; the new disparity is the
//! difference of x.

use rstar::RTree;
use rstar::primitives::GeomWithData;

use super::sigma_of_left;
use crate::curve::{Flag, MatchedCurve, MatchedPoint, Trace, TraceEnd, TracePoint};
use crate::geometry::angle_to_row;
use crate::matching::sigma::{ill_conditioned, sigma_disparity_px};

/// Snaps all curves; a curve is split where points are removed.
pub(super) fn snap(
    matched: &[MatchedCurve],
    [left, right]: [&[Trace]; 2],
    sigma_row_px: f64,
    max_distance_px: f64,
) -> Vec<MatchedCurve> {
    let detected = right.iter().flat_map(|trace| &trace.points);
    let detected = RTree::bulk_load(
        detected.map(|point| GeomWithData::new([point.position.x, point.position.y], *point)).collect(),
    );
    let snap_point = |point: &MatchedPoint, left_trace: usize| {
        let warped = point.right();
        let (found, distance2) = detected.nearest_neighbor_iter_with_distance_2([warped.x, warped.y]).next()?;
        (distance2 <= max_distance_px * max_distance_px).then(|| {
            let sigma_left_px = sigma_of_left(point, left.get(left_trace));
            snapped(point, sigma_left_px, &found.data, sigma_row_px)
        })
    };
    let snap_curve = |curve: &MatchedCurve| -> Vec<Option<MatchedPoint>> {
        curve.points.iter().map(|point| snap_point(point, curve.left_trace)).collect()
    };
    matched.iter().flat_map(|curve| split(curve, &snap_curve(curve))).collect()
}

fn snapped(point: &MatchedPoint, sigma_left_px: f64, right: &TracePoint, sigma_row_px: f64) -> MatchedPoint {
    let crossing =
        sigma_disparity_px((&point.tangent_left, sigma_left_px), (&right.tangent, right.sigma_perp_px), sigma_row_px);
    // Snapping corrects the part of an error that lies across the right line, sin^2 psi of it; the rest stays.
    let left_over = point.sigma_px * angle_to_row(&right.tangent).cos().powi(2);
    let ill = ill_conditioned(&point.tangent_left) || ill_conditioned(&right.tangent);
    MatchedPoint {
        disparity_px: right.position.x - point.left.x,
        tangent_right: Some(right.tangent),
        sigma_px: crossing.hypot(left_over),
        flag: if ill { Flag::IllConditioned } else { Flag::Ok },
        ..*point
    }
}

/// The pieces of a curve between removed points; pieces of a single point are removed too.
fn split(curve: &MatchedCurve, points: &[Option<MatchedPoint>]) -> Vec<MatchedCurve> {
    let count = points.len();
    let Some(hole) = points.iter().position(Option::is_none) else {
        return vec![MatchedCurve { points: points.iter().flatten().copied().collect(), ..curve.clone() }];
    };
    // A closed curve with a hole is an open one that starts after it.
    let start = if curve.closed { hole } else { 0 };
    let order: Vec<usize> = (0..count).map(|index| (index + start) % count).collect();
    let pieces = order.split(|&index| points[index].is_none()).filter(|piece| piece.len() >= 2);
    pieces
        .map(|piece| {
            let end = |at: usize, wanted: usize, end: TraceEnd| {
                if !curve.closed && at == wanted { end } else { TraceEnd::Free }
            };
            MatchedCurve {
                left_trace: curve.left_trace,
                points: piece.iter().filter_map(|&index| points[index]).collect(),
                closed: false,
                ends: [end(piece[0], 0, curve.ends[0]), end(piece[piece.len() - 1], count - 1, curve.ends[1])],
            }
        })
        .collect()
}

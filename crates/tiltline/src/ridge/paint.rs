//! Draws judged chains as a line map: a sharp crest of known height on the sub-pixel centreline.
//!
//! The height at a point of significance z is `z^2 / (z^2 + z_half^2)`, times the trust that it is a line: 1/2 where z is the operating point, and still
//! telling strong lines from very strong ones. The crest has a Gaussian profile of fixed width, because what the next
//! stages need from it is the centreline; the width of the lines is told apart from it.

use ndarray::Array2;

use crate::geometry::{Point2, Vector2};
use crate::ridge::chains::Chain;
use crate::ridge::points::RidgePoint;

/// Standard deviation of the painted profile, px.
const PROFILE_SIGMA_PX: f64 = 1.3;
/// Crests lower than this are not painted.
const LOWEST: f64 = 0.02;

/// The line map of chains; `half_significance` is where it is 1/2.
pub(super) fn paint(
    shape: (usize, usize),
    points: &[RidgePoint],
    chains: &[Chain],
    half_significance: f64,
    line_width_px: f64,
) -> Array2<f32> {
    let heights: Vec<Vec<f64>> = chains
        .iter()
        .map(|chain| {
            let odds = chain.strengths().map(|strength| (strength / half_significance).powi(2));
            odds.zip(&chain.trust).map(|(odds, trust)| trust * odds / (1.0 + odds)).collect()
        })
        .collect();
    let mut map = Array2::zeros(shape);
    for (chain, heights) in chains.iter().zip(&heights) {
        let crest: Vec<(Point2, f64)> =
            chain.points.iter().zip(heights).map(|(index, height)| (points[*index].position, *height)).collect();
        for pair in crest.windows(2) {
            segment(&mut map, pair[0], pair[1]);
        }
        if let (true, Some(first), Some(last)) = (chain.closed, crest.first(), crest.last()) {
            segment(&mut map, *last, *first);
        }
    }
    for (from, to) in junction_gaps(points, chains, &heights, 2.0 * line_width_px + 2.0) {
        segment(&mut map, from, to);
    }
    map
}

/// Where lines meet at an angle the responses of the weaker one break off a line width before: its ends, and the point
/// of another chain that they run into within `reach_px`.
fn junction_gaps(
    points: &[RidgePoint],
    chains: &[Chain],
    heights: &[Vec<f64>],
    reach_px: f64,
) -> Vec<((Point2, f64), (Point2, f64))> {
    let cell = |point: &Point2| ((point.x / 8.0).floor() as i64, (point.y / 8.0).floor() as i64);
    let mut grid = std::collections::HashMap::<(i64, i64), Vec<(usize, usize)>>::new();
    for (chain_index, chain) in chains.iter().enumerate() {
        for (place, index) in chain.points.iter().enumerate() {
            if heights[chain_index][place] > 0.25 {
                grid.entry(cell(&points[*index].position)).or_default().push((chain_index, place));
            }
        }
    }
    let cells = (reach_px / 8.0).ceil() as i64;
    let mut gaps = Vec::new();
    for (chain_index, chain) in chains.iter().enumerate().filter(|(_, chain)| !chain.closed) {
        let last = chain.points.len() - 1;
        for (place, sense) in [(0, -1.0), (last, 1.0)] {
            let height = heights[chain_index][place];
            if height < 0.25 {
                continue;
            }
            let end = points[chain.points[place]].position;
            let outward: Vector2 = points[chain.points[place]].tangent * sense;
            let (column, row) = cell(&end);
            let near =
                (row - cells..=row + cells).flat_map(|row| (column - cells..=column + cells).map(move |c| (c, row)));
            let candidates = near.filter_map(|cell| grid.get(&cell)).flatten();
            let best = candidates
                .filter(|(other, _)| *other != chain_index)
                .filter_map(|&(other, place)| {
                    let target = points[chains[other].points[place]].position;
                    let between = target - end;
                    let distance = between.norm();
                    // Straight ahead within 35 degrees.
                    let ahead = between.dot(&outward) > 0.82 * distance;
                    (distance <= reach_px && distance > 1e-6 && ahead).then_some((distance, other, place, target))
                })
                .min_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
            if let Some((_, other, place, target)) = best {
                let height = height.min(heights[other][place]);
                gaps.push(((end, height), (target, height)));
            }
        }
    }
    gaps
}

/// Paints a segment whose height runs linearly between its ends; higher crests stay.
fn segment(map: &mut Array2<f32>, (a, height_a): (Point2, f64), (b, height_b): (Point2, f64)) {
    if height_a.max(height_b) < LOWEST {
        return;
    }
    let (rows, columns) = map.dim();
    let reach = 3.5 * PROFILE_SIGMA_PX;
    let range = |low: f64, high: f64, count: usize| {
        let (low, high) = ((low - reach).ceil().max(0.0), (high + reach).floor().min(count as f64 - 1.0));
        low as usize..if high < low { low as usize } else { high as usize + 1 }
    };
    let along = b - a;
    let length2 = along.norm_squared().max(1e-12);
    for row in range(a.y.min(b.y), a.y.max(b.y), rows) {
        for column in range(a.x.min(b.x), a.x.max(b.x), columns) {
            let offset = Point2::new(column as f64, row as f64) - a;
            let foot = (offset.dot(&along) / length2).clamp(0.0, 1.0);
            let distance2 = (offset - along * foot).norm_squared();
            if distance2 > reach * reach {
                continue;
            }
            let height = height_a + (height_b - height_a) * foot;
            let value = (height * (-0.5 * distance2 / (PROFILE_SIGMA_PX * PROFILE_SIGMA_PX)).exp()) as f32;
            let pixel = &mut map[[row, column]];
            *pixel = pixel.max(value);
        }
    }
}

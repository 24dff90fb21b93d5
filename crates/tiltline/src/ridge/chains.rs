//! Links ridge points to chains and judges each chain as a whole: long enough, a ridge and not a step, of the width of
//! a line, not a streak.
//!
//! Distances are in px of the rectified image; significances in standard deviations of the response's noise.

use std::collections::BTreeMap;

use ndarray::Array2;
use rayon::prelude::*;

use crate::geometry::{Point2, Vector2, length2};
use crate::ridge::points::RidgePoint;
use crate::ridge::scales::Scale;

/// Furthest neighbour on a chain, px.
const REACH_PX: f64 = 3.0;
/// Largest angle between the tangents of neighbours: cos 45 degrees, three steps of direction.
const LEAST_AGREEMENT: f64 = 0.70;
/// Half the number of points over which a chain's features are averaged.
const WINDOW: usize = 6;
/// Significance per length: a chain of this length counts as it is, a longer one for more, a shorter one for less.
const PLAIN_LENGTH_PX: f64 = 25.0;
/// Contrast of the weaker side in units of the stronger one below which a chain is the foot of a step, and above which
/// it is a full ridge.
const ONE_SIDED: [f64; 2] = [0.05, 0.3];
/// A straight chain within this angle of the scan direction is a streak, where streaks were found.
const STREAK_TOLERANCE_DEG: f64 = 1.2;

/// Points of one line in order, and what they say.
#[derive(Clone, Debug)]
pub(super) struct Chain {
    /// Indices of the ridge points.
    pub points: Vec<usize>,
    /// Whether the last point links to the first.
    pub closed: bool,
    /// Significance of the line at each point.
    pub significance: Vec<f64>,
    /// Trust that it is a line, from 0 (a step, a blob, a band, a streak) to 1, at each point.
    pub trust: Vec<f64>,
    /// Full width at half maximum, px.
    pub width_px: f64,
}

impl Chain {
    /// Significance less what is not trusted.
    pub fn strengths(&self) -> impl Iterator<Item = f64> + '_ {
        self.significance.iter().zip(&self.trust).map(|(significance, trust)| significance * trust)
    }
}

/// What chains are judged by.
pub(super) struct Judge<'a> {
    /// All scales, ascending; the last one or two are wider than any line.
    pub scales: &'a [Scale],
    /// +1 for dark lines, -1 for bright ones.
    pub sign: f32,
    /// Widest line, px FWHM.
    pub widest_px: f64,
    /// Significance at which a line is taken for one.
    pub half_significance: f64,
    /// Directions of streaks, radians.
    pub streaks_rad: &'a [f64],
}

/// Chains of linked points with their tangents turned along them.
pub(super) fn chains(points: &mut [RidgePoint], shape: (usize, usize), judge: &Judge<'_>) -> Vec<Chain> {
    let links = link(points, shape);
    let mut orders = merge(points, walk(&links));
    orders.retain(|(order, _)| order.len() >= 5 && judge.may_count(points, order));
    for order in &orders {
        orient(points, order);
        // Across the chain's own direction, on one scale, so that the crest does not jump.
        let scale = typical_scale(points, &order.0);
        for &index in &order.0 {
            points[index].refine(&judge.scales[scale]);
        }
        orient(points, order);
    }
    let points = &*points;
    let mut chains: Vec<Chain> = orders.into_par_iter().filter_map(|order| judge.assess(points, order)).collect();
    judge.drop_wide(&mut chains);
    chains
}

/// The best neighbour of each point ahead (`[1]`) and behind (`[0]`), where the choice is mutual.
fn link(points: &[RidgePoint], shape: (usize, usize)) -> Vec<[Option<usize>; 2]> {
    let mut at = Array2::from_elem(shape, u32::MAX);
    for (index, point) in points.iter().enumerate() {
        at[point.pixel] = index as u32;
    }
    let choice: Vec<[Option<usize>; 2]> = (0..points.len())
        .into_par_iter()
        .map(|index| [-1.0, 1.0].map(|sense| best(points, &at, index, sense)))
        .collect();
    let mutual = |from: usize, to: usize| choice[to].contains(&Some(from));
    choice
        .iter()
        .enumerate()
        .map(|(from, ends)| {
            let [back, ahead] = ends.map(|end| end.filter(|to| mutual(from, *to)));
            // One neighbour at both ends is a pair that points past each other: keep one link.
            if back == ahead { [None, ahead] } else { [back, ahead] }
        })
        .collect()
}

fn best(points: &[RidgePoint], at: &Array2<u32>, index: usize, sense: f64) -> Option<usize> {
    let (height, width) = at.dim();
    let point = &points[index];
    let [row, column] = point.pixel;
    let mut best: Option<(f64, usize)> = None;
    for row in row.saturating_sub(3)..(row + 4).min(height) {
        for column in column.saturating_sub(3)..(column + 4).min(width) {
            let other = at[[row, column]];
            if other == u32::MAX || other as usize == index {
                continue;
            }
            let other = other as usize;
            let between = points[other].position - point.position;
            let distance = between.norm();
            let along = sense * between.dot(&point.tangent);
            let across = (distance * distance - along * along).max(0.0).sqrt();
            let agreement = point.tangent.dot(&points[other].tangent).abs();
            if distance > REACH_PX || along < 0.25 || across > 0.35 + 0.6 * along || agreement < LEAST_AGREEMENT {
                continue;
            }
            let cost = distance + 1.5 * across + 2.0 * (1.0 - agreement);
            if best.is_none_or(|(least, _)| cost < least) {
                best = Some((cost, other));
            }
        }
    }
    best.map(|(_, other)| other)
}

/// Sequences of linked points; `true` for loops. Each point is in one sequence.
fn walk(links: &[[Option<usize>; 2]]) -> Vec<(Vec<usize>, bool)> {
    let mut seen = vec![false; links.len()];
    let mut sequences = Vec::new();
    let follow = |start: usize, seen: &mut Vec<bool>| {
        let mut sequence = vec![start];
        seen[start] = true;
        let mut here = start;
        while let Some(next) = links[here].iter().flatten().copied().find(|next| !seen[*next]) {
            seen[next] = true;
            sequence.push(next);
            here = next;
        }
        let closed = sequence.len() > 8 && links[here].contains(&Some(start));
        (sequence, closed)
    };
    for start in 0..links.len() {
        if !seen[start] && links[start].iter().flatten().count() < 2 {
            sequences.push(follow(start, &mut seen));
        }
    }
    for start in 0..links.len() {
        if !seen[start] {
            sequences.push(follow(start, &mut seen));
        }
    }
    sequences
}

/// Joins sequences whose ends meet: where the strongest direction or scale changes, neighbours may choose past each
/// other.
fn merge(points: &[RidgePoint], mut sequences: Vec<(Vec<usize>, bool)>) -> Vec<(Vec<usize>, bool)> {
    const CELL_PX: f64 = 5.0;
    /// Where a sequence ends and its outward direction there.
    struct Tip {
        sequence: usize,
        end: usize,
        position: Point2,
        outward: Vector2,
    }
    let cell = |point: &Point2| ((point.x / CELL_PX).floor() as i64, (point.y / CELL_PX).floor() as i64);
    let mut tips = Vec::new();
    for (index, (sequence, closed)) in sequences.iter().enumerate() {
        if *closed || sequence.len() < 3 {
            continue;
        }
        let last = sequence.len() - 1;
        for (end, tip, inner) in [(0, 0, 5.min(last)), (1, last, last.saturating_sub(5))] {
            let position = points[sequence[tip]].position;
            let outward = (position - points[sequence[inner]].position).try_normalize(1e-9);
            tips.push(Tip { sequence: index, end, position, outward: outward.unwrap_or_else(Vector2::x) });
        }
    }
    let mut grid = BTreeMap::<(i64, i64), Vec<usize>>::new();
    for (index, tip) in tips.iter().enumerate() {
        grid.entry(cell(&tip.position)).or_default().push(index);
    }
    let mut pairs = Vec::new();
    for (index, tip) in tips.iter().enumerate() {
        let (column, row) = cell(&tip.position);
        let near = (column - 1..=column + 1).flat_map(|c| (row - 1..=row + 1).map(move |r| (c, r)));
        for &other_index in near.filter_map(|cell| grid.get(&cell)).flatten().filter(|other| **other > index) {
            let other = &tips[other_index];
            let gap = other.position - tip.position;
            let facing = -tip.outward.dot(&other.outward);
            let aside = tip.outward.perp(&gap).abs().max(other.outward.perp(&gap).abs());
            // They may overlap by a point or two.
            let ahead = tip.outward.dot(&gap);
            if other.sequence != tip.sequence && facing > LEAST_AGREEMENT && aside < 1.8 && (-3.0..4.5).contains(&ahead)
            {
                pairs.push((gap.norm() + aside + 3.0 * (1.0 - facing), index, other_index));
            }
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut taken = vec![false; tips.len()];
    // Which sequence a tip belongs to now and at which of its ends it is; and the tips at the two ends of each.
    let mut home: Vec<(usize, usize)> = tips.iter().map(|tip| (tip.sequence, tip.end)).collect();
    let mut tips_of = vec![[usize::MAX; 2]; sequences.len()];
    for (index, tip) in tips.iter().enumerate() {
        tips_of[tip.sequence][tip.end] = index;
    }
    for (_, a, b) in pairs {
        let ((first, first_end), (second, second_end)) = (home[a], home[b]);
        if taken[a] || taken[b] || first == second {
            continue;
        }
        (taken[a], taken[b]) = (true, true);
        let mut head = std::mem::take(&mut sequences[first].0);
        let mut tail = std::mem::take(&mut sequences[second].0);
        if first_end == 0 {
            head.reverse();
        }
        if second_end == 1 {
            tail.reverse();
        }
        // Points of an overlap would lead back: the tail starts beyond the head.
        let (end, outward) = (tips[a].position, tips[a].outward);
        let beyond = |index: &usize| (points[*index].position - end).dot(&outward) > 0.3;
        let skip = tail.iter().take(4).take_while(|index| !beyond(index)).count();
        head.extend(tail.into_iter().skip(skip));
        sequences[first].0 = head;
        tips_of[first] = [tips_of[first][1 - first_end], tips_of[second][1 - second_end]];
        for (end, tip) in tips_of[first].into_iter().enumerate() {
            home[tip] = (first, end);
        }
    }
    sequences.retain(|(sequence, _)| !sequence.is_empty());
    sequences
}

/// Sets tangents to the direction of the chain, which is finer than the 15 degrees of the kernels.
fn orient(points: &mut [RidgePoint], (order, _): &(Vec<usize>, bool)) {
    let positions: Vec<Point2> = order.iter().map(|index| points[*index].position).collect();
    for (place, &index) in order.iter().enumerate() {
        let (before, after) = (place.saturating_sub(3), (place + 3).min(order.len() - 1));
        if let Some(along) = (positions[after] - positions[before]).try_normalize(1e-9) {
            points[index].tangent = along;
        }
    }
}

impl Judge<'_> {
    /// Whether a chain could come to half the significance of the operating point: most chains are noise.
    fn may_count(&self, points: &[RidgePoint], order: &[usize]) -> bool {
        let significance: Vec<f64> = order.iter().map(|index| f64::from(points[*index].significance)).collect();
        let best = running_mean(&significance, WINDOW).into_iter().fold(0.0, f64::max);
        best * weight_of_length(1.2 * order.len() as f64) > 0.45 * self.half_significance
    }

    /// Features and strength of a chain, without ends that do not belong to it; none for a chain that is too short.
    fn assess(&self, points: &[RidgePoint], (order, closed): (Vec<usize>, bool)) -> Option<Chain> {
        let scale_of = typical_scale(points, &order);
        let sides: Vec<[f64; 2]> = order.iter().map(|index| self.side_contrasts(&points[*index], scale_of)).collect();
        let left = running_mean(&sides.iter().map(|side| side[0]).collect::<Vec<_>>(), WINDOW);
        let right = running_mean(&sides.iter().map(|side| side[1]).collect::<Vec<_>>(), WINDOW);
        let local = |index: &usize| self.local_response(&points[*index], scale_of);
        let local = running_median(&order.iter().map(local).collect::<Vec<_>>(), WINDOW / 2);
        // The elongated kernels see a line before it begins: ends without contrast of their own are cut.
        let (first, last) = if closed { (0, order.len() - 1) } else { trimmed(&local) };
        if last < first + 4 {
            return None;
        }
        let span = first..=last;
        let positions: Vec<Point2> = order[span.clone()].iter().map(|index| points[*index].position).collect();
        let length_px = length2(&smooth(&positions));
        let width_px = self.width_px(points, &order[span.clone()]);
        let elongation = length_px / width_px;
        // Blobs come out as chains about twice as long as wide.
        let doubt_of_blob = ramp(elongation, 2.0, 4.0);
        let by_length = weight_of_length(length_px);
        let by_width = 1.0 - ramp(width_px, self.widest_px, 1.3 * self.widest_px);
        let by_streak = self.trust_beside_streaks(&positions);
        // A strong spot reaches far along the elongated kernels: what counts is what most of the places there support.
        let supported = |(index, local): (&usize, &f64)| {
            let point = &points[*index];
            f64::from(point.significance) * (local / f64::from(point.response).max(1e-12)).clamp(0.0, 1.0)
        };
        let alone: Vec<f64> =
            order.iter().map(|index| self.local_response(&points[*index], points[*index].scale)).collect();
        let significance: Vec<f64> = order.iter().zip(&running_median(&alone, WINDOW)).map(supported).collect();
        let sides = left[span.clone()].iter().zip(&right[span.clone()]);
        let trust = sides.zip(&by_streak).map(|((left, right), by_streak)| {
            let two_sided = ramp(left.min(*right) / left.max(*right).max(1e-9), ONE_SIDED[0], ONE_SIDED[1]);
            two_sided * doubt_of_blob * by_width * by_streak
        });
        let trust = trust.collect();
        let significance = running_mean(&significance, WINDOW)[span.clone()].iter().map(|z| z * by_length).collect();
        Some(Chain { points: order[span].to_vec(), closed, significance, trust, width_px })
    }

    /// Response of a scale at a point alone, without the elongated kernel.
    fn local_response(&self, point: &RidgePoint, scale: usize) -> f64 {
        let scale = &self.scales[scale];
        let [left, centre, right] = scale.across(point.position, point.across(), scale.spacing());
        f64::from(self.sign * (left + right - 2.0 * centre)) * scale.sigma_on_grid().powi(2)
    }

    /// By how much the line stands out against its left and its right side (positive for the wanted polarity).
    fn side_contrasts(&self, point: &RidgePoint, scale: usize) -> [f64; 2] {
        let scale = &self.scales[scale];
        let across = point.across();
        let mut contrasts = [0.0; 2];
        for along in [-1.0, 0.0, 1.0] {
            let here = point.position + point.tangent * (along * scale.sigma_px);
            // A neighbouring line may hide the farther flank, but not the foot of a step.
            let [far, near] = [2.2, 1.4].map(|reach| scale.across(here, across, reach * scale.sigma_px));
            contrasts[0] += f64::from((self.sign * (far[0] - far[1])).max(self.sign * (near[0] - near[1]))) / 3.0;
            contrasts[1] += f64::from((self.sign * (far[2] - far[1])).max(self.sign * (near[2] - near[1]))) / 3.0;
        }
        contrasts
    }

    /// Width from the scale at which the second derivative, times sigma^(3/2), is largest: that is the line's own
    /// sigma (Lindeberg, IJCV 1998, gamma = 3/4).
    fn width_px(&self, points: &[RidgePoint], order: &[usize]) -> f64 {
        let stride = (order.len() / 60).max(1);
        let strengths: Vec<f64> = self
            .scales
            .iter()
            .map(|scale| {
                // A difference over one sigma each way instead of the derivative adds about sigma^2 / 6 to the variance.
                let sum: f64 = order
                    .iter()
                    .step_by(stride)
                    .map(|&index| {
                        let point = &points[index];
                        let [left, centre, right] = scale.across(point.position, point.across(), scale.sigma_px);
                        f64::from(self.sign * (left + right - 2.0 * centre))
                    })
                    .sum();
                sum / scale.sigma_px.sqrt()
            })
            .collect();
        let best = (0..strengths.len()).max_by(|a, b| strengths[*a].total_cmp(&strengths[*b])).unwrap_or(0);
        let log = |index: usize| self.scales[index].sigma_px.ln();
        let mut log_sigma = log(best);
        if best > 0 && best + 1 < strengths.len() {
            let (x, y) = ([log(best - 1), log(best), log(best + 1)], &strengths[best - 1..=best + 1]);
            let (fall, rise) = ((y[1] - y[0]) / (x[1] - x[0]), (y[2] - y[1]) / (x[2] - x[1]));
            if fall > rise {
                let middle = [0.5 * (x[0] + x[1]), 0.5 * (x[1] + x[2])];
                log_sigma = middle[0] + (middle[1] - middle[0]) * fall / (fall - rise);
            }
        }
        log_sigma.exp() * (8.0 * 2.0_f64.ln()).sqrt()
    }

    /// 0 at points on a streak, 1 elsewhere: on a chain that is one as a whole, or a straight stretch that runs along a
    /// direction in which streaks were found.
    fn trust_beside_streaks(&self, positions: &[Point2]) -> Vec<f64> {
        const HALF_STRETCH: usize = 25;
        if self.streaks_rad.is_empty() {
            return vec![1.0; positions.len()];
        }
        if self.is_streak(positions, 1.2) {
            return vec![0.0; positions.len()];
        }
        let mut trust = vec![1.0; positions.len()];
        for first in 0..positions.len().saturating_sub(2 * HALF_STRETCH) {
            let stretch = first..=first + 2 * HALF_STRETCH;
            // Bowed lines are level for a while too: over 50 px they leave the chord by more than this.
            if self.is_streak(&positions[stretch.clone()], 0.5) {
                trust[stretch].fill(0.0);
            }
        }
        trust
    }

    /// Whether points are straight to within `rms_px` and run along a direction in which streaks were found.
    fn is_streak(&self, positions: &[Point2], rms_px: f64) -> bool {
        let (Some(first), Some(last)) = (positions.first(), positions.last()) else { return false };
        let chord = last - first;
        let Some(along) = chord.try_normalize(1e-9) else { return false };
        let squares: f64 = positions.iter().map(|point| along.perp(&(point - first)).powi(2)).sum();
        self.streaks_rad.iter().any(|streak| {
            let off = (along.x * streak.sin() - along.y * streak.cos()).abs().min(1.0).asin();
            // Short pieces have less certain directions: half a px at each end.
            off < STREAK_TOLERANCE_DEG.to_radians() + 0.7 / chord.norm().max(1.0)
                && squares < rms_px * rms_px * positions.len() as f64
        })
    }

    /// Weakens chains much wider than the image's typical line: lamella boundaries among dislocations.
    fn drop_wide(&self, chains: &mut [Chain]) {
        let Some(typical) = typical_width_px(chains) else { return };
        for chain in chains {
            let doubt = 1.0 - ramp(chain.width_px, 2.2 * typical + 1.0, 3.0 * typical + 1.0);
            chain.trust.iter_mut().for_each(|trust| *trust *= doubt);
        }
    }
}

/// Width of the typical line: the median over chains weighted by length and significance.
pub(super) fn typical_width_px(chains: &[Chain]) -> Option<f64> {
    let mut widths: Vec<(f64, f64)> = chains
        .iter()
        .map(|chain| {
            let weight: f64 = chain.strengths().filter(|strength| *strength > 6.0).map(|s| s.min(30.0)).sum();
            (chain.width_px, weight)
        })
        .filter(|(_, weight)| *weight > 0.0)
        .collect();
    widths.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * widths.iter().map(|width| width.1).sum::<f64>();
    let mut sum = 0.0;
    widths
        .iter()
        .find(|width| {
            sum += width.1;
            sum >= half
        })
        .map(|width| width.0)
}

fn typical_scale(points: &[RidgePoint], order: &[usize]) -> usize {
    let mut scales: Vec<usize> = order.iter().map(|index| points[*index].scale).collect();
    scales.sort_unstable();
    scales[scales.len() / 2]
}

/// What the significance of a chain counts for.
fn weight_of_length(length_px: f64) -> f64 {
    (length_px / PLAIN_LENGTH_PX).sqrt().clamp(0.5, 1.3)
}

/// First and last place of a chain without the ends whose contrast is small beside that of the whole chain or of the
/// points further in.
fn trimmed(contrast: &[f64]) -> (usize, usize) {
    let count = contrast.len();
    let mut sorted = contrast.to_vec();
    sorted.sort_by(f64::total_cmp);
    // Of a short chain across a blob most points may be its tails: the peak counts too.
    let least = (0.4 * sorted[count / 2]).max(0.15 * sorted[count - 1]);
    let belongs = |place: usize, inward: &dyn Fn(usize) -> usize| {
        let further = (4..=14).map(|step| contrast[inward(step)]).sum::<f64>() / 11.0;
        contrast[place] > least.max(0.55 * further)
    };
    let first = (0..count).find(|&place| belongs(place, &|step| (place + step).min(count - 1)));
    let last = (0..count).rfind(|&place| belongs(place, &|step| place.saturating_sub(step)));
    (first.unwrap_or(count), last.unwrap_or(0))
}

/// 0 below `low`, 1 above `high`, linear between.
fn ramp(value: f64, low: f64, high: f64) -> f64 {
    ((value - low) / (high - low)).clamp(0.0, 1.0)
}

/// Means over up to `2 half + 1` neighbours.
fn running_mean(values: &[f64], half: usize) -> Vec<f64> {
    (0..values.len())
        .map(|index| {
            let near = &values[index.saturating_sub(half)..(index + half + 1).min(values.len())];
            near.iter().sum::<f64>() / near.len() as f64
        })
        .collect()
}

/// Medians over up to `2 half + 1` neighbours.
fn running_median(values: &[f64], half: usize) -> Vec<f64> {
    let mut near = Vec::with_capacity(2 * half + 1);
    (0..values.len())
        .map(|index| {
            near.clear();
            near.extend_from_slice(&values[index.saturating_sub(half)..(index + half + 1).min(values.len())]);
            near.sort_by(f64::total_cmp);
            near[near.len() / 2]
        })
        .collect()
}

fn smooth(points: &[Point2]) -> Vec<Point2> {
    let mean = |pick: fn(&Point2) -> f64| running_mean(&points.iter().map(pick).collect::<Vec<_>>(), 2);
    mean(|point| point.x).into_iter().zip(mean(|point| point.y)).map(|(x, y)| Point2::new(x, y)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(x: f64, y: f64, tangent: (f64, f64)) -> RidgePoint {
        RidgePoint {
            pixel: [y.round() as usize, x.round() as usize],
            position: Point2::new(x, y),
            tangent: Vector2::new(tangent.0, tangent.1),
            significance: 10.0,
            response: 0.1,
            scale: 0,
        }
    }

    #[test]
    fn points_of_a_line_make_one_chain_in_order_and_a_crossing_line_another() {
        let mut points: Vec<RidgePoint> = (5..40).rev().map(|x| point(f64::from(x), 20.2, (1.0, 0.0))).collect();
        points.extend((5..40).filter(|y| *y != 20).map(|y| point(17.6, f64::from(y), (0.0, -1.0))));
        let sequences = walk(&link(&points, (50, 50)));
        let mut lengths: Vec<usize> = sequences.iter().map(|(sequence, _)| sequence.len()).collect();
        lengths.sort_unstable();
        assert_eq!(lengths, [34, 35]);
        for (sequence, closed) in sequences {
            assert!(!closed);
            let steps = sequence.windows(2).map(|pair| (points[pair[1]].position - points[pair[0]].position).norm());
            assert!(steps.into_iter().all(|step| step < 2.1));
        }
    }

    #[test]
    fn points_of_a_circle_close() {
        let points: Vec<RidgePoint> = (0..100)
            .map(|step| {
                let (sin, cos) = (f64::from(step) / 100.0 * std::f64::consts::TAU).sin_cos();
                point(30.0 + 20.0 * cos, 30.0 + 20.0 * sin, (-sin, cos))
            })
            .collect();
        let sequences = walk(&link(&points, (60, 60)));
        assert!(sequences.iter().any(|(sequence, closed)| *closed && sequence.len() > 70));
    }
}

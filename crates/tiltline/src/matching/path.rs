//! Dynamic programming along a line: the cheapest choice of a candidate, or of none, for every point.
//!
//! The state of a point is one of its candidates or "unmatched". Steps may leap over a few points without a good
//! candidate, which keeps the disparity before and after a gap tied together. There is no ordering constraint between lines.
//! Costs are per px of arc length; an unmatched px costs 1.

use super::candidates::{Candidate, line_angle};
use super::crossings::RowIndex;

/// Cost per px without a match, where the line is well and where it is ill conditioned (such a stretch says little).
const UNMATCHED_COST: f64 = 1.0;
const UNMATCHED_ILL_COST: f64 = 0.35;
/// Cost per px leapt over.
const GAP_COST: f64 = 0.7;
const GAP_ILL_COST: f64 = 0.1;
/// Cost of a leap as such.
const LEAP_COST: f64 = 0.5;
/// Cost of passing between matched and unmatched.
const PASSAGE_COST: f64 = 2.0;
/// Cost of passing to another traced line in the same direction (a tracer's gap), and more for a turn: where two lines
/// cross, passing from one to the other makes a kink that the left line does not have.
const SWITCH_COST: f64 = 1.5;
const TURN_COST: f64 = 8.0;
/// Turn at which half of that is paid (15 degrees).
const TURN_SCALE_RAD: f64 = 0.26;
/// Cost of passing between a traced line and a mere likeness, or between two likenesses.
const TRACED_TO_UNTRACED_COST: f64 = 1.0;
/// Cost per px of change of disparity.
const SLOPE_COST: f64 = 0.5;
/// Steepest change of disparity, px per px of arc length: at 8 degrees of tilt, a line inclined by 82 degrees.
pub(crate) const MAX_SLOPE: f64 = 1.0;
/// Longest leap in px; ill-conditioned px count a third.
const MAX_LEAP_PX: f64 = 20.0;

/// A point of the line as the path search sees it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Step<'a> {
    /// Its candidates.
    pub candidates: &'a [Candidate],
    /// Extra cost per px of each candidate (empty: none).
    pub surcharge: &'a [f32],
    /// Arc length from the previous point, px.
    pub step_px: f64,
    /// Whether the line runs along the row here.
    pub ill: bool,
}

#[derive(Clone, Copy)]
enum Back {
    Start,
    Unmatched,
    Candidate { point: usize, index: usize },
}

/// The index of the chosen candidate of each point.
pub(crate) fn cheapest_path(steps: &[Step<'_>], there: &RowIndex<'_>) -> Vec<Option<usize>> {
    let mut costs: Vec<Vec<f64>> = Vec::with_capacity(steps.len());
    let mut backs: Vec<Vec<Back>> = Vec::with_capacity(steps.len());
    let mut unmatched: Vec<(f64, Back)> = Vec::with_capacity(steps.len());
    // The cheapest candidate of each point spares most of the leaps.
    let mut least: Vec<f64> = Vec::with_capacity(steps.len());
    for (point, step) in steps.iter().enumerate() {
        // A point stands for half a step on either side.
        let weight = 0.5 * (step.step_px + steps.get(point + 1).map_or(step.step_px, |next| next.step_px));
        let weight = if point == 0 { steps.get(1).map_or(1.0, |next| next.step_px) } else { weight };
        let mut cost = Vec::with_capacity(step.candidates.len());
        let mut back = Vec::with_capacity(step.candidates.len());
        for (index, candidate) in step.candidates.iter().enumerate() {
            let surcharge = step.surcharge.get(index).copied().unwrap_or(0.0);
            let own = weight * f64::from(candidate.cost + surcharge);
            let (arrival, from) = arrive(candidate, point, steps, there, &costs, &least, &unmatched);
            cost.push(own + arrival);
            back.push(from);
        }
        let own = weight * if step.ill { UNMATCHED_ILL_COST } else { UNMATCHED_COST };
        let (arrival, from) = match point.checked_sub(1) {
            None => (0.0, Back::Start),
            Some(previous) => {
                cheapest(&costs[previous]).map_or((unmatched[previous].0, Back::Unmatched), |(index, cost)| {
                    if cost + PASSAGE_COST < unmatched[previous].0 {
                        (cost + PASSAGE_COST, Back::Candidate { point: previous, index })
                    } else {
                        (unmatched[previous].0, Back::Unmatched)
                    }
                })
            }
        };
        unmatched.push((own + arrival, from));
        least.push(cheapest(&cost).map_or(f64::INFINITY, |(_, cost)| cost));
        costs.push(cost);
        backs.push(back);
    }
    backtrack(&costs, &backs, &unmatched)
}

/// The cheapest way to arrive at a candidate of `point`.
fn arrive(
    candidate: &Candidate,
    point: usize,
    steps: &[Step<'_>],
    there: &RowIndex<'_>,
    costs: &[Vec<f64>],
    least: &[f64],
    unmatched: &[(f64, Back)],
) -> (f64, Back) {
    let Some(previous) = point.checked_sub(1) else { return (0.0, Back::Start) };
    let mut best = (unmatched[previous].0 + PASSAGE_COST, Back::Unmatched);
    let (mut leap_px, mut gap_cost, mut distance_px) = (0.0, 0.0, 0.0);
    for origin in (0..point).rev() {
        distance_px += steps[origin + 1].step_px;
        if least[origin] + gap_cost < best.0 {
            for (index, (from, cost)) in steps[origin].candidates.iter().zip(&costs[origin]).enumerate() {
                if cost + gap_cost < best.0 {
                    let total = cost + gap_cost + transition(from, candidate, distance_px, there);
                    if total < best.0 {
                        best = (total, Back::Candidate { point: origin, index });
                    }
                }
            }
        }
        let (step, ill) = (steps[origin].step_px, steps[origin].ill);
        leap_px += if ill { step / 3.0 } else { step };
        if leap_px > MAX_LEAP_PX {
            break;
        }
        gap_cost +=
            step * if ill { GAP_ILL_COST } else { GAP_COST } + if origin + 1 == point { LEAP_COST } else { 0.0 };
    }
    best
}

/// Cost of passing from one candidate to the next, `distance_px` further along; infinite for a jump in depth.
fn transition(from: &Candidate, to: &Candidate, distance_px: f64, there: &RowIndex<'_>) -> f64 {
    let noise = from.sigma_px.hypot(to.sigma_px);
    let change = ((to.disparity_px - from.disparity_px).abs() - noise).max(0.0);
    if change > MAX_SLOPE * distance_px + 0.5 {
        return f64::INFINITY;
    }
    let switch = match (from.on, to.on) {
        (Some((a, from_arc)), Some((b, to_arc))) => {
            let follows = a == b && there.distance_px(a, from_arc, to_arc) <= 2.5 * distance_px + 2.0 * noise + 2.0;
            if follows { 0.0 } else { SWITCH_COST + turn_cost(from, to) }
        }
        (None, None) => 0.5 * change,
        _ => TRACED_TO_UNTRACED_COST,
    };
    SLOPE_COST * change + switch
}

/// Cost of the angle between the directions of two traced candidates.
fn turn_cost(from: &Candidate, to: &Candidate) -> f64 {
    let (Some(a), Some(b)) = (from.tangent, to.tangent) else { return 0.0 };
    let turn = line_angle(&a, &b) / TURN_SCALE_RAD;
    TURN_COST * turn * turn / (1.0 + turn * turn)
}

fn cheapest(costs: &[f64]) -> Option<(usize, f64)> {
    costs.iter().copied().enumerate().min_by(|a, b| a.1.total_cmp(&b.1))
}

fn backtrack(costs: &[Vec<f64>], backs: &[Vec<Back>], unmatched: &[(f64, Back)]) -> Vec<Option<usize>> {
    let mut path = vec![None; costs.len()];
    let Some(last) = costs.len().checked_sub(1) else { return path };
    let (mut point, mut state) = match cheapest(&costs[last]) {
        Some((index, cost)) if cost < unmatched[last].0 => (last, Some(index)),
        _ => (last, None),
    };
    loop {
        path[point] = state;
        let back = state.map_or(unmatched[point].1, |index| backs[point][index]);
        (point, state) = match back {
            Back::Start => return path,
            Back::Unmatched => (point - 1, None),
            Back::Candidate { point, index } => (point, Some(index)),
        };
    }
}

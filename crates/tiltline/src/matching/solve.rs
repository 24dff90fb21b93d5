//! The matcher as a whole: both directions, rounds of agreement between them, and the final check.

use rayon::prelude::*;

use super::assemble::{Measured, assemble};
use super::candidates::{Candidates, Side};
use super::crossings::RowIndex;
use super::path::{Step, cheapest_path};
use super::sigma::ill_conditioned;
use crate::curve::{LineMap, MatchedCurve, Trace, TraceGraph};
use crate::rectify::RectifiedPair;

/// Rounds after the first in which each direction yields to the other.
const ROUNDS: usize = 3;
/// Extra cost per px of a candidate that the other direction gave to another line.
const CONTRADICTION_COST: f32 = 0.6;
/// The other direction agrees if it comes back within this distance along the line, px.
const RETURN_PX: f64 = 4.0;
/// A contradicted stretch longer than this is dropped, px; a shorter one with agreement on both sides is where two lines
/// lie over each other and only one of them can be given back.
const MAX_CONTRADICTED_PX: f64 = 40.0;

/// One direction of matching: lines of one view and their candidates in the other.
struct Direction<'a> {
    here: Side<'a>,
    there: Side<'a>,
    traces: &'a [Trace],
    range_px: [f64; 2],
    candidates: Vec<Candidates>,
    ill: Vec<Vec<bool>>,
}

/// The cheapest path of one line, and the extra costs it was found with.
#[derive(Clone, PartialEq)]
struct Solved {
    /// The chosen candidate of each point.
    path: Vec<Option<usize>>,
    /// Extra cost of each candidate of each point.
    surcharges: Vec<Vec<f32>>,
}

impl<'a> Direction<'a> {
    fn new(here: Side<'a>, there: Side<'a>, range_px: [f64; 2]) -> Self {
        let traces = here.traces;
        let candidates = traces.par_iter().map(|trace| Candidates::on_traces(trace, here, there, range_px)).collect();
        let ill = |trace: &Trace| trace.points.iter().map(|point| ill_conditioned(&point.tangent)).collect();
        Self { here, there, traces, range_px, candidates, ill: traces.iter().map(ill).collect() }
    }

    /// Adds mere likenesses where lines found no traced partner.
    fn look_for_untraced(&mut self, solved: &[Solved]) {
        let (here, there, range_px) = (self.here, self.there, self.range_px);
        let lines = self.candidates.par_iter_mut().zip(self.traces).zip(solved);
        lines.for_each(|((candidates, trace), solved)| {
            let wanted: Vec<bool> = solved.path.iter().map(Option::is_none).collect();
            candidates.add_likenesses(trace, here, there, range_px, &wanted);
        });
    }

    /// The cheapest path of every line; `surcharge` gives the extra cost of a candidate. A line whose costs are as they
    /// were in `before` keeps its path.
    fn paths(&self, before: &[Solved], surcharge: impl Fn(usize, usize, usize) -> f32 + Sync) -> Vec<Solved> {
        let solve = |line: usize| {
            let surcharges: Vec<Vec<f32>> = self.candidates[line]
                .at
                .iter()
                .enumerate()
                .map(|(point, list)| (0..list.len()).map(|index| surcharge(line, point, index)).collect())
                .collect();
            match before.get(line) {
                Some(before) if before.surcharges == surcharges => before.clone(),
                _ => Solved { path: self.path(line, &surcharges), surcharges },
            }
        };
        (0..self.traces.len()).into_par_iter().map(solve).collect()
    }

    fn path(&self, line: usize, surcharges: &[Vec<f32>]) -> Vec<Option<usize>> {
        let (candidates, trace) = (&self.candidates[line], &self.traces[line]);
        let count = trace.points.len();
        // A closed line is run round twice and the middle kept, so that where it starts does not matter.
        let rounds = if trace.closed { 2 } else { 1 };
        let closing_px = trace.length_px() - candidates.arc_px[count - 1];
        let steps: Vec<Step<'_>> = (0..rounds * count)
            .map(|unrolled| {
                let point = unrolled % count;
                let step_px =
                    if point > 0 { candidates.arc_px[point] - candidates.arc_px[point - 1] } else { closing_px };
                Step {
                    candidates: &candidates.at[point],
                    surcharge: &surcharges[point],
                    step_px,
                    ill: self.ill[line][point],
                }
            })
            .collect();
        let path = cheapest_path(&steps, self.there.index);
        if trace.closed {
            let start = count / 2;
            let mut middle = path[start..start + count].to_vec();
            middle.rotate_right(start);
            middle
        } else {
            path
        }
    }

    /// Where a candidate leads: the line of the other view and the point of it, if it is traced.
    fn target(&self, line: usize, point: usize, index: usize) -> Option<(usize, f64)> {
        self.candidates[line].at[point][index].on
    }
}

/// What the other direction says of a candidate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    /// It comes back to the same place.
    Agrees,
    /// It has no match there, or the candidate is not on a traced line.
    Silent,
    /// It goes to another line, or to another place of this one.
    Contradicts,
}

/// What `back` (with the paths of the other view's lines) says of a candidate of `forth`.
fn verdict(
    forth: &Direction<'_>,
    back: &Direction<'_>,
    back_solved: &[Solved],
    [line, point, index]: [usize; 3],
) -> Verdict {
    let Some((other, arc_px)) = forth.target(line, point, index) else { return Verdict::Silent };
    let other_point = forth.there.index.point_at(other, arc_px);
    let Some(chosen) = back_solved[other].path[other_point] else { return Verdict::Silent };
    match back.target(other, other_point, chosen) {
        None => Verdict::Silent,
        Some((returned, returned_arc)) => {
            let here_arc = forth.candidates[line].arc_px[point];
            let near = returned == line && back.there.index.distance_px(line, here_arc, returned_arc) <= RETURN_PX;
            // Along the row the same place is told only roughly.
            let ill = forth.ill[line][point] && returned == line;
            if near || ill { Verdict::Agrees } else { Verdict::Contradicts }
        }
    }
}

/// Matched curves of a pair with disparities in `range_px`.
pub(super) fn solve(
    pair: &RectifiedPair,
    lines: &[LineMap; 2],
    traces: &[TraceGraph; 2],
    range_px: [f64; 2],
) -> Vec<MatchedCurve> {
    let [left_index, right_index] = [0, 1].map(|view| RowIndex::new(&traces[view].traces));
    let left = Side { image: &pair.left, lines: &lines[0], traces: &traces[0].traces, index: &left_index };
    let right = Side { image: &pair.right, lines: &lines[1], traces: &traces[1].traces, index: &right_index };
    let mut forth = Direction::new(left, right, range_px);
    let back = Direction::new(right, left, [-range_px[1], -range_px[0]]);
    let solved = agree(&forth, &back, [Vec::new(), Vec::new()]);
    forth.look_for_untraced(&solved[0]);
    let [forth_solved, back_solved] = agree(&forth, &back, solved);
    let spread_px = (range_px[1] - range_px[0]) / 12.0_f64.sqrt();
    let curves: Vec<Vec<MatchedCurve>> = (0..forth.traces.len())
        .into_par_iter()
        .map(|line| {
            let measured = checked(&forth, &back, &back_solved, line, &forth_solved[line].path);
            assemble(line, &forth.traces[line], &measured, pair.rectification.sigma_row_px, spread_px)
        })
        .collect();
    curves.into_iter().flatten().collect()
}

/// Both directions after the rounds in which each yields to the other, going on from `solved` (empty at first).
fn agree(forth: &Direction<'_>, back: &Direction<'_>, solved: [Vec<Solved>; 2]) -> [Vec<Solved>; 2] {
    let extra = |verdict: Verdict| if verdict == Verdict::Contradicts { CONTRADICTION_COST } else { 0.0 };
    let [mut forth_solved, mut back_solved] = solved;
    if forth_solved.is_empty() {
        forth_solved = forth.paths(&[], |_, _, _| 0.0);
        back_solved = back.paths(&[], |_, _, _| 0.0);
    }
    for _ in 0..ROUNDS {
        let next_forth = forth.paths(&forth_solved, |l, p, c| extra(verdict(forth, back, &back_solved, [l, p, c])));
        let next_back = back.paths(&back_solved, |l, p, c| extra(verdict(back, forth, &forth_solved, [l, p, c])));
        let settled = next_forth == forth_solved && next_back == back_solved;
        (forth_solved, back_solved) = (next_forth, next_back);
        if settled {
            break;
        }
    }
    [forth_solved, back_solved]
}

/// What was measured along a line, without the stretches that the other direction contradicts.
fn checked(
    forth: &Direction<'_>,
    back: &Direction<'_>,
    back_solved: &[Solved],
    line: usize,
    path: &[Option<usize>],
) -> Vec<Option<Measured>> {
    let verdicts: Vec<Option<Verdict>> = path
        .iter()
        .enumerate()
        .map(|(point, chosen)| chosen.map(|index| verdict(forth, back, back_solved, [line, point, index])))
        .collect();
    let contradicted = |point: usize| verdicts[point] == Some(Verdict::Contradicts);
    let agrees = |point: usize| verdicts[point] == Some(Verdict::Agrees);
    let arc_px = &forth.candidates[line].arc_px;
    let mut dropped = vec![false; path.len()];
    let mut start = 0;
    while start < path.len() {
        if !contradicted(start) {
            start += 1;
            continue;
        }
        let end = (start..path.len()).find(|&point| agrees(point)).unwrap_or(path.len());
        let last = (start..end).rev().find(|&point| contradicted(point)).unwrap_or(start);
        let before = (0..start).rev().find(|&point| verdicts[point].is_some());
        let flanked = before.is_some_and(agrees) && end < path.len();
        if !flanked || arc_px[last] - arc_px[start] > MAX_CONTRADICTED_PX {
            dropped[start..=last].fill(true);
        }
        start = last + 1;
    }
    path.iter()
        .enumerate()
        .map(|(point, chosen)| {
            let index = chosen.filter(|_| !dropped[point])?;
            let candidate = &forth.candidates[line].at[point][index];
            Some(Measured {
                disparity_px: candidate.disparity_px,
                sigma_px: candidate.sigma_px,
                tangent_right: candidate.tangent,
            })
        })
        .collect()
}

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

/// For each line and point, the chosen candidate.
type Paths = Vec<Vec<Option<usize>>>;

impl<'a> Direction<'a> {
    fn new(here: Side<'a>, there: Side<'a>, range_px: [f64; 2]) -> Self {
        let traces = here.traces;
        let candidates = traces.par_iter().map(|trace| Candidates::on_traces(trace, here, there, range_px)).collect();
        let ill = |trace: &Trace| trace.points.iter().map(|point| ill_conditioned(&point.tangent)).collect();
        Self { here, there, traces, range_px, candidates, ill: traces.iter().map(ill).collect() }
    }

    /// Adds mere likenesses where lines found no traced partner.
    fn look_for_untraced(&mut self, paths: &Paths) {
        let (here, there, range_px) = (self.here, self.there, self.range_px);
        let lines = self.candidates.par_iter_mut().zip(self.traces).zip(paths);
        lines.for_each(|((candidates, trace), path)| {
            let wanted: Vec<bool> = path.iter().map(Option::is_none).collect();
            candidates.add_likenesses(trace, here, there, range_px, &wanted);
        });
    }

    /// The cheapest path of every line; `surcharge` gives the extra cost of a candidate.
    fn paths(&self, surcharge: impl Fn(usize, usize, usize) -> f32 + Sync) -> Paths {
        (0..self.traces.len()).into_par_iter().map(|line| self.path(line, &surcharge)).collect()
    }

    fn path(&self, line: usize, surcharge: &(impl Fn(usize, usize, usize) -> f32 + Sync)) -> Vec<Option<usize>> {
        let (candidates, trace) = (&self.candidates[line], &self.traces[line]);
        let count = trace.points.len();
        let extra: Vec<Vec<f32>> = (0..count)
            .map(|point| (0..candidates.at[point].len()).map(|index| surcharge(line, point, index)).collect())
            .collect();
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
                    surcharge: &extra[point],
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

/// What `back` (the paths of the other view's lines) says of a candidate of `forth`.
fn verdict(
    forth: &Direction<'_>,
    back: &Direction<'_>,
    back_paths: &Paths,
    [line, point, index]: [usize; 3],
) -> Verdict {
    let Some((other, arc_px)) = forth.target(line, point, index) else { return Verdict::Silent };
    let other_point = forth.there.index.point_at(other, arc_px);
    let Some(chosen) = back_paths[other][other_point] else { return Verdict::Silent };
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
    let (forth_paths, _) = agree(&forth, &back);
    forth.look_for_untraced(&forth_paths);
    let (forth_paths, back_paths) = agree(&forth, &back);
    let spread_px = (range_px[1] - range_px[0]) / 12.0_f64.sqrt();
    let curves: Vec<Vec<MatchedCurve>> = (0..forth.traces.len())
        .into_par_iter()
        .map(|line| {
            let measured = checked(&forth, &back, &back_paths, line, &forth_paths[line]);
            assemble(line, &forth.traces[line], &measured, pair.rectification.sigma_row_px, spread_px)
        })
        .collect();
    curves.into_iter().flatten().collect()
}

/// Paths of both directions after the rounds in which each yields to the other.
fn agree(forth: &Direction<'_>, back: &Direction<'_>) -> (Paths, Paths) {
    let extra = |verdict: Verdict| if verdict == Verdict::Contradicts { CONTRADICTION_COST } else { 0.0 };
    let mut forth_paths = forth.paths(|_, _, _| 0.0);
    let mut back_paths = back.paths(|_, _, _| 0.0);
    for _ in 0..ROUNDS {
        let next_forth = forth.paths(|l, p, c| extra(verdict(forth, back, &back_paths, [l, p, c])));
        let next_back = back.paths(|l, p, c| extra(verdict(back, forth, &forth_paths, [l, p, c])));
        if next_forth == forth_paths && next_back == back_paths {
            break;
        }
        (forth_paths, back_paths) = (next_forth, next_back);
    }
    (forth_paths, back_paths)
}

/// What was measured along a line, without the stretches that the other direction contradicts.
fn checked(
    forth: &Direction<'_>,
    back: &Direction<'_>,
    back_paths: &Paths,
    line: usize,
    path: &[Option<usize>],
) -> Vec<Option<Measured>> {
    let verdicts: Vec<Option<Verdict>> = path
        .iter()
        .enumerate()
        .map(|(point, chosen)| chosen.map(|index| verdict(forth, back, back_paths, [line, point, index])))
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

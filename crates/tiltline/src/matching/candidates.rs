//! Where a point of a line in one view may lie on its row in the other view, and what each place costs.
//!
//! Two kinds of candidate: crossings of the row with traced lines (sub-pixel), and, for lines that were not traced in the
//! other view, places that merely look alike (peaks of NCC over the whole disparity range). Costs are per px of arc
//! length, on a scale where leaving a point unmatched costs 1 (see [`super::path`]).

use ndarray::Array2;

use super::appearance::{Likeness, Profile, ProfileShape};
use super::crossings::{Crossing, RowIndex, arc_lengths};
use super::sigma::sigma_along_row_px;
use crate::curve::{LineMap, Trace};
use crate::filter::sample_linear;
use crate::geometry::Vector2;

/// Rows of the window on either side of a point, counted in points of the trace (about 1 px of arc each).
const STACK: usize = 4;
/// Appearance-only candidates kept per point.
const PEAKS: usize = 3;
/// Least NCC of an appearance-only candidate.
const MIN_PEAK_NCC: f32 = 0.55;
/// An appearance peak this close (px) to a traced line is that line.
const PEAK_CLEARANCE_PX: f64 = 2.0;
/// NCC assumed where there is no data to compare.
const UNKNOWN_NCC: f32 = 0.4;
/// Sigma in px of an appearance-only disparity beside the statistical one: the window assumes one disparity over its
/// height, and the background in it lies at other depths.
const APPEARANCE_SIGMA_PX: f64 = 0.5;
/// Angle between both tangents at which their disagreement costs half of its most.
const TANGENT_SCALE_RAD: f64 = 0.35;

/// Weights of the terms of the cost of a traced candidate.
const BASE_COST: f32 = 0.05;
const NCC_COST: f32 = 0.6;
const TANGENT_COST: f32 = 0.35;
const EVIDENCE_COST: f32 = 0.2;
/// And of one that was not traced.
const UNTRACED_BASE_COST: f32 = 0.35;
const UNTRACED_NCC_COST: f32 = 0.9;
const UNTRACED_EVIDENCE_COST: f32 = 0.45;

/// A place on the row in the other view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Candidate {
    /// `x_other - x_this`, px.
    pub disparity_px: f64,
    /// Error of it from the tracing of both lines (or of the appearance peak), px; without the row error.
    pub sigma_px: f64,
    /// The traced line it lies on, and its arc length there; `None` for a mere likeness.
    pub on: Option<(usize, f64)>,
    /// Tangent of the other line, if traced.
    pub tangent: Option<Vector2>,
    /// Cost per px of arc length.
    pub cost: f32,
}

/// One view as seen by the matcher.
#[derive(Clone, Copy)]
pub(crate) struct Side<'a> {
    pub image: &'a Array2<f32>,
    pub lines: &'a LineMap,
    pub traces: &'a [Trace],
    pub index: &'a RowIndex<'a>,
}

/// A left trace made ready for the path search.
pub(crate) struct Candidates {
    /// Candidates of each point.
    pub at: Vec<Vec<Candidate>>,
    /// Arc length of each point, px.
    pub arc_px: Vec<f64>,
}

impl Candidates {
    /// Crossings with traced lines for every point of `trace`, a line of `here`, in the view `there`, with disparities in
    /// `range_px`.
    pub fn on_traces(trace: &Trace, here: Side<'_>, there: Side<'_>, range_px: [f64; 2]) -> Self {
        let arc_px = arc_lengths(trace);
        let at = traced(trace, here, there, range_px, profile_shape(here, there), &arc_px);
        Self { at, arc_px }
    }

    /// Adds mere likenesses at the points that are `wanted`.
    pub fn add_likenesses(
        &mut self,
        trace: &Trace,
        here: Side<'_>,
        there: Side<'_>,
        range_px: [f64; 2],
        wanted: &[bool],
    ) {
        let peaks = untraced(trace, here, there, range_px, profile_shape(here, there), wanted);
        for (list, peaks) in self.at.iter_mut().zip(peaks) {
            let apart = |peak: &Candidate| {
                list.iter().all(|candidate| (candidate.disparity_px - peak.disparity_px).abs() > PEAK_CLEARANCE_PX)
            };
            let free: Vec<Candidate> = peaks.into_iter().filter(apart).collect();
            list.extend(free);
        }
    }
}

fn profile_shape(here: Side<'_>, there: Side<'_>) -> ProfileShape {
    ProfileShape::for_line_width(0.5 * (here.lines.line_width_px + there.lines.line_width_px))
}

/// Crossings of the row with traced lines.
fn traced(
    trace: &Trace,
    here: Side<'_>,
    there: Side<'_>,
    range_px: [f64; 2],
    shape: ProfileShape,
    arc_px: &[f64],
) -> Vec<Vec<Candidate>> {
    let crossings: Vec<_> = trace
        .points
        .iter()
        .map(|point| {
            let x = point.position.x;
            there.index.crossings(point.position.y, [x + range_px[0], x + range_px[1]])
        })
        .collect();
    let reach = (shape.half + shape.line) as f64;
    // The profile of a view at `x` without the other lines that this row cuts.
    let profile = |side: Side<'_>, row: &[Crossing], x: f64, y: f64| {
        let others = row.iter().map(|other| other.x - x).filter(|other| other.abs() > 0.5 && other.abs() < reach);
        Profile::sample(side.image, x, y, shape).without_lines(others, shape)
    };
    let rows: Vec<Vec<Likeness>> = trace
        .points
        .iter()
        .zip(&crossings)
        .map(|(point, crossings)| {
            let (x, y) = (point.position.x, point.position.y);
            let left = profile(here, &here.index.crossings(y, [x - reach, x + reach]), x, y);
            let likeness = |at: f64| Likeness::of(&left, &profile(there, crossings, at, y), shape);
            crossings.iter().map(|crossing| likeness(crossing.x)).collect()
        })
        .collect();
    // The crossing of the next point that continues along the same line.
    let follow = |from: usize, crossing: usize, to: usize| -> Option<usize> {
        let start = &crossings[from][crossing];
        let reach = 2.0 * (arc_px[to] - arc_px[from]).abs() + 2.0;
        let along = |index: usize| there.index.distance_px(start.trace, start.arc_px, crossings[to][index].arc_px);
        (0..crossings[to].len())
            .filter(|&index| crossings[to][index].trace == start.trace && along(index) <= reach)
            .min_by(|&a, &b| along(a).total_cmp(&along(b)))
    };
    let stacked = |point: usize, crossing: usize| {
        let mut sum = rows[point][crossing];
        for step in [-1_i64, 1] {
            let (mut at, mut current) = (point, crossing);
            for _ in 0..STACK {
                let Some(next) = at.checked_add_signed(step as isize).filter(|next| *next < rows.len()) else { break };
                let Some(index) = follow(at, current, next) else { break };
                (at, current) = (next, index);
                sum.add(&rows[at][current]);
            }
        }
        sum
    };
    trace
        .points
        .iter()
        .enumerate()
        .map(|(index, point)| {
            let candidate = |(number, crossing): (usize, &Crossing)| {
                let ncc = stacked(index, number).ncc().unwrap_or(UNKNOWN_NCC);
                let angle = line_angle(&point.tangent, &crossing.tangent) / TANGENT_SCALE_RAD;
                let evidence = crossing.probability.max(evidence(there.lines, crossing.x, point.position.y));
                let cost = BASE_COST
                    + NCC_COST * (1.0 - ncc)
                    + TANGENT_COST * (angle * angle / (1.0 + angle * angle)) as f32
                    + EVIDENCE_COST * (1.0 - evidence);
                Candidate {
                    disparity_px: crossing.x - point.position.x,
                    sigma_px: sigma_along_row_px(&point.tangent, point.sigma_perp_px)
                        .hypot(sigma_along_row_px(&crossing.tangent, crossing.sigma_perp_px)),
                    on: Some((crossing.trace, crossing.arc_px)),
                    tangent: Some(crossing.tangent),
                    cost,
                }
            };
            crossings[index].iter().enumerate().map(candidate).collect()
        })
        .collect()
}

/// Peaks of likeness over whole-pixel disparities, made sub-pixel by a parabola.
fn untraced(
    trace: &Trace,
    here: Side<'_>,
    there: Side<'_>,
    range_px: [f64; 2],
    shape: ProfileShape,
    wanted: &[bool],
) -> Vec<Vec<Candidate>> {
    let (low, high) = (range_px[0].ceil() as i64 - 1, range_px[1].floor() as i64 + 1);
    let levels = (high - low + 1).max(0) as usize;
    let window = |index: usize| index.saturating_sub(STACK)..(index + STACK + 1).min(wanted.len());
    let rows: Vec<Vec<Likeness>> = trace
        .points
        .iter()
        .enumerate()
        .map(|(index, point)| {
            if !wanted[window(index)].contains(&true) {
                return Vec::new();
            }
            let (column, row) = (point.position.x.round() as i64, point.position.y.round() as i64);
            let left = Profile::of_pixels(here.image, column, row, shape);
            (0..levels as i64)
                .map(|level| {
                    let right = Profile::of_pixels(there.image, column + low + level, row, shape);
                    Likeness::of(&left, &right, shape)
                })
                .collect()
        })
        .collect();
    let mut ncc = vec![f32::NAN; levels];
    (0..rows.len())
        .map(|index| {
            if !wanted[index] {
                return Vec::new();
            }
            let mut pixels = 0.0;
            for (level, value) in ncc.iter_mut().enumerate() {
                let mut sum = Likeness::default();
                rows[window(index)].iter().for_each(|row| sum.add(&row[level]));
                *value = sum.ncc().unwrap_or(f32::NAN);
                pixels = sum.pixels().max(pixels);
            }
            let point = &trace.points[index];
            let mut peaks: Vec<Candidate> = (1..levels.saturating_sub(1))
                .filter(|&level| {
                    ncc[level] > MIN_PEAK_NCC && ncc[level] >= ncc[level - 1] && ncc[level] > ncc[level + 1]
                })
                .map(|level| {
                    let [before, peak, after] = [ncc[level - 1], ncc[level], ncc[level + 1]].map(f64::from);
                    let bend = (before - 2.0 * peak + after).min(-1e-4);
                    let disparity_px = (low + level as i64) as f64 + 0.5 * (before - after) / bend;
                    let evidence = evidence(there.lines, point.position.x + disparity_px, point.position.y);
                    let cost = UNTRACED_BASE_COST
                        + UNTRACED_NCC_COST * (1.0 - ncc[level])
                        + UNTRACED_EVIDENCE_COST * (1.0 - evidence);
                    // Variance of a correlation peak (Carter 1987): (1 - r^2) / (r^2 n |r''| / r).
                    let variance = (1.0 - peak * peak).max(0.0) / (peak * f64::from(pixels).max(1.0) * -bend);
                    let sigma_px = variance.sqrt().hypot(APPEARANCE_SIGMA_PX);
                    Candidate { disparity_px, sigma_px, on: None, tangent: None, cost }
                })
                .filter(|peak| (range_px[0]..=range_px[1]).contains(&peak.disparity_px))
                .collect();
            peaks.sort_by(|a, b| a.cost.total_cmp(&b.cost));
            peaks.truncate(PEAKS);
            peaks
        })
        .collect()
}

/// Line probability of the map at a point; 0 outside.
fn evidence(lines: &LineMap, x: f64, y: f64) -> f32 {
    sample_linear(&lines.probability.view(), x, y).unwrap_or(0.0).clamp(0.0, 1.0)
}

/// Angle between two undirected lines, in `[0, pi/2]`.
pub(crate) fn line_angle(a: &Vector2, b: &Vector2) -> f64 {
    (a.x * b.y - a.y * b.x).abs().atan2(a.dot(b).abs())
}

//! Junction errors: places where three or more arms meet, found and missed.
//!
//! Files hold curves, not graphs, so junctions are read off the curves of truth and result by one rule: ends that lie
//! together are arms, and a curve that passes by an end adds two. Lines that merely cross have no end there and make none.

use serde::{Deserialize, Serialize};

use crate::geometry::Point2;
use crate::score::ScoreSettings;
use crate::score::pairing::Pieces;
use crate::score::sampling::Foot;
use crate::score::space::SpaceCurve;

/// Ends of a result this close in plan are one junction, px: its centrelines stop short of each other.
const RESULT_JOIN_PX: f64 = 3.0;
/// Ends of the truth are exact, but for the rounding of files and the pixels of hand labels.
const TRUTH_JOIN_PX: f64 = 1.0;
/// A junction found within this distance of a true one is that one, px.
const FOUND_PX: f64 = 5.0;
/// Times the tolerance of disparity that arms, and a junction and its truth, may differ by: disparity is worst at ends.
const DISPARITY_FACTOR: f64 = 2.0;

/// Junctions missed and invented.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct JunctionScore {
    /// Visible true junctions.
    pub truth: usize,
    /// Junctions of the result.
    pub result: usize,
    /// True ones that were not found.
    pub missed: usize,
    /// Found ones that are not there.
    pub extra: usize,
}

/// A junction of curves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Junction {
    pub plan: Point2,
    pub disparity: f64,
    /// Whether all its arms can be asked for.
    pub counts: bool,
}

/// Compares the junctions of truth and result; `offset_px` is the disparity offset of the result.
pub(crate) fn junction_score(
    truth: (&[SpaceCurve], &Pieces),
    result: (&[SpaceCurve], &Pieces),
    offset_px: f64,
    settings: &ScoreSettings,
) -> JunctionScore {
    let apart = DISPARITY_FACTOR * settings.disparity_tolerance_px;
    let true_junctions = junctions(truth, TRUTH_JOIN_PX, apart);
    let found = junctions(result, RESULT_JOIN_PX, apart);
    let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
    for (at, junction) in true_junctions.iter().enumerate() {
        for (candidate, other) in found.iter().enumerate() {
            let distance = (junction.plan - other.plan).norm();
            if distance <= FOUND_PX && (other.disparity - offset_px - junction.disparity).abs() <= apart {
                pairs.push((distance, at, candidate));
            }
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut has_partner, mut is_true) = (vec![false; true_junctions.len()], vec![false; found.len()]);
    for (_, at, candidate) in pairs {
        if !has_partner[at] && !is_true[candidate] {
            (has_partner[at], is_true[candidate]) = (true, true);
        }
    }
    let visible = |at: &usize| true_junctions[*at].counts;
    JunctionScore {
        truth: (0..true_junctions.len()).filter(visible).count(),
        result: found.len(),
        missed: (0..true_junctions.len()).filter(visible).filter(|&at| !has_partner[at]).count(),
        extra: is_true.iter().filter(|found| !**found).count(),
    }
}

/// An end of a curve.
struct Arm {
    plan: Point2,
    disparity: f64,
    counts: bool,
}

fn junctions((curves, pieces): (&[SpaceCurve], &Pieces), join_px: f64, disparity_px: f64) -> Vec<Junction> {
    let mut ends: Vec<(usize, Arm)> = Vec::new();
    for (index, curve) in curves.iter().enumerate().filter(|(_, curve)| !curve.closed && curve.plan.len() > 1) {
        for at in [0, curve.plan.len() - 1] {
            let (plan, disparity, counts) = (curve.plan[at], curve.disparity[at], curve.counts[at]);
            ends.push((index, Arm { plan, disparity, counts }));
        }
    }
    let joins = |a: &Arm, plan: &Point2, disparity: f64| {
        (a.plan - plan).norm() <= join_px && (a.disparity - disparity).abs() <= disparity_px
    };
    let mut group: Vec<usize> = (0..ends.len()).collect();
    for a in 0..ends.len() {
        for b in 0..a {
            if joins(&ends[a].1, &ends[b].1.plan, ends[b].1.disparity) {
                let (from, to) = (group[a].max(group[b]), group[a].min(group[b]));
                group.iter_mut().filter(|member| **member == from).for_each(|member| *member = to);
            }
        }
    }
    let (mut junctions, mut feet) = (Vec::new(), Vec::new());
    for root in 0..ends.len() {
        let members: Vec<usize> = (0..ends.len()).filter(|&end| group[end] == root).collect();
        let Some(&first) = members.first() else { continue };
        let count = members.len() as f64;
        let sum = members.iter().fold((0.0, 0.0, 0.0), |sum, &end| {
            let arm = &ends[end].1;
            (sum.0 + arm.plan.x, sum.1 + arm.plan.y, sum.2 + arm.disparity)
        });
        let (plan, disparity) = (Point2::new(sum.0 / count, sum.1 / count), sum.2 / count);
        let end = &ends[first].1;
        // Curves that pass by at this depth, other than those that end here.
        pieces.chords.feet(&end.plan, join_px, &mut feet);
        let passes = |foot: &&Foot| {
            let curve = pieces.chords.curve[foot.piece];
            let same_depth = (pieces.disparity_at(foot) - end.disparity).abs() <= disparity_px;
            same_depth && members.iter().all(|&member| ends[member].0 != curve)
        };
        let arms = members.len() + 2 * feet.iter().filter(passes).count();
        if arms >= 3 {
            junctions.push(Junction { plan, disparity, counts: members.iter().all(|&end| ends[end].1.counts) });
        }
    }
    junctions
}

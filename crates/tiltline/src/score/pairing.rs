//! Which stretches of a result are which stretches of the truth: one-to-one, weighted by length, and the same when truth
//! and result are swapped.
//!
//! 1. Both sets of curves are cut into pieces of 0.5 px. A piece is a candidate partner of the piece at its foot on every
//!    curve that passes within the tolerance across the line, from either side.
//! 2. One depth offset for all is taken out: where the differences of disparity are densest (a parabolic kernel as wide as
//!    the tolerance: Epanechnikov 1969), then the median within the tolerance of it.
//! 3. Candidates within the tolerance of disparity that follow one another along both curves make a stretch. A stretch
//!    shorter than what a line crossing at 45 degrees leaves inside the tolerance is no match.
//! 4. Stretches take their pieces in the order of their length, the closer ones worth more. A piece has one partner: of a
//!    doubled curve only one copy is right, and one line through a narrow dipole finds one of the two.

use crate::geometry::Point2;
use crate::score::calibration::weighted_quantile;
use crate::score::sampling::{Chords, Foot, pieces};
use crate::score::space::SpaceCurve;

/// Pieces along either curve that a stretch may skip (3 px), and that the partners of one piece may lie apart.
const SKIP: usize = 6;

/// All pieces of a set of curves.
pub(crate) struct Pieces {
    pub chords: Chords,
    pub middle: Vec<Point2>,
    pub disparity: Vec<f64>,
    /// Disparity at both ends.
    ends_disparity: Vec<[f64; 2]>,
    pub length: Vec<f64>,
    pub counts: Vec<bool>,
    /// First piece, number of pieces and whether it is closed, of each curve.
    curves: Vec<(usize, usize, bool)>,
}

impl Pieces {
    pub fn new(curves: &[SpaceCurve]) -> Self {
        let cut: Vec<_> = curves.iter().map(|curve| pieces(&curve.plan, curve.closed)).collect();
        let sources = curves.iter().zip(&cut);
        let chords = Chords::new(sources.map(|(curve, cut)| (curve.plan.as_slice(), curve.closed, cut.as_slice())));
        let mut all = Self {
            chords,
            middle: Vec::new(),
            disparity: Vec::new(),
            ends_disparity: Vec::new(),
            length: Vec::new(),
            counts: Vec::new(),
            curves: Vec::new(),
        };
        for (curve, cut) in curves.iter().zip(&cut) {
            all.curves.push((all.length.len(), cut.len(), curve.closed));
            let count = curve.plan.len();
            for piece in cut {
                let disparity = |place: crate::score::sampling::Place| place.interpolate(|i| curve.disparity[i], count);
                all.middle.push(piece.middle.point(&curve.plan));
                all.disparity.push(disparity(piece.middle));
                all.ends_disparity.push([disparity(piece.start), disparity(piece.end)]);
                all.length.push(piece.length);
                all.counts.push(piece.middle.holds(|i| curve.counts[i], count));
            }
        }
        all
    }

    /// Disparity at a foot on these pieces.
    pub fn disparity_at(&self, foot: &Foot) -> f64 {
        let [start, end] = self.ends_disparity[foot.piece];
        start + (end - start) * foot.fraction
    }

    fn curve_length(&self, curve: usize) -> f64 {
        let (first, count, _) = self.curves[curve];
        self.length[first..first + count].iter().sum()
    }

    /// Pieces between two pieces of one curve, the short way round a closed one.
    fn apart(&self, a: usize, b: usize) -> usize {
        let (_, count, closed) = self.curves[self.chords.curve[a]];
        let direct = a.abs_diff(b);
        if closed { direct.min(count - direct) } else { direct }
    }
}

/// Two pieces beside each other.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    truth: usize,
    result: usize,
    across: f64,
    /// Result less truth.
    disparity: f64,
}

/// How well the partner of a piece fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Partner {
    /// The partner's piece.
    pub piece: usize,
    /// Distance across the line, px.
    pub across_px: f64,
    /// Difference of disparity less the offset, px.
    pub disparity_px: f64,
}

/// Partners of all pieces, and the offset that was removed.
pub(crate) struct Pairing {
    pub truth: Vec<Option<Partner>>,
    pub result: Vec<Option<Partner>>,
    /// Result less truth, px of disparity.
    pub offset_px: f64,
}

/// Pairs two sets of pieces.
pub(crate) fn pair_pieces(truth: &Pieces, result: &Pieces, across_px: f64, disparity_px: f64) -> Pairing {
    let mut candidates = candidates(truth, result, across_px);
    let offset_px = densest(&candidates, truth, result, disparity_px);
    candidates.retain_mut(|candidate| {
        candidate.disparity -= offset_px;
        // A difference of exactly the tolerance, but for rounding, is within it.
        candidate.disparity.abs() <= disparity_px + 1e-9
    });
    let cost = |candidate: &Candidate| {
        0.5 * ((candidate.across / across_px).powi(2) + (candidate.disparity / disparity_px).powi(2))
    };
    let shortest = 2.0 * across_px / std::f64::consts::FRAC_PI_4.sin();
    let mut stretches: Vec<(f64, Vec<Candidate>)> = stretches(&candidates, truth, result)
        .into_iter()
        .filter(|stretch| {
            let length = |mut of: Vec<usize>, pieces: &Pieces| {
                of.sort_unstable();
                of.dedup();
                of.iter().map(|&piece| pieces.length[piece]).sum::<f64>()
            };
            let on_truth = length(stretch.iter().map(|candidate| candidate.truth).collect(), truth);
            let on_result = length(stretch.iter().map(|candidate| candidate.result).collect(), result);
            let curve = truth.curve_length(truth.chords.curve[stretch[0].truth]);
            let other = result.curve_length(result.chords.curve[stretch[0].result]);
            on_truth.min(on_result) >= shortest.min(0.5 * curve.min(other))
        })
        .map(|stretch| {
            let worth = |candidate: &Candidate| {
                (truth.length[candidate.truth] + result.length[candidate.result]) * (1.0 - 0.5 * cost(candidate))
            };
            (stretch.iter().map(worth).sum(), stretch)
        })
        .collect();
    stretches.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut pairing =
        Pairing { truth: vec![None; truth.length.len()], result: vec![None; result.length.len()], offset_px };
    for (_, mut stretch) in stretches {
        stretch.sort_by(|a, b| cost(a).total_cmp(&cost(b)));
        for candidate in &stretch {
            pairing.take(candidate, truth, result);
        }
    }
    pairing
}

impl Pairing {
    /// Makes two pieces partners, unless one of them has its partners elsewhere.
    fn take(&mut self, candidate: &Candidate, truth: &Pieces, result: &Pieces) {
        let free = |partner: &Option<Partner>, piece: usize, pieces: &Pieces| {
            partner.is_none_or(|partner| {
                let same_curve = pieces.chords.curve[partner.piece] == pieces.chords.curve[piece];
                same_curve && pieces.apart(partner.piece, piece) <= SKIP
            })
        };
        let (of_truth, of_result) = (&mut self.truth[candidate.truth], &mut self.result[candidate.result]);
        if !free(of_truth, candidate.result, result) || !free(of_result, candidate.truth, truth) {
            return;
        }
        let (across_px, disparity_px) = (candidate.across, candidate.disparity);
        // Candidates come in the order of their fit: the first partner is the best.
        of_truth.get_or_insert(Partner { piece: candidate.result, across_px, disparity_px });
        of_result.get_or_insert(Partner { piece: candidate.truth, across_px, disparity_px });
    }
}

/// Every piece with the piece at each of its feet, from both sides, sorted by truth and result piece.
fn candidates(truth: &Pieces, result: &Pieces, across_px: f64) -> Vec<Candidate> {
    let mut candidates = Vec::new();
    let mut feet = Vec::new();
    let mut look = |from: &Pieces, to: &Pieces, from_truth: bool| {
        for (piece, middle) in from.middle.iter().enumerate() {
            to.chords.feet(middle, across_px, &mut feet);
            for foot in &feet {
                let difference = to.disparity_at(foot) - from.disparity[piece];
                if difference.is_finite() {
                    let across = foot.distance;
                    candidates.push(if from_truth {
                        Candidate { truth: piece, result: foot.piece, across, disparity: difference }
                    } else {
                        Candidate { truth: foot.piece, result: piece, across, disparity: -difference }
                    });
                }
            }
        }
    };
    look(truth, result, true);
    look(result, truth, false);
    candidates
        .sort_unstable_by(|a, b| (a.truth, a.result).cmp(&(b.truth, b.result)).then(a.across.total_cmp(&b.across)));
    candidates.dedup_by_key(|candidate| (candidate.truth, candidate.result));
    candidates
}

/// The offset of disparity that most length agrees on: the median about the place where differences are densest.
fn densest(candidates: &[Candidate], truth: &Pieces, result: &Pieces, tolerance: f64) -> f64 {
    let weight = |candidate: &Candidate| truth.length[candidate.truth] + result.length[candidate.result];
    let mut weighted: Vec<(f64, f64)> =
        candidates.iter().map(|candidate| (candidate.disparity, weight(candidate))).collect();
    weighted.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    // Running sums of w, w x, w x^2: the kernel sum about any place follows from their differences.
    let mut sums = vec![[0.0; 3]];
    for (index, (x, w)) in weighted.iter().enumerate() {
        let [a, b, c] = sums[index];
        sums.push([a + w, b + w * x, c + w * x * x]);
    }
    let (mut first, mut after) = (0, 0);
    let mut best = (0.0, 0..0);
    for &(centre, _) in &weighted {
        while weighted[first].0 < centre - tolerance {
            first += 1;
        }
        while after < weighted.len() && weighted[after].0 <= centre + tolerance {
            after += 1;
        }
        let [w, wx, wxx] = [0, 1, 2].map(|power| sums[after][power] - sums[first][power]);
        let density = w - (wxx - 2.0 * centre * wx + centre * centre * w) / (tolerance * tolerance);
        // More than rounding, or a plateau's winner would depend on it.
        if density > best.0 * (1.0 + 1e-9) {
            best = (density, first..after);
        }
    }
    let inside = &weighted[best.1];
    let lower = weighted_quantile(inside.to_vec(), 0.5).unwrap_or(0.0);
    let upper = weighted_quantile(inside.iter().map(|(x, w)| (-x, *w)).collect(), 0.5).unwrap_or(0.0);
    // Between the two middle values, so that swapping truth and result negates it exactly.
    0.5 * (lower - upper)
}

/// Candidates of one pair of curves that follow one another along both.
fn stretches(candidates: &[Candidate], truth: &Pieces, result: &Pieces) -> Vec<Vec<Candidate>> {
    let mut sorted: Vec<Candidate> = candidates.to_vec();
    let curves = |candidate: &Candidate| (truth.chords.curve[candidate.truth], result.chords.curve[candidate.result]);
    sorted.sort_by_key(|candidate| (curves(candidate), candidate.truth, candidate.result));
    let mut stretches = Vec::new();
    for group in sorted.chunk_by(|a, b| curves(a) == curves(b)) {
        let mut root: Vec<usize> = (0..group.len()).collect();
        for (index, candidate) in group.iter().enumerate() {
            for before in (0..index).rev().take_while(|&before| candidate.truth - group[before].truth <= SKIP) {
                if candidate.result.abs_diff(group[before].result) <= SKIP {
                    let (a, b) = (find(&mut root, before), find(&mut root, index));
                    root[b.max(a)] = a.min(b);
                }
            }
        }
        let mut members: std::collections::BTreeMap<usize, Vec<Candidate>> = std::collections::BTreeMap::new();
        for (index, candidate) in group.iter().enumerate() {
            members.entry(find(&mut root, index)).or_default().push(*candidate);
        }
        stretches.extend(members.into_values());
    }
    stretches
}

fn find(root: &mut [usize], index: usize) -> usize {
    let mut at = index;
    while root[at] != at {
        root[at] = root[root[at]];
        at = root[at];
    }
    at
}

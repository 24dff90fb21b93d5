//! The end-to-end protocol: are the true curves there in 3D, and only they?
//!
//! Completeness is the share of visible true length with a partner in the result, correctness the share of the result's
//! length with a partner in the truth; partners are one-to-one ([`crate::score::pairing`]), at most 2 px apart across the line
//! and 2 px in disparity, after one depth offset for the whole pair is taken out (depth is relative). Lengths are those of
//! the plan (the left view's projection), so a line along the beam weighs nothing. Result on a true line that is not visible is
//! correct, but adds nothing to completeness.

use serde::{Deserialize, Serialize};

use crate::reconstruction::LengthUnit;
use crate::score::calibration::weighted_quantile;
use crate::score::junctions::{JunctionScore, junction_score};
use crate::score::pairing::{Pairing, Partner, Pieces, pair_pieces};
use crate::score::space::{Basis, best_basis, result_curves, truth_curves};
use crate::score::{ResultCurves, ScoreError, ScoreSettings};
use crate::truth::TruthPair;

/// Distances to the nearest curve are cut here, in px, where they are taken over everything.
pub const FAR_PX: f64 = 10.0;

/// Scores of the end-to-end protocol.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EndToEndScore {
    /// What the result was held against.
    pub basis: Basis,
    /// Length of visible true line in px of the left image: what completeness is a share of.
    pub truth_length_px: f64,
    /// Share of all true line in both views that is visible and inside both images.
    pub visible_share: f64,
    /// Length of the result in px.
    pub result_length_px: f64,
    /// Share of the visible true length that was found.
    pub completeness: f64,
    /// Share of the result's length that is right; none for an empty result.
    pub correctness: Option<f64>,
    /// Harmonic mean of both; 0 for an empty result.
    pub f_score: f64,
    /// Distance across the line of what was matched (both ways), px.
    pub across_px: Option<Spread>,
    /// Absolute difference of disparity of what was matched, px.
    pub disparity_px: Option<Spread>,
    /// Distance in 3D of what was matched, in `unit`; none without 3D.
    pub distance: Option<Spread>,
    /// Unit of `distance`.
    pub unit: LengthUnit,
    /// Distance in plan of everything (visible truth to result and result to truth) to the nearest curve, cut at 10 px.
    pub any_distance_px: Spread,
    /// Disparity offset that was removed, result less truth, px.
    pub removed_offset_px: f64,
    /// Shift of the result's origin that was taken from its own image columns, (x, y) px.
    pub origin_shift_px: [f64; 2],
    /// Turn of the result's frame about the viewing direction that was taken from them, degrees clockwise on the screen: how
    /// far the tilt axis it found is off.
    #[serde(default)]
    pub frame_turn_deg: f64,
    /// Junctions.
    pub junctions: JunctionScore,
    /// The same against the centres of contrast, where the headline is against the cores.
    pub on_contrast: Option<ContrastScore>,
}

/// Mean and 95 percent value, weighted by length.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// 95 percent of the length is at or below it.
    pub p95: f64,
}

/// End-to-end scores against contrast instead of core, and how far the two are apart.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ContrastScore {
    /// Completeness against the centres of contrast.
    pub completeness: f64,
    /// Correctness against them.
    pub correctness: Option<f64>,
    /// F-score against them.
    pub f_score: f64,
    /// Distance across the line of what was matched, px.
    pub across_px: Option<Spread>,
    /// Distance of the centre of contrast from the projected core in both views, over what is visible, input px.
    pub core_to_contrast_px: Option<Spread>,
}

impl Spread {
    /// Of values with weights; none without weight.
    pub fn of(weighted: Vec<(f64, f64)>) -> Option<Self> {
        let total: f64 = weighted.iter().map(|(_, weight)| weight).sum();
        let sum: f64 = weighted.iter().map(|(value, weight)| value * weight).sum();
        let p95 = weighted_quantile(weighted, 0.95)?;
        (total > 0.0).then(|| Self { mean: sum / total, p95 })
    }
}

/// Lengths and distances of one comparison, kept for pooling over images.
pub(crate) struct Compared {
    pub truth_length: f64,
    pub truth_found: f64,
    pub all_truth_length: f64,
    pub result_length: f64,
    pub result_right: f64,
    /// Across the line, difference of disparity, weight.
    pub matched: Vec<(f64, f64, f64)>,
    pub any_distance: Vec<(f64, f64)>,
    pub offset_px: f64,
}

impl Compared {
    fn new(truth: &Pieces, result: &Pieces, settings: &ScoreSettings) -> Self {
        let Pairing { truth: of_truth, result: of_result, offset_px } =
            pair_pieces(truth, result, settings.across_tolerance_px, settings.disparity_tolerance_px);
        let mut compared = Self {
            truth_length: 0.0,
            truth_found: 0.0,
            all_truth_length: truth.length.iter().sum(),
            result_length: result.length.iter().sum(),
            result_right: 0.0,
            matched: Vec::new(),
            any_distance: Vec::new(),
            offset_px,
        };
        let values = |partner: &Partner, length: f64| (partner.across_px, partner.disparity_px.abs(), length);
        for (piece, partner) in of_truth.iter().enumerate().filter(|(piece, _)| truth.counts[*piece]) {
            let length = truth.length[piece];
            compared.truth_length += length;
            if let Some(partner) = partner {
                compared.truth_found += length;
                compared.matched.push(values(partner, length));
            }
        }
        for (piece, partner) in of_result.iter().enumerate() {
            let length = result.length[piece];
            if let Some(partner) = partner {
                compared.result_right += length;
                compared.matched.push(values(partner, length));
            }
        }
        compared
    }

    /// Distance of everything to the nearest curve of the other side.
    fn measure_any_distance(&mut self, truth: &Pieces, result: &Pieces) {
        for piece in (0..truth.length.len()).filter(|&piece| truth.counts[piece]) {
            let distance = result.chords.capped_distance(&truth.middle[piece], FAR_PX);
            self.any_distance.push((distance, truth.length[piece]));
        }
        for piece in 0..result.length.len() {
            let distance = truth.chords.capped_distance(&result.middle[piece], FAR_PX);
            self.any_distance.push((distance, result.length[piece]));
        }
    }

    fn completeness(&self) -> f64 {
        if self.truth_length > 0.0 { self.truth_found / self.truth_length } else { 0.0 }
    }

    fn correctness(&self) -> Option<f64> {
        (self.result_length > 0.0).then(|| self.result_right / self.result_length)
    }

    fn f_score(&self) -> f64 {
        f_score(self.completeness(), self.correctness())
    }

    fn across(&self) -> Option<Spread> {
        Spread::of(self.matched.iter().map(|(across, _, weight)| (*across, *weight)).collect())
    }
}

/// Harmonic mean of completeness and correctness; 0 without a correctness.
pub(crate) fn f_score(completeness: f64, correctness: Option<f64>) -> f64 {
    let correctness = correctness.unwrap_or(0.0);
    if completeness + correctness > 0.0 { 2.0 * completeness * correctness / (completeness + correctness) } else { 0.0 }
}

/// Scores a result end to end.
///
/// # Errors
/// [`ScoreError::Unit`].
pub(crate) fn end_to_end_score(
    result: &ResultCurves,
    pair: &TruthPair<'_>,
    settings: &ScoreSettings,
) -> Result<(EndToEndScore, Compared), ScoreError> {
    let basis = best_basis(pair);
    let truth_space = truth_curves(pair, basis);
    let (result_space, placement) = result_curves(result, pair, basis)?;
    let (truth, found) = (Pieces::new(&truth_space), Pieces::new(&result_space));
    let on_cores = || {
        let mut compared = Compared::new(&truth, &found, settings);
        compared.measure_any_distance(&truth, &found);
        compared
    };
    let (compared, on_contrast) = rayon::join(on_cores, || {
        (basis == Basis::Core).then(|| {
            let contrast = Compared::new(&Pieces::new(&truth_curves(pair, Basis::Contrast)), &found, settings);
            ContrastScore {
                completeness: contrast.completeness(),
                correctness: contrast.correctness(),
                f_score: contrast.f_score(),
                across_px: contrast.across(),
                core_to_contrast_px: core_to_contrast(pair),
            }
        })
    });
    let junctions = junction_score((&truth_space, &truth), (&result_space, &found), compared.offset_px, settings);
    let disparity_px =
        Spread::of(compared.matched.iter().map(|(_, disparity, weight)| (*disparity, *weight)).collect());
    let geometry = pair.geometry.filter(|_| basis != Basis::Image);
    let distance = geometry.and_then(|geometry| {
        let gain = geometry.tilts.depth_gain();
        let in_unit = |(across, disparity, weight): &(f64, f64, f64)| {
            (across.hypot(disparity * gain) / geometry.px_per_unit, *weight)
        };
        Spread::of(compared.matched.iter().map(in_unit).collect())
    });
    let score = EndToEndScore {
        basis,
        truth_length_px: compared.truth_length,
        visible_share: compared.truth_length / compared.all_truth_length.max(f64::MIN_POSITIVE),
        result_length_px: compared.result_length,
        completeness: compared.completeness(),
        correctness: compared.correctness(),
        f_score: compared.f_score(),
        across_px: compared.across(),
        disparity_px,
        distance,
        unit: if geometry.is_some() { pair.truth.unit } else { LengthUnit::Px },
        any_distance_px: Spread::of(compared.any_distance.clone()).unwrap_or(Spread { mean: 0.0, p95: 0.0 }),
        removed_offset_px: compared.offset_px,
        origin_shift_px: placement.shift_px,
        frame_turn_deg: placement.turn_rad.to_degrees(),
        junctions,
        on_contrast,
    };
    Ok((score, compared))
}

/// Distance of contrast and core in both views, over the length of what is visible.
fn core_to_contrast(pair: &TruthPair<'_>) -> Option<Spread> {
    let mut distances = Vec::new();
    for (view, curve) in [pair.left, pair.right].into_iter().flat_map(|view| view.curves.iter().map(move |c| (view, c)))
    {
        let Some(core) = &curve.core else { continue };
        let seen = |index: usize| curve.is_visible(index) && view.contains(&curve.contrast[index]);
        for index in 1..core.len() {
            if seen(index - 1) && seen(index) {
                let off = |index: usize| (curve.contrast[index] - core[index]).norm();
                distances.push((0.5 * (off(index - 1) + off(index)), (core[index] - core[index - 1]).norm()));
            }
        }
    }
    Spread::of(distances)
}

//! Scores of many images: pooled by length, by tilt angle and family, with bootstrap intervals over images.
//!
//! Pooling adds lengths and errors before dividing, so that an image counts by the line in it. Intervals are percentile
//! bootstrap (Efron & Tibshirani 1993, section 13.3): images, not pixels, are drawn with replacement, because the errors
//! within an image hang together.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::score::calibration::{Calibration, calibration};
use crate::score::end_to_end::{Compared, EndToEndScore, f_score};
use crate::score::lines::LineScore;
use crate::score::paper::Residual;
use crate::score::{PairScore, ScoreSettings};
use crate::truth::TruthPair;

/// Pooled 95 percent distances come from a histogram with bins of this width, in px; they are right to one bin.
const BIN_PX: f64 = 0.02;
/// Number of bins: up to 10 px, and one for all above.
const BINS: usize = 501;
/// Tilt angles closer than this are one group, in degrees.
const ANGLE_STEP_DEG: f64 = 0.5;

macro_rules! figures {
    ($($(#[$doc:meta])* $name:ident: $title:literal,)*) => {
        /// The figures of a group of images.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
        pub struct Figures<T> {
            $($(#[$doc])* pub $name: T,)*
        }

        impl Figures<()> {
            /// Name in files and title in tables of each figure, in order.
            pub const NAMES: &'static [(&'static str, &'static str)] = &[$((stringify!($name), $title)),*];
        }

        impl<T> Figures<T> {
            /// All figures in the order of [`Figures::NAMES`].
            pub fn values(&self) -> Vec<&T> {
                vec![$(&self.$name),*]
            }

            fn map<U>(&self, mut change: impl FnMut(usize, &T) -> U) -> Figures<U> {
                let mut index = 0;
                Figures { $($name: { index += 1; change(index - 1, &self.$name) }),* }
            }
        }
    };
}

figures! {
    /// Paper: share of true line with a prediction.
    coverage: "coverage",
    /// Paper: end-point error where predicted, px.
    epe_px: "EPE, px",
    /// Paper: percentage above 1 px or missing.
    bad_1_percent: "bad-1, %",
    /// Paper: percentage above 3 px or missing.
    bad_3_percent: "bad-3, %",
    /// Paper: percentage above 5 px or missing.
    bad_5_percent: "bad-5, %",
    /// Paper: end-point error as depth, px.
    depth_error_px: "depth error, px",
    /// End to end: share of visible truth found.
    completeness: "completeness",
    /// End to end: share of result right.
    correctness: "correctness",
    /// End to end: harmonic mean.
    f_score: "F-score",
    /// End to end: mean distance across the line of what was matched, px.
    across_mean_px: "across, mean, px",
    /// End to end: 95 percent distance across the line, px.
    across_p95_px: "across, 95 %, px",
    /// End to end: mean difference of disparity of what was matched, px.
    disparity_mean_px: "disparity, mean, px",
    /// End to end: 95 percent difference of disparity, px.
    disparity_p95_px: "disparity, 95 %, px",
    /// End to end: mean distance of everything to the nearest curve, cut at 10 px.
    any_distance_mean_px: "any distance, mean, px",
    /// End to end: 95 percent distance of everything, cut at 10 px.
    any_distance_p95_px: "any distance, 95 %, px",
    /// End to end: share of true junctions missed.
    junctions_missed: "junctions missed",
    /// End to end: invented junctions per image.
    junctions_extra_per_image: "junctions extra, per image",
    /// clDice of the left lines.
    cl_dice: "clDice",
    /// Calibration: share of predicted truth within one sigma.
    within_1_sigma: "within 1 sigma",
    /// Calibration: share of predicted truth within two sigma.
    within_2_sigma: "within 2 sigma",
}

/// A figure and its 95 percent interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Pooled over the group.
    pub value: f64,
    /// Lower and upper end of the interval; none for a single image.
    pub interval_95: Option<[f64; 2]>,
}

/// What the images of a group have in common; none where they differ.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Group {
    /// Angle between the views in degrees, without its sign.
    pub phi_deg: Option<f64>,
    /// Family.
    pub family: Option<String>,
    /// Kind of image in its data set.
    pub kind: Option<String>,
}

/// Scores of a group of images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GroupScore {
    /// Which.
    pub group: Group,
    /// Number of images.
    pub images: usize,
    /// Its figures; none where nothing was measured.
    pub figures: Figures<Option<Estimate>>,
    /// Calibration over all its true line.
    pub calibration: Calibration,
}

/// All groups: everything, and what the images differ in.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// All images.
    pub all: GroupScore,
    /// One group for each tilt angle, where there are several.
    pub by_angle: Vec<GroupScore>,
    /// One group for each family, where there are several.
    pub by_family: Vec<GroupScore>,
    /// One group for each family at each angle, where there are several of both.
    pub by_family_and_angle: Vec<GroupScore>,
    /// One group for each kind of image in a data set, where there are several.
    pub by_kind: Vec<GroupScore>,
}

impl Summary {
    /// Pools the scores of pairs; order and number of threads do not matter, the seed does.
    pub fn new(scores: &[PairScore], settings: &ScoreSettings) -> Self {
        let all: Vec<&PairScore> = scores.iter().collect();
        let angle = |score: &PairScore| score.phi_deg.map(|phi| (phi.abs() / ANGLE_STEP_DEG).round() * ANGLE_STEP_DEG);
        let by = |key: &dyn Fn(&PairScore) -> Option<Group>| groups(scores, key, settings);
        let of_angle = |score: &PairScore| Some(Group { phi_deg: Some(angle(score)?), ..Group::default() });
        let of_family = |score: &PairScore| Some(Group { family: Some(score.family.clone()?), ..Group::default() });
        let of_kind = |score: &PairScore| Some(Group { kind: Some(score.kind.clone()?), ..Group::default() });
        let of_both = |score: &PairScore| Some(Group { phi_deg: Some(angle(score)?), ..of_family(score)? });
        let (by_angle, by_family) = (by(&of_angle), by(&of_family));
        let crossed = !by_angle.is_empty() && !by_family.is_empty();
        Self {
            all: group_score(Group::default(), &all, settings),
            by_family_and_angle: if crossed { by(&of_both) } else { Vec::new() },
            by_angle,
            by_family,
            by_kind: by(&of_kind),
        }
    }
}

/// The groups that a key makes, in order; none where there is only one.
fn groups(
    scores: &[PairScore],
    key: &dyn Fn(&PairScore) -> Option<Group>,
    settings: &ScoreSettings,
) -> Vec<GroupScore> {
    let mut found: Vec<Group> = Vec::new();
    for group in scores.iter().filter_map(key) {
        if !found.contains(&group) {
            found.push(group);
        }
    }
    if found.len() < 2 {
        return Vec::new();
    }
    let angle = |group: &Group| group.phi_deg.unwrap_or_default();
    found.sort_by(|a, b| (&a.family, &a.kind).cmp(&(&b.family, &b.kind)).then(angle(a).total_cmp(&angle(b))));
    let members = |group: &Group| scores.iter().filter(|score| key(score).as_ref() == Some(group)).collect::<Vec<_>>();
    found.into_iter().map(|group| group_score(group.clone(), &members(&group), settings)).collect()
}

fn group_score(group: Group, scores: &[&PairScore], settings: &ScoreSettings) -> GroupScore {
    let pool = |tallies: &mut dyn Iterator<Item = &Tally>| {
        let mut sum = Tally::default();
        tallies.for_each(|tally| sum.add(tally));
        sum.figures()
    };
    let values = pool(&mut scores.iter().map(|score| &score.tally));
    let mut resampled: Vec<Vec<f64>> = vec![Vec::new(); Figures::NAMES.len()];
    if scores.len() > 1 {
        let mut rng = Pcg64::seed_from_u64(settings.bootstrap_seed);
        for _ in 0..settings.bootstrap_samples {
            let draw: Vec<usize> = (0..scores.len()).map(|_| rng.random_range(0..scores.len())).collect();
            let figures = pool(&mut draw.iter().map(|&index| &scores[index].tally));
            for (samples, value) in resampled.iter_mut().zip(figures.values()) {
                samples.extend(value);
            }
        }
    }
    for samples in &mut resampled {
        samples.sort_unstable_by(f64::total_cmp);
    }
    let figures = values.map(|index, value| {
        let samples = &resampled[index];
        let at = |fraction: f64| samples[((samples.len() - 1) as f64 * fraction).round() as usize];
        let interval_95 = (!samples.is_empty()).then(|| [at(0.025), at(0.975)]);
        value.map(|value| Estimate { value, interval_95 })
    });
    let residuals = scores.iter().flat_map(|score| &score.residuals);
    GroupScore { group, images: scores.len(), figures, calibration: calibration(residuals) }
}

/// Sums over images from which every figure follows.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tally {
    sums: [f64; Sum::COUNT],
    across: Histogram,
    disparity: Histogram,
    any_distance: Histogram,
}

impl Default for Tally {
    fn default() -> Self {
        let empty = Histogram::default;
        Self { sums: [0.0; Sum::COUNT], across: empty(), disparity: empty(), any_distance: empty() }
    }
}

/// What is summed; lengths in px.
#[derive(Clone, Copy)]
enum Sum {
    Images,
    Asked,
    Predicted,
    PredictedWithTilt,
    Error,
    DepthError,
    Bad1,
    Bad3,
    Bad5,
    Truth,
    Found,
    Result,
    Right,
    Junctions,
    Missed,
    Extra,
    LineTruth,
    LineFound,
    LineDetected,
    LineRight,
    WithSigma,
    Within1,
    Within2,
}

impl Sum {
    const COUNT: usize = Sum::Within2 as usize + 1;
}

impl Tally {
    pub fn new(
        residuals: &[Residual],
        compared: &Compared,
        end_to_end: &EndToEndScore,
        lines: &LineScore,
        pair: &TruthPair<'_>,
    ) -> Self {
        let mut tally = Self::default();
        let sums = &mut tally.sums;
        let mut add = |sum: Sum, value: f64| sums[sum as usize] += value;
        let gain = pair.tilts.map(|tilts| tilts.depth_gain().abs());
        add(Sum::Images, 1.0);
        for piece in residuals {
            let length = piece.length_px;
            add(Sum::Asked, length);
            for (sum, limit) in [(Sum::Bad1, 1.0), (Sum::Bad3, 3.0), (Sum::Bad5, 5.0)] {
                add(sum, if piece.is_bad(limit) { length } else { 0.0 });
            }
            let Some(error) = piece.error else { continue };
            add(Sum::Predicted, length);
            add(Sum::Error, length * error.distance_px);
            if let Some(gain) = gain {
                add(Sum::PredictedWithTilt, length);
                add(Sum::DepthError, length * error.distance_px * gain);
            }
            for (sum, multiple) in [(Sum::Within1, 1.0), (Sum::Within2, 2.0)] {
                add(sum, if error.is_within(multiple) == Some(true) { length } else { 0.0 });
            }
            add(Sum::WithSigma, if error.sigma_px.is_some() { length } else { 0.0 });
        }
        add(Sum::Truth, compared.truth_length);
        add(Sum::Found, compared.truth_found);
        add(Sum::Result, compared.result_length);
        add(Sum::Right, compared.result_right);
        add(Sum::Junctions, end_to_end.junctions.truth as f64);
        add(Sum::Missed, end_to_end.junctions.missed as f64);
        add(Sum::Extra, end_to_end.junctions.extra as f64);
        add(Sum::LineTruth, lines.truth_length_px);
        add(Sum::LineFound, lines.truth_length_px * lines.sensitivity);
        add(Sum::LineDetected, lines.detected_length_px);
        add(Sum::LineRight, lines.detected_length_px * lines.precision.unwrap_or(0.0));
        for (across, disparity, weight) in &compared.matched {
            tally.across.add(*across, *weight);
            tally.disparity.add(*disparity, *weight);
        }
        for (distance, weight) in &compared.any_distance {
            tally.any_distance.add(*distance, *weight);
        }
        tally
    }

    fn add(&mut self, other: &Self) {
        self.sums.iter_mut().zip(&other.sums).for_each(|(sum, value)| *sum += value);
        self.across.merge(&other.across);
        self.disparity.merge(&other.disparity);
        self.any_distance.merge(&other.any_distance);
    }

    fn figures(&self) -> Figures<Option<f64>> {
        let sum = |sum: Sum| self.sums[sum as usize];
        let ratio = |of: Sum, to: Sum| (sum(to) > 0.0).then(|| sum(of) / sum(to));
        let percent = |of: Sum| ratio(of, Sum::Asked).map(|share| 100.0 * share);
        let (completeness, correctness) = (ratio(Sum::Found, Sum::Truth), ratio(Sum::Right, Sum::Result));
        let (sensitivity, precision) =
            (ratio(Sum::LineFound, Sum::LineTruth), ratio(Sum::LineRight, Sum::LineDetected));
        Figures {
            coverage: ratio(Sum::Predicted, Sum::Asked),
            epe_px: ratio(Sum::Error, Sum::Predicted),
            bad_1_percent: percent(Sum::Bad1),
            bad_3_percent: percent(Sum::Bad3),
            bad_5_percent: percent(Sum::Bad5),
            depth_error_px: ratio(Sum::DepthError, Sum::PredictedWithTilt),
            completeness,
            correctness,
            f_score: completeness.map(|completeness| f_score(completeness, correctness)),
            across_mean_px: self.across.mean(),
            across_p95_px: self.across.quantile(0.95),
            disparity_mean_px: self.disparity.mean(),
            disparity_p95_px: self.disparity.quantile(0.95),
            any_distance_mean_px: self.any_distance.mean(),
            any_distance_p95_px: self.any_distance.quantile(0.95),
            junctions_missed: ratio(Sum::Missed, Sum::Junctions),
            junctions_extra_per_image: ratio(Sum::Extra, Sum::Images),
            cl_dice: sensitivity.map(|sensitivity| f_score(sensitivity, precision)),
            within_1_sigma: ratio(Sum::Within1, Sum::WithSigma),
            within_2_sigma: ratio(Sum::Within2, Sum::WithSigma),
        }
    }
}

/// Weight by value, with the exact sum beside it for the mean.
#[derive(Clone, Debug, PartialEq)]
struct Histogram {
    bins: Vec<f64>,
    weight: f64,
    sum: f64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { bins: vec![0.0; BINS], weight: 0.0, sum: 0.0 }
    }
}

impl Histogram {
    fn add(&mut self, value: f64, weight: f64) {
        // A bin holds the values up to its upper end, so that 0.02 px is in the first.
        let bin = ((value / BIN_PX - 1e-9).ceil().max(1.0) as usize - 1).min(BINS - 1);
        self.bins[bin] += weight;
        self.weight += weight;
        self.sum += value * weight;
    }

    fn merge(&mut self, other: &Self) {
        self.bins.iter_mut().zip(&other.bins).for_each(|(bin, more)| *bin += more);
        self.weight += other.weight;
        self.sum += other.sum;
    }

    fn mean(&self) -> Option<f64> {
        (self.weight > 0.0).then(|| self.sum / self.weight)
    }

    /// The upper end of the bin that the quantile lies in.
    fn quantile(&self, fraction: f64) -> Option<f64> {
        let mut reached = 0.0;
        let bin = self.bins.iter().position(|weight| {
            reached += weight;
            reached >= fraction * self.weight * (1.0 - 1e-12)
        })?;
        (self.weight > 0.0).then(|| ((bin + 1) as f64 * BIN_PX * 1e6).round() / 1e6)
    }
}

//! Scores: how far a result is from the truth, by the paper's protocol and end to end (docs/truth.md).
//!
//! [`score_pair`] scores one pair, [`Summary::new`] pools many with bootstrap intervals, by tilt angle and family, and
//! [`report`] writes them. [`statistics`] measures images the way the paper's Table 3 does.
//!
//! All lengths and weights are arc lengths of sub-pixel curves: how densely a file's points are set changes no score.

mod calibration;
mod detected;
mod end_to_end;
mod error;
mod grid;
mod junctions;
mod lines;
mod pairing;
mod paper;
pub mod report;
mod result;
mod sampling;
mod space;
pub mod statistics;
mod summary;

use serde::{Deserialize, Serialize};

pub use calibration::{Calibration, FlagCalibration, SigmaDecile, calibration};
pub use detected::detected_lines;
pub use end_to_end::{ContrastScore, EndToEndScore, FAR_PX, Spread};
pub use error::ScoreError;
pub use junctions::JunctionScore;
pub use lines::{LineScore, cl_dice};
pub use paper::{CurvePredictor, PaperScore, Prediction, Residual, ResidualError, paper_score, residuals};
pub use result::{ResultCurve, ResultCurves, ResultPoint};
pub use space::Basis;
pub use statistics::{ImageStatistics, image_statistics};
pub use summary::{Estimate, Figures, Group, GroupScore, Summary};

use crate::geometry::Point2;
use crate::truth::{TrueView, TruthPair};
use summary::Tally;

/// Tolerances of the scores. The defaults are the protocols; other values are for looking, not for reporting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScoreSettings {
    /// Partners are at most this far apart across the line, px of the left image.
    pub across_tolerance_px: f64,
    /// And this far in disparity, after one offset for the pair.
    pub disparity_tolerance_px: f64,
    /// In the paper's protocol, a result's curve speaks for true points this far beside it, px.
    pub reach_px: f64,
    /// Width of the line masks of clDice, px: what the paper's authors painted.
    pub mask_width_px: f64,
    /// Resamples of the bootstrap over images.
    pub bootstrap_samples: usize,
    /// Seed of the bootstrap.
    pub bootstrap_seed: u64,
}

impl Default for ScoreSettings {
    fn default() -> Self {
        Self {
            across_tolerance_px: 2.0,
            disparity_tolerance_px: 2.0,
            reach_px: 3.0,
            mask_width_px: 3.0,
            bootstrap_samples: 1000,
            bootstrap_seed: 1,
        }
    }
}

/// All scores of one pair.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairScore {
    /// Name of the pair.
    pub name: String,
    /// Family of the images, if the truth says.
    pub family: Option<String>,
    /// Kind of image within its data set, if it says.
    pub kind: Option<String>,
    /// Angle from the left view to the right one in degrees, if known.
    pub phi_deg: Option<f64>,
    /// The paper's protocol.
    pub paper: PaperScore,
    /// End to end.
    pub end_to_end: EndToEndScore,
    /// Whether sigma means what it says.
    pub calibration: Calibration,
    /// Line detection in the left image.
    pub lines: LineScore,
    /// What limits these figures: labels without a partner, unknown geometry.
    pub notes: Vec<String>,
    /// Sums for pooling; not in files, so scores that were read from one cannot be pooled again.
    #[serde(skip)]
    tally: Tally,
    /// Residuals of the paper's protocol, for pooled calibration; not in files.
    #[serde(skip)]
    residuals: Vec<Residual>,
}

/// Scores a result against the truth of its pair.
///
/// # Errors
/// Where the result reaches far outside the images of the truth, nothing of the truth is visible in both views, or units
/// cannot be compared.
pub fn score_pair(
    name: &str,
    result: &ResultCurves,
    pair: &TruthPair<'_>,
    settings: &ScoreSettings,
) -> Result<PairScore, ScoreError> {
    check_reach(result, pair)?;
    let by_paper = || {
        let predictor = CurvePredictor::new(result, settings.reach_px);
        let residuals = residuals(pair, |left, direction| predictor.predict(left, direction));
        (residuals, lines::line_score(result, pair, settings.mask_width_px))
    };
    let ((residuals, lines), end_to_end) =
        rayon::join(by_paper, || end_to_end::end_to_end_score(result, pair, settings));
    if residuals.is_empty() {
        let (left, right) = (pair.left.name.clone(), pair.right.name.clone());
        return Err(ScoreError::NothingToFind { left, right, curves: pair.truth.curves.len() });
    }
    let (end_to_end, compared) = end_to_end?;
    let tally = Tally::new(&residuals, &compared, &end_to_end, &lines, pair);
    Ok(PairScore {
        name: name.into(),
        family: pair.truth.family.clone(),
        kind: None,
        phi_deg: pair.tilts.map(|tilts| (tilts.phi().to_degrees() * 1e6).round() / 1e6),
        paper: paper_score(pair, &residuals),
        end_to_end,
        calibration: calibration(&residuals),
        lines,
        notes: notes(result, pair),
        tally,
        residuals,
    })
}

/// A matched point may lie a little outside an image, but a result for another image lies far outside.
fn check_reach(result: &ResultCurves, pair: &TruthPair<'_>) -> Result<(), ScoreError> {
    let points = || result.curves.iter().flat_map(|curve| &curve.points);
    let check = |view: &'static str, truth: &TrueView, point: Point2| {
        let (width, height) = (truth.width as f64, truth.height as f64);
        // A tenth of the image: right points are extrapolated along the row.
        let inside = |at: f64, side: f64| at > -0.1 * side - 2.0 && at < 1.1 * side + 2.0;
        if inside(point.x, width) && inside(point.y, height) {
            return Ok(());
        }
        Err(ScoreError::ImageSize { view, x: point.x, y: point.y, width: truth.width, height: truth.height })
    };
    points().try_for_each(|point| check("left", pair.left, point.left))?;
    points().try_for_each(|point| check("right", pair.right, point.right))
}

fn notes(result: &ResultCurves, pair: &TruthPair<'_>) -> Vec<String> {
    let mut notes = Vec::new();
    for (labels, view) in pair.unpaired_labels().into_iter().zip([pair.left, pair.right]) {
        if !labels.is_empty() {
            notes.push(format!(
                "{} curves of the truth are only in '{}' and are not asked for: {}",
                labels.len(),
                view.name,
                labels.iter().take(8).copied().collect::<Vec<_>>().join(", ")
            ));
        }
    }
    if pair.geometry.is_none() {
        notes.push(
            "the truth has no tilts or no maps: rows are taken as epipolar lines, and x, y and depth of the result are not \
             judged, only its image columns"
                .into(),
        );
    }
    if result.unmatched_left.is_none() {
        notes.push("no lines.csv beside the curves: line detection is scored on matched lines only".into());
    }
    notes
}

#[cfg(test)]
mod tests;

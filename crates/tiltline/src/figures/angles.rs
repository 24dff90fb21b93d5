//! Table 1: the error of depth against the angle between the views, raw and refined.
//!
//! Every pair is detected, traced and matched once; the matched curves are then taken as they are, snapped to the nearest detected
//! pixel (the paper's refinement), and refined along curves (ours).

use std::fmt::Write;

use serde::{Deserialize, Serialize};

use super::FiguresError;
use super::chart::{Line, Panel, lines};
use super::pool::{pooled, with_interval};
use crate::matching::unmatched_lines;
use crate::micrograph::StereoPair;
use crate::pipeline::{Detect, Match, reconstruct};
use crate::reconstruction::Reconstruction;
use crate::refine::{RefineSettings, Refinement, refine};
use crate::score::{PaperScore, ResultCurves, ScoreError, ScoreSettings, score_pair};
use crate::settings::Settings;
use crate::triangulate::triangulate;
use crate::truth::TruthPair;

/// Methods of refinement, with their words.
pub const REFINEMENTS: [(Refinement, &str); 3] = [
    (Refinement::None, "raw"),
    (Refinement::Nearest, "refined, to the nearest pixel (the paper's)"),
    (Refinement::Curve, "refined, along curves"),
];

/// Angles of the paper's table, degrees, and its depth errors in px, raw and refined.
const PAPER: [(f64, f64, f64); 6] = [
    (2.0, 18.3, 18.0),
    (4.0, 21.5, 20.1),
    (6.0, 15.0, 14.7),
    (8.0, 14.6, 13.2),
    (10.0, 22.2, 21.8),
    (12.0, 28.4, 29.9),
];

/// Scores of one pair by the paper's protocol.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the pair.
    pub item: String,
    /// Angle between the views, degrees.
    pub phi_deg: f64,
    /// A score for each of [`REFINEMENTS`]; none where nothing of the truth is visible in both views.
    pub scores: Option<Vec<PaperScore>>,
}

/// Reconstructs a pair and scores it with each refinement; a pair that cannot be rectified counts as nothing found.
///
/// # Errors
/// Where a result cannot be scored.
pub fn measure(
    item: &str,
    pair: StereoPair,
    truth: &TruthPair<'_>,
    detector: &dyn Detect,
    matcher: &dyn Match,
    settings: &Settings,
) -> Result<Row, FiguresError> {
    let phi_deg = (pair.tilts.phi().to_degrees() * 1e6).round() / 1e6;
    let mut settings = settings.clone();
    settings.refine.method = Refinement::None;
    let raw = reconstruct(pair, detector, matcher, &settings, &|_| {}).ok();
    let score = |(method, _): (Refinement, &str)| {
        let result = raw.as_ref().map_or_else(ResultCurves::none, |raw| refined(raw, method, &settings));
        match score_pair(item, &result, truth, &ScoreSettings::default()) {
            Ok(score) => Ok(Some(score.paper)),
            Err(ScoreError::NothingToFind { .. }) => Ok(None),
            Err(error) => Err(FiguresError::from(error)),
        }
    };
    let scores = REFINEMENTS.into_iter().map(score).collect::<Result<Option<Vec<_>>, _>>()?;
    Ok(Row { item: item.into(), phi_deg, scores })
}

/// A result with unrefined curves as it is with another refinement.
fn refined(raw: &Reconstruction, method: Refinement, settings: &Settings) -> ResultCurves {
    let rectification = &raw.rectified.rectification;
    let matched =
        refine(raw.matched.clone(), &raw.traces, rectification, &RefineSettings { method, ..settings.refine.clone() });
    let sigma_phi_rad = settings.measure.tilt_sigma_deg.to_radians();
    let (curves, frame) = triangulate(&matched, &raw.rectified, &raw.pair, sigma_phi_rad, settings.flip_depth);
    let unmatched = unmatched_lines(&matched, &raw.traces, rectification);
    ResultCurves::from(&Reconstruction { matched, curves, frame, unmatched, ..raw.clone() })
}

fn angles(rows: &[Row]) -> Vec<f64> {
    let mut angles: Vec<f64> = rows.iter().map(|row| row.phi_deg.abs()).collect();
    angles.sort_by(f64::total_cmp);
    angles.dedup();
    angles
}

/// Value times weight and weight of each pair at an angle that `part` gives one for.
fn parts(
    rows: &[Row],
    angle_deg: f64,
    method: usize,
    part: impl Fn(&PaperScore) -> Option<(f64, f64)>,
) -> Vec<(f64, f64)> {
    let here = rows.iter().filter(|row| row.phi_deg.abs() == angle_deg);
    here.filter_map(|row| part(row.scores.as_ref()?.get(method)?)).collect()
}

fn of_predicted(score: &PaperScore, value: Option<f64>) -> Option<(f64, f64)> {
    let weight = score.coverage * score.truth_length_px;
    Some((value? * weight, weight))
}

fn depth(score: &PaperScore) -> Option<(f64, f64)> {
    of_predicted(score, score.depth_error_px)
}

fn epe(score: &PaperScore) -> Option<(f64, f64)> {
    of_predicted(score, score.epe_px)
}

fn covered(score: &PaperScore) -> Option<(f64, f64)> {
    Some((score.coverage * score.truth_length_px, score.truth_length_px))
}

/// A figure's name, its unit, decimals, and how it is taken from a score.
type Figure = (&'static str, usize, fn(&PaperScore) -> Option<(f64, f64)>);

/// The table, with the paper's figures below ours.
pub fn table(rows: &[Row]) -> String {
    let angles = angles(rows);
    let mut text = String::from("| |");
    for angle in &angles {
        let _ = write!(text, " {angle}\u{b0} |");
    }
    text += &format!("\n|---|{}\n", "---|".repeat(angles.len()));
    let figures: [Figure; 3] = [("depth error, px", 1, depth), ("EPE, px", 2, epe), ("coverage", 3, covered)];
    for (name, decimals, part) in figures {
        for (method, (_, word)) in REFINEMENTS.iter().enumerate() {
            let _ = write!(text, "| {name}, {word} |");
            for angle in &angles {
                let _ = write!(text, " {} |", with_interval(pooled(&parts(rows, *angle, method, part)), decimals));
            }
            text += "\n";
        }
    }
    for (index, word) in ["raw", "refined"].into_iter().enumerate() {
        let _ = write!(text, "| [the paper: depth error, px, {word}] |");
        for angle in &angles {
            let known = PAPER.iter().find(|paper| paper.0 == *angle);
            let value =
                known.map_or("-".into(), |paper| format!("[{:.1}]", if index == 0 { paper.1 } else { paper.2 }));
            let _ = write!(text, " {value} |");
        }
        text += "\n";
    }
    text
}

/// The chart: depth error and end-point error against the angle.
pub fn draw(rows: &[Row]) -> String {
    const COLOURS: [&str; 3] = ["#8a8f98", "#e69f00", "#0072b2"];
    let angles = angles(rows);
    let labels: Vec<String> = angles.iter().map(f64::to_string).collect();
    let panel = |heading: &str, part: fn(&PaperScore) -> Option<(f64, f64)>| Panel {
        heading: heading.to_owned(),
        y_title: heading.to_owned(),
        y: None,
        lines: REFINEMENTS
            .iter()
            .enumerate()
            .map(|(method, (_, word))| Line {
                name: (*word).into(),
                colour: COLOURS[method],
                dashed: false,
                values: angles
                    .iter()
                    .map(|angle| pooled(&parts(rows, *angle, method, part)).map(|estimate| estimate.value))
                    .collect(),
            })
            .collect(),
    };
    let panels = [panel("Depth error (px)", depth), panel("End-point error (px)", epe)];
    lines("Error against the angle between the views", "angle between the views (degrees)", &labels, &panels, 2)
}

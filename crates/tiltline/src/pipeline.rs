//! The main job: two micrographs in, 3D curves out (paper, Figure 1).

use std::time::Instant;

use ndarray::Array2;

use crate::curve::{LineMap, MatchedCurve, TraceGraph, UnmatchedLine};
use crate::matching::unmatched_lines;
use crate::measure::measure;
use crate::micrograph::{StereoPair, View};
use crate::progress::{Event, Progress, Stage};
use crate::reconstruction::Reconstruction;
use crate::rectify::{RectifiedPair, RectifyError, rectify};
use crate::refine::refine;
use crate::settings::Settings;
use crate::trace::trace;
use crate::triangulate::triangulate;
use crate::warning::Warning;

/// Finds lines in one view of a rectified pair: the ridge filter, a network, or the simulator's truth.
pub trait Detect: Sync {
    /// Line probability on the rectified grid of that view, zero where it has no data.
    fn detect(&self, pair: &RectifiedPair, view: View) -> LineMap;

    /// How much is found in a view (normalised) at each look that lines may have, such as their widths, where the detector decides on one for
    /// both views of a pair by the left one; nothing where it decides on none.
    fn looks(&self, _view: &Array2<f32>) -> Vec<f64> {
        Vec::new()
    }
}

/// Finds the disparity along left lines: dynamic programming, a network, or the simulator's truth.
pub trait Match: Sync {
    /// Curves found in both views, with disparity and its sigma per point; points keep the order of their left trace.
    fn match_curves(&self, pair: &RectifiedPair, lines: &[LineMap; 2], traces: &[TraceGraph; 2]) -> Vec<MatchedCurve>;
}

/// Why a reconstruction failed as a whole.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// The pair could not be rectified.
    #[error(transparent)]
    Rectify(#[from] RectifyError),
}

/// Reconstructs the 3D curves of a pair.
pub fn reconstruct(
    pair: StereoPair,
    detector: &dyn Detect,
    matcher: &dyn Match,
    settings: &Settings,
    progress: Progress<'_>,
) -> Result<Reconstruction, PipelineError> {
    let (rectified, warnings) = timed(progress, Stage::Rectify, || rectify(&pair, &settings.rectify, settings.seed))?;
    Ok(reconstruct_rectified(pair, rectified, warnings, detector, matcher, settings, progress))
}

/// The main job after rectification: the entry for pairs whose geometry is known.
pub fn reconstruct_rectified(
    pair: StereoPair,
    rectified: RectifiedPair,
    mut warnings: Vec<Warning>,
    detector: &dyn Detect,
    matcher: &dyn Match,
    settings: &Settings,
    progress: Progress<'_>,
) -> Reconstruction {
    let lines = timed(progress, Stage::Detect, || View::BOTH.map(|view| detector.detect(&rectified, view)));
    let traces = timed(progress, Stage::Trace, || [0, 1].map(|view| trace(&lines[view], &settings.trace)));
    let matched = timed(progress, Stage::Match, || matcher.match_curves(&rectified, &lines, &traces));
    let matched =
        timed(progress, Stage::Refine, || refine(matched, &traces, &rectified.rectification, &settings.refine));
    let (curves, frame) = timed(progress, Stage::Triangulate, || {
        let sigma_phi_rad = settings.measure.tilt_sigma_deg.to_radians();
        triangulate(&matched, &rectified, &pair, sigma_phi_rad, settings.flip_depth)
    });
    let unmatched: Vec<UnmatchedLine> = unmatched_lines(&matched, &traces, &rectified.rectification);
    let (measures, doubts) =
        timed(progress, Stage::Measure, || measure(&curves, &frame, &rectified, &settings.measure));
    warnings.extend(doubts);
    Reconstruction { pair, rectified, lines, traces, matched, curves, unmatched, frame, measures, warnings }
}

fn timed<T>(progress: Progress<'_>, stage: Stage, work: impl FnOnce() -> T) -> T {
    progress(Event::Started(stage));
    let start = Instant::now();
    let result = work();
    progress(Event::Finished(stage, start.elapsed().as_secs_f64()));
    result
}

//! From a pair's result to one of all views, and back into the form that a pair's result has: rectified images, disparities and
//! depths of the pair, now with the poses and curves that all views agree on. So every output and measure stays what it is.

use super::faint::faint;
use super::grow::{aligned_views, extended};
use super::settle::settled;
use super::volume::{Volume, away_from};
use super::{FitSettings, FittedCurve, Grown, Hold, StartCurve, grow};
use crate::curve::{Flag, MatchedCurve, MatchedPoint, TraceEnd, TraceGraph};
use crate::geometry::{Point2, Point3, Similarity2, TiltPair, Vector2, project_at_tilt};
use crate::matching::unmatched_lines;
use crate::measure::measure;
use crate::micrograph::View;
use crate::pipeline::Detect;
use crate::progress::Stage;
use crate::reconstruction::Reconstruction;
use crate::rectify::RectifiedPair;
use crate::rectify::resample::{common_grid, resample};
use crate::series::{AlignedSeries, SavedCurve, SavedCurves, Series, SeriesError, ViewLines, saved};
use crate::settings::Settings;
use crate::trace::trace;
use crate::triangulate::triangulate;
use crate::warning::Warning;

/// Curves of the pair that are found in a smaller share of their places in other views are wrong matches, and are taken out. Where
/// the detector finds little in any view, less is asked: so much of the usual share, the median over the length of the pair's curves.
const LEAST_SUPPORT: f64 = 0.4;
const LEAST_OF_USUAL: f64 = 0.6;
/// A curve of which less lies on one of the tomogram of all views is not confirmed by it, and more support is asked of it.
const CONFIRMED: f64 = 0.5;
const LEAST_UNCONFIRMED: f64 = 0.8;
const LEAST_OF_USUAL_UNCONFIRMED: f64 = 1.2;
/// Curves of the tomogram must be found in this share: faint lines are in it that hardly any view shows by itself.
const LEAST_OF_TOMOGRAM: f64 = 0.1;
/// So many views beside the pair are needed to say so.
const LEAST_OTHERS: usize = 3;
/// Points on lines of so many views are measured.
const MEASURED_VIEWS: usize = 2;
/// A curve's end belongs to a junction this near, px.
const JUNCTION_PX: f64 = 8.0;

/// A result of all views.
#[derive(Clone, Debug)]
pub struct SeriesFit {
    /// The result, in the frame of the pair.
    pub reconstruction: Reconstruction,
    /// Poses and lines of the views, in the frame of the result's curves.
    pub grown: Grown,
    /// The alignment of the series, refined on the curves.
    pub refined: AlignedSeries,
}

/// Fits the curves of a pair's result to all views of its series. `pair` are the places of left and right in the series;
/// `lines_of` finds the lines of a view.
///
/// # Errors
/// Where a view cannot be read.
#[expect(clippy::too_many_arguments, reason = "the stages of a pair and the parts of a series meet here")]
pub fn reconstruct_series(
    result: Reconstruction,
    pair: [usize; 2],
    series: &Series,
    aligned: &AlignedSeries,
    detector: &dyn Detect,
    settings: &Settings,
    fit: &FitSettings,
    lines_of: &mut dyn FnMut(usize) -> Result<ViewLines, SeriesError>,
) -> Result<SeriesFit, SeriesError> {
    let sigma_row_px = result.rectified.rectification.sigma_row_px;
    let fit = &FitSettings { pair_row_sigma_px: fit.pair_row_sigma_px.max(sigma_row_px), ..fit.clone() };
    let saved = SavedCurves::of(&result);
    let poses = saved.poses;
    let start: Vec<StartCurve> = saved
        .curves
        .into_iter()
        .map(|SavedCurve { points, sigma_z, closed, .. }| StartCurve { points, sigma_z, closed })
        .collect();
    let starts = [(pair[0], poses[0]), (pair[1], poses[1])];
    let registered = grow(&start, starts, series, aligned, fit, lines_of)?;
    let views = aligned_views(starts, series, aligned, &registered.views, lines_of)?;
    let (mut grown, found, is_aligned) = settled(registered, views, &start, fit);
    let confirmed = found.confirmed(&grown.curves);
    let of_pair = kept(&grown, &confirmed, &found);
    let new = away_from(&found.curves, of_pair.iter().map(|index| &grown.curves[*index]));
    if !new.is_empty() {
        // Where the pair's curves led astray they hold nothing; what views agree on does.
        let (hold, held) = if is_aligned { (Hold::AGREED, &[][..]) } else { (Hold::LOOSE, &start[..]) };
        grown = extended(grown, hold, &new, held, fit);
    }
    let mut kept = kept(&grown, &confirmed, &found);
    let known: Vec<&FittedCurve> = kept.iter().map(|index| &grown.curves[*index]).collect();
    // One that was taken out may come back from what all views show, where that is.
    let faint = faint(&grown.views, &known);
    let fitted = grown.curves.len();
    kept.extend(fitted..fitted + faint.len());
    grown.curves.extend(faint);
    let mut reconstruction = in_pair_form(result, &grown, &kept, detector, settings);
    reconstruction.warnings.extend(warnings(&grown, series, &kept, [start.len(), fitted]));
    if is_aligned {
        let message = format!(
            "the {} views agree better where the alignment of the series and what they show together puts them than where the curves of the pair \
             do, which are then wrong in part. Look at the curves in other views (tiltline reproject), and try another --pair",
            grown.views.len()
        );
        reconstruction.warnings.push(Warning::new(Stage::Refine, message));
    }
    let Reconstruction { rectified, pair, frame, .. } = &reconstruction;
    grown.move_to(saved::poses(&rectified.rectification, pair.tilts, frame));
    let refined = refined(&grown, series, aligned, pair.tilts.mid_rad());
    Ok(SeriesFit { reconstruction, grown, refined })
}

/// The alignment with the fitted poses; views that took no part move with their nearest one.
fn refined(grown: &Grown, series: &Series, aligned: &AlignedSeries, mid: f64) -> AlignedSeries {
    let pose = |view: usize| {
        let nominal = series.views[view].tilt_deg.to_radians();
        let off = |other: &super::FitView| (other.nominal_rad + mid - nominal).abs();
        let nearest = grown.views.iter().min_by(|a, b| off(a).total_cmp(&off(b))).expect("the pair took part");
        let moved = nearest.pose.origin() - aligned.poses[nearest.view].origin();
        match grown.views.iter().find(|other| other.view == view) {
            Some(fitted) => super::ViewPose { tilt_rad: fitted.pose.tilt_rad + mid, ..fitted.pose },
            None => {
                let origin = aligned.poses[view].origin() + moved;
                super::ViewPose::new(nominal, nearest.pose.axis_rad(), nearest.pose.scale(), origin)
            }
        }
    };
    let poses: Vec<super::ViewPose> = (0..series.views.len()).map(pose).collect();
    AlignedSeries { axis_rad: grown.views[0].pose.axis_rad(), poses, ..aligned.clone() }
}

fn in_pair_form(
    mut result: Reconstruction,
    grown: &Grown,
    kept: &[usize],
    detector: &dyn Detect,
    settings: &Settings,
) -> Reconstruction {
    let mid = result.pair.tilts.mid_rad();
    let [left, right] = [0, 1].map(|view| &grown.views[view].pose);
    let tilts = TiltPair { left_rad: mid + left.tilt_rad, right_rad: mid + right.tilt_rad };
    // The images on a grid whose rows are epipolar lines of the fitted poses.
    let shapes = [&result.pair.left, &result.pair.right].map(|image| [image.height(), image.width()]);
    let maps = [left, right].map(|pose| pose.image_from_projection.inverse());
    let grid = common_grid(shapes, [&maps[0], &maps[1]]);
    let shifted = |map: &Similarity2| {
        let mut map = *map;
        map.isometry.translation.vector += grid.shift;
        map
    };
    let maps = maps.each_ref().map(shifted);
    let images = View::BOTH.map(|view| result.pair.view(view).normalised());
    let [left_image, right_image] = [0, 1].map(|view| resample(&images[view].view(), &maps[view], grid.shape));
    let old = result.rectified.rectification.clone();
    let turned = maps[0].isometry.rotation.angle() - maps[1].isometry.rotation.angle();
    let rectification = crate::rectify::Rectification {
        rectified_from_left: maps[0],
        rectified_from_right: maps[1],
        shape: grid.shape,
        axis_deg: left.axis_rad().to_degrees(),
        relative_rotation_deg: turned.sin().atan2(turned.cos()).to_degrees(),
        relative_scale: right.scale() / left.scale(),
        ..old
    };
    result.pair.tilts = tilts;
    result.rectified = RectifiedPair { left: left_image, right: right_image, rectification };
    result.lines = View::BOTH.map(|view| detector.detect(&result.rectified, view));
    result.traces = [0, 1].map(|view| trace(&result.lines[view], &settings.trace));

    let depth_gain = tilts.depth_gain().abs();
    let in_left = |point: &Point3| project_at_tilt(point, left.tilt_rad) + grid.shift;
    let in_right = |point: &Point3| project_at_tilt(point, right.tilt_rad) + grid.shift;
    let matched = kept.iter().map(|&index| {
        // None for a curve of a tomogram.
        let (curve, old) = (&grown.curves[index], result.matched.get(index));
        let [on_left, on_right]: [Vec<Point2>; 2] =
            [curve.points.iter().map(in_left).collect(), curve.points.iter().map(in_right).collect()];
        let points = (0..curve.points.len()).map(|at| MatchedPoint {
            left: on_left[at],
            tangent_left: tangent(&on_left, at),
            tangent_right: Some(tangent(&on_right, at)),
            disparity_px: on_right[at].x - on_left[at].x,
            sigma_px: curve.sigma_z[at] / depth_gain,
            flag: flag(curve, at, old.map_or(Flag::Bridged, |old| old.points[at].flag), &grown.views),
        });
        let points: Vec<MatchedPoint> = points.collect();
        let left_trace = nearest_trace(&points, &result.traces[0]).unwrap_or(0);
        let (first, last) = (points[0].left, points[points.len() - 1].left);
        let ends = old.map_or([TraceEnd::Free; 2], |old| old.ends);
        let ends = [(ends[0], first), (ends[1], last)].map(|(end, place)| at_junction(end, &place, &result.traces[0]));
        MatchedCurve { left_trace, points, closed: curve.closed, ends }
    });
    let matched: Vec<MatchedCurve> = matched.collect();
    result.matched = matched;
    // An error of the tilts scales depths by less the further the views are apart.
    let spread: f64 = grown.views.iter().map(|view| view.pose.tilt_rad.powi(2)).sum::<f64>().sqrt();
    let sigma_rad = settings.measure.tilt_sigma_deg.to_radians() / std::f64::consts::SQRT_2;
    let sigma_phi_rad = sigma_rad / spread.max(1e-9) * tilts.phi().abs();
    (result.curves, result.frame) =
        triangulate(&result.matched, &result.rectified, &result.pair, sigma_phi_rad, result.frame.depth_flipped);
    result.unmatched = unmatched_lines(&result.matched, &result.traces, &result.rectified.rectification);
    let (measures, doubts) = measure(&result.curves, &result.frame, &result.rectified, &settings.measure);
    result.measures = measures;
    // What was measured on the pair alone is measured anew.
    result.warnings.retain(|warning| warning.stage != Stage::Measure);
    result.warnings.extend(doubts);
    result
}

/// The curves that are kept, the first ones those of the pair with what the tomogram says to each.
///
/// A curve of the pair must be supported by other views; one that the tomogram does not show, where it would, by more of them. Those
/// behind are the tomogram's own.
fn kept(grown: &Grown, confirmed: &[f64], found: &Volume) -> Vec<usize> {
    let of_pair = confirmed.len();
    let usual = usual_support(&grown.curves[..of_pair]);
    let few = grown.views.len() < 2 + LEAST_OTHERS;
    let is_kept = |index: &usize| {
        let support = grown.curves[*index].support;
        match confirmed.get(*index) {
            None => support >= LEAST_OF_TOMOGRAM,
            Some(_) if few => true,
            Some(share) if found.is_decisive && *share < CONFIRMED => {
                support >= LEAST_UNCONFIRMED.min(LEAST_OF_USUAL_UNCONFIRMED * usual)
            }
            Some(_) => support >= LEAST_SUPPORT.min(LEAST_OF_USUAL * usual),
        }
    };
    (0..grown.curves.len()).filter(is_kept).collect()
}

/// The median support over the length of curves.
fn usual_support(curves: &[FittedCurve]) -> f64 {
    let mut shares: Vec<(f64, usize)> = curves.iter().map(|curve| (curve.support, curve.points.len())).collect();
    shares.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = shares.iter().map(|share| share.1).sum::<usize>() / 2;
    let mut passed = 0;
    let usual = shares.iter().find(|(_, length)| {
        passed += length;
        passed > half
    });
    usual.map_or(1.0, |share| share.0)
}

/// What is to be said of the views and of the curves that are kept, the first `of_pair` of all being those of the pair and those from
/// `fitted` on faint ones.
fn warnings(grown: &Grown, series: &Series, kept: &[usize], [of_pair, fitted]: [usize; 2]) -> Vec<Warning> {
    let from = |first: usize| kept.iter().filter(|index| **index >= first).count();
    let (added, faint) = (from(of_pair) - from(fitted), from(fitted));
    let out = of_pair + added + faint - kept.len();
    let mut warnings = Vec::new();
    if !grown.left_out.is_empty() {
        let mut tilts: Vec<f64> = grown.left_out.iter().map(|view| series.views[*view].tilt_deg).collect();
        tilts.sort_by(f64::total_cmp);
        let tilts: Vec<String> = tilts.iter().map(f64::to_string).collect();
        let message = format!(
            "{} of {} views take no part: the curves do not lie on the lines found at {} degrees",
            tilts.len(),
            series.views.len(),
            tilts.join(", ")
        );
        warnings.push(Warning::new(Stage::Refine, message));
    }
    if added > 0 {
        let message =
            format!("{added} curves were added that the pair does not show, from what all views show together");
        warnings.push(Warning::new(Stage::Match, message));
    }
    if faint > 0 {
        let message = format!(
            "{faint} curves were added that are too faint for the detector in most views (all flagged as bridged): all views together show \
             them, and they could be something else that is faint; their sigma is that of the volume they are found in"
        );
        warnings.push(Warning::new(Stage::Match, message));
    }
    if out > 0 {
        let message = format!(
            "{out} of {of_pair} curves of the pair were taken out as wrong matches: too little of them lies on lines of the other views, or \
             all views together do not show them (lines.csv has their lines)"
        );
        warnings.push(Warning::new(Stage::Refine, message));
    }
    warnings
}

/// How far a point is trusted: as in the pair where only the pair sees it.
fn flag(curve: &FittedCurve, at: usize, before: Flag, views: &[super::FitView]) -> Flag {
    match curve.seen[at] {
        seen if seen > MEASURED_VIEWS || (seen == MEASURED_VIEWS && views.len() > 2 && before == Flag::Ok) => Flag::Ok,
        seen if seen >= MEASURED_VIEWS => before,
        _ => Flag::Bridged,
    }
}

fn tangent(points: &[Point2], at: usize) -> Vector2 {
    let step = points[(at + 1).min(points.len() - 1)] - points[at.saturating_sub(1)];
    step.try_normalize(1e-9).unwrap_or_else(Vector2::y)
}

/// The trace that most of a curve's points are nearest to.
fn nearest_trace(points: &[MatchedPoint], graph: &TraceGraph) -> Option<usize> {
    let mut votes = vec![0_usize; graph.traces.len()];
    for point in points.iter().step_by(5) {
        let distance = |trace: &crate::curve::Trace| {
            let each = trace.points.iter().map(|other| (other.position - point.left).norm_squared());
            each.fold(f64::INFINITY, f64::min)
        };
        let nearest = (0..graph.traces.len())
            .map(|trace| (distance(&graph.traces[trace]), trace))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, trace)) = nearest {
            votes[trace] += 1;
        }
    }
    (0..votes.len()).max_by_key(|trace| (votes[*trace], std::cmp::Reverse(*trace)))
}

/// The end of a curve among the junctions of the new traces.
fn at_junction(end: TraceEnd, place: &Point2, graph: &TraceGraph) -> TraceEnd {
    if !matches!(end, TraceEnd::Junction(_)) {
        return end;
    }
    let distance = |junction: usize| (graph.junctions[junction] - place).norm();
    let nearest = (0..graph.junctions.len()).min_by(|&a, &b| distance(a).total_cmp(&distance(b)));
    nearest.filter(|junction| distance(*junction) <= JUNCTION_PX).map_or(TraceEnd::Free, TraceEnd::Junction)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::series::fit::FitView;
    use crate::series::{LineIndex, ViewPose};

    fn curve(support: f64, points: usize) -> FittedCurve {
        let points = vec![Point3::origin(); points];
        FittedCurve { sigma_z: vec![1.0; points.len()], seen: vec![2; points.len()], points, closed: false, support }
    }

    /// Where lines are found in nearly every view a curve without support is a wrong match; where they are found in every third view
    /// only, it is one with less than most have. One that the tomogram does not show needs more; one of the tomogram less.
    #[test]
    fn support_is_held_against_what_is_usual_and_the_tomogram() {
        let lines = LineIndex::new(ViewLines::new(TraceGraph::default(), [64, 64]));
        let view = |place: usize| {
            let tilt_rad = 0.1 * place as f64;
            FitView::new(place, ViewPose::new(tilt_rad, 0.0, 1.0, Point2::origin()), lines.clone())
        };
        let grown = |curves: Vec<FittedCurve>, views: usize| Grown {
            noise: vec![1.0; views],
            tilt_sigma_rad: vec![0.0; views],
            views: (0..views).map(view).collect(),
            left_out: Vec::new(),
            curves,
        };
        let [silent, decisive] = [false, true].map(|is_decisive| Volume { curves: Vec::new(), is_decisive });
        let well_found = || vec![curve(0.9, 100), curve(0.3, 20), curve(0.85, 60), curve(0.7, 50)];
        assert_eq!(kept(&grown(well_found(), 9), &[1.0, 1.0, 1.0, 0.0], &silent), [0, 2, 3]);
        assert_eq!(kept(&grown(well_found(), 9), &[1.0, 1.0, 1.0, 0.0], &decisive), [0, 2]);
        // Behind those of the pair: of the tomogram.
        assert_eq!(kept(&grown(well_found(), 9), &[1.0], &decisive), [0, 1, 2, 3]);
        assert_eq!(kept(&grown(vec![curve(0.9, 100), curve(0.09, 20)], 9), &[1.0], &decisive), [0]);
        // Too few views to say so.
        assert_eq!(kept(&grown(well_found(), 4), &[0.0; 4], &silent), [0, 1, 2, 3]);
        let badly_found = vec![curve(0.3, 100), curve(0.1, 20), curve(0.4, 60), curve(0.2, 30)];
        assert_eq!(kept(&grown(badly_found, 9), &[1.0; 4], &decisive), [0, 2, 3]);
        assert!((usual_support(&[curve(0.3, 100), curve(0.1, 20)]) - 0.3).abs() < 1e-12);
        assert!((usual_support(&[]) - 1.0).abs() < 1e-12);
    }
}

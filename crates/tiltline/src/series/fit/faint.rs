//! Lines that all views show a little, and of which the detector makes a line in hardly any: the curves of a tomogram of the evidence of
//! the views, as far as the views agree that they are fainter than lines that the detector is sure of.
//!
//! What is as dark as these and yet no line to the detector is something else (a boundary, a slip trace); what is fainter it may
//! have missed. Curves stay where the tomogram has them: what lines single views have near a faint one is mostly noise, to which a fit
//! would draw it.

use super::evidence::contrast_of_lines;
use super::grid::Grid;
use super::tomogram::{MOST_VOXELS, Tomogram};
use super::volume::{away_from, depth_of};
use super::{FitView, FittedCurve, StartCurve};
use crate::geometry::Point3;
use crate::series::ViewLines;

/// Views that are needed to say anything.
const LEAST_VIEWS: usize = 8;
/// A voxel belongs to a line from so many times the root mean square of a tomogram of chance on.
const ABOVE_CHANCE: f64 = 5.0;
/// Shortest curve, px: what is by chance, or left over beside known curves, is short.
const SHORTEST_PX: f64 = 20.0;
/// Contrast must be noise by this share at least: where things stand out of it, the detector has seen them, and has taken them for lines or not.
const LEAST_NOISE: f64 = 0.85;
/// The contrast of a curve against that of the lines that the detector is sure of: the mean over views is less than the first, their
/// median more than the second.
const MOST_OF_SURE: f64 = 1.0;
const LEAST_OF_SURE: f64 = 0.25;
/// It is dark where those are dark on average, or bright where they are bright, in this share of the views at least.
const LEAST_SHARE: f64 = 0.8;
/// Where the lines that the detector is sure of have less contrast, standard deviations of the views', nothing can be held against it.
const LEAST_CONTRAST: f64 = 0.2;

/// The faint curves of the views that are away from the known ones, about as deep as these; none with few views. No lines of single views
/// are counted for them, and their sigma is that of the tomogram's voxels.
pub(super) fn faint(views: &[FitView], known: &[&FittedCurve]) -> Vec<FittedCurve> {
    let shown: Vec<&FitView> = views.iter().filter(|view| is_shown(view.lines.lines())).collect();
    let Some(depth) = depth_of(known.iter().copied()) else { return Vec::new() };
    if shown.len() < LEAST_VIEWS || share_of_noise(&shown) < LEAST_NOISE {
        return Vec::new();
    }
    let Some(sure) = Contrast::of_sure_lines(&shown) else { return Vec::new() };
    let Some(tomogram) = Tomogram::new(&shown, depth, MOST_VOXELS, Grid::evidence) else { return Vec::new() };
    let least = ABOVE_CHANCE * tomogram.rms_of_chance();
    let Some(threshold) = tomogram.beyond_chance(least) else { return Vec::new() };
    let found = tomogram.curves(threshold);
    drop(tomogram);
    let mut curves = away_from(&found, known.iter().copied());
    curves.retain(|curve| curve.length_px() >= SHORTEST_PX && sure.is_fainter_line(curve, &shown));
    let fitted = |curve: StartCurve| FittedCurve {
        seen: vec![0; curve.points.len()],
        points: curve.points,
        sigma_z: curve.sigma_z,
        closed: curve.closed,
        support: 0.0,
    };
    curves.into_iter().map(fitted).collect()
}

/// How far contrast is noise: its standard deviation as the median tells it, which lines and other things that stand out hardly change,
/// in those about each place; 1 where it is normal noise only, on average over views.
fn share_of_noise(views: &[&FitView]) -> f64 {
    // Of a normal distribution.
    const SIGMA_OF_MEDIAN: f64 = 1.4826;
    let share = |view: &&FitView| {
        // Where there is no data there is no contrast.
        let known = view.lines.lines().contrast.iter().filter(|contrast| **contrast != 0);
        let mut sizes: Vec<u8> = known.map(|contrast| contrast.unsigned_abs()).collect();
        if sizes.is_empty() {
            return 0.0;
        }
        let middle = sizes.len() / 2;
        SIGMA_OF_MEDIAN * f64::from(ViewLines::CONTRAST_STEP) * f64::from(*sizes.select_nth_unstable(middle).1)
    };
    views.iter().map(share).sum::<f64>() / views.len() as f64
}

/// Whether both maps of a view are known.
fn is_shown(lines: &ViewLines) -> bool {
    !lines.probability.is_empty() && lines.probability.dim() == lines.contrast.dim()
}

/// The contrast of the lines that the detector is sure of, in standard deviations of the views': negative where they are bright.
struct Contrast(f64);

impl Contrast {
    /// On average over views; `None` where it is too small to hold anything against it.
    fn of_sure_lines(views: &[&FitView]) -> Option<Self> {
        let sum: f64 = views.iter().map(|view| f64::from(contrast_of_lines(view.lines.lines()))).sum();
        let mean = sum / views.len().max(1) as f64;
        (mean.abs() >= LEAST_CONTRAST).then_some(Self(mean))
    }

    /// Whether the views agree that a curve looks like those lines, but fainter.
    fn is_fainter_line(&self, curve: &StartCurve, views: &[&FitView]) -> bool {
        let mut each: Vec<f64> = views.iter().filter_map(|view| Some(contrast_along(curve, view)? / self.0)).collect();
        if 2 * each.len() < views.len() {
            return false;
        }
        each.sort_by(f64::total_cmp);
        let count = each.len() as f64;
        let mean = each.iter().sum::<f64>() / count;
        let alike = each.iter().filter(|contrast| **contrast > 0.0).count() as f64 / count;
        mean < MOST_OF_SURE && each[each.len() / 2] > LEAST_OF_SURE && alike >= LEAST_SHARE
    }
}

/// The mean contrast of a view along a curve; `None` where it shows less than half of it.
fn contrast_along(curve: &StartCurve, view: &FitView) -> Option<f64> {
    let contrast = &view.lines.lines().contrast;
    let at = |point: &Point3| {
        let seen = view.pose.project(point);
        let is_inside = seen.x >= -0.5 && seen.y >= -0.5;
        contrast.get([seen.y.round() as usize, seen.x.round() as usize]).filter(|_| is_inside).copied()
    };
    let inside: Vec<i8> = curve.points.iter().filter_map(at).collect();
    let sum: f64 = inside.iter().map(|contrast| f64::from(*contrast)).sum();
    let mean = f64::from(ViewLines::CONTRAST_STEP) * sum / inside.len().max(1) as f64;
    (2 * inside.len() >= curve.points.len()).then_some(mean)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use ndarray::Array2;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::curve::TraceGraph;
    use crate::filter::gaussian_blur;
    use crate::geometry::Point2;
    use crate::series::{LineIndex, ViewPose};
    use crate::simulate::draw::union_of_profiles;

    const SHAPE: [usize; 2] = [300, 360];

    /// Three lines along the tilt axis, of different depths.
    fn line(x: f64, z: f64) -> Vec<Point3> {
        (-40..=40).map(|step| Point3::new(x + 0.1 * f64::from(step), f64::from(step), z)).collect()
    }

    const SURE: (f64, f64) = (-45.0, 5.0);
    const OTHER: (f64, f64) = (0.0, -10.0);
    const FAINT: (f64, f64) = (45.0, 12.0);

    /// So many views of a line that the detector is sure of, with contrast 2; of something with the contrast `other` and a line with the
    /// contrast `faint` in each view, of both of which the detector sees nothing; and normal noise of 0.9 standard deviations,
    /// smoothed as contrast is.
    fn views(count: usize, other: f64, faint: impl Fn(usize) -> f64) -> Vec<FitView> {
        noisy_views(count, 0.9, other, faint)
    }

    fn noisy_views(count: usize, noise: f64, other: f64, faint: impl Fn(usize) -> f64) -> Vec<FitView> {
        let mut rng = Pcg64::seed_from_u64(2);
        // Nearly normal: the sum of twelve.
        let mut normal = || (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>();
        let view = |index: usize| {
            let tilt_deg = -48.0 + 96.0 * index as f64 / (count - 1) as f64;
            let pose = ViewPose::new(tilt_deg.to_radians(), 0.0, 1.0, Point2::new(179.5, 149.5));
            let drawn = |(x, z): (f64, f64)| {
                let seen: Vec<Point2> = line(x, z).iter().map(|point| pose.project(point)).collect();
                union_of_profiles(SHAPE, &[seen], 1.5)
            };
            let (sure, unlike, weak) = (drawn(SURE), drawn(OTHER), drawn(FAINT));
            // Smoothing by one px leaves 1 / (2 sqrt(pi)) of the standard deviation.
            let white = Array2::from_shape_fn(SHAPE, |_| (noise * 2.0 * std::f64::consts::PI.sqrt() * normal()) as f32);
            let smooth = gaussian_blur(&white, 1.0);
            let contrast = Array2::from_shape_fn(SHAPE, |at| {
                let lines = 2.0 * sure[at] + other as f32 * unlike[at] + faint(index) as f32 * weak[at];
                ((lines + smooth[at]) / ViewLines::CONTRAST_STEP).clamp(-127.0, 127.0) as i8
            });
            let lines = ViewLines {
                probability: Arc::new(sure.mapv(|value| (60.0 * value) as u8)),
                contrast: Arc::new(contrast),
                ..ViewLines::new(TraceGraph::default(), SHAPE)
            };
            FitView::new(index, pose, LineIndex::new(lines))
        };
        (0..count).map(view).collect()
    }

    /// What is found beside the line that is known, and for each curve whether it is the faint line.
    fn found(views: &[FitView]) -> Vec<(FittedCurve, bool)> {
        let known = FittedCurve {
            points: [line(SURE.0, SURE.1), line(SURE.0, -20.0), line(SURE.0, 25.0)].concat(),
            sigma_z: vec![1.0; 243],
            seen: vec![9; 243],
            closed: false,
            support: 1.0,
        };
        let is_right = |curve: FittedCurve| {
            let right = curve.points.iter().filter(|point| {
                let near = line(FAINT.0, FAINT.1).iter().map(|other| (other - *point).norm()).fold(9.0, f64::min);
                near < 2.0
            });
            let share = right.count() as f64 / curve.points.len() as f64;
            (curve, share > 0.9)
        };
        faint(views, &[&known]).into_iter().map(is_right).collect()
    }

    /// A line that is fainter than those that are found is one; what has as much as these would have been found if it were
    /// one.
    #[test]
    fn a_fainter_line_is_one_and_what_is_as_dark_as_lines_is_something_else() {
        let curves = found(&views(41, 2.0, |_| 1.5));
        let length: usize = curves.iter().map(|(curve, _)| curve.points.len()).sum();
        assert!(length > 60 && curves.iter().all(|(_, is_right)| *is_right), "{length} {curves:?}");
        assert!(found(&views(41, 2.0, |_| 2.0)).is_empty());
        // Bright where those are dark: hardly in the tomogram, and it would not be taken for a line.
        assert!(found(&views(41, 0.0, |_| -1.5)).is_empty());
        let points = line(FAINT.0, FAINT.1);
        let curve = StartCurve { sigma_z: vec![1.5; points.len()], points, closed: false };
        let is_line = |views: Vec<FitView>| Contrast(2.0).is_fainter_line(&curve, &views.iter().collect::<Vec<_>>());
        assert!(is_line(views(8, 0.0, |_| 1.5)) && !is_line(views(8, 0.0, |_| -1.5)));
    }

    /// Without noise the detector has seen whatever is there.
    #[test]
    fn where_things_stand_out_of_the_noise_there_are_no_faint_lines() {
        assert!(found(&noisy_views(41, 0.3, 0.0, |_| 1.5)).is_empty());
        assert!((share_of_noise(&noisy_views(8, 0.5, 0.0, |_| 0.0).iter().collect::<Vec<_>>()) - 0.5).abs() < 0.05);
    }

    /// A few views that show something, however strongly, are not all views.
    #[test]
    fn what_a_few_views_show_is_no_line() {
        let in_some = |index: usize| if index.is_multiple_of(3) { 2.0 } else { 0.0 };
        assert!(found(&views(41, 0.0, in_some)).is_empty());
    }

    #[test]
    fn few_views_and_unknown_maps_say_nothing() {
        assert!(found(&views(LEAST_VIEWS - 1, 0.0, |_| 1.5)).is_empty());
        assert!(!found(&views(33, 0.0, |_| 1.5)).is_empty());
        let blind = |view: FitView| {
            let lines = ViewLines { contrast: Arc::default(), ..view.lines.lines().clone() };
            FitView { lines: LineIndex::new(lines), ..view }
        };
        assert!(found(&views(41, 0.0, |_| 1.5).into_iter().map(blind).collect::<Vec<_>>()).is_empty());
        assert!(faint(&views(41, 0.0, |_| 1.5), &[]).is_empty());
    }
}

//! Where the pair's curves lead the views astray: poses from the alignment of the series instead, and from the lines that all views
//! show at those.
//!
//! The alignment is good to a px or two. The views agree on more: first each moves to where the tomogram of the others shows it
//! ([`consensus`](super::consensus)), then poses are fitted to the curves of the tomogram.
//!
//! Views are registered on the pair's curves. Where most of these are wrong, so are the poses; the alignment of the images, which
//! knows of no lines, is then the better start. The tomogram of lines tells: lines meet in it where poses are right.

use super::consensus::in_consensus;
use super::grow::{ROUNDS, WIDE_PX, finished, placed};
use super::volume::{ABOVE_CHANCE, Volume, depth_of};
use super::{FitSettings, FitView, FittedCurve, Grown, Problem, StartCurve};
use crate::series::{ViewPose, register};

/// Where lines meet less at aligned poses than by this share of what they do at the registered ones, these are right.
const WORTH_A_TRY: f64 = 0.5;
/// Lines must meet so much more in the end than at the registered poses.
const CLEARLY: f64 = 1.3;
/// Poses are fitted to the lines in the tomogram, and the tomogram made anew, so often.
const TIMES: usize = 4;
/// Lines are so many times above chance while poses are fitted to them: more are enough to fit to than are believed in the end.
const ABOVE_AT_FIRST: f64 = 0.75 * ABOVE_CHANCE;
/// A view of which no more lines lie on the curves than by chance, within so many px of where it is, is left out.
const SEARCH_PX: f64 = 3.0;

/// The fit, and the tomogram at its poses: of the registered views, or of those of `aligned` where lines meet clearly better in them.
/// Both begin with the views of the pair; `curves` are those of the pair. The last value says whether it is the aligned ones.
pub(super) fn settled(
    registered: Grown,
    aligned: Vec<FitView>,
    curves: &[StartCurve],
    settings: &FitSettings,
) -> (Grown, Volume, bool) {
    let volume = Volume::new(&registered.views, &registered.curves, ABOVE_CHANCE);
    let known = &registered.curves;
    let (aligned, other) = better([aligned.clone(), agreed(aligned, known)], known);
    if registered.left_out.is_empty() && other.strength <= WORTH_A_TRY * volume.strength {
        return (registered, volume, false);
    }
    // Poses from the lines that all views show, faint ones too, and more lines from better poses.
    let mut problem = Problem::new(&[], aligned.clone(), settings);
    for time in 0..TIMES {
        let above = if time + 1 < TIMES { ABOVE_AT_FIRST } else { ABOVE_CHANCE };
        let meeting = Volume::new(&problem.views, known, above);
        problem = Problem::new(&meeting.curves, problem.views, settings);
        problem.run(ROUNDS, [WIDE_PX, settings.reach_px], settings);
    }
    problem.run(settings.rounds, [settings.reach_px; 2], settings);
    let points = problem.points_with_tangents();
    let lies = |view: &FitView| {
        register(&points, &view.lines, &view.pose, SEARCH_PX, false).is_some_and(|found| found.is_supported())
    };
    let pair = [0, 1].map(|place| registered.views[place].view);
    let (mut views, mut out): (Vec<FitView>, Vec<FitView>) =
        problem.views.into_iter().partition(|view| pair.contains(&view.view) || lies(view));
    let mut settled = Volume::new(&views, known, ABOVE_CHANCE);
    if other.strength > settled.strength {
        // The curves led astray, and what does not lie on them is not wrong for that: all views stay.
        (views, out, settled) = (aligned, Vec::new(), other);
    }
    if settled.strength <= CLEARLY * volume.strength {
        return (registered, volume, false);
    }
    // The pair's curves at these poses, which the others hold.
    let mut all = curves.to_vec();
    all.extend_from_slice(&settled.curves);
    let mut problem = Problem::new(&all, views, settings);
    problem.run(ROUNDS, [WIDE_PX, settings.reach_px], settings);
    let mut grown = finished(problem, out.into_iter().map(|view| view.view).collect(), settings);
    grown.curves.truncate(curves.len());
    (grown, settled, true)
}

/// The views at those poses at which lines meet more.
fn better(both: [Vec<FitView>; 2], known: &[FittedCurve]) -> (Vec<FitView>, Volume) {
    let [first, second] = both.map(|views| {
        let volume = Volume::new(&views, known, ABOVE_CHANCE);
        (views, volume)
    });
    if first.1.strength > second.1.strength { first } else { second }
}

/// The views moved to where they agree, in the frame of the pair.
fn agreed(mut views: Vec<FitView>, known: &[FittedCurve]) -> Vec<FitView> {
    let Some(depth) = depth_of(known) else { return views };
    let poses = in_consensus(&views, depth);
    let tilts_rad: Vec<f64> = views.iter().map(|view| view.pose.tilt_rad).collect();
    let pair = [0, 1].map(|view| (view, views[view].pose));
    for (view, pose) in views.iter_mut().zip(placed(pair, &tilts_rad, &poses)) {
        view.pose = ViewPose { tilt_rad: view.pose.tilt_rad, ..pose };
    }
    views
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::super::tests::{SHAPE, curves, noisy_lines};
    use super::*;
    use crate::geometry::{Point2, Point3, Vector2};
    use crate::series::fit::FittedCurve;
    use crate::series::{LineIndex, ViewLines, ViewPose};
    use crate::simulate::draw::union_of_profiles;

    const TILTS_DEG: [f64; 11] = [-4.0, 4.0, 0.0, -12.0, 12.0, -22.0, 22.0, -32.0, 32.0, -42.0, 42.0];

    /// Views of known poses; beyond the pair they are thought to be off by so many px.
    fn views(off_px: f64) -> (Vec<ViewPose>, Vec<FitView>) {
        turned_views(off_px, 0.0, 1.0)
    }

    /// The same, of an axis that is turned and another magnification.
    fn turned_views(off_px: f64, axis_rad: f64, scale: f64) -> (Vec<ViewPose>, Vec<FitView>) {
        let mut rng = Pcg64::seed_from_u64(3);
        let view = |(index, tilt_deg): (usize, f64)| {
            let truth = ViewPose::new(tilt_deg.to_radians(), axis_rad, scale, Point2::new(255.5, 255.5));
            let lines = noisy_lines(&curves(), &truth, &mut rng);
            let drawn: Vec<Vec<Point2>> =
                curves().iter().map(|curve| curve.iter().map(|point| truth.project(point)).collect()).collect();
            let probability = union_of_profiles(SHAPE, &drawn, 1.3).mapv(|value| (255.0 * value) as u8);
            let lines = LineIndex::new(ViewLines { probability: Arc::new(probability), ..lines });
            let angle = 2.4 * index as f64;
            let shift = Vector2::new(angle.cos(), angle.sin()) * if index < 2 { 0.0 } else { off_px };
            let pose = truth.changed(0.0, 0.0, 0.0, shift, &Point2::origin());
            (truth, FitView::new(index, pose, lines))
        };
        TILTS_DEG.into_iter().enumerate().map(view).unzip()
    }

    /// The true curves, their depth times this.
    fn curves_as_start(times: f64) -> Vec<StartCurve> {
        let start = |curve: Vec<Point3>| StartCurve {
            sigma_z: vec![3.0; curve.len()],
            points: curve.into_iter().map(|point| Point3::new(point.x, point.y, times * point.z)).collect(),
            closed: false,
        };
        curves().into_iter().map(start).collect()
    }

    fn registered(views: Vec<FitView>, curves: &[StartCurve]) -> Grown {
        let fitted = |curve: &StartCurve| FittedCurve {
            points: curve.points.clone(),
            sigma_z: curve.sigma_z.clone(),
            seen: vec![2; curve.points.len()],
            closed: false,
            support: 0.3,
        };
        Grown {
            noise: vec![1.0; views.len()],
            tilt_sigma_rad: vec![0.0; views.len()],
            views,
            left_out: Vec::new(),
            curves: curves.iter().map(fitted).collect(),
        }
    }

    /// Largest error, px, of where views show the true curves.
    fn worst_px(grown: &Grown, truth: &[ViewPose]) -> f64 {
        let points: Vec<Point3> = curves().into_iter().flatten().collect();
        let off = |view: &FitView| {
            let true_pose = &truth[view.view];
            let sum = points
                .iter()
                .fold(Vector2::zeros(), |sum, point| sum + (view.pose.project(point) - true_pose.project(point)));
            (sum / points.len() as f64).norm()
        };
        grown.views.iter().map(off).fold(0.0, f64::max)
    }

    /// Views that are 5 px beside their places, of any axis and magnification, move to them by what they show, in the frame of the
    /// pair: an error of 0.1 px in where the pair's views agree is 0.7 px of depth, which far tilts show.
    #[test]
    fn views_move_to_where_they_agree() {
        for (axis_rad, scale) in [(0.0, 1.0), (0.4, 1.0), (0.4, 0.8), (0.4, 1.25)] {
            let (truth, off) = turned_views(5.0, axis_rad, scale);
            let known = registered(off.clone(), &curves_as_start(1.0)).curves;
            let grown = Grown { views: agreed(off, &known), ..registered(Vec::new(), &[]) };
            assert!(worst_px(&grown, &truth) < 1.0, "{axis_rad} {scale} {}", worst_px(&grown, &truth));
        }
    }

    /// Curves whose depth is turned over say nothing right of where other views lie; the alignment of the series does, to 1.5 px, and
    /// the lines that meet there do better, though wrong curves pull. Where the registered views are right already, they stay.
    #[test]
    fn where_the_pairs_curves_are_wrong_the_alignment_leads() {
        let turned_over = curves_as_start(-1.0);
        let settings = FitSettings::default();
        let ((truth, wrong), (_, near), (_, right)) = (views(11.0), views(1.5), views(0.0));
        let (grown, volume, is_aligned) =
            settled(registered(wrong.clone(), &turned_over), near, &turned_over, &settings);
        assert!(is_aligned && grown.curves.len() == turned_over.len());
        assert!(grown.left_out.is_empty() && grown.views.len() == TILTS_DEG.len() && !volume.curves.is_empty());
        // The wrong curves of the pair take part in the last fit.
        assert!(worst_px(&grown, &truth) < 1.0, "{}", worst_px(&grown, &truth));
        let (grown, _, is_aligned) = settled(registered(right, &turned_over), wrong, &turned_over, &settings);
        assert!(!is_aligned && worst_px(&grown, &truth) < 1e-9);
    }
}

//! Where the pair's curves lead the views astray: poses from the alignment of the series instead, and from what all views show at those.
//!
//! Views are registered on the pair's curves. Where most of these are wrong, so are the poses; the alignment of the images, which
//! knows of no lines, is then the better start. It is good to a px or two and knows of no turns; the views agree on more: each moves to
//! where the tomogram of the others shows it ([`consensus`](super::consensus)). How well views agree there tells which poses are right.
//! What they agree on is worth more than the pair's curves, most of which are wrong here: these are fitted to the views as they lie, and
//! move them only within what the views agree to.

use super::consensus::{agreement, in_consensus};
use super::grow::{ROUNDS, WIDE_PX, finished, next_batch, shown_by_both};
use super::volume::{Volume, depth_of};
use super::{FitSettings, FitView, FittedCurve, Grown, Hold, Problem, StartCurve};
use crate::series::ViewPose;

/// Views must agree by so much more for the aligned ones to be taken: registered ones are known to lie on lines.
const CLEARLY: f64 = 1.01;
/// And by so much more than they do before they move to where they agree, when they do as well after that: there they are far off.
const FAR: f64 = 1.05;

/// The fit, and the tomogram at its poses: of the registered views, or of those of `aligned`, moved to where they agree, where they agree
/// clearly more. Both begin with the views of the pair; `curves` are those of the pair. The last value says whether it is the aligned ones.
pub(super) fn settled(
    registered: Grown,
    aligned: Vec<FitView>,
    curves: &[StartCurve],
    settings: &FitSettings,
) -> (Grown, Volume, bool) {
    let known = &registered.curves;
    let aligned = depth_of(known).and_then(|depth| {
        let aligned = agreed(aligned, depth, settings);
        agree_more(&aligned, &registered.views, depth, settings).then_some(aligned)
    });
    let Some(aligned) = aligned else {
        let volume = Volume::new(&registered.views, known);
        return (registered, volume, false);
    };
    let volume = Volume::new(&aligned, known);
    let grown = fitted_to_placed(aligned, curves, &volume.curves, settings);
    (grown, volume, true)
}

/// The pair's curves, fitted to views that agree where they lie. What is known of their depths from a few degrees leads far beside their
/// lines in far views: they come to those from the pair outwards, while views stay (but for the axis, which they share). Then the views move
/// too, within what they agree to and held by the curves that they all show, `shown`; wrong ones of the pair pull, the longer the more.
fn fitted_to_placed(
    mut views: Vec<FitView>,
    curves: &[StartCurve],
    shown: &[StartCurve],
    settings: &FitSettings,
) -> Grown {
    let mid = 0.5 * (views[0].pose.tilt_rad + views[1].pose.tilt_rad);
    let off = |view: &FitView| (view.pose.tilt_rad - mid).abs();
    views[2..].sort_by(|a, b| off(a).total_cmp(&off(b)));
    let mut problem = Problem::new(curves, views[..2].to_vec(), settings);
    problem.hold = Hold::FIRM;
    let (mut placed, mut reached) = (2, off(&views[0]).max(1e-3));
    while placed < views.len() {
        let waiting: Vec<f64> = views[placed..].iter().map(off).collect();
        let (batch, limit) = next_batch(&waiting, reached);
        for view in &views[placed..placed + batch] {
            problem.add_held(view.clone(), view.pose);
        }
        (placed, reached) = (placed + batch, limit);
        problem.run(ROUNDS, [WIDE_PX, settings.reach_px], settings);
    }
    let led = finished(problem, Vec::new(), settings);
    let mut all: Vec<StartCurve> = led.curves.iter().map(FittedCurve::as_start).collect();
    all.extend_from_slice(shown);
    let mut problem = Problem::new(&all, views, settings);
    problem.hold = Hold::AGREED;
    problem.run(ROUNDS, [settings.reach_px; 2], settings);
    let mut grown = finished(problem, Vec::new(), settings);
    grown.curves.truncate(curves.len());
    grown
}

/// Whether the views that both have agree clearly more as they are in the first than in the second, on average: more than these do when
/// they move to where they agree too, which a good registration gains little by, or far more than they do as they are. Registered
/// views so few that nothing can be said of them are taken for wrong.
fn agree_more(aligned: &[FitView], registered: &[FitView], depth: [f64; 2], settings: &FitSettings) -> bool {
    let ours = agreement(aligned, &registered[0], depth);
    let is_more = |others: &[FitView], times: f64| {
        let theirs = agreement(others, &registered[0], depth);
        let both = theirs.iter().filter_map(|(view, theirs)| Some((ours.get(view)?, theirs)));
        let [our, their] = both.fold([0.0; 2], |sums, (ours, theirs)| [sums[0] + ours, sums[1] + theirs]);
        our > times * their.max(0.0) || (theirs.is_empty() && !ours.is_empty())
    };
    is_more(registered, FAR) || is_more(&agreed(registered.to_vec(), depth, settings), CLEARLY)
}

/// The views moved to where they agree, in the frame of the pair.
fn agreed(mut views: Vec<FitView>, depth: [f64; 2], settings: &FitSettings) -> Vec<FitView> {
    let poses = in_consensus(&views, depth, settings);
    let tilts = [0, 1].map(|view: usize| views[view].pose.tilt_rad);
    let seen = [0, 1].map(|view: usize| poses[view].image_from_projection.inverse() * views[view].pose.origin());
    let origin = shown_by_both(tilts, seen);
    // Lengths are those of the left view.
    let grown = views[0].pose.scale() / poses[0].scale();
    for (view, pose) in views.iter_mut().zip(poses) {
        view.pose = ViewPose::new(pose.tilt_rad, pose.axis_rad(), grown * pose.scale(), pose.project(&origin));
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
    use crate::series::{LineIndex, ViewLines, ViewPose};
    use crate::simulate::draw::union_of_profiles;

    const TILTS_DEG: [f64; 11] = [-4.0, 4.0, 0.0, -12.0, 12.0, -22.0, 22.0, -32.0, 32.0, -42.0, 42.0];

    /// Views of known poses; beyond the pair they are thought to be off by so many px, and turned and magnified for it.
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
            let off_px = if index < 2 { 0.0 } else { off_px };
            let shift = Vector2::new(angle.cos(), angle.sin()) * off_px;
            // A fifth of a degree and 0.1 % to a px.
            let turn = (0.2 * off_px * (3.1 * index as f64).sin()).to_radians();
            let pose = truth.changed(0.0, turn, 0.001 * off_px * (1.7 * index as f64).sin(), shift, &Point2::origin());
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

    /// Largest mean error of a view, px, of where it shows the points of the true curves.
    fn worst_px(grown: &Grown, truth: &[ViewPose]) -> f64 {
        let points: Vec<Point3> = curves().into_iter().flatten().collect();
        let off = |view: &FitView| {
            let true_pose = &truth[view.view];
            let each = points.iter().map(|point| (view.pose.project(point) - true_pose.project(point)).norm());
            each.sum::<f64>() / points.len() as f64
        };
        grown.views.iter().map(off).fold(0.0, f64::max)
    }

    /// Views that are 5 px beside their places, up to a degree turned and half a percent larger or smaller, of any axis and magnification,
    /// move to them by what they show, in the frame of the pair: an error of 0.1 px in where the pair's views agree is 0.7 px of
    /// depth, which far tilts show.
    #[test]
    fn views_move_to_where_they_agree() {
        for (axis_rad, scale) in [(0.0, 1.0), (0.4, 1.0), (0.4, 0.8), (0.4, 1.25)] {
            let (truth, off) = turned_views(5.0, axis_rad, scale);
            let depth = depth_of(&registered(off.clone(), &curves_as_start(1.0)).curves).unwrap();
            let grown = Grown { views: agreed(off, depth, &FitSettings::default()), ..registered(Vec::new(), &[]) };
            approx::assert_relative_eq!(grown.views[0].pose.scale(), scale, max_relative = 1e-12);
            let worst = worst_px(&grown, &truth) / scale;
            assert!(worst < 1.0, "{axis_rad} {scale} {worst}");
        }
    }

    /// Curves that the pair puts 40 px too deep, or not deep enough, are nearer to other lines than to theirs in far views, all of which are where
    /// they agree to be; from the pair outwards they come to theirs, and no view moves for it.
    #[test]
    fn curves_come_to_their_lines_from_the_pair_outwards() {
        let settings = FitSettings::default();
        let (truth, placed) = views(0.0);
        let mut start = curves_as_start(1.0);
        for (index, curve) in start.iter_mut().enumerate() {
            let off = if index % 2 == 0 { 40.0 } else { -40.0 };
            curve.points.iter_mut().for_each(|point| point.z += off);
            curve.sigma_z.fill(20.0);
        }
        let grown = fitted_to_placed(placed, &start, &[], &settings);
        assert_eq!(grown.curves.len(), start.len());
        for (fitted, truth) in grown.curves.iter().zip(curves()) {
            let middle = truth.len() / 2;
            let off = fitted.points[middle].z - truth[middle].z;
            assert!(off.abs() < 1.0 && fitted.support > 0.9, "{off} {}", fitted.support);
        }
        assert!(worst_px(&grown, &truth) < 0.2, "{}", worst_px(&grown, &truth));
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

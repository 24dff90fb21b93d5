//! Lines that all views together show: a tomogram of the probabilities of lines, and the curves in it.
//!
//! A faint line has a small probability in every view, too small for a matched pair to make a curve of it; projected back from all
//! views, small probabilities add up in one place. What looks like a line in single views only does not meet itself there.
//! Weighted back projection takes out again what the views do not agree on.

use ndarray::Array2;
use rstar::RTree;
use rstar::primitives::GeomWithData;

use super::grid::Grid;
use super::tomogram::{MOST_VOXELS, Tomogram};
use super::{FitView, FittedCurve, StartCurve};
use crate::geometry::{Point2, Point3};
use crate::simulate::draw::profile;
use crate::tomography::{Geometry, Method, WbpSettings, volume};

/// Depth is looked at beyond that of the known curves, by this share on both sides.
const BEYOND: f64 = 0.15;
/// Standard deviation of a line in a map of probabilities, px.
const LINE_SIGMA_PX: f64 = 1.3;
/// A voxel belongs to a line from so many times the root mean square of a tomogram of chance on, of the same views where their lines
/// do not belong together.
const ABOVE_CHANCE: f64 = 10.0;
/// And with n views from this over n^3 on of the value of a line that all views are sure of (with three views nothing is sure enough):
/// where the two near views of a pair meet a line is long in depth, and is crossed there more often than the views of the tomogram of
/// chance, which have no pair among them, cross each other.
const FEW: f64 = 50.0;
/// And from this share of that value on: with many views next to nothing is there by chance, but what is no line and lies in all of them.
const LEAST_SHARE: f64 = 0.075;
/// Where less than this share of it is enough, a line that is seen in the views is in the tomogram.
const DECISIVE_SHARE: f64 = 0.15;
/// A curve and the tomogram agree within this, px.
const NEAR_PX: f64 = 4.0;
/// Shortest stretch that is new, px.
const SHORTEST_PX: f64 = 15.0;

/// What the tomogram of all views shows.
pub(super) struct Volume {
    /// The curves in it, in the frame of the poses.
    pub curves: Vec<StartCurve>,
    /// Whether views are so many, and show so few other lines, that a line that is seen in them is in the tomogram.
    pub is_decisive: bool,
}

impl Volume {
    /// The tomogram of the views, about as deep as the known curves, and the curves in it.
    pub fn new(views: &[FitView], known: &[FittedCurve]) -> Self {
        let none = Self { curves: Vec::new(), is_decisive: false };
        depth_of(known).map_or(none, |depth| Self::between(views, depth, MOST_VOXELS))
    }

    /// The tomogram of the views between two depths, px, and the curves in it; see [`Volume::new`].
    fn between(views: &[FitView], depth: [f64; 2], most_voxels: f64) -> Self {
        let none = Self { curves: Vec::new(), is_decisive: false };
        let views: Vec<&FitView> = views.iter().filter(|view| !view.lines.lines().probability.is_empty()).collect();
        let Some(tomogram) = Tomogram::new(&views, depth, most_voxels, Grid::image) else { return none };
        let tilts_rad: Vec<f64> = views.iter().map(|view| view.pose.tilt_rad).collect();
        let (sigma_px, height) = tomogram.grid.blurred(LINE_SIGMA_PX);
        let sure = value_of_a_line(&tilts_rad, sigma_px / tomogram.grid.px).map(|value| value * height);
        let Some(sure) = sure else { return none };
        let few = FEW / (views.len() as f64).powi(3);
        let least = (ABOVE_CHANCE * tomogram.rms_of_chance()).max(few.max(LEAST_SHARE) * sure);
        let Some(threshold) = tomogram.beyond_chance(least) else { return none };
        Self { curves: tomogram.curves(threshold), is_decisive: threshold / sure <= DECISIVE_SHARE }
    }

    /// For each curve the share of its points that lie on one of the tomogram.
    pub fn confirmed(&self, curves: &[FittedCurve]) -> Vec<f64> {
        let tree = tree(self.curves.iter().map(|curve| &curve.points[..]));
        let share = |curve: &FittedCurve| {
            let near = curve.points.iter().filter(|point| is_near(&tree, point)).count();
            near as f64 / curve.points.len().max(1) as f64
        };
        curves.iter().map(share).collect()
    }
}

/// The stretches of curves that are away from all the known ones.
pub(super) fn away_from<'a>(curves: &[StartCurve], known: impl Iterator<Item = &'a FittedCurve>) -> Vec<StartCurve> {
    let tree = tree(known.map(|curve| &curve.points[..]));
    let mut away = Vec::new();
    for curve in curves {
        for stretch in curve.points.split(|point| is_near(&tree, point)) {
            if stretch.len() < 2 {
                continue;
            }
            let stretch = StartCurve {
                points: stretch.into(),
                sigma_z: vec![curve.sigma_z[0]; stretch.len()],
                closed: curve.closed && stretch.len() == curve.points.len(),
            };
            if stretch.length_px() >= SHORTEST_PX {
                away.push(stretch);
            }
        }
    }
    away
}

/// Where to look for lines, px: about as deep as the known curves.
pub(super) fn depth_of<'a>(known: impl IntoIterator<Item = &'a FittedCurve>) -> Option<[f64; 2]> {
    let mut z: Vec<f64> = known.into_iter().flat_map(|curve| &curve.points).map(|point| point.z).collect();
    z.sort_by(f64::total_cmp);
    let last = z.len().checked_sub(1)?;
    let [low, high] = [0.01, 0.99].map(|share| z[(last as f64 * share) as usize]);
    let more = BEYOND * (high - low);
    Some([low - more, high + more])
}

type Tree = RTree<GeomWithData<[f64; 3], ()>>;

fn tree<'a>(curves: impl Iterator<Item = &'a [Point3]>) -> Tree {
    let points = curves.flatten().map(|point| GeomWithData::new([point.x, point.y, point.z], ()));
    RTree::bulk_load(points.collect())
}

fn is_near(tree: &Tree, point: &Point3) -> bool {
    tree.locate_within_distance([point.x, point.y, point.z], NEAR_PX * NEAR_PX).next().is_some()
}

/// The value in the tomogram of a line along the tilt axis that all views are sure of.
fn value_of_a_line(tilts_rad: &[f64], sigma_px: f64) -> Option<f64> {
    const SIDE: usize = 65;
    const MIDDLE: usize = SIDE / 2;
    let mut image = Array2::<f32>::zeros([3, SIDE]);
    let line = [Point2::new(MIDDLE as f64, -10.0), Point2::new(MIDDLE as f64, 12.0)];
    profile([3, SIDE], &line, sigma_px, |row, column, value| image[[row, column]] = value);
    let geometry = Geometry::centred(tilts_rad.to_vec(), SIDE, 3);
    let tomogram = volume(&vec![image; tilts_rad.len()], &geometry, &Method::Wbp(WbpSettings::default())).ok()?;
    Some(f64::from(tomogram[[1, 1, MIDDLE]]))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::curve::TraceGraph;
    use crate::geometry::Vector3;
    use crate::series::{LineIndex, ViewLines, ViewPose};
    use crate::simulate::draw::union_of_profiles;

    const SHAPE: [usize; 2] = [160, 150];

    /// A bowed line behind mid-foil, and where a view shows it.
    fn line() -> Vec<Point3> {
        let at = |step: i32| {
            let y = f64::from(step);
            Point3::new(12.0 + 0.3 * y + 0.004 * y * y, y, 22.0 + 0.2 * y)
        };
        (-50..=50).map(at).collect()
    }

    /// Views that are turned, magnified and shifted; each sees the line with a probability, and surely one more line of its own.
    fn views(tilts_deg: &[f64], probability: f64) -> Vec<FitView> {
        let view = |(index, tilt_deg): (usize, &f64)| {
            let wave = |k: f64| (k * (index as f64 + 1.0)).sin();
            let origin = Point2::new(74.5 + 4.0 * wave(2.3), 79.5 + 4.0 * wave(1.7));
            let pose = ViewPose::new(tilt_deg.to_radians(), 0.05 + 0.01 * wave(0.9), 1.0 + 0.01 * wave(3.1), origin);
            let seen: Vec<Point2> = line().iter().map(|point| pose.project(point)).collect();
            // Across the tilt axis, at different heights: they do not meet.
            let y = 12.0 + 8.0 * index as f64;
            let own = vec![Point2::new(10.0, y), Point2::new(140.0, y + 4.0)];
            let (line, own) =
                (union_of_profiles(SHAPE, &[seen], LINE_SIGMA_PX), union_of_profiles(SHAPE, &[own], LINE_SIGMA_PX));
            let both = Array2::from_shape_fn(SHAPE, |at| (255.0 * (probability as f32 * line[at]).max(own[at])) as u8);
            let lines = ViewLines { probability: Arc::new(both), ..ViewLines::new(TraceGraph::default(), SHAPE) };
            FitView::new(index, pose, LineIndex::new(lines))
        };
        tilts_deg.iter().enumerate().map(view).collect()
    }

    /// Largest distance of the found points from the line, and the share of the line that has one within 3 px.
    fn off(found: &[StartCurve]) -> (f64, f64) {
        let points: Vec<Point3> = found.iter().flat_map(|curve| curve.points.clone()).collect();
        let line = line();
        let nearest = |point: &Point3, others: &[Point3]| {
            others.iter().map(|other| (other - point).norm()).fold(f64::INFINITY, f64::min)
        };
        let worst = points.iter().map(|point| nearest(point, &line)).fold(0.0, f64::max);
        let seen = line.iter().filter(|point| nearest(point, &points) < 3.0).count();
        (worst, seen as f64 / line.len() as f64)
    }

    /// A line that every view holds for unlikely lies where it is, in front and behind not turned over, and what each view alone is
    /// sure of lies nowhere; in a shrunk tomogram too.
    #[test]
    fn a_line_that_all_views_hold_for_unlikely_is_found_and_what_single_views_show_is_not() {
        let tilts: Vec<f64> = (-8..=8).map(|step| 6.0 * f64::from(step)).collect();
        let views = views(&tilts, 0.3);
        for (most_voxels, accepted) in [(1e9, 2.0), (4e5, 4.0)] {
            let found = Volume::between(&views, [0.0, 40.0], most_voxels);
            let (worst, seen) = off(&found.curves);
            assert!(worst < accepted && seen > 0.9, "{worst} {seen}");
        }
    }

    /// Views full of lines that have nothing to do with each other: what meets there meets by chance. One more line, which all of them
    /// show, is found among them.
    #[test]
    fn what_meets_by_chance_is_not_found() {
        let tilts: Vec<f64> = (-8..=8).map(|step| 6.0 * f64::from(step)).collect();
        let mut rng = Pcg64::seed_from_u64(1);
        let crowded = |views: Vec<FitView>, rng: &mut Pcg64| -> Vec<FitView> {
            let with_more = |view: FitView| {
                let mut at = || Point2::new(rng.random_range(0.0..150.0), rng.random_range(0.0..160.0));
                let others: Vec<Vec<Point2>> = (0..12).map(|_| vec![at(), at()]).collect();
                let others = union_of_profiles(SHAPE, &others, LINE_SIGMA_PX);
                let mut both = view.lines.lines().probability.as_ref().clone();
                both.zip_mut_with(&others, |value, other| *value = (*value).max((255.0 * other) as u8));
                let lines = ViewLines { probability: Arc::new(both), ..ViewLines::new(TraceGraph::default(), SHAPE) };
                FitView::new(view.view, view.pose, LineIndex::new(lines))
            };
            views.into_iter().map(with_more).collect()
        };
        let length = |found: &Volume| found.curves.iter().map(|curve| curve.points.len()).sum::<usize>();
        let without = Volume::between(&crowded(views(&tilts, 0.0), &mut rng), [0.0, 40.0], 1e9);
        let with = Volume::between(&crowded(views(&tilts, 1.0), &mut rng), [0.0, 40.0], 1e9);
        assert!(off(&with.curves).1 > 0.8, "{}", off(&with.curves).1);
        assert!(10 * length(&without) < length(&with), "{} {}", length(&without), length(&with));
    }

    /// Lines of two of four views meet somewhere, whatever they are.
    #[test]
    fn with_few_views_most_must_be_sure() {
        let tilts = [-30.0, -10.0, 10.0, 30.0];
        let (sure, blind) = (views(&tilts, 1.0), views(&tilts, 0.0));
        let found = |views: &[FitView]| off(&Volume::between(views, [0.0, 40.0], 1e9).curves).1;
        assert!(found(&sure) > 0.5);
        let two: Vec<FitView> = sure[..2].iter().chain(&blind[2..]).cloned().collect();
        assert!(found(&two) < 0.01);
        assert!(found(&[]) < 0.01 && found(&sure[1..]) < 0.01);
    }

    /// Curves in the tomogram are confirmed, and are not new beside it; others are neither.
    #[test]
    fn what_is_known_is_confirmed_and_not_new() {
        let start = |dz: f64| StartCurve {
            points: line().iter().map(|point| point + Vector3::new(0.0, 0.0, dz)).collect(),
            sigma_z: vec![1.0; 101],
            closed: false,
        };
        let fitted = |dz: f64| FittedCurve {
            points: start(dz).points,
            sigma_z: vec![1.0; 101],
            seen: vec![3; 101],
            closed: false,
            support: 1.0,
        };
        let volume = Volume { curves: vec![start(0.0)], is_decisive: true };
        assert_eq!(volume.confirmed(&[fitted(1.0), fitted(9.0)]), [1.0, 0.0]);
        assert!(away_from(&volume.curves, [fitted(1.0)].iter()).is_empty());
        assert_eq!(away_from(&volume.curves, [fitted(9.0)].iter()), [start(0.0)]);
        let mut half = fitted(1.0);
        half.points.truncate(60);
        let rest = away_from(&volume.curves, [half].iter());
        assert!(rest.len() == 1 && (30..45).contains(&rest[0].points.len()), "{}", rest[0].points.len());
    }
}

//! Curves of a result in views that it was not made from (paper, Figure 7): how far re-projected points lie from the lines that
//! are detected there.
//!
//! Each view gets its own pose, found on the curves ([`mod@super::register`]) from that of its neighbour, outwards from the pair.
//! What is left is the error of the curves' shape and of the lines; a shift, a small turn and a change of magnification of each
//! view, which no microscope avoids, are not counted.

use super::{
    AlignedSeries, Checks, LineIndex, Registration, SavedCurves, Series, SeriesError, ViewLines, ViewPose, checks,
    register,
};
use crate::geometry::Point2;
use crate::progress::Stage;
use crate::warning::Warning;

/// Shifts are looked for within this share of the image's longer side about where the neighbour says, px at least.
const SEARCH_SHARE: f64 = 0.06;
const SEARCH_LEAST_PX: f64 = 16.0;
/// Where the neighbour's start finds nothing, a wider search is tried.
const WIDE: f64 = 2.5;

/// Distances of re-projected points to the nearest detected line, px of the view's file.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Distances {
    /// Points of the curves that lie in the image.
    pub points: usize,
    /// Median.
    pub median_px: f64,
    /// 95 percent are nearer.
    pub percent95_px: f64,
    /// Share within 2 px.
    pub within_2px: f64,
    /// Share within 5 px.
    pub within_5px: f64,
    /// Share within 3 px that would be by chance: the share of the image within 3 px of a line.
    pub chance_within_3px: f64,
}

impl Distances {
    /// Of curves projected into a view to its lines, over the points that lie in the image.
    pub fn to_lines(projected: &[Vec<Point2>], lines: &LineIndex, chance_within_3px: f64) -> Option<Self> {
        let [height, width] = lines.lines().shape.map(|side| side as f64 - 0.5);
        let inside = |point: &&Point2| point.x >= -0.5 && point.y >= -0.5 && point.x <= width && point.y <= height;
        let distances = projected.iter().flatten().filter(inside).filter_map(|point| lines.distance(point)).collect();
        Self::of(distances, chance_within_3px)
    }

    /// Statistics of distances; `None` without any.
    pub fn of(mut distances: Vec<f64>, chance_within_3px: f64) -> Option<Self> {
        distances.sort_by(f64::total_cmp);
        let count = distances.len();
        let at = |share: f64| distances[((count - 1) as f64 * share).round() as usize];
        let within = |px: f64| distances.partition_point(|distance| *distance <= px) as f64 / count as f64;
        (count > 0).then(|| Self {
            points: count,
            median_px: at(0.5),
            percent95_px: at(0.95),
            within_2px: within(2.0),
            within_5px: within(5.0),
            chance_within_3px,
        })
    }
}

/// One view with the curves in it.
#[derive(Clone, Debug)]
pub struct ViewReprojection {
    /// Its place in [`Series::views`].
    pub view: usize,
    /// Its tilt in degrees.
    pub tilt_deg: f64,
    /// Whether the curves were made from it.
    pub in_pair: bool,
    /// Its pose in the frame of the curves.
    pub pose: ViewPose,
    /// Whether the pose is supported: clearly more points lie on lines than would by chance.
    pub supported: bool,
    /// By how much the pose had to be moved from where its neighbour and the alignment of the series say, px.
    pub moved_px: f64,
    /// Each curve in the image, in px of the view's file.
    pub curves: Vec<Vec<Point2>>,
    /// Distances to the nearest line; `None` where no point lies in the image or no line was found.
    pub distances: Option<Distances>,
    /// The lines found in it.
    pub lines: ViewLines,
}

/// Curves in many views.
#[derive(Clone, Debug)]
pub struct Reprojection {
    /// The views by ascending tilt.
    pub views: Vec<ViewReprojection>,
    /// What the views say about the pair.
    pub checks: Checks,
    /// The alignment of the whole series, refined on the curves in these views; tilts are those of the series.
    pub refined: AlignedSeries,
    /// What could not be done.
    pub warnings: Vec<Warning>,
}

/// Re-projects curves into views of a series (by their places in [`Series::views`]).
///
/// `aligned` gives the shifts between neighbours; `lines_of` finds the lines of a view.
///
/// # Errors
/// Where a view cannot be read, or there are no curves.
pub fn reproject(
    curves: &SavedCurves,
    series: &Series,
    aligned: &AlignedSeries,
    views: &[usize],
    lines_of: &mut dyn FnMut(usize) -> Result<ViewLines, SeriesError>,
) -> Result<Reprojection, SeriesError> {
    let points = curves.points_with_tangents();
    if points.is_empty() {
        let what = "the result has no curves: there is nothing to re-project".to_owned();
        return Err(SeriesError::Result { path: "curves.json".into(), what });
    }
    let mut warnings = Vec::new();
    let pair = pair_views(curves, series, &mut warnings);
    let mid_rad = curves.tilts.mid_rad();
    let tilt_in_frame = |view: usize| series.views[view].tilt_deg.to_radians() - mid_rad;
    let search_px = (SEARCH_SHARE * series.shape[0].max(series.shape[1]) as f64).max(SEARCH_LEAST_PX);
    // Poses that are known, by view: those of the pair first.
    let mut known: Vec<(usize, ViewPose)> =
        pair.iter().zip(&curves.poses).filter_map(|(view, pose)| Some(((*view)?, *pose))).collect();
    let mut order = views.to_vec();
    order.sort_by(|&a, &b| tilt_in_frame(a).abs().total_cmp(&tilt_in_frame(b).abs()));
    let mut found: Vec<(ViewReprojection, LineIndex)> = Vec::new();
    for view in order {
        let lines = LineIndex::new(lines_of(view)?);
        let start = start(view, &known, curves, aligned, tilt_in_frame(view));
        let mut registration = register(&points, &lines, &start, search_px, false);
        if !registration.is_some_and(|registration| registration.is_supported()) {
            let wide = register(&points, &lines, &start, WIDE * search_px, false);
            let better = |a: &Registration, b: &Registration| a.near > b.near + 0.1;
            if let Some(wide) = wide.filter(|wide| registration.is_none_or(|narrow| better(wide, &narrow))) {
                registration = Some(wide);
            }
        }
        let supported = registration.is_some_and(|registration| registration.is_supported());
        let pose = registration.map_or(start, |registration| registration.pose);
        if supported {
            known.retain(|(other, _)| *other != view);
            known.push((view, pose));
        }
        found.push((in_view(view, curves, series, &pair, pose, registration, supported, &lines), lines));
    }
    found.sort_by_key(|(view, _)| view.view);
    let lost: Vec<String> =
        found.iter().filter(|(view, _)| !view.supported).map(|(view, _)| format!("{}", view.tilt_deg)).collect();
    if !lost.is_empty() {
        let message = format!(
            "in the views at {} degrees no more re-projected points lie on lines than would by chance: their poses are guesses",
            lost.join(", ")
        );
        warnings.push(Warning::new(Stage::Measure, message));
    }
    let refined = refined(series, &known, curves, aligned, mid_rad);
    let checks = checks::check(curves, &points, &found, series);
    Ok(Reprojection { views: found.into_iter().map(|(view, _)| view).collect(), checks, refined, warnings })
}

/// The views of the series that the result was made from: those at its tilts.
fn pair_views(curves: &SavedCurves, series: &Series, warnings: &mut Vec<Warning>) -> [Option<usize>; 2] {
    let tilts = [curves.tilts.left_rad, curves.tilts.right_rad].map(f64::to_degrees);
    tilts.map(|tilt_deg| match series.nearest(tilt_deg) {
        Ok(view) => Some(view),
        Err(error) => {
            let message = format!("the pair is not in the series: {error}; its depths are compared all the same");
            warnings.push(Warning::new(Stage::Read, message));
            None
        }
    })
}

/// Where the pose of a view is expected: turn and magnification of the nearest known view, shift by the alignment.
fn start(
    view: usize,
    known: &[(usize, ViewPose)],
    curves: &SavedCurves,
    aligned: &AlignedSeries,
    tilt: f64,
) -> ViewPose {
    let nearest = known.iter().min_by(|(_, a), (_, b)| (a.tilt_rad - tilt).abs().total_cmp(&(b.tilt_rad - tilt).abs()));
    let Some(&(other, pose)) = nearest else {
        return ViewPose { tilt_rad: tilt, ..curves.poses[0] };
    };
    let off = pose.origin() - aligned.poses[other].origin();
    let turned = pose.axis_rad();
    ViewPose::new(tilt, turned, pose.scale(), aligned.poses[view].origin() + off)
}

/// The alignment with the poses that were found on the curves, and those of other views moved with their nearest one.
fn refined(
    series: &Series,
    known: &[(usize, ViewPose)],
    curves: &SavedCurves,
    aligned: &AlignedSeries,
    mid_rad: f64,
) -> AlignedSeries {
    let pose = |view: usize| {
        let tilt = series.views[view].tilt_deg.to_radians();
        let found = known.iter().find(|(other, _)| *other == view).map(|(_, pose)| *pose);
        let pose = found.unwrap_or_else(|| start(view, known, curves, aligned, tilt - mid_rad));
        ViewPose { tilt_rad: tilt, ..pose }
    };
    let poses: Vec<ViewPose> = (0..series.views.len()).map(pose).collect();
    AlignedSeries { axis_rad: curves.poses[0].axis_rad(), poses, ..aligned.clone() }
}

#[expect(clippy::too_many_arguments, reason = "one place puts a view's results together")]
fn in_view(
    view: usize,
    curves: &SavedCurves,
    series: &Series,
    pair: &[Option<usize>; 2],
    pose: ViewPose,
    registration: Option<Registration>,
    supported: bool,
    lines: &LineIndex,
) -> ViewReprojection {
    let projected = curves.projected(&pose);
    ViewReprojection {
        view,
        tilt_deg: series.views[view].tilt_deg,
        in_pair: pair.contains(&Some(view)),
        pose,
        supported,
        moved_px: registration.map_or(0.0, |registration| registration.moved_px.norm()),
        distances: Distances::to_lines(&projected, lines, registration.map_or(0.0, |found| found.chance)),
        curves: projected,
        lines: lines.lines().clone(),
    }
}

//! Two views of a truth as a stereo pair: which right point belongs to which left point, and the frame scores work in.
//!
//! A point seen in both views is described by its *plan*, where the left view projects it (x across the tilt axis, y along
//! it, px of the left image), and its disparity `x_R - x_L` in the same px (CONVENTIONS.md; depth is disparity /
//! (2 sin(phi / 2))). An offset of all disparities, which no pair of images can tell, leaves the plan where it is.

use crate::geometry::{Point2, Point3, Similarity2, TiltPair, Vector2, project_at_tilt};
use crate::truth::{ProjectedCurve, TrueCurve, TrueView, Truth, TruthError};

/// How far along a right curve the row of a left point is looked for, in px: contrast sits a few px off the core.
const ROW_SEARCH_PX: f64 = 10.0;
/// Rows closer than this are the same; truth files are written to 1e-4 px.
const SAME_ROW_PX: f64 = 1e-3;
/// Spacing in px of left points on curves without 3D points.
const HAND_SPACING_PX: f64 = 1.0;

/// Two views of a truth.
#[derive(Clone, Copy, Debug)]
pub struct TruthPair<'a> {
    /// All of it.
    pub truth: &'a Truth,
    /// The left view.
    pub left: &'a TrueView,
    /// The right view.
    pub right: &'a TrueView,
    /// Tilts, where both are known.
    pub tilts: Option<TiltPair>,
    /// The frame, where tilts and maps of both views are known.
    pub geometry: Option<PairGeometry>,
}

/// Known geometry of a pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairGeometry {
    /// Tilts of both views.
    pub tilts: TiltPair,
    /// Left input px to the projected specimen, in px of the left image.
    pub rows_from_left: Similarity2,
    /// Right input px to the projected specimen, in px of the left image.
    pub rows_from_right: Similarity2,
    /// Px of the left image per unit of the 3D points.
    pub px_per_unit: f64,
}

impl PairGeometry {
    /// Plan and disparity of a point from where both images show it.
    pub fn of_images(&self, left: &Point2, right: &Point2) -> (Point2, f64) {
        let (left, right) = (self.rows_from_left * left, self.rows_from_right * right);
        (left, right.x - left.x)
    }

    /// Plan and disparity of a specimen point.
    pub fn of_specimen(&self, point: &Point3) -> (Point2, f64) {
        let left = project_at_tilt(point, self.tilts.left_rad) * self.px_per_unit;
        let right = project_at_tilt(point, self.tilts.right_rad) * self.px_per_unit;
        (left, right.x - left.x)
    }

    /// Plan and disparity of a point of the mid-view frame, in px of the left image.
    pub fn of_mid_view(&self, point: &Point3) -> (Point2, f64) {
        let (x_left, x_right) = self.tilts.project(point.x, point.z);
        (Point2::new(x_left, point.y), x_right - x_left)
    }
}

/// One curve in both views.
#[derive(Clone, Debug, PartialEq)]
pub struct PairedCurve<'a> {
    /// The curve.
    pub curve: &'a TrueCurve,
    /// Centre of contrast in left input px.
    pub left: Vec<Point2>,
    /// The point of the right contrast on the epipolar row of each left point, in right input px; `None` where there is
    /// none.
    pub right: Vec<Option<Point2>>,
    /// Whether each point can be asked for: visible and inside both images, with a right point.
    pub counts: Vec<bool>,
}

impl<'a> TruthPair<'a> {
    pub(super) fn new(truth: &'a Truth, left: usize, right: usize) -> Result<Self, TruthError> {
        let count = truth.views.len();
        let missing = TruthError::NoPair { left, right, count };
        let (Some(left_view), Some(right_view), true) = (truth.views.get(left), truth.views.get(right), left != right)
        else {
            return Err(missing);
        };
        let tilts = left_view.tilt_rad.zip(right_view.tilt_rad);
        let tilts = tilts.map(|(left_rad, right_rad)| TiltPair { left_rad, right_rad });
        if let Some(tilts) = tilts.filter(|tilts| tilts.phi() == 0.0) {
            let value = format!("{} and {}", tilts.left_rad.to_degrees(), tilts.right_rad.to_degrees());
            return Err(TruthError::Value {
                what: "tilt_deg of the pair".into(),
                value,
                expected: "two different angles",
            });
        }
        let maps = left_view.input_from_projection.zip(right_view.input_from_projection);
        let geometry = tilts.zip(maps).map(|(tilts, (left, right))| {
            let px_per_unit = left.scale_px;
            let rows_from = |input_from_projection: Similarity2| {
                let mut map = input_from_projection.inverse();
                map.append_scaling_mut(px_per_unit);
                map
            };
            let rows_from_left = rows_from(left.input_from_projection());
            let rows_from_right = rows_from(right.input_from_projection());
            PairGeometry { tilts, rows_from_left, rows_from_right, px_per_unit }
        });
        Ok(Self { truth, left: left_view, right: right_view, tilts, geometry })
    }

    /// Unit vector along the epipolar rows of the right image, in input px.
    pub fn right_row_direction(&self) -> Vector2 {
        self.geometry
            .map_or(Vector2::x(), |geometry| geometry.rows_from_right.isometry.rotation.inverse() * Vector2::x())
    }

    /// Disparity of a left and a right input point in px of the left image: about the tilt axis where the geometry is known,
    /// else the difference of columns.
    pub fn disparity_px(&self, left: &Point2, right: &Point2) -> f64 {
        self.geometry.map_or(right.x - left.x, |geometry| geometry.of_images(left, right).1)
    }

    /// Curves that are in one view only, left then right.
    pub fn unpaired_labels(&self) -> [Vec<&'a str>; 2] {
        let only = |here: &'a TrueView, there: &TrueView| {
            here.curves.iter().map(|curve| curve.label.as_str()).filter(|label| there.curve(label).is_none()).collect()
        };
        [only(self.left, self.right), only(self.right, self.left)]
    }

    /// All curves that are in both views, in the order of [`Truth::curves`].
    pub fn curves(&self) -> Vec<PairedCurve<'a>> {
        let in_both = |curve: &'a TrueCurve| {
            let (left, right) = (self.left.curve(&curve.label)?, self.right.curve(&curve.label)?);
            Some(if curve.points.is_some() {
                self.aligned(curve, left, right)
            } else {
                self.by_row(curve, left, right)
            })
        };
        self.truth.curves.iter().filter_map(in_both).collect()
    }

    /// Rows of left and right input points, in px of the left image.
    fn rows(&self) -> [impl Fn(&Point2) -> f64 + use<>; 2] {
        let maps = self.geometry.map(|geometry| [geometry.rows_from_left, geometry.rows_from_right]);
        [0, 1].map(|view| move |point: &Point2| maps.map_or(point.y, |maps| (maps[view] * point).y))
    }

    /// Pairs index by index, then moves each right point along its curve to the left point's row: contrast leaves the core
    /// by different amounts in the two views, and what stereo (or a person) matches is what lies on one row.
    fn aligned(&self, curve: &'a TrueCurve, left: &ProjectedCurve, right: &ProjectedCurve) -> PairedCurve<'a> {
        let [left_row, right_row] = self.rows();
        let right_rows: Vec<f64> = right.contrast.iter().map(right_row).collect();
        let find = |(index, point): (usize, &Point2)| {
            let (found, nearest) = on_row(&right.contrast, &right_rows, curve.closed, index, left_row(point));
            let visible = left.is_visible(index) && right.is_visible(nearest);
            (Some(found), visible && self.left.contains(point) && self.right.contains(&found))
        };
        let (right, counts) = left.contrast.iter().enumerate().map(find).unzip();
        PairedCurve { curve, left: left.contrast.clone(), right, counts }
    }

    /// Pairs by row where no index is shared. A curve may cross a row several times: of all choices along it, the one whose
    /// disparity varies least.
    fn by_row(&self, curve: &'a TrueCurve, left: &ProjectedCurve, right: &ProjectedCurve) -> PairedCurve<'a> {
        let [left_row, right_row] = self.rows();
        let (points, origin) = densified(&left.contrast, curve.closed);
        let right_points = closing(&right.contrast, curve.closed);
        let right_rows: Vec<f64> = right_points.iter().map(right_row).collect();
        let candidates: Vec<Vec<(Point2, usize)>> =
            points.iter().map(|point| crossings(&right_points, &right_rows, left_row(point))).collect();
        let disparities: Vec<Vec<f64>> = points
            .iter()
            .zip(&candidates)
            .map(|(point, found)| found.iter().map(|(right, _)| self.disparity_px(point, right)).collect())
            .collect();
        let chosen = least_variation(&disparities);
        let found =
            points.iter().zip(&origin).zip(chosen.iter().zip(&candidates)).map(|((point, &index), (&at, found))| {
                let Some((right_point, nearest)) = at.map(|at| found[at]) else { return (None, false) };
                let visible = left.is_visible(index) && right.is_visible(nearest % right.contrast.len());
                (Some(right_point), visible && self.left.contains(point) && self.right.contains(&right_point))
            });
        let (right, counts) = found.unzip();
        PairedCurve { curve, left: points, right, counts }
    }
}

/// The place on a polyline, nearest along it to point `index`, that lies on `row`, and the index of the point nearest to
/// it; the point itself where the row is not met within reach (lines along the row).
fn on_row(points: &[Point2], rows: &[f64], closed: bool, index: usize, row: f64) -> (Point2, usize) {
    if (rows[index] - row).abs() <= SAME_ROW_PX {
        return (points[index], index);
    }
    let count = points.len();
    let mut best: Option<(f64, Point2, usize)> = None;
    for forward in [true, false] {
        let (mut at, mut walked) = (index, 0.0);
        while walked < ROW_SEARCH_PX {
            let next = match (forward, closed) {
                (true, false) if at + 1 == count => break,
                (false, false) if at == 0 => break,
                (true, _) => (at + 1) % count,
                (false, _) => (at + count - 1) % count,
            };
            let step = (points[next] - points[at]).norm();
            if (rows[at] - row) * (rows[next] - row) <= 0.0 && rows[at] != rows[next] {
                let fraction = (row - rows[at]) / (rows[next] - rows[at]);
                let distance = walked + fraction * step;
                if distance <= ROW_SEARCH_PX && best.is_none_or(|(nearest, ..)| distance < nearest) {
                    let place = points[at] + (points[next] - points[at]) * fraction;
                    best = Some((distance, place, if fraction < 0.5 { at } else { next }));
                }
                break;
            }
            (at, walked) = (next, walked + step);
            if at == index {
                break;
            }
        }
    }
    best.map_or((points[index], index), |(_, place, nearest)| (place, nearest))
}

/// All places where a polyline meets a row, each with the index of its nearest point; of a stretch along the row, its ends.
fn crossings(points: &[Point2], rows: &[f64], row: f64) -> Vec<(Point2, usize)> {
    let above = |index: usize| if (rows[index] - row).abs() <= SAME_ROW_PX { 0.0 } else { rows[index] - row };
    let mut found: Vec<(Point2, usize)> = Vec::new();
    for index in 0..points.len() {
        if above(index) == 0.0 {
            found.push((points[index], index));
        } else if index > 0 && above(index - 1) * above(index) < 0.0 {
            let fraction = above(index - 1) / (above(index - 1) - above(index));
            let place = points[index - 1] + (points[index] - points[index - 1]) * fraction;
            found.push((place, if fraction < 0.5 { index - 1 } else { index }));
        }
    }
    found
}

/// One candidate per point so that the disparity varies least along the curve (dynamic programming); `None` where there
/// are no candidates.
fn least_variation(disparities: &[Vec<f64>]) -> Vec<Option<usize>> {
    let mut steps: Vec<(usize, Vec<usize>)> = Vec::new();
    let mut costs: Vec<f64> = Vec::new();
    let mut previous: Option<&Vec<f64>> = None;
    for (index, here) in disparities.iter().enumerate().filter(|(_, here)| !here.is_empty()) {
        let mut came_from = vec![0; here.len()];
        let mut next = vec![0.0; here.len()];
        if let Some(before) = previous {
            for (at, d) in here.iter().enumerate() {
                let reach = |from: usize| costs[from] + (d - before[from]).abs();
                came_from[at] = (0..before.len()).min_by(|&a, &b| reach(a).total_cmp(&reach(b))).unwrap_or(0);
                next[at] = reach(came_from[at]);
            }
        }
        steps.push((index, came_from));
        (costs, previous) = (next, Some(here));
    }
    let mut chosen = vec![None; disparities.len()];
    let mut at = (0..costs.len()).min_by(|&a, &b| costs[a].total_cmp(&costs[b])).unwrap_or(0);
    for (index, came_from) in steps.iter().rev() {
        chosen[*index] = Some(at);
        at = came_from[at];
    }
    chosen
}

/// Points at most 1 px apart on a polyline, and the index of the vertex nearest to each.
fn densified(points: &[Point2], closed: bool) -> (Vec<Point2>, Vec<usize>) {
    let count = points.len();
    let mut dense = (vec![points[0]], vec![0]);
    for end in 1..count + usize::from(closed) {
        let (a, b) = (points[end - 1], points[end % count]);
        let pieces = ((b - a).norm() / HAND_SPACING_PX).ceil().max(1.0) as usize;
        for piece in 1..=pieces {
            if end == count && piece == pieces {
                break;
            }
            let fraction = piece as f64 / pieces as f64;
            dense.0.push(a + (b - a) * fraction);
            dense.1.push(if fraction < 0.5 { end - 1 } else { end % count });
        }
    }
    dense
}

/// The points, the first one once more at the end of a closed curve.
fn closing(points: &[Point2], closed: bool) -> Vec<Point2> {
    let mut points = points.to_vec();
    if closed {
        points.push(points[0]);
    }
    points
}

//! Curves in one image ([`Trace`]), in two ([`MatchedCurve`]) and in the foil ([`Curve3`]).

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use crate::geometry::{Point2, Point3, Vector2, length2};

/// Evidence for lines on one rectified grid: what a detector returns.
#[derive(Clone, Debug, PartialEq)]
pub struct LineMap {
    /// Probability of a line `[row, column]`, in `[0, 1]`; 0 where the image has no data.
    pub probability: Array2<f32>,
    /// Typical full width of the lines in px (full width at half maximum of their profile).
    pub line_width_px: f64,
}

/// A point on the centreline of a line in one rectified image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TracePoint {
    /// Sub-pixel position.
    pub position: Point2,
    /// Unit tangent, in the order of the points.
    pub tangent: Vector2,
    /// Line probability at the point.
    pub probability: f32,
    /// One-sigma error of the position across the line, in px.
    pub sigma_perp_px: f64,
}

/// What a trace ends at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TraceEnd {
    /// Inside the image: a dislocation that meets a surface, or fades.
    Free,
    /// At the border of the valid region.
    Border,
    /// At a junction, by its index in [`TraceGraph::junctions`].
    Junction(usize),
}

/// The centreline of one line in one rectified image.
#[derive(Clone, Debug, PartialEq)]
pub struct Trace {
    /// Points about 1 px of arc length apart, at least two.
    pub points: Vec<TracePoint>,
    /// Whether the last point joins the first.
    pub closed: bool,
    /// What the first and last point end at; `Free` both for a closed trace.
    pub ends: [TraceEnd; 2],
}

impl Trace {
    /// Length along the centreline in px.
    pub fn length_px(&self) -> f64 {
        let open: f64 = self.points.windows(2).map(|pair| (pair[1].position - pair[0].position).norm()).sum();
        match (self.closed, self.points.first(), self.points.last()) {
            (true, Some(first), Some(last)) => open + (first.position - last.position).norm(),
            _ => open,
        }
    }
}

/// All lines of one rectified image and where they meet.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TraceGraph {
    /// The lines.
    pub traces: Vec<Trace>,
    /// Positions of junctions: places where three or more traces meet.
    pub junctions: Vec<Point2>,
}

/// How far a matched point can be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Flag {
    /// Measured in both images.
    Ok,
    /// Measured, but the line runs within 10 degrees of the row: its disparity is poorly determined.
    IllConditioned,
    /// Not measured here: interpolated from the neighbours on its curve, or of a line that only all views of a series show together.
    Bridged,
}

impl Flag {
    /// The word used in every output file.
    pub fn word(self) -> &'static str {
        match self {
            Flag::Ok => "ok",
            Flag::IllConditioned => "ill_conditioned",
            Flag::Bridged => "bridged",
        }
    }
}

/// A point of a left line with its disparity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchedPoint {
    /// Position in the rectified left image.
    pub left: Point2,
    /// Unit tangent of the left line.
    pub tangent_left: Vector2,
    /// Unit tangent of the right line, where it was measured.
    pub tangent_right: Option<Vector2>,
    /// `x_R - x_L` in rectified px.
    pub disparity_px: f64,
    /// One sigma of the disparity.
    pub sigma_px: f64,
    /// How far to trust it.
    pub flag: Flag,
}

impl MatchedPoint {
    /// The matching point in the rectified right image, on the same row.
    pub fn right(&self) -> Point2 {
        Point2::new(self.left.x + self.disparity_px, self.left.y)
    }
}

/// A line (or the stretch of one) that was found in both images.
#[derive(Clone, Debug, PartialEq)]
pub struct MatchedCurve {
    /// Index of the left trace it lies on.
    pub left_trace: usize,
    /// Points in the order of the left trace, at least two.
    pub points: Vec<MatchedPoint>,
    /// Whether the last point joins the first.
    pub closed: bool,
    /// What the first and last point end at in the left image; `Free` where matching, not the line, ended.
    pub ends: [TraceEnd; 2],
}

impl MatchedCurve {
    /// Length in the rectified left image, in px.
    pub fn length_px(&self) -> f64 {
        let points: Vec<Point2> = self.points.iter().map(|point| point.left).collect();
        length2(&points)
    }
}

/// A point of a reconstructed curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurvePoint {
    /// Position in the pixels of the left input file.
    pub left_input: Point2,
    /// Position in the pixels of the right input file.
    pub right_input: Point2,
    /// Position in the rectified left image.
    pub left_rectified: Point2,
    /// Disparity in rectified px.
    pub disparity_px: f64,
    /// One sigma of the disparity in px.
    pub sigma_disparity_px: f64,
    /// Position in the mid-view frame, in the unit of the reconstruction: x and y from the centre of the rectified
    /// image, z away from the viewer, relative to the length-weighted median.
    pub position: Point3,
    /// One sigma of z in the unit of the reconstruction, without the tilt error, which scales all z alike.
    pub sigma_z: f64,
    /// How far to trust it.
    pub flag: Flag,
}

/// A dislocation (or a stretch of one) in the foil.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve3 {
    /// Points about 1 px of arc length apart in the left image, at least two.
    pub points: Vec<CurvePoint>,
    /// Whether the last point joins the first.
    pub closed: bool,
    /// What the first and last point end at.
    pub ends: [TraceEnd; 2],
}

impl Curve3 {
    /// Length in the foil, in the unit of the reconstruction.
    pub fn length(&self) -> f64 {
        let open: f64 = self.points.windows(2).map(|pair| (pair[1].position - pair[0].position).norm()).sum();
        match (self.closed, self.points.first(), self.points.last()) {
            (true, Some(first), Some(last)) => open + (first.position - last.position).norm(),
            _ => open,
        }
    }
}

/// A detected line, or the stretch of one, that found no match in the other view.
#[derive(Clone, Debug, PartialEq)]
pub struct UnmatchedLine {
    /// The view it was detected in.
    pub view: crate::micrograph::View,
    /// Points in the pixels of that view's input file.
    pub points_input: Vec<Point2>,
}

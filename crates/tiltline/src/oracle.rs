//! The oracle: a detector and a matcher that know the curves. They prove the geometry before any image is involved,
//! and, swapped in for one stage, show which stage loses accuracy.

use nalgebra::Translation2;

use crate::curve::{Flag, LineMap, MatchedCurve, MatchedPoint, TraceGraph};
use crate::geometry::{Point2, Similarity2, TiltPair, Vector2};
use crate::micrograph::View;
use crate::pipeline::{Detect, Match};
use crate::rectify::{Rectification, RectifiedPair};
use crate::simulate::draw::union_of_profiles;
use crate::simulate::{Scene, ViewSettings};
use crate::truth::{PairGeometry, TruthPair};

/// Standard deviation in px of the lines that the oracle's detector draws.
const LINE_SIGMA_PX: f64 = 1.5;
/// Furthest a traced point may lie from the true line to be given its disparity.
const REACH_PX: f64 = 3.0;

/// Knows the curves of a scene in both rectified views.
#[derive(Clone, Debug)]
pub struct Oracle {
    /// True curves in the rectified left and right image; same index, same physical point.
    pub curves: [Vec<Vec<Point2>>; 2],
}

impl Oracle {
    /// The oracle for a scene seen in two views, given how each view maps onto the rectified grid.
    pub fn new(scene: &Scene, views: [&ViewSettings; 2], rectification: &Rectification) -> Self {
        let maps = [&rectification.rectified_from_left, &rectification.rectified_from_right];
        let curves = [0, 1].map(|view| {
            let curves = views[view].project_curves(scene);
            curves.iter().map(|curve| curve.iter().map(|point| maps[view] * point).collect()).collect()
        });
        Self { curves }
    }

    /// True disparity and tangents at the point of a true left curve nearest to `left`, if one is within reach.
    pub fn disparity_at(&self, left: &Point2) -> Option<(f64, Vector2)> {
        let mut best: Option<(f64, f64, Vector2)> = None;
        for (left_curve, right_curve) in self.curves[0].iter().zip(&self.curves[1]) {
            for index in 1..left_curve.len() {
                let (a, b) = (left_curve[index - 1], left_curve[index]);
                let along = b - a;
                let foot = ((left - a).dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
                let distance = (left - (a + along * foot)).norm();
                if distance < best.map_or(REACH_PX, |(nearest, ..)| nearest) {
                    let d = (right_curve[index - 1].x - a.x) * (1.0 - foot) + (right_curve[index].x - b.x) * foot;
                    best = Some((distance, d, right_curve[index] - right_curve[index - 1]));
                }
            }
        }
        best.map(|(_, disparity, tangent)| (disparity, tangent))
    }
}

impl Detect for Oracle {
    fn detect(&self, pair: &RectifiedPair, view: View) -> LineMap {
        let (height, width) = pair.view(view).dim();
        let probability = union_of_profiles([height, width], &self.curves[view.index()], LINE_SIGMA_PX);
        LineMap { probability, line_width_px: LINE_SIGMA_PX * (8.0 * 2.0_f64.ln()).sqrt() }
    }
}

impl Match for Oracle {
    fn match_curves(&self, _: &RectifiedPair, _: &[LineMap; 2], traces: &[TraceGraph; 2]) -> Vec<MatchedCurve> {
        let mut matched = Vec::new();
        for (left_trace, trace) in traces[0].traces.iter().enumerate() {
            let points: Vec<MatchedPoint> = trace
                .points
                .iter()
                .filter_map(|point| {
                    let (disparity_px, tangent) = self.disparity_at(&point.position)?;
                    Some(MatchedPoint {
                        left: point.position,
                        tangent_left: point.tangent,
                        tangent_right: tangent.try_normalize(1e-9),
                        disparity_px,
                        sigma_px: point.sigma_perp_px,
                        flag: Flag::Ok,
                    })
                })
                .collect();
            if points.len() >= 2 {
                matched.push(MatchedCurve { left_trace, points, closed: trace.closed, ends: trace.ends });
            }
        }
        matched
    }
}

/// Knows the lines that a pair of a truth shows in both views, in px of the images, and follows them onto whatever
/// rectified grid it is asked about: the stages of a benchmark that lose nothing.
#[derive(Clone, Debug)]
pub struct TruthOracle {
    /// Centres of contrast in the left and right image, input px; same index, same epipolar row. Curves are cut where they
    /// cannot be asked for.
    curves: [Vec<Vec<Point2>>; 2],
}

impl TruthOracle {
    /// The oracle for a pair of views of a truth.
    pub fn new(pair: &TruthPair<'_>) -> Self {
        let mut curves = [Vec::new(), Vec::new()];
        for paired in pair.curves() {
            let points = paired.left.iter().zip(&paired.right).zip(&paired.counts);
            let points: Vec<_> =
                points.map(|((left, right), counts)| right.filter(|_| *counts).map(|right| [*left, right])).collect();
            let closing = points.first().filter(|_| paired.curve.closed).copied();
            let points: Vec<_> = points.into_iter().chain(closing).collect();
            for run in points.split(Option::is_none).filter(|run| run.len() >= 2) {
                for (view, curves) in curves.iter_mut().enumerate() {
                    curves.push(run.iter().flatten().map(|both| both[view]).collect());
                }
            }
        }
        Self { curves }
    }

    fn on(&self, rectification: &Rectification) -> Oracle {
        let maps = [&rectification.rectified_from_left, &rectification.rectified_from_right];
        let curves = [0, 1].map(|view| {
            let mapped = |curve: &Vec<Point2>| curve.iter().map(|point| maps[view] * point).collect();
            self.curves[view].iter().map(mapped).collect()
        });
        Oracle { curves }
    }
}

impl Detect for TruthOracle {
    fn detect(&self, pair: &RectifiedPair, view: View) -> LineMap {
        self.on(&pair.rectification).detect(pair, view)
    }
}

impl Match for TruthOracle {
    fn match_curves(&self, pair: &RectifiedPair, lines: &[LineMap; 2], traces: &[TraceGraph; 2]) -> Vec<MatchedCurve> {
        self.on(&pair.rectification).match_curves(pair, lines, traces)
    }
}

impl Rectification {
    /// The exact rectification of two views whose geometry is known, without an estimate: the rectified grid is the
    /// left image turned about its centre so that the tilt axis is vertical.
    pub fn from_known_views(left: &ViewSettings, right: &ViewSettings) -> Self {
        let rectified_from_projection = Similarity2::new(centre_of(left.shape), 0.0, left.scale);
        let maps = [left, right].map(|view| rectified_from_projection * view.image_from_projection().inverse());
        Self::known(maps, left.shape)
    }

    /// The exact rectification of a pair of a truth: the rectified grid has the size of the left image, the tilt axis upright,
    /// and the middle of the left image in its middle.
    pub fn of_truth(geometry: &PairGeometry, shape: [usize; 2]) -> Self {
        let centre = centre_of(shape);
        let shift = centre - (geometry.rows_from_left * Point2::from(centre)).coords;
        let shift = Translation2::from(shift);
        Self::known([shift * geometry.rows_from_left, shift * geometry.rows_from_right], shape)
    }

    /// Disparity of a point z px behind mid-foil (away from the viewer): `2 sin(phi / 2) z`.
    pub fn disparity_of_depth(tilts: &TiltPair, z: f64) -> f64 {
        z / tilts.depth_gain()
    }
}

/// Centre of an image of some rows and columns.
fn centre_of(shape: [usize; 2]) -> Vector2 {
    Vector2::new(0.5 * (shape[1] as f64 - 1.0), 0.5 * (shape[0] as f64 - 1.0))
}

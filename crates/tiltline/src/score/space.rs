//! Truth and result in one frame: plan (where the left view projects a point, axis upright) and disparity, both in px of
//! the left image ([`PairGeometry`]). Tolerances then mean the same for every tilt, pixel size and unit, and a depth offset
//! leaves the plan where it is.

use serde::{Deserialize, Serialize};

use crate::geometry::Point2;
use crate::reconstruction::LengthUnit;
use crate::score::calibration::weighted_quantile;
use crate::score::sampling::pieces;
use crate::score::{ResultCurves, ScoreError};
use crate::truth::{PairGeometry, TruthPair};

/// What truth a result's curves are held against.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Basis {
    /// The 3D cores: the headline.
    Core,
    /// The centres of contrast of both images, triangulated: what can be seen, without the shift of diffraction contrast.
    Contrast,
    /// Columns of the images, for labels without known geometry.
    Image,
}

/// A curve in plan and disparity.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SpaceCurve {
    pub plan: Vec<Point2>,
    pub disparity: Vec<f64>,
    /// Whether each point can be asked for (always true for results).
    pub counts: Vec<bool>,
    pub closed: bool,
}

/// The basis a truth allows for 3D scores.
pub(crate) fn best_basis(pair: &TruthPair<'_>) -> Basis {
    match pair.geometry {
        Some(_) if pair.curves().iter().any(|paired| paired.curve.points.is_some()) => Basis::Core,
        Some(_) => Basis::Contrast,
        None => Basis::Image,
    }
}

/// True curves that are in both views.
pub(crate) fn truth_curves(pair: &TruthPair<'_>, basis: Basis) -> Vec<SpaceCurve> {
    let curve = |paired: crate::truth::PairedCurve<'_>| {
        let closed = paired.curve.closed;
        if let (Basis::Core, Some(geometry), Some(points)) = (basis, pair.geometry, &paired.curve.points) {
            let (plan, disparity) = points.iter().map(|point| geometry.of_specimen(point)).unzip();
            return SpaceCurve { plan, disparity, counts: paired.counts, closed };
        }
        let mut space = SpaceCurve { plan: Vec::new(), disparity: Vec::new(), counts: Vec::new(), closed };
        for ((left, right), counts) in paired.left.iter().zip(&paired.right).zip(&paired.counts) {
            // A point without a partner has no depth; it stays, so that lengths agree, and is not asked for.
            let (plan, disparity) = match (right, pair.geometry) {
                (Some(right), Some(geometry)) => geometry.of_images(left, right),
                (Some(right), None) => (*left, right.x - left.x),
                (None, Some(geometry)) => (geometry.rows_from_left * left, f64::NAN),
                (None, None) => (*left, f64::NAN),
            };
            space.plan.push(plan);
            space.disparity.push(disparity);
            space.counts.push(*counts);
        }
        space
    };
    pair.curves().into_iter().map(curve).collect()
}

/// Curves of a result from its x, y, z columns, and the shift of origin, (x, y) in px, that was added to their plan.
///
/// A result counts x and y from the centre of its own rectified image. Where that lies is told by its own left image
/// columns: the shift is the median, over the result's length, of where they are less where x, y, z project to. No truth
/// curve takes part. z is used as it is (its sign and scale are judged); its offset is removed later.
pub(crate) fn result_curves(
    result: &ResultCurves,
    pair: &TruthPair<'_>,
    basis: Basis,
) -> Result<(Vec<SpaceCurve>, [f64; 2]), ScoreError> {
    let geometry = pair.geometry.filter(|_| basis != Basis::Image);
    let px_per_unit = geometry.map_or(Ok(1.0), |geometry| px_per_result_unit(result.unit, pair, &geometry))?;
    let mut curves: Vec<SpaceCurve> = result
        .curves
        .iter()
        .map(|curve| {
            let place = |point: &crate::score::ResultPoint| match geometry {
                Some(geometry) => geometry.of_mid_view(&(point.position * px_per_unit)),
                None => (point.left, point.right.x - point.left.x),
            };
            let (plan, disparity): (Vec<_>, Vec<_>) = curve.points.iter().map(place).unzip();
            SpaceCurve { counts: vec![true; plan.len()], plan, disparity, closed: curve.closed }
        })
        .collect();
    let shift = geometry.map_or([0.0; 2], |geometry| origin_shift(result, &curves, &geometry));
    for point in curves.iter_mut().flat_map(|curve| &mut curve.plan) {
        (point.x, point.y) = (point.x + shift[0], point.y + shift[1]);
    }
    Ok((curves, shift))
}

fn px_per_result_unit(unit: LengthUnit, pair: &TruthPair<'_>, geometry: &PairGeometry) -> Result<f64, ScoreError> {
    match (unit, pair.truth.unit) {
        (LengthUnit::Px, _) => Ok(1.0),
        (LengthUnit::Nm, LengthUnit::Nm) => Ok(geometry.px_per_unit),
        (LengthUnit::Nm, LengthUnit::Px) => pair.truth.pixel_size_nm.map(|size| 1.0 / size).ok_or(ScoreError::Unit),
    }
}

fn origin_shift(result: &ResultCurves, curves: &[SpaceCurve], geometry: &PairGeometry) -> [f64; 2] {
    let (mut x, mut y) = (Vec::new(), Vec::new());
    for (curve, space) in result.curves.iter().zip(curves) {
        let left = curve.left();
        for piece in pieces(&left, curve.closed) {
            let off = geometry.rows_from_left * piece.middle.point(&left) - piece.middle.point(&space.plan);
            x.push((off.x, piece.length));
            y.push((off.y, piece.length));
        }
    }
    [x, y].map(|offsets| weighted_quantile(offsets, 0.5).unwrap_or(0.0))
}

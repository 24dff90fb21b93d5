//! Truth and result in one frame: plan (where the left view projects a point, axis upright) and disparity, both in px of
//! the left image ([`PairGeometry`]). Tolerances then mean the same for every tilt, pixel size and unit, and a depth offset
//! leaves the plan where it is.

use nalgebra::Rotation3;
use serde::{Deserialize, Serialize};

use crate::geometry::{Point2, Vector2, Vector3};
use crate::reconstruction::LengthUnit;
use crate::score::calibration::weighted_quantile;
use crate::score::result::{ResultCurve, ResultPoint};
use crate::score::sampling::pieces;
use crate::score::{ResultCurves, ScoreError};
use crate::truth::{PairGeometry, TruthPair};

/// Turns of a result's frame, each a thousandth of the one before: the last is below rounding.
const TURNS: usize = 4;

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

/// Where a result's frame lies in the true one, as told by its own left image columns.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Placement {
    /// Turn about the viewing direction, radians clockwise on the screen: how far its tilt axis is off.
    pub turn_rad: f64,
    /// Shift of the plan after that, (x, y) px.
    pub shift_px: [f64; 2],
}

/// Curves of a result from its x, y, z columns, and where its frame was found to lie.
///
/// A result counts x and y from the centre of its own rectified image, along and across the axis it found. Where those lie
/// is told by its own left image columns: the turn is the least squares one, and the shift the median, over the result's
/// length, of where the true geometry puts its left points less where its x, y, z project to. No truth curve takes part.
///
/// The turn is one of the 3D points about the viewing direction, which leaves z, and so disparity, as it is. z is used as it is
/// (its sign and scale are judged); its offset is removed later.
pub(crate) fn result_curves(
    result: &ResultCurves,
    pair: &TruthPair<'_>,
    basis: Basis,
) -> Result<(Vec<SpaceCurve>, Placement), ScoreError> {
    let geometry = pair.geometry.filter(|_| basis != Basis::Image);
    let Some(geometry) = geometry else {
        let place = |point: &ResultPoint| (point.left, point.right.x - point.left.x);
        return Ok((space_curves(result, place), Placement::default()));
    };
    let px_per_unit = px_per_result_unit(result.unit, pair, &geometry)?;
    let turned_by = |turn_rad: f64| {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), turn_rad);
        space_curves(result, |point| geometry.of_mid_view(&(turn * point.position * px_per_unit)))
    };
    let mut turn_rad = 0.0;
    let mut curves = turned_by(turn_rad);
    // The projection does not turn with the points, so what is left over after one turn is turned again.
    for _ in 0..TURNS {
        turn_rad += remaining_turn(&offsets(result, &curves, &geometry));
        curves = turned_by(turn_rad);
    }
    let offsets = offsets(result, &curves, &geometry);
    let middle = |component: usize| {
        let values = offsets.iter().map(|offset| (offset.there[component] - offset.here[component], offset.weight));
        weighted_quantile(values.collect(), 0.5).unwrap_or(0.0)
    };
    let shift_px = [0, 1].map(middle);
    for point in curves.iter_mut().flat_map(|curve| &mut curve.plan) {
        (point.x, point.y) = (point.x + shift_px[0], point.y + shift_px[1]);
    }
    Ok((curves, Placement { turn_rad, shift_px }))
}

/// Curves of a result, each point placed by itself.
fn space_curves(result: &ResultCurves, place: impl Fn(&ResultPoint) -> (Point2, f64)) -> Vec<SpaceCurve> {
    let curve = |curve: &ResultCurve| {
        let (plan, disparity): (Vec<_>, Vec<_>) = curve.points.iter().map(&place).unzip();
        SpaceCurve { counts: vec![true; plan.len()], plan, disparity, closed: curve.closed }
    };
    result.curves.iter().map(curve).collect()
}

fn px_per_result_unit(unit: LengthUnit, pair: &TruthPair<'_>, geometry: &PairGeometry) -> Result<f64, ScoreError> {
    match (unit, pair.truth.unit) {
        (LengthUnit::Px, _) => Ok(1.0),
        (LengthUnit::Nm, LengthUnit::Nm) => Ok(geometry.px_per_unit),
        (LengthUnit::Nm, LengthUnit::Px) => pair.truth.pixel_size_nm.map(|size| 1.0 / size).ok_or(ScoreError::Unit),
    }
}

/// A piece of a result in its own plan and where the true geometry puts it by its left image columns.
struct Offset {
    here: Vector2,
    there: Vector2,
    weight: f64,
}

fn offsets(result: &ResultCurves, curves: &[SpaceCurve], geometry: &PairGeometry) -> Vec<Offset> {
    let mut offsets = Vec::new();
    for (curve, space) in result.curves.iter().zip(curves) {
        let left = curve.left();
        offsets.extend(pieces(&left, curve.closed).into_iter().map(|piece| Offset {
            here: piece.middle.point(&space.plan).coords,
            there: (geometry.rows_from_left * piece.middle.point(&left)).coords,
            weight: piece.length,
        }));
    }
    offsets
}

/// The turn that takes `here` to `there` best, weighted least squares, a shift being free; 0 where nothing shows it.
fn remaining_turn(offsets: &[Offset]) -> f64 {
    let weight: f64 = offsets.iter().map(|offset| offset.weight).sum();
    let mean = |place: fn(&Offset) -> Vector2| {
        offsets.iter().map(|offset| place(offset) * offset.weight).sum::<Vector2>() / weight.max(f64::MIN_POSITIVE)
    };
    let (here, there) = (mean(|offset| offset.here), mean(|offset| offset.there));
    let (mut dot, mut cross) = (0.0, 0.0);
    for offset in offsets {
        let (p, q) = (offset.here - here, offset.there - there);
        dot += offset.weight * p.dot(&q);
        cross += offset.weight * p.perp(&q);
    }
    cross.atan2(dot)
}

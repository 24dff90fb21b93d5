//! A tomogram in the report, beside the curves.

use ndarray::{Array3, Axis};
use serde::{Deserialize, Serialize};

use super::image::Picture;
use super::{GEOMETRY_DIGITS, MEASURE_DIGITS, ReportError, kept};
use crate::filter::percentiles;
use crate::geometry::Point3;
use crate::series::SavedCurves;
use crate::tomography::Geometry;
use crate::tomography::compare::{Comparison, REACH_PX, compare};

/// Pictures of the volume have at most so many px a side.
const PICTURE_PX: usize = 768;

/// Curves beside a tomogram.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReportTomogram {
    /// How the tomogram was made, in words.
    pub method: String,
    /// The figures.
    pub comparison: Comparison,
    /// Columns, rows and layers, voxels.
    pub size: [usize; 3],
    /// The largest value along z, and along y (layers down), as pictures averaged down to at most 768 px a side.
    pub above: Picture,
    /// See `above`.
    pub edge: Picture,
    /// Side of a pixel of `above` and of `edge`, voxels.
    pub step: [usize; 2],
    /// Rows (a, b, c, d): voxel x, y, z are `a x + b y + c z + d` of a curve's position in the unit of the frame.
    pub voxels: [[f64; 4]; 3],
}

impl ReportTomogram {
    /// Compares the curves of a result with a volume `[z, y, x]` of its series, aligned so that the origin of the curves lies on
    /// the tilt axis in the middle row. `None` where there is nothing bright in it.
    ///
    /// # Errors
    /// Where a picture cannot be encoded.
    pub fn new(
        volume: &Array3<f32>,
        geometry: &Geometry,
        curves: &SavedCurves,
        method: String,
    ) -> Result<Option<Self>, ReportError> {
        let (layers, rows, columns) = volume.dim();
        let voxels = voxels(geometry, rows, curves);
        let origin = Point3::new(geometry.axis_column, 0.0, geometry.middle_layer());
        let (_, pixel) = curves.unit;
        let sign = depth_sign(curves);
        let place = |point: &Point3| {
            let position = [point.x * pixel, point.y * pixel, sign * point.z * pixel];
            let at = voxels.map(|[a, b, c, d]| a * position[0] + b * position[1] + c * position[2] + d);
            Point3::from(Point3::from(at) - origin)
        };
        let lines = curves.curves.iter().map(|curve| {
            let closing = curve.closed.then(|| &curve.points[0]);
            curve.points.iter().chain(closing).map(place).collect()
        });
        let along_px = REACH_PX * curves.tilts.depth_gain().abs();
        let Some(comparison) = compare(volume, geometry, &lines.collect::<Vec<_>>(), along_px) else {
            return Ok(None);
        };
        let (above, above_step) = picture(volume, Axis(0))?;
        let (edge, edge_step) = picture(volume, Axis(1))?;
        Ok(Some(Self {
            method,
            comparison: kept(&comparison, MEASURE_DIGITS)?,
            size: [columns, rows, layers],
            above,
            edge,
            step: [above_step, edge_step],
            voxels: kept(&voxels, GEOMETRY_DIGITS)?,
        }))
    }
}

fn depth_sign(curves: &SavedCurves) -> f64 {
    if curves.depth_flipped { -1.0 } else { 1.0 }
}

/// From positions of the result (mid-view frame, its unit, its sign of depth) to voxels: turned about the tilt axis, so that z runs
/// along the beam at tilt zero.
fn voxels(geometry: &Geometry, rows: usize, curves: &SavedCurves) -> [[f64; 4]; 3] {
    let (sin, cos) = curves.tilts.mid_rad().sin_cos();
    let (sign, (_, pixel)) = (depth_sign(curves), curves.unit);
    [
        [cos / pixel, 0.0, -sin * sign / pixel, geometry.axis_column],
        [0.0, 1.0 / pixel, 0.0, 0.5 * (rows as f64 - 1.0)],
        [sin / pixel, 0.0, cos * sign / pixel, geometry.middle_layer()],
    ]
}

/// The largest value along an axis, as a picture, and the side of its pixels in voxels.
fn picture(volume: &Array3<f32>, axis: Axis) -> Result<(Picture, usize), ReportError> {
    let most = volume.fold_axis(axis, f32::NEG_INFINITY, |most, value| most.max(*value));
    let [low, high] = percentiles(&most, [0.02, 0.998]);
    let range = (high - low).max(f32::MIN_POSITIVE);
    let grey = most.mapv_into(|value| (value - low) / range);
    let step = grey.nrows().max(grey.ncols()).div_ceil(PICTURE_PX).max(1);
    Ok((Picture::reduced(&grey, step)?, step))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Point2, TiltPair};
    use crate::reconstruction::LengthUnit;
    use crate::series::{SavedCurve, ViewPose};

    /// A line as a tomogram of tilts about zero shows it, and as a pair about 20 degrees sees it: the projections into any view must
    /// be the same (x = X cos a + Z sin a), so the voxels that the report states are where the line is bright.
    #[test]
    fn curves_of_a_tilted_pair_lie_in_the_bright_voxels_whatever_the_sign_of_depth() {
        let tilts = TiltPair::from_degrees(16.0, 24.0);
        let mid = tilts.mid_rad();
        // In the frame of the series, px.
        let line: Vec<Point3> =
            (0..60).map(|k| Point3::new(0.5 * f64::from(k) - 12.0, f64::from(k) - 30.0, 9.0)).collect();
        let in_view = |point: &Point3, tilt: f64| point.x * tilt.cos() + point.z * tilt.sin();
        // The mid-view frame: X is what the mid view shows, Z what a view at right angles to it shows.
        let quarter = std::f64::consts::FRAC_PI_2;
        let points: Vec<Point3> =
            line.iter().map(|point| Point3::new(in_view(point, mid), point.y, in_view(point, mid + quarter))).collect();
        let geometry = Geometry::centred(vec![-0.5, 0.0, 0.5], 64, 41);
        let mut volume = Array3::zeros((41, 64, 64));
        for ((layer, row, column), value) in volume.indexed_iter_mut() {
            let near = |point: &Point3| {
                let off = [
                    column as f64 - geometry.axis_column - point.x,
                    row as f64 - 31.5 - point.y,
                    layer as f64 - geometry.middle_layer() - point.z,
                ];
                off.iter().map(|value| value * value).sum::<f64>()
            };
            let nearest = line.iter().map(near).fold(f64::INFINITY, f64::min);
            *value = (-0.25 * nearest).exp() as f32;
        }
        for depth_flipped in [false, true] {
            let curve = SavedCurve {
                sigma_z: vec![1.0; points.len()],
                flags: vec![crate::curve::Flag::Ok; points.len()],
                points: points.clone(),
                closed: false,
            };
            let curves = SavedCurves {
                curves: vec![curve],
                tilts,
                poses: [-4.0_f64, 4.0].map(|tilt| ViewPose::new(tilt.to_radians(), 0.0, 1.0, Point2::new(31.5, 31.5))),
                unit: (LengthUnit::Nm, 2.5),
                depth_flipped,
                sha256: String::new(),
            };
            let shown = ReportTomogram::new(&volume, &geometry, &curves, String::new()).unwrap().unwrap();
            let [off, spread] = shown.comparison.depth_px.unwrap();
            assert!(shown.comparison.result[1] > 0.9 && off.abs() < 0.3 && spread < 0.5, "{:?}", shown.comparison);
            let sign = if depth_flipped { -1.0 } else { 1.0 };
            for (point, expected) in points.iter().zip(&line) {
                let position = [2.5 * point.x, 2.5 * point.y, sign * 2.5 * point.z];
                let at = shown.voxels.map(|[a, b, c, d]| a * position[0] + b * position[1] + c * position[2] + d);
                let expected = [expected.x + 31.5, expected.y + 31.5, expected.z + 20.0];
                assert!(at.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{at:?} {expected:?}");
            }
        }
        let dark = Array3::zeros((8, 8, 8));
        let empty = SavedCurves {
            curves: Vec::new(),
            tilts,
            poses: [ViewPose::new(0.0, 0.0, 1.0, Point2::origin()); 2],
            unit: (LengthUnit::Px, 1.0),
            depth_flipped: false,
            sha256: String::new(),
        };
        assert!(
            ReportTomogram::new(&dark, &Geometry::centred(vec![0.0, 0.1], 8, 8), &empty, String::new())
                .unwrap()
                .is_none()
        );
    }
}

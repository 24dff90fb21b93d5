//! Curves of a result read back from its `curves.json`, with the poses of its two views.

use std::path::Path;

use serde::Deserialize;
use serde_json::{Map, Value};
use sha2::{Digest, Sha256};

use super::{SeriesError, ViewPose};
use crate::curve::{Curve3, Flag};
use crate::geometry::{Point2, Point3, TiltPair, Vector2};
use crate::reconstruction::{Frame, LengthUnit, Reconstruction};
use crate::rectify::Rectification;

/// No result is larger, bytes.
const MAX_BYTES: u64 = 1 << 31;

/// One curve of a result.
#[derive(Clone, Debug, PartialEq)]
pub struct SavedCurve {
    /// Points in the mid-view frame in rectified px, with the depth sign of the tilts (an asked-for flip undone): what
    /// [`ViewPose`]s project.
    pub points: Vec<Point3>,
    /// One sigma of z at each, rectified px.
    pub sigma_z: Vec<f64>,
    /// How far each is trusted.
    pub flags: Vec<Flag>,
    /// Whether the last point joins the first.
    pub closed: bool,
}

/// Curves of a result and how its two views were taken.
#[derive(Clone, Debug, PartialEq)]
pub struct SavedCurves {
    /// The curves.
    pub curves: Vec<SavedCurve>,
    /// Tilts of left and right as the result has them.
    pub tilts: TiltPair,
    /// Poses of left and right in the mid-view frame: their tilts are -phi/2 and phi/2.
    pub poses: [ViewPose; 2],
    /// Unit of the result's lengths, and how many of it a rectified px has.
    pub unit: (LengthUnit, f64),
    /// Whether the result's depths have the other sign, as was asked for.
    pub depth_flipped: bool,
    /// SHA-256 of the file they were read from, in hex; empty for curves that were not.
    pub sha256: String,
}

#[derive(Deserialize)]
struct File {
    tilts_deg: [f64; 2],
    frame: Frame,
    rectification: Rectification,
    curves: Vec<Curve>,
}

#[derive(Deserialize)]
struct Curve {
    closed: bool,
    points: Map<String, Value>,
}

impl SavedCurves {
    /// Reads the `curves.json` of a result's folder, or the file itself.
    ///
    /// # Errors
    /// Where it cannot be read or is not such a file.
    pub fn read(path: &Path) -> Result<Self, SeriesError> {
        let path = if path.is_dir() { path.join("curves.json") } else { path.to_path_buf() };
        let fault = |what: String| SeriesError::Result { path: path.clone(), what };
        let size = std::fs::metadata(&path).map_err(|error| {
            fault(format!("cannot be read ({error}); name the folder that `tiltline reconstruct` wrote"))
        })?;
        if size.len() > MAX_BYTES {
            return Err(fault(format!("the file has {} bytes: it is no result", size.len())));
        }
        let text = std::fs::read_to_string(&path).map_err(|error| fault(format!("cannot be read: {error}")))?;
        let file: File = serde_json::from_str(&text)
            .map_err(|error| fault(format!("it is no curves.json of `tiltline reconstruct`: {error}")))?;
        let sha256 = Sha256::digest(text.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Self { sha256, ..file.curves().map_err(fault)? })
    }
}

impl File {
    fn curves(&self) -> Result<SavedCurves, String> {
        let tilts = TiltPair::from_degrees(self.tilts_deg[0], self.tilts_deg[1]);
        let Frame { pixel, unit, depth_flipped, .. } = self.frame;
        let sound = pixel.is_finite() && pixel > 0.0 && tilts.phi().is_finite() && tilts.phi() != 0.0;
        if !sound {
            return Err(format!("tilts {:?} or pixel {pixel} cannot be", self.tilts_deg));
        }
        let sign = if depth_flipped { -1.0 } else { 1.0 };
        let curve = |(index, curve): (usize, &Curve)| {
            let numbers = |name: &str| -> Result<Vec<f64>, String> {
                let values = curve.points.get(name).and_then(Value::as_array);
                let values = values.ok_or_else(|| format!("curve {index} has no {name}"))?;
                let numbers = values.iter().map(Value::as_f64).collect::<Option<Vec<f64>>>();
                numbers.ok_or_else(|| format!("curve {index}: {name} are not all numbers"))
            };
            let [x, y, z] = ["x", "y", "z"].map(|axis| numbers(&format!("{axis}_{}", unit.word())));
            let (x, y, z) = (x?, y?, z?);
            let sigma_z = numbers(&format!("sigma_z_{}", unit.word()))?;
            let words = curve.points.get("flag").and_then(Value::as_array).map(Vec::as_slice).unwrap_or_default();
            let flags: Vec<Flag> = words.iter().filter_map(|word| flag(word.as_str()?)).collect();
            if [y.len(), z.len(), flags.len(), sigma_z.len()] != [x.len(); 4] || x.len() < 2 {
                return Err(format!(
                    "curve {index} has columns of different length, an unknown flag or too few points"
                ));
            }
            let point = |at: usize| Point3::new(x[at] / pixel, y[at] / pixel, sign * z[at] / pixel);
            let sigma_z = sigma_z.iter().map(|sigma| sigma / pixel).collect();
            Ok(SavedCurve { points: (0..x.len()).map(point).collect(), sigma_z, flags, closed: curve.closed })
        };
        let curves = self.curves.iter().enumerate().map(curve).collect::<Result<_, _>>()?;
        Ok(SavedCurves {
            curves,
            tilts,
            poses: poses(&self.rectification, tilts, &self.frame),
            unit: (unit, pixel),
            depth_flipped,
            sha256: String::new(),
        })
    }
}

fn flag(word: &str) -> Option<Flag> {
    [Flag::Ok, Flag::IllConditioned, Flag::Bridged].into_iter().find(|flag| flag.word() == word)
}

/// Poses of the views of a pair in its mid-view frame: x and y from the centre of the rectified image, z relative to its median.
pub(super) fn poses(rectification: &Rectification, tilts: TiltPair, frame: &Frame) -> [ViewPose; 2] {
    let half = 0.5 * tilts.phi();
    let maps = [(&rectification.rectified_from_left, -half), (&rectification.rectified_from_right, half)];
    // Depths were measured from where disparity is zero; what was subtracted since moves each view along the rows.
    let sign = if frame.depth_flipped { -1.0 } else { 1.0 };
    let median_z = sign * frame.median_z / frame.pixel;
    maps.map(|(rectified_from_image, tilt_rad)| {
        let centre = Vector2::new(frame.centre_px[0] + median_z * tilt_rad.sin(), frame.centre_px[1]);
        let image_from_rectified = rectified_from_image.inverse();
        let origin = image_from_rectified * Point2::from(centre);
        let turn = image_from_rectified.isometry.rotation.angle();
        ViewPose::new(tilt_rad, turn, image_from_rectified.scaling(), origin)
    })
}

impl SavedCurves {
    /// The curves of a result in memory.
    pub fn of(result: &Reconstruction) -> Self {
        let Frame { pixel, unit, depth_flipped, .. } = result.frame;
        let sign = if depth_flipped { -1.0 } else { 1.0 };
        let curve = |curve: &Curve3| SavedCurve {
            points: curve
                .points
                .iter()
                .map(|point| Point3::new(point.position.x, point.position.y, sign * point.position.z) / pixel)
                .collect(),
            sigma_z: curve.points.iter().map(|point| point.sigma_z / pixel).collect(),
            flags: curve.points.iter().map(|point| point.flag).collect(),
            closed: curve.closed,
        };
        Self {
            curves: result.curves.iter().map(curve).collect(),
            tilts: result.pair.tilts,
            poses: poses(&result.rectified.rectification, result.pair.tilts, &result.frame),
            unit: (unit, pixel),
            depth_flipped,
            sha256: String::new(),
        }
    }

    /// Each curve in a view with this pose, px of the view.
    pub fn projected(&self, pose: &ViewPose) -> Vec<Vec<Point2>> {
        self.curves.iter().map(|curve| curve.points.iter().map(|point| pose.project(point)).collect()).collect()
    }

    /// Share of the spread of depths that is not their own error: `1 - mean(sigma^2) / variance`, between 0.2 and 1.
    pub fn reliability(&self) -> f64 {
        let points = self.curves.iter().flat_map(|curve| curve.points.iter().zip(&curve.sigma_z));
        let (mut count, mut sum, mut squares, mut errors) = (0.0, 0.0, 0.0, 0.0);
        for (point, sigma) in points.filter(|(_, sigma)| sigma.is_finite()) {
            count += 1.0;
            sum += point.z;
            squares += point.z * point.z;
            errors += sigma * sigma;
        }
        let variance = squares - sum * sum / f64::max(count, 1.0);
        if variance > 0.0 { (1.0 - errors / variance).clamp(0.2, 1.0) } else { 0.2 }
    }

    /// All points, and the direction of their curve there; of closed curves too each point once.
    pub fn points_with_tangents(&self) -> Vec<(Point3, crate::geometry::Vector3)> {
        let of_curve = |curve: &SavedCurve| {
            let last = curve.points.len() - 1;
            let tangent = |at: usize| curve.points[(at + 1).min(last)] - curve.points[at.saturating_sub(1)];
            (0..=last).map(|at| (curve.points[at], tangent(at))).collect::<Vec<_>>()
        };
        self.curves.iter().flat_map(of_curve).collect()
    }
}

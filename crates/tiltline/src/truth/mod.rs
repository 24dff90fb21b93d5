//! Truth: the curves that are really in a foil and where each view shows them. What the simulator writes, what
//! annotated images are brought into, and what every score is measured against (docs/truth.md is the file's reference).
//!
//! - 3D points lie in the untilted specimen frame (CONVENTIONS.md), in nm, or in px where no pixel size is known.
//! - 2D points are in px of the image file as the user has it ("input px"), pixel centres at integers.
//! - Diffraction contrast sits several px beside the core of a dislocation, so both are kept: 2D scores use the noise-free
//!   centre of contrast, 3D scores the core.

mod error;
mod file;
mod labelme;
mod pair;
mod raster;

use nalgebra::{Rotation2, Translation2};
use serde::{Deserialize, Serialize};

pub use error::TruthError;
pub use labelme::{LabelWarning, import_labelme};
pub use pair::{PairGeometry, PairedCurve, TruthPair};
pub use raster::{curve_mask, draw_polyline};

use crate::geometry::{Point2, Point3, Similarity2, Vector2, Vector3, project_at_tilt};
use crate::reconstruction::LengthUnit;
use crate::simulate::Foil;

/// The version of the file format this program writes.
pub const TRUTH_VERSION: u32 = 1;

/// The name of the format, the first entry of every file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum TruthFormat {
    /// The only one.
    #[default]
    #[serde(rename = "tiltline-truth")]
    TiltlineTruth,
}

/// Known curves of one foil in any number of views.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Truth {
    /// Always `tiltline-truth`.
    pub format: TruthFormat,
    /// Version of the format, [`TRUTH_VERSION`].
    pub version: u32,
    /// Unit of the 3D points.
    pub unit: LengthUnit,
    /// Side of a pixel of the first view in nm, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixel_size_nm: Option<f64>,
    /// Look of the images (`gan`, `tial`, `cantor`, ...), for scores by family.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub family: Option<String>,
    /// Where the truth comes from: simulator and seed, or who labelled what.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
    /// The curves, each with a label of its own.
    pub curves: Vec<TrueCurve>,
    /// The views; of a pair, left then right.
    pub views: Vec<TrueView>,
}

/// One curve of the foil.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrueCurve {
    /// Name, unique in the file: the correspondence between views.
    pub label: String,
    /// Whether the last point joins the first.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub closed: bool,
    /// The core in the untilted specimen frame; absent for hand labels. Where present, the points of every view are
    /// aligned with it, index by index.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub points: Option<Vec<Point3>>,
    /// Burgers vector in nm, specimen frame, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub burgers_nm: Option<Vector3>,
    /// Unit normal of the slip plane, specimen frame, if it lies on one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plane_normal: Option<Vector3>,
}

/// What one view shows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrueView {
    /// File name of the image (relative to this file), or any name.
    pub name: String,
    /// Tilt in radians (degrees in the file), if known.
    #[serde(default, rename = "tilt_deg", with = "file::degrees", skip_serializing_if = "Option::is_none")]
    pub tilt_rad: Option<f64>,
    /// Columns of the image.
    pub width: usize,
    /// Rows of the image.
    pub height: usize,
    /// From the projected specimen to the image; absent where unknown. Where a view of a pair lacks it, the rows of both
    /// images are taken as epipolar lines.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub input_from_projection: Option<ViewMap>,
    /// The multiple of noise and local texture above which a point's contrast counts as visible, where it was computed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub visible_above_noise: Option<f64>,
    /// The curves in this image; a curve that is not here is not in the image or was not labelled.
    pub curves: Vec<ProjectedCurve>,
}

/// Projected specimen plane (origin on the tilt axis, y along it) to input px.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ViewMap {
    /// Input px per unit of the 3D points.
    pub scale_px: f64,
    /// Direction of the tilt axis, radians (degrees in the file) clockwise on the screen from image y.
    #[serde(rename = "axis_deg", with = "file::degrees_always")]
    pub axis_rad: f64,
    /// Where the specimen's origin lands, (x, y) in input px.
    pub origin_px: [f64; 2],
}

impl ViewMap {
    /// As a transform.
    pub fn input_from_projection(&self) -> Similarity2 {
        let shift = Translation2::from(Vector2::from(self.origin_px));
        Similarity2::from_parts(shift, Rotation2::new(self.axis_rad).into(), self.scale_px)
    }

    /// Where a specimen point lands at a tilt, in input px.
    pub fn project(&self, point: &Point3, tilt_rad: f64) -> Point2 {
        self.input_from_projection() * project_at_tilt(point, tilt_rad)
    }
}

/// One curve in one image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProjectedCurve {
    /// The curve's label in [`Truth::curves`].
    pub label: String,
    /// The noise-free centre of contrast (for hand labels, what was drawn), in input px. Points may lie outside the image.
    pub contrast: Vec<Point2>,
    /// The projected core in input px, index by index with `contrast`; absent for hand labels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub core: Option<Vec<Point2>>,
    /// Whether each point's contrast stands out from the noise; absent where all of them do.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub visible: Option<Vec<bool>>,
}

impl ProjectedCurve {
    /// A curve whose contrast sits on its core and is visible everywhere.
    pub fn on_core(label: impl Into<String>, core: Vec<Point2>) -> Self {
        Self { label: label.into(), contrast: core.clone(), core: Some(core), visible: None }
    }

    /// Whether the contrast of a point stands out from the noise.
    pub fn is_visible(&self, index: usize) -> bool {
        self.visible.as_ref().is_none_or(|visible| visible[index])
    }
}

impl TrueView {
    /// The curve of a label, if it is in this view.
    pub fn curve(&self, label: &str) -> Option<&ProjectedCurve> {
        self.curves.iter().find(|curve| curve.label == label)
    }

    /// Whether a point lies on the image: within half a pixel of its pixel centres.
    pub fn contains(&self, point: &Point2) -> bool {
        let inside = |at: f64, count: usize| at >= -0.5 && at <= count as f64 - 0.5;
        inside(point.x, self.width) && inside(point.y, self.height)
    }
}

/// What a view of a foil needs beside the foil.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewGeometry {
    /// Name of the view.
    pub name: String,
    /// Tilt in radians.
    pub tilt_rad: f64,
    /// Rows and columns.
    pub shape: [usize; 2],
    /// Projected specimen to input px.
    pub map: ViewMap,
}

impl Truth {
    /// The truth of a foil (nm) seen in some views, as if contrast sat on the cores and all of it were visible; a
    /// simulator then replaces `contrast` and `visible` by what it computed.
    pub fn of_foil(foil: &Foil, views: &[ViewGeometry]) -> Self {
        let curves: Vec<TrueCurve> = foil
            .dislocations
            .iter()
            .enumerate()
            .map(|(index, line)| TrueCurve {
                label: index.to_string(),
                closed: line.closed,
                points: Some(line.points.clone()),
                burgers_nm: line.burgers_nm,
                plane_normal: line.plane_normal,
            })
            .collect();
        let views = views.iter().map(|view| TrueView::of_curves(&curves, view)).collect();
        let format = TruthFormat::TiltlineTruth;
        let (unit, version) = (LengthUnit::Nm, TRUTH_VERSION);
        Self { format, version, unit, pixel_size_nm: None, family: None, source: None, curves, views }
    }

    /// Views `left` and `right` as a pair.
    ///
    /// # Errors
    /// Where a view does not exist, or both are the same.
    pub fn pair(&self, left: usize, right: usize) -> Result<TruthPair<'_>, TruthError> {
        TruthPair::new(self, left, right)
    }

    /// The curve of a label.
    pub fn curve(&self, label: &str) -> Option<&TrueCurve> {
        self.curves.iter().find(|curve| curve.label == label)
    }
}

impl TrueView {
    /// The cores of 3D curves in a view; curves without 3D points are left out.
    pub fn of_curves(curves: &[TrueCurve], view: &ViewGeometry) -> Self {
        let project = |point: &Point3| view.map.project(point, view.tilt_rad);
        let curves = curves
            .iter()
            .filter_map(|curve| {
                let core = curve.points.as_ref()?.iter().map(project).collect();
                Some(ProjectedCurve::on_core(&curve.label, core))
            })
            .collect();
        Self {
            name: view.name.clone(),
            tilt_rad: Some(view.tilt_rad),
            width: view.shape[1],
            height: view.shape[0],
            input_from_projection: Some(view.map),
            visible_above_noise: None,
            curves,
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;

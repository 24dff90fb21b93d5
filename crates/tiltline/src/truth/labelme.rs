//! Import of hand labels: LabelMe JSON files (`shapes` with `shape_type` "linestrip", "line" or "polygon", one file an image).
//!
//! Source of the format: the files written by LabelMe 5 (github.com/wkentaro/labelme): `imagePath`, `imageHeight`,
//! `imageWidth`, `shapes[] {label, points [[x, y], ...], group_id, shape_type}`. LabelMe counts from the corner of the
//! first pixel; half a pixel is subtracted here, because pixel centres are at integers (CONVENTIONS.md).

use std::collections::HashMap;
use std::path::Path;

use serde::Deserialize;

use crate::geometry::Point2;
use crate::reconstruction::LengthUnit;
use crate::truth::file::{read_bytes, unique};
use crate::truth::{ProjectedCurve, TRUTH_VERSION, TrueCurve, TrueView, Truth, TruthError, TruthFormat};

/// Something a person should know about imported labels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LabelWarning {
    /// A label that only one of the two files has: the line counts in that image, and is not asked for in the pair.
    OneSided {
        /// The label.
        label: String,
        /// The file that has it.
        file: String,
    },
    /// A shape that is not a line.
    NotALine {
        /// Its label.
        label: String,
        /// Its `shape_type`.
        shape_type: String,
        /// The file.
        file: String,
    },
    /// A line that reaches outside its image.
    Outside {
        /// Its label.
        label: String,
        /// Points outside.
        points: usize,
        /// The file.
        file: String,
    },
}

impl std::fmt::Display for LabelWarning {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::OneSided { label, file } => {
                write!(formatter, "label '{label}' is only in {file}: give the same line the same label in both images")
            }
            Self::NotALine { label, shape_type, file } => {
                write!(
                    formatter,
                    "shape '{label}' in {file} is a {shape_type} and was left out: draw lines as linestrip"
                )
            }
            Self::Outside { label, points, file } => {
                write!(formatter, "{points} points of '{label}' in {file} lie outside the image and are not scored")
            }
        }
    }
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct LabelFile {
    shapes: Vec<Shape>,
    image_path: Option<String>,
    image_height: usize,
    image_width: usize,
}

// LabelMe's own versions add keys, so unknown ones are let through here.
#[derive(Deserialize)]
struct Shape {
    label: String,
    points: Vec<[f64; 2]>,
    #[serde(default)]
    group_id: Option<i64>,
    #[serde(default = "polygon")]
    shape_type: String,
}

/// What LabelMe means where it writes no type.
fn polygon() -> String {
    "polygon".into()
}

impl Shape {
    /// One name for one line: the label, with the group where there is one.
    fn name(&self) -> String {
        match self.group_id {
            Some(group) => format!("{}#{group}", self.label),
            None => self.label.clone(),
        }
    }
}

/// The truth of a pair labelled in LabelMe, without 3D; lines correspond by label (and `group_id`, where there is one).
///
/// `tilts_deg` are the tilts of left and right, where known.
///
/// # Errors
/// Where a file is not LabelMe's, a number is not finite, two lines of one image have the same name, or no line is in
/// both.
pub fn import_labelme(
    left: &Path,
    right: &Path,
    tilts_deg: Option<[f64; 2]>,
) -> Result<(Truth, Vec<LabelWarning>), TruthError> {
    let mut warnings = Vec::new();
    let mut closed = HashMap::new();
    let mut views = Vec::new();
    for (index, path) in [left, right].into_iter().enumerate() {
        let mut view = read_view(path, &mut closed, &mut warnings)?;
        view.tilt_rad = tilts_deg.map(|tilts| tilts[index].to_radians());
        views.push(view);
    }
    for (here, there, path) in [(0, 1, left), (1, 0, right)] {
        for curve in &views[here].curves {
            if views[there].curve(&curve.label).is_none() {
                warnings.push(LabelWarning::OneSided { label: curve.label.clone(), file: path.display().to_string() });
            }
        }
    }
    if !views[0].curves.iter().any(|curve| views[1].curve(&curve.label).is_some()) {
        return Err(TruthError::NothingInCommon { left: left.into(), right: right.into() });
    }
    let mut curves: Vec<TrueCurve> = Vec::new();
    for label in views.iter().flat_map(|view| &view.curves).map(|curve| &curve.label) {
        if !curves.iter().any(|curve| curve.label == *label) {
            let closed = closed.get(label).copied().unwrap_or(false);
            let label = label.clone();
            curves.push(TrueCurve { label, closed, points: None, burgers_nm: None, plane_normal: None });
        }
    }
    let truth = Truth {
        format: TruthFormat::TiltlineTruth,
        version: TRUTH_VERSION,
        unit: LengthUnit::Px,
        pixel_size_nm: None,
        family: None,
        source: Some(format!("LabelMe: {}, {}", left.display(), right.display())),
        curves,
        views,
    };
    truth.check()?;
    Ok((truth, warnings))
}

fn read_view(
    path: &Path,
    closed: &mut HashMap<String, bool>,
    warnings: &mut Vec<LabelWarning>,
) -> Result<TrueView, TruthError> {
    let labels: LabelFile =
        serde_json::from_slice(&read_bytes(path)?).map_err(|source| TruthError::Json { path: path.into(), source })?;
    let file = path.display().to_string();
    let mut view = TrueView {
        name: labels.image_path.unwrap_or_else(|| file.clone()),
        tilt_rad: None,
        width: labels.image_width,
        height: labels.image_height,
        input_from_projection: None,
        visible_above_noise: None,
        curves: Vec::new(),
    };
    for shape in labels.shapes {
        let label = shape.name();
        if !matches!(shape.shape_type.as_str(), "linestrip" | "line" | "polygon") {
            warnings.push(LabelWarning::NotALine { label, shape_type: shape.shape_type, file: file.clone() });
            continue;
        }
        closed.insert(label.clone(), shape.shape_type == "polygon" && shape.points.len() > 2);
        let contrast: Vec<Point2> = shape.points.iter().map(|[x, y]| Point2::new(x - 0.5, y - 0.5)).collect();
        let points = contrast.iter().filter(|point| !view.contains(point)).count();
        if points > 0 {
            warnings.push(LabelWarning::Outside { label: label.clone(), points, file: file.clone() });
        }
        view.curves.push(ProjectedCurve { label, contrast, core: None, visible: None });
    }
    unique(view.curves.iter().map(|curve| curve.label.as_str()), || file.clone())?;
    Ok(view)
}

//! Dislocation density: length per volume of foil where its thickness is known, else per projected area.
//!
//! The interval joins the error of the length, the counting of curves (a compound Poisson process: relative variance
//! `sum l^2 / (sum l)^2`) and the thickness, as factors of a log-normal.

use serde::{Deserialize, Serialize};

use crate::measure::{CurveMeasures, Foil, Known, LengthBudget};
use crate::reconstruction::{Frame, LengthUnit};
use crate::rectify::RectifiedPair;

/// What every density is.
pub const LOWER_BOUND: &str = "lower bound: lines invisible with this g are not counted";

/// Two-sided 95 percent of a normal distribution.
const NORMAL_95: f64 = 1.959_964;

/// Unit of a density.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DensityUnit {
    /// Length per volume.
    #[serde(rename = "m^-2")]
    PerSquareMetre,
    /// Length per volume, pixel size unknown.
    #[serde(rename = "px^-2")]
    PerSquarePixel,
    /// Length per projected area.
    #[serde(rename = "m^-1")]
    PerMetre,
    /// Length per projected area, pixel size unknown.
    #[serde(rename = "px^-1")]
    PerPixel,
}

impl DensityUnit {
    /// The unit as it is written.
    pub fn word(self) -> &'static str {
        match self {
            DensityUnit::PerSquareMetre => "m^-2",
            DensityUnit::PerSquarePixel => "px^-2",
            DensityUnit::PerMetre => "m^-1",
            DensityUnit::PerPixel => "px^-1",
        }
    }
}

/// Length per volume or per projected area.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Density {
    /// The estimate.
    pub value: f64,
    /// Lower end of the 95 percent interval.
    pub low: f64,
    /// Upper end of the 95 percent interval.
    pub high: f64,
    /// Unit of the three.
    pub unit: DensityUnit,
    /// What it does not count.
    pub note: String,
}

/// Area of the foil seen in both images, projected along the mid-view beam, in unit^2.
///
/// Rectified columns are foreshortened by cos(phi / 2), since each view is half the angle off the mid view.
pub fn projected_area(rectified: &RectifiedPair, frame: &Frame) -> f64 {
    let both = rectified.left.iter().zip(&rectified.right).filter(|(l, r)| l.is_finite() && r.is_finite()).count();
    let sin_half_phi = (0.5 / frame.depth_gain).clamp(-1.0, 1.0);
    both as f64 * frame.pixel * frame.pixel / (1.0 - sin_half_phi * sin_half_phi).sqrt()
}

pub(super) fn density(
    per_curve: &[CurveMeasures],
    length: &LengthBudget,
    foil: &Known<Foil>,
    frame: &Frame,
    rectified: &RectifiedPair,
) -> Known<Density> {
    let area = projected_area(rectified, frame);
    if length.total <= 0.0 {
        return Known::Unknown("there are no curves".into());
    }
    if area <= 0.0 {
        return Known::Unknown("the images have no area in common".into());
    }
    let squares: f64 = per_curve.iter().map(|curve| curve.length * curve.length).sum();
    let independent = (length.variance + squares) / (length.total * length.total);
    // How ln(length) follows the depth scale, as the path of the beam does: their errors have the same cause.
    let length_by_scale = length.depth_part / length.total;
    let (per_area, metres) = (length.total / area, 1e9);
    let (value, relative2, unit) = match foil.known() {
        Some(foil) => {
            // The beam's path through a foil that leans is longer than the foil is thick: thickness / cos(tilt).
            let path = foil.surfaces.z_far - foil.surfaces.z_near;
            let scale = (1.0 - length_by_scale) * frame.relative_tilt_error;
            let relative2 = independent + (foil.fit_sigma / foil.thickness).powi(2) + scale * scale;
            (per_area / path, relative2, [DensityUnit::PerSquareMetre, DensityUnit::PerSquarePixel])
        }
        None => {
            let relative2 = independent + (length_by_scale * frame.relative_tilt_error).powi(2);
            (per_area, relative2, [DensityUnit::PerMetre, DensityUnit::PerPixel])
        }
    };
    let (value, unit) = match (frame.unit, unit) {
        (LengthUnit::Px, [_, in_px]) => (value, in_px),
        (LengthUnit::Nm, [per_volume @ DensityUnit::PerSquareMetre, _]) => (value * metres * metres, per_volume),
        (LengthUnit::Nm, [per_metre, _]) => (value * metres, per_metre),
    };
    let factor = (NORMAL_95 * relative2.sqrt()).exp();
    Known::Known(Density { value, low: value / factor, high: value * factor, unit, note: LOWER_BOUND.into() })
}

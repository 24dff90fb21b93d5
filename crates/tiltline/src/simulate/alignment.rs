//! How the views of one foil lie on the screen: shift, turned tilt axis, change of magnification. No microscope comes back
//! to the same place.

use rand::RngExt;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use super::Camera;
use super::settings::{SimulateError, check_value};

/// Largest deviations from perfect alignment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AlignmentSettings {
    /// Shift of a view along x and y, as a share of the image's side.
    pub shift: f64,
    /// Turn of the tilt axis from the nominal direction that all views share, degrees.
    pub axis_deg: f64,
    /// Turn of one view against the others, degrees.
    pub turn_deg: f64,
    /// Change of magnification from view to view, as a share.
    pub scale: f64,
}

impl Default for AlignmentSettings {
    fn default() -> Self {
        Self { shift: 0.06, axis_deg: 1.0, turn_deg: 1.0, scale: 0.005 }
    }
}

impl AlignmentSettings {
    /// Cameras at these tilts (degrees) for images of `size_px`, `scale` px per nm in the first view.
    pub fn random(&self, tilts_deg: &[f64], size_px: usize, scale: f64, rng: &mut Pcg64) -> Vec<Camera> {
        let mut within = |most: f64| most * rng.random_range(-1.0..1.0);
        let axis_deg = within(self.axis_deg);
        let view = |(index, tilt_deg): (usize, &f64)| {
            let [x, y] = [0; 2].map(|_| within(self.shift) * size_px as f64);
            let (turn, magnification) = (within(self.turn_deg), 1.0 + within(self.scale));
            Camera {
                shape: [size_px, size_px],
                tilt_rad: tilt_deg.to_radians(),
                axis_rad: (axis_deg + turn).to_radians(),
                // The pixel size that is written is that of the first view.
                scale: if index == 0 { scale } else { scale * magnification },
                shift_px: [x, y],
            }
        };
        tilts_deg.iter().enumerate().map(view).collect()
    }

    /// Checks every number.
    ///
    /// # Errors
    /// [`SimulateError::Value`] with the name of the first that is not possible.
    pub fn validate(&self) -> Result<(), SimulateError> {
        check_value("alignment.shift", self.shift, [0.0, 0.4])?;
        check_value("alignment.axis_deg", self.axis_deg, [0.0, 90.0])?;
        check_value("alignment.turn_deg", self.turn_deg, [0.0, 10.0])?;
        check_value("alignment.scale", self.scale, [0.0, 0.2])
    }
}

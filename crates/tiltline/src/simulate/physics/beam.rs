//! Beam, crystal and imaging parameters of physics mode, with units in their names.
//!
//! Sources: P. Hirsch, A. Howie, R. Nicholson, D. Pashley, M. Whelan, *Electron Microscopy of Thin Crystals*
//! (Butterworths 1965), chapters 7-10 and 12; M. De Graef, *Introduction to Conventional TEM* (Cambridge 2003), chapters
//! 5-8. Lengths are nm, reciprocal lengths 1/nm (|g| = 1/d), angles mrad or rad as named.
//!
//! No material is the default: the extinction distance and the absorption ratios must be given for the crystal, the
//! reflection and the beam energy at hand; the defaults are only of the usual size for a low-index reflection of a metal
//! of medium weight.

use serde::{Deserialize, Serialize};

use crate::geometry::Vector3;
use crate::simulate::{Camera, Foil};

use super::PhysicsError;

/// What is recorded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Detector {
    /// The direct beam. With a cone of convergence: STEM bright field, the whole direct disc.
    #[default]
    BrightField,
    /// The diffracted beam. A weak-beam image is this with a large deviation (|s| of about 0.2 / nm).
    DarkField,
    /// STEM annular bright field: the rim of the direct disc, from `inner_fraction` of its radius outwards.
    AnnularBrightField {
        /// Inner radius of the ring over the radius of the disc, 0 to 1.
        inner_fraction: f64,
    },
    /// STEM annular dark field: a share of the diffracted beam plus a share of everything lost from the two beams. The
    /// second term stands for diffuse (thermal diffuse and inelastic) scattering, taken as proportional to the absorbed
    /// intensity `1 - |phi_0|^2 - |phi_g|^2`: the simplest model that brightens where absorption is strong.
    AnnularDarkField {
        /// Share of the diffracted intensity that reaches the ring, 0 to 1.
        diffracted_fraction: f64,
        /// Share of the absorbed intensity that reaches the ring, 0 to 1.
        diffuse_fraction: f64,
    },
}

/// Everything two-beam contrast depends on, except the foil and the view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PhysicsSettings {
    /// Energy of the beam in keV; sets the wavelength, hence the Bragg angle and whether convergent discs overlap.
    pub beam_energy_kev: f64,
    /// Two-beam extinction distance xi_g in nm at this energy.
    pub extinction_distance_nm: f64,
    /// xi_g / xi_0': normal (mean) absorption, which only scales the image.
    pub normal_absorption_ratio: f64,
    /// xi_g / xi_g': anomalous absorption; not above the normal one, or one Bloch wave would grow.
    pub anomalous_absorption_ratio: f64,
    /// Diffraction vector in the untilted specimen frame, 1/nm.
    pub g_per_nm: Vector3,
    /// Deviation s_g at the centre of the untilted foil, 1/nm; positive where the reciprocal lattice point is inside the
    /// Ewald sphere.
    pub deviation_per_nm: f64,
    /// Whether tilting changes the deviation (`s += g_x sin(tilt)` for g in the foil). False: the operator keeps s_g
    /// constant through the series, as is done for stereo pairs and tomography.
    pub crystal_turns_with_holder: bool,
    /// Convergence semi-angle in mrad; 0 is a parallel beam.
    pub convergence_mrad: f64,
    /// What is recorded.
    pub detector: Detector,
    /// Poisson's ratio.
    pub poisson_ratio: f64,
    /// Columns nearer to a line than this are computed at this distance, where elasticity still means something; nm.
    pub core_radius_nm: f64,
    /// The strain of a line is faded out between half this lateral distance and all of it, in nm. The surfaces of a real
    /// foil screen it at about the thickness of the foil.
    pub reach_nm: f64,
    /// Change of thickness per distance along specimen x and y (nm per nm), about the centre, half on each surface.
    pub wedge: [f64; 2],
    /// Curvatures (k_xx, k_xy, k_yy) of the bent foil in 1/um: its mid-plane is `z = (k_xx x^2 + 2 k_xy x y + k_yy y^2) / 2`.
    /// Only the turning of the lattice planes is modelled, not the change of height.
    pub bend_per_um: [f64; 3],
    /// Standard deviation of the blur by probe or objective and pixel, nm.
    pub blur_nm: f64,
    /// Where the image is smooth it is computed on a coarser grid and interpolated, to this share of its maximum.
    pub interpolation_tolerance: f64,
}

impl Default for PhysicsSettings {
    fn default() -> Self {
        Self {
            beam_energy_kev: 200.0,
            extinction_distance_nm: 60.0,
            normal_absorption_ratio: 0.10,
            anomalous_absorption_ratio: 0.08,
            g_per_nm: Vector3::new(0.0, 4.5, 0.0),
            deviation_per_nm: 0.005,
            crystal_turns_with_holder: false,
            convergence_mrad: 0.0,
            detector: Detector::BrightField,
            poisson_ratio: 0.3,
            core_radius_nm: 0.25,
            reach_nm: 120.0,
            wedge: [0.0; 2],
            bend_per_um: [0.0; 3],
            blur_nm: 0.7,
            interpolation_tolerance: 0.003,
        }
    }
}

impl PhysicsSettings {
    /// Relativistic wavelength in nm: `h / sqrt(2 m e V (1 + e V / 2 m c^2))`.
    pub fn wavelength_nm(&self) -> f64 {
        // h c = 1.239842 keV nm, m c^2 = 510.99895 keV (CODATA).
        1.239_841_984 / (self.beam_energy_kev * (self.beam_energy_kev + 2.0 * 510.998_95)).sqrt()
    }

    /// Bragg angle in mrad.
    pub fn bragg_angle_mrad(&self) -> f64 {
        1e3 * (0.5 * self.wavelength_nm() * self.g_per_nm.norm()).asin()
    }

    /// Whether the discs of the direct and the diffracted beam overlap: there the two-beam image is only a model.
    pub fn discs_overlap(&self) -> bool {
        self.convergence_mrad > self.bragg_angle_mrad()
    }

    /// Half the range of s over the cone of convergence, `|g| alpha`, in 1/nm.
    pub fn deviation_spread_per_nm(&self) -> f64 {
        self.g_per_nm.norm() * self.convergence_mrad * 1e-3
    }

    /// Deviation at a point (x, y) of the untilted specimen's mid-plane (nm) in a view at tilt `tilt_rad`, 1/nm.
    ///
    /// The reciprocal lattice point moving by `dg` along the beam (+z) moves towards the outside of the sphere:
    /// `ds = -dg_z`. A mid-plane of height h turns g by `(g . grad h)` along z; a holder tilt gives
    /// `dg_z = g_z cos a - g_x sin a - g_z`.
    pub fn deviation_at(&self, x_nm: f64, y_nm: f64, tilt_rad: f64) -> f64 {
        let [xx, xy, yy] = self.bend_per_um.map(|per_um| per_um * 1e-3);
        let g = &self.g_per_nm;
        let turned_by_bending = g.x * (xx * x_nm + xy * y_nm) + g.y * (xy * x_nm + yy * y_nm);
        let (sin, cos) = tilt_rad.sin_cos();
        let turned_by_holder = if self.crystal_turns_with_holder { g.z * (cos - 1.0) - g.x * sin } else { 0.0 };
        self.deviation_per_nm - turned_by_bending - turned_by_holder
    }

    /// Checks every value.
    ///
    /// # Errors
    /// [`PhysicsError::OutOfRange`] with the value and the range for the first that is not a number or absurd.
    pub fn validate(&self) -> Result<(), PhysicsError> {
        check("beam_energy_kev", self.beam_energy_kev, 10.0, 5000.0)?;
        check("extinction_distance_nm", self.extinction_distance_nm, 2.0, 5000.0)?;
        check("normal_absorption_ratio", self.normal_absorption_ratio, 0.0, 1.0)?;
        check("anomalous_absorption_ratio", self.anomalous_absorption_ratio, 0.0, self.normal_absorption_ratio)?;
        for component in self.g_per_nm.iter() {
            check("g_per_nm", *component, -50.0, 50.0)?;
        }
        check("|g_per_nm|", self.g_per_nm.norm(), 0.5, 50.0)?;
        check("deviation_per_nm", self.deviation_per_nm, -1.0, 1.0)?;
        check("convergence_mrad", self.convergence_mrad, 0.0, 100.0)?;
        check("poisson_ratio", self.poisson_ratio, -0.99, 0.5)?;
        check("core_radius_nm", self.core_radius_nm, 1e-4, 10.0)?;
        check("reach_nm", self.reach_nm, 1.0, 1e5)?;
        check("blur_nm", self.blur_nm, 0.0, 1e3)?;
        check("interpolation_tolerance", self.interpolation_tolerance, 0.0, 0.1)?;
        for slope in self.wedge {
            check("wedge", slope, -1.0, 1.0)?;
        }
        for curvature in self.bend_per_um {
            check("bend_per_um", curvature, -10.0, 10.0)?;
        }
        match self.detector {
            Detector::BrightField | Detector::DarkField => Ok(()),
            Detector::AnnularBrightField { inner_fraction } => check("inner_fraction", inner_fraction, 0.0, 0.99),
            Detector::AnnularDarkField { diffracted_fraction, diffuse_fraction } => {
                check("diffracted_fraction", diffracted_fraction, 0.0, 1.0)?;
                check("diffuse_fraction", diffuse_fraction, 0.0, 1.0)
            }
        }
    }
}

/// Checks every value of a camera over a foil in nm (its scale is px per nm).
///
/// # Errors
/// [`PhysicsError::OutOfRange`] with the value and the range.
pub fn validate_view(view: &Camera) -> Result<(), PhysicsError> {
    for extent in view.shape {
        check("shape", extent as f64, 1.0, 16384.0)?;
    }
    // Beyond 80 degrees the columns are more than six times the thickness and two-beam contrast says nothing.
    check("tilt_rad", view.tilt_rad, -1.4, 1.4)?;
    check("axis_rad", view.axis_rad, -10.0, 10.0)?;
    check("pixel_size_nm", 1.0 / view.scale, 0.01, 1e3)?;
    for shift in view.shift_px {
        check("shift_px", shift, -1e5, 1e5)?;
    }
    Ok(())
}

/// Checks that a foil can be imaged: a thickness, finite points, a Burgers vector for every line.
///
/// # Errors
/// [`PhysicsError`] naming the line and the value.
pub fn validate_foil(foil: &Foil) -> Result<(), PhysicsError> {
    check("thickness_nm", foil.thickness_nm, 0.1, 1e4)?;
    for (line, dislocation) in foil.dislocations.iter().enumerate() {
        if dislocation.points.len() < 2 {
            return Err(PhysicsError::TooFewPoints { line, points: dislocation.points.len() });
        }
        let Some(burgers) = dislocation.burgers_nm else { return Err(PhysicsError::UnknownBurgers { line }) };
        for component in burgers.iter() {
            check("burgers_nm", *component, -10.0, 10.0)?;
        }
        for point in &dislocation.points {
            for coordinate in point.iter() {
                check("a dislocation's point, nm", *coordinate, -1e6, 1e6)?;
            }
        }
    }
    Ok(())
}

fn check(name: &'static str, value: f64, low: f64, high: f64) -> Result<(), PhysicsError> {
    // A NaN fails both comparisons.
    if value >= low && value <= high { Ok(()) } else { Err(PhysicsError::OutOfRange { name, value, low, high }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn wavelength_and_bragg_angle_at_200_kv_are_the_textbook_ones() {
        let settings = PhysicsSettings { g_per_nm: Vector3::new(4.0, 0.0, 0.0), ..PhysicsSettings::default() };
        // 2.508 pm is in every table of relativistic wavelengths.
        assert_relative_eq!(settings.wavelength_nm(), 2.508e-3, epsilon = 1e-6);
        assert_relative_eq!(settings.bragg_angle_mrad(), 5.016, epsilon = 2e-3);
        let stem = PhysicsSettings { convergence_mrad: 12.4, ..settings };
        assert!(stem.discs_overlap());
    }

    #[test]
    fn values_that_are_absurd_or_not_numbers_are_named_with_their_value() {
        let bad = PhysicsSettings { extinction_distance_nm: f64::NAN, ..PhysicsSettings::default() };
        assert!(bad.validate().unwrap_err().to_string().contains("extinction_distance_nm"));
        let growing = PhysicsSettings { anomalous_absorption_ratio: 0.2, ..PhysicsSettings::default() };
        let message = growing.validate().unwrap_err().to_string();
        assert!(message.contains("0.2") && message.contains("0.1"), "{message}");
        assert!(PhysicsSettings::default().validate().is_ok());
        assert!(validate_view(&Camera { scale: 0.0, ..Camera::new([8, 8]) }).is_err());
        assert!(validate_foil(&Foil::default()).is_err());
    }

    /// Physical argument: with g along +x, s > 0 means the point g is inside the sphere, so that it must be moved along
    /// the beam to reach it. A positive tilt turns +x towards the viewer (x = X cos a + Z sin a goes with
    /// z = Z cos a - X sin a): g moves against the beam, further inside, and s grows.
    #[test]
    fn tilting_plus_x_towards_the_source_increases_the_deviation_of_g_along_x() {
        let g = Vector3::new(4.0, 0.0, 0.0);
        let settings = PhysicsSettings { g_per_nm: g, crystal_turns_with_holder: true, ..PhysicsSettings::default() };
        let change = settings.deviation_at(0.0, 0.0, 0.01) - settings.deviation_at(0.0, 0.0, 0.0);
        assert_relative_eq!(change, 4.0 * 0.01_f64.sin(), epsilon = 1e-12);
        // A foil whose +x side bends towards the viewer (k_xx < 0) does the same there.
        let bent = PhysicsSettings { bend_per_um: [-0.1, 0.0, 0.0], ..settings };
        assert!(bent.deviation_at(50.0, 0.0, 0.0) > bent.deviation_at(0.0, 0.0, 0.0));
    }
}

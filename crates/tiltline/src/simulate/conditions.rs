//! Random diffraction conditions for physics mode: which reflection, how far from the Bragg condition, how thick an extinction
//! distance, which detector.

use rand::RngExt;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::geometry::Vector3;

use super::Foil;
use super::geometry::{Crystal, Range};
use super::physics::{Detector, PhysicsSettings};
use super::settings::{SimulateError, check_range, check_value};

/// Ranges `[low, high]` that conditions are drawn from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ConditionSettings {
    /// Energy of the beam, keV.
    pub beam_energy_kev: Range,
    /// Two-beam extinction distance, nm.
    pub extinction_distance_nm: Range,
    /// xi_g / xi_g'.
    pub anomalous_absorption_ratio: Range,
    /// Deviation w = s xi_g in bright field.
    pub deviation: Range,
    /// Share of images made with a cone of convergence.
    pub stem: f64,
    /// Semi-angle of that cone, mrad.
    pub convergence_mrad: Range,
    /// Share of dark-field (in STEM: annular dark-field) images.
    pub dark_field: f64,
    /// Share of weak-beam images among the parallel dark-field ones.
    pub weak_beam: f64,
    /// Curvature of the foil, 1/um.
    pub bend_per_um: Range,
    /// Change of thickness per distance.
    pub wedge: Range,
    /// Blur of probe or objective, nm.
    pub blur_nm: Range,
    /// Change of w from view to view.
    pub deviation_change: f64,
}

impl Default for ConditionSettings {
    fn default() -> Self {
        Self {
            beam_energy_kev: Range::new(120.0, 300.0),
            extinction_distance_nm: Range::new(30.0, 120.0),
            anomalous_absorption_ratio: Range::new(0.04, 0.11),
            deviation: Range::new(-0.3, 1.5),
            stem: 0.5,
            convergence_mrad: Range::new(4.0, 15.0),
            dark_field: 0.12,
            weak_beam: 0.5,
            bend_per_um: Range::new(0.0, 0.006),
            wedge: Range::new(0.0, 0.02),
            blur_nm: Range::new(0.5, 2.5),
            deviation_change: 0.2,
        }
    }
}

/// Share of the length of line that a reflection must show, if any does.
const SHOWN: f64 = 0.6;
/// Reflections steeper than this to the foil (sine) cannot be excited there.
const STEEPEST: f64 = 0.35;

impl ConditionSettings {
    /// Conditions for a foil. Without a crystal, g is chosen so that the Burgers vector of the most line has |g.b| = 1 or 2.
    pub fn random(&self, foil: &Foil, crystal: Option<&Crystal>, rng: &mut Pcg64) -> PhysicsSettings {
        let g_per_nm = reflection(foil, crystal, rng);
        let extinction_distance_nm = self.extinction_distance_nm.sample_log(rng);
        let anomalous = self.anomalous_absorption_ratio.sample(rng);
        let stem = chance(rng, self.stem);
        let dark = chance(rng, self.dark_field);
        let weak = !stem && dark && chance(rng, self.weak_beam);
        let detector = match (stem, dark) {
            (false, false) => Detector::BrightField,
            (false, true) => Detector::DarkField,
            (true, false) if chance(rng, 0.4) => Detector::BrightField,
            (true, false) => Detector::AnnularBrightField { inner_fraction: rng.random_range(0.3..0.7) },
            (true, true) => Detector::AnnularDarkField { diffracted_fraction: 0.6, diffuse_fraction: 0.6 },
        };
        let deviation_per_nm = if weak {
            rng.random_range(0.12..0.25) * if chance(rng, 0.5) { 1.0 } else { -1.0 }
        } else {
            self.deviation.sample(rng) / extinction_distance_nm
        };
        let signed = |rng: &mut Pcg64, range: Range| range.sample(rng) * if chance(rng, 0.5) { 1.0 } else { -1.0 };
        PhysicsSettings {
            beam_energy_kev: self.beam_energy_kev.sample(rng),
            extinction_distance_nm,
            normal_absorption_ratio: anomalous * rng.random_range(1.0..1.6),
            anomalous_absorption_ratio: anomalous,
            g_per_nm,
            deviation_per_nm,
            convergence_mrad: if stem { self.convergence_mrad.sample(rng) } else { 0.0 },
            detector,
            bend_per_um: [0; 3].map(|_| signed(rng, self.bend_per_um)),
            wedge: [0; 2].map(|_| signed(rng, self.wedge)),
            blur_nm: self.blur_nm.sample(rng),
            reach_nm: foil.thickness_nm.clamp(60.0, 160.0),
            ..PhysicsSettings::default()
        }
    }

    /// The same conditions as found in another view: the operator comes back to nearly the same deviation.
    pub fn another_view(&self, conditions: &PhysicsSettings, rng: &mut Pcg64) -> PhysicsSettings {
        let change = self.deviation_change * rng.random_range(-1.0..1.0) / conditions.extinction_distance_nm;
        PhysicsSettings { deviation_per_nm: conditions.deviation_per_nm + change, ..conditions.clone() }
    }

    /// Checks every number.
    ///
    /// # Errors
    /// [`SimulateError::Value`] with the name of the first that is not possible.
    pub fn validate(&self) -> Result<(), SimulateError> {
        check_range("conditions.beam_energy_kev", self.beam_energy_kev.into(), [10.0, 5000.0])?;
        check_range("conditions.extinction_distance_nm", self.extinction_distance_nm.into(), [5.0, 2000.0])?;
        check_range("conditions.anomalous_absorption_ratio", self.anomalous_absorption_ratio.into(), [0.0, 0.5])?;
        check_range("conditions.deviation", self.deviation.into(), [-20.0, 20.0])?;
        check_range("conditions.convergence_mrad", self.convergence_mrad.into(), [0.0, 50.0])?;
        check_range("conditions.bend_per_um", self.bend_per_um.into(), [0.0, 5.0])?;
        check_range("conditions.wedge", self.wedge.into(), [0.0, 0.5])?;
        check_range("conditions.blur_nm", self.blur_nm.into(), [0.0, 100.0])?;
        check_value("conditions.stem", self.stem, [0.0, 1.0])?;
        check_value("conditions.dark_field", self.dark_field, [0.0, 1.0])?;
        check_value("conditions.weak_beam", self.weak_beam, [0.0, 1.0])?;
        check_value("conditions.deviation_change", self.deviation_change, [0.0, 10.0])
    }
}

/// A reflection near the plane of the foil that shows most of the line, as an operator would choose; if none does, the
/// one that shows most.
fn reflection(foil: &Foil, crystal: Option<&Crystal>, rng: &mut Pcg64) -> Vector3 {
    let lengths: Vec<(Vector3, f64)> = foil
        .dislocations
        .iter()
        .filter_map(|line| {
            let length: f64 = line.points.windows(2).map(|ends| (ends[1] - ends[0]).norm()).sum();
            Some((line.burgers_nm?, length))
        })
        .collect();
    let total: f64 = lengths.iter().map(|(_, length)| length).sum();
    let candidates = match crystal {
        Some(crystal) => crystal.reflections(),
        None => invented(&lengths),
    };
    let level: Vec<Vector3> = candidates.iter().copied().filter(|g| g.z.abs() <= STEEPEST * g.norm()).collect();
    let candidates = if level.is_empty() { candidates.into_iter().take(4).collect() } else { level };
    let shown = |g: &Vector3| {
        let visible = lengths.iter().filter(|(burgers, _)| g.dot(burgers).abs() > 0.3);
        visible.map(|(_, length)| length).sum::<f64>() / total.max(1e-9)
    };
    let good: Vec<Vector3> = candidates.iter().copied().filter(|g| shown(g) >= SHOWN).collect();
    let best = || candidates.iter().copied().max_by(|a, b| shown(a).total_cmp(&shown(b)));
    match good.len() {
        0 => best().unwrap_or(Vector3::new(0.0, 4.5, 0.0)),
        count => good[rng.random_range(0..count)],
    }
}

/// Vectors in the plane of the foil along the projected Burgers vectors, with g.b = 1 or 2.
fn invented(lengths: &[(Vector3, f64)]) -> Vec<Vector3> {
    let level = lengths.iter().map(|(burgers, _)| Vector3::new(burgers.x, burgers.y, 0.0));
    let seen = level
        .filter(|level| level.norm() > 0.05)
        .flat_map(|level| [1.0, 2.0].map(|n| level * (n / level.norm_squared())));
    // A reflection with a spacing below 0.05 nm is none.
    seen.filter(|g| g.norm() < 20.0).collect()
}

fn chance(rng: &mut Pcg64, probability: f64) -> bool {
    rng.random_range(0.0..1.0) < probability
}

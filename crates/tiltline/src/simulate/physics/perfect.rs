//! Two beams in a perfect crystal: the analytic solution, and the cone of convergence over which it is averaged.
//!
//! Sign convention (Hirsch et al. 1965, chapters 8-9; the same physics as De Graef 2003, chapter 6): waves are
//! `exp(+2 pi i k . r)`, z runs along the beam, and s > 0 where the reciprocal lattice point is inside the Ewald sphere.
//! With `q = 1/xi_g + i/xi_g'` and the phases common to both waves taken out,
//!
//! `d/dz (phi_0, phi_g) = i pi [[-s, q], [q, s]] (phi_0, phi_g)`, times `exp(-pi z / xi_0')` for normal absorption;
//!
//! `phi_0 = cos(pi k z) - i (s/k) sin(pi k z)`, `phi_g = i (q/k) sin(pi k z)`, `k = sqrt(s^2 + q^2)`.
//!
//! 1/nm and nm; the incident intensity is 1.

use std::f64::consts::PI;

use nalgebra::Complex;

use super::beam::{Detector, PhysicsSettings};

/// Intensities of the direct and the diffracted beam after a perfect crystal of the given thickness.
pub fn intensities(settings: &PhysicsSettings, thickness_nm: f64, s_per_nm: f64) -> [f64; 2] {
    let q = coupling(settings);
    let kappa = (q * q + s_per_nm * s_per_nm).sqrt();
    let phase = kappa * (PI * thickness_nm);
    let sine = phase.sin() / kappa;
    let direct = phase.cos() - Complex::<f64>::i() * s_per_nm * sine;
    let diffracted = Complex::<f64>::i() * q * sine;
    let absorbed = normal_absorption(settings, thickness_nm);
    [direct.norm_sqr() * absorbed, diffracted.norm_sqr() * absorbed]
}

/// `1/xi_g + i/xi_g'` in 1/nm.
pub fn coupling(settings: &PhysicsSettings) -> Complex<f64> {
    Complex::new(1.0, settings.anomalous_absorption_ratio) / settings.extinction_distance_nm
}

/// `exp(-2 pi t / xi_0')`: what normal absorption leaves of every intensity.
pub fn normal_absorption(settings: &PhysicsSettings, thickness_nm: f64) -> f64 {
    (-2.0 * PI * thickness_nm * settings.normal_absorption_ratio / settings.extinction_distance_nm).exp()
}

/// Effective extinction distance `xi_g / sqrt(1 + w^2)`, `w = s xi_g`, in nm.
pub fn effective_extinction_distance_nm(settings: &PhysicsSettings) -> f64 {
    let w = settings.deviation_per_nm * settings.extinction_distance_nm;
    settings.extinction_distance_nm / (1.0 + w * w).sqrt()
}

/// Directions of the incident cone: offsets of s and their weights, which add up to 1.
///
/// A ray at angle theta along g has `s + g theta`. Over a disc of semi-angle alpha the weight of `rho = theta / alpha` is
/// the chord `sqrt(1 - rho^2)`, for which Gauss-Chebyshev quadrature of the second kind is exact; a ring is its disc less
/// the disc inside it (its weights are negative).
#[derive(Clone, Debug, PartialEq)]
pub struct Cone {
    /// Offset of s of each direction, 1/nm.
    pub offset_per_nm: Vec<f64>,
    /// Weight of each.
    pub weight: Vec<f64>,
}

impl Cone {
    /// The directions needed for columns up to `thickness_nm`.
    pub fn new(settings: &PhysicsSettings, thickness_nm: f64) -> Self {
        let spread = settings.deviation_spread_per_nm();
        if spread == 0.0 {
            return Self { offset_per_nm: vec![0.0], weight: vec![1.0] };
        }
        let inner = match settings.detector {
            Detector::AnnularBrightField { inner_fraction } => inner_fraction,
            _ => 0.0,
        };
        let mut cone = Self { offset_per_nm: Vec::new(), weight: Vec::new() };
        let area = 1.0 - inner * inner;
        cone.add_disc(spread, 1.0 / area, thickness_nm);
        if inner > 0.0 {
            cone.add_disc(spread * inner, -inner * inner / area, thickness_nm);
        }
        cone
    }

    fn add_disc(&mut self, spread: f64, weight: f64, thickness_nm: f64) {
        // Intensities oscillate in s with periods down to 1 / thickness: exp(2 pi i thickness spread rho). N nodes
        // integrate that well once 2 N exceeds its argument (the Bessel functions beyond fall off at once).
        let count = (PI * thickness_nm * spread + 5.0).ceil() as usize;
        for index in 1..=count {
            let angle = PI * index as f64 / (count + 1) as f64;
            self.offset_per_nm.push(spread * angle.cos());
            self.weight.push(weight * 2.0 / (count + 1) as f64 * angle.sin().powi(2));
        }
    }

    /// Number of directions.
    pub fn len(&self) -> usize {
        self.weight.len()
    }

    /// Whether there is no direction (never, for a cone made by [`Self::new`]).
    pub fn is_empty(&self) -> bool {
        self.weight.is_empty()
    }
}

/// What the detector records of two beams.
pub fn recorded(detector: Detector, direct: f64, diffracted: f64) -> f64 {
    match detector {
        Detector::BrightField | Detector::AnnularBrightField { .. } => direct,
        Detector::DarkField => diffracted,
        Detector::AnnularDarkField { diffracted_fraction, diffuse_fraction } => {
            diffracted_fraction * diffracted + diffuse_fraction * (1.0 - direct - diffracted)
        }
    }
}

/// Recorded intensity of a perfect column, averaged over the cone.
pub fn recorded_intensity(settings: &PhysicsSettings, cone: &Cone, thickness_nm: f64, s_per_nm: f64) -> f64 {
    let directions = cone.offset_per_nm.iter().zip(&cone.weight);
    directions
        .map(|(offset, weight)| {
            let [direct, diffracted] = intensities(settings, thickness_nm, s_per_nm + offset);
            weight * recorded(settings.detector, direct, diffracted)
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn transparent() -> PhysicsSettings {
        PhysicsSettings { normal_absorption_ratio: 0.0, anomalous_absorption_ratio: 0.0, ..PhysicsSettings::default() }
    }

    /// Hirsch et al., chapter 8: `I_g = sin^2(pi t k) / (xi_g k)^2`, `k^2 = s^2 + 1/xi_g^2`; fringes of period xi_eff.
    #[test]
    fn without_absorption_the_rocking_curve_and_the_fringes_are_the_textbook_ones() {
        for s in [-0.03, 0.0, 0.01, 0.05] {
            let settings = PhysicsSettings { deviation_per_nm: s, ..transparent() };
            let xi = settings.extinction_distance_nm;
            let xi_eff = effective_extinction_distance_nm(&settings);
            for t in [10.0, 47.0, 130.0] {
                let [direct, diffracted] = intensities(&settings, t, s);
                let textbook = (PI * t / xi_eff).sin().powi(2) * (xi_eff / xi).powi(2);
                assert_relative_eq!(diffracted, textbook, epsilon = 1e-12);
                assert_relative_eq!(direct + diffracted, 1.0, epsilon = 1e-12);
                let one_fringe_on = intensities(&settings, t + xi_eff, s)[1];
                assert_relative_eq!(one_fringe_on, diffracted, epsilon = 1e-12);
            }
        }
    }

    /// Known since Hashimoto, Howie & Whelan (1962): with absorption the bright-field rocking curve is lopsided, brighter
    /// for s > 0 (the well transmitted Bloch wave is then mostly the direct wave), and the dark-field one is not.
    #[test]
    fn anomalous_absorption_makes_bright_field_brighter_at_positive_deviation() {
        let settings = PhysicsSettings::default();
        let t = 4.0 * settings.extinction_distance_nm;
        let [plus, minus] = [0.01, -0.01].map(|s| intensities(&settings, t, s));
        assert!(plus[0] > 1.5 * minus[0], "{plus:?} {minus:?}");
        assert_relative_eq!(plus[1], minus[1], epsilon = 1e-12);
    }

    #[test]
    fn the_cone_averages_a_constant_to_itself_and_s_squared_to_a_quarter_of_its_edge() {
        let disc = PhysicsSettings { convergence_mrad: 12.4, ..PhysicsSettings::default() };
        let ring = PhysicsSettings { detector: Detector::AnnularBrightField { inner_fraction: 0.5 }, ..disc.clone() };
        // <x^2> over a disc is 1/4; over a ring (1 + r^2) / 4.
        for (settings, expected) in [(disc, 0.25), (ring, 0.3125)] {
            let cone = Cone::new(&settings, 150.0);
            assert_relative_eq!(cone.weight.iter().sum::<f64>(), 1.0, epsilon = 1e-12);
            let spread = settings.deviation_spread_per_nm();
            let second: f64 = cone.offset_per_nm.iter().zip(&cone.weight).map(|(s, w)| w * (s / spread).powi(2)).sum();
            assert_relative_eq!(second, expected, epsilon = 1e-12);
        }
    }

    #[test]
    fn the_cone_has_enough_directions_and_damps_the_fringes() {
        let stem = PhysicsSettings { convergence_mrad: 12.4, ..transparent() };
        let parallel = transparent();
        let swing = |settings: &PhysicsSettings, fine: f64| {
            let cone = Cone::new(settings, 200.0 * fine);
            let at = |t: f64| recorded_intensity(settings, &cone, t, 0.0);
            let values: Vec<f64> = (0..60).map(|i| at(100.0 + i as f64)).collect();
            let high = values.iter().copied().fold(f64::MIN, f64::max);
            (high - values.iter().copied().fold(f64::MAX, f64::min), values)
        };
        let (damped, values) = swing(&stem, 1.0);
        let (_, finer) = swing(&stem, 3.0);
        for (value, fine) in values.iter().zip(&finer) {
            // Gauss quadrature of a band-limited function; the tail of the Bessel functions is what is left.
            assert_relative_eq!(*value, *fine, epsilon = 1e-4);
        }
        assert!(damped < 0.25 * swing(&parallel, 1.0).0, "{damped}");
    }
}

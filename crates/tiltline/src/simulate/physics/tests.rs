//! What diffraction contrast must do, each with its reason. Signs: x right, y down, z along the beam, right-handed.

use std::f64::consts::PI;

use approx::assert_relative_eq;
use nalgebra::Complex;

use super::column::{Columns, Scratch};
use super::displacement::StraightLine;
use super::perfect::effective_extinction_distance_nm;
use super::*;
use crate::geometry::{Point3, Vector3};
use crate::simulate::{Camera, Dislocation, Foil};

const B_NM: f64 = 0.25;

fn straight(through: Point3, direction: Vector3, burgers: Vector3, half_length: f64) -> Dislocation {
    let half = direction.normalize() * half_length;
    Dislocation {
        points: vec![through - half, through + half],
        closed: false,
        burgers_nm: Some(burgers),
        plane_normal: None,
    }
}

fn foil(thickness_nm: f64, dislocations: Vec<Dislocation>) -> Foil {
    Foil { thickness_nm, size_nm: [400.0, 400.0], dislocations }
}

/// A line along -y at depth `z0` below the entrance surface, so that `z^ x u` is +x.
fn horizontal(thickness_nm: f64, z0: f64, burgers: Vector3) -> Foil {
    foil(thickness_nm, vec![straight(Point3::new(0.0, 0.0, z0 - 0.5 * thickness_nm), -Vector3::y(), burgers, 200.0)])
}

/// A line from surface to surface whose projection runs along y; `z(y)` rises with y.
fn inclined(thickness_nm: f64, length_y: f64, burgers: Vector3) -> Foil {
    let half = Vector3::new(0.0, 0.5 * length_y, 0.5 * thickness_nm);
    foil(thickness_nm, vec![straight(Point3::origin(), half, burgers, half.norm())])
}

fn g_along(direction: Vector3, order: f64) -> Vector3 {
    direction * (order / B_NM)
}

fn intensity(foil: &Foil, settings: &PhysicsSettings, at: [f64; 2]) -> f64 {
    Columns::new(foil, settings, 0.0).unwrap().intensity(at, &mut Scratch::default())
}

fn profile(foil: &Foil, settings: &PhysicsSettings, half_width: f64, step: f64) -> Vec<(f64, f64)> {
    let columns = Columns::new(foil, settings, 0.0).unwrap();
    let count = (half_width / step).round() as i32;
    (-count..=count)
        .map(|i| f64::from(i) * step)
        .map(|x| (x, columns.intensity([x, 0.0], &mut Scratch::default())))
        .collect()
}

fn contrast(profile: &[(f64, f64)], background: f64) -> f64 {
    profile.iter().map(|(_, value)| (value / background - 1.0).abs()).fold(0.0, f64::max)
}

/// The Howie-Whelan equations of Hirsch et al. (1965), chapter 10, with their phases `exp(+-2 pi i (s z + g . R))` and
/// absorption, by Runge-Kutta steps: knows neither Magnus, nor slices, nor segments.
fn by_runge_kutta(line: &StraightLine, settings: &PhysicsSettings, thickness: f64, x: f64, steps: usize) -> [f64; 2] {
    let i = Complex::<f64>::i();
    let q = Complex::new(1.0, settings.anomalous_absorption_ratio) / settings.extinction_distance_nm;
    let mean = PI * settings.normal_absorption_ratio / settings.extinction_distance_nm;
    let rate = |z: f64, [direct, diffracted]: [Complex<f64>; 2]| {
        let displaced = settings.g_per_nm.dot(&line.displacement(&Point3::new(x, 0.0, z - 0.5 * thickness)));
        let phase = (i * (2.0 * PI * (settings.deviation_per_nm * z + displaced))).exp();
        [i * PI * q * phase * diffracted - direct * mean, i * PI * q * direct / phase - diffracted * mean]
    };
    let h = thickness / steps as f64;
    let mut waves = [Complex::new(1.0, 0.0), Complex::new(0.0, 0.0)];
    let add = |a: [Complex<f64>; 2], b: [Complex<f64>; 2], scale: f64| [a[0] + b[0] * scale, a[1] + b[1] * scale];
    for step in 0..steps {
        let z = step as f64 * h;
        let k1 = rate(z, waves);
        let k2 = rate(z + 0.5 * h, add(waves, k1, 0.5 * h));
        let k3 = rate(z + 0.5 * h, add(waves, k2, 0.5 * h));
        let k4 = rate(z + h, add(waves, k3, h));
        waves = add(add(add(add(waves, k1, h / 6.0), k2, h / 3.0), k3, h / 3.0), k4, h / 6.0);
    }
    waves.map(|wave| wave.norm_sqr())
}

#[test]
fn columns_agree_with_runge_kutta_on_the_textbook_equations() {
    let thickness = 110.0;
    let burgers = Vector3::new(0.15, -0.2, 0.1);
    let direction = Vector3::new(0.4, -0.9, 0.35).normalize();
    let through = Point3::new(0.0, 0.0, -12.0);
    let foil = foil(thickness, vec![straight(through, direction, burgers, 300.0)]);
    for deviation_per_nm in [-0.01, 0.0, 0.02] {
        let base = PhysicsSettings {
            // g.b = 2: a fraction would add a stacking fault on the cut, which strain alone knows nothing of.
            g_per_nm: Vector3::new(6.0, -5.0, 1.0),
            deviation_per_nm,
            reach_nm: 1e4,
            core_radius_nm: 1e-3,
            ..PhysicsSettings::default()
        };
        let line = StraightLine { point: through, direction, burgers_nm: burgers, poisson_ratio: base.poisson_ratio };
        for x in [-25.0, -6.0, -1.5, 0.7, 3.0, 14.0] {
            let expected = by_runge_kutta(&line, &base, thickness, x, 20_000);
            for (detector, expected) in [Detector::BrightField, Detector::DarkField].into_iter().zip(expected) {
                let settings = PhysicsSettings { detector, ..base.clone() };
                // The stated error of the slices (a third of the share gives 2e-4).
                assert_relative_eq!(intensity(&foil, &settings, [x, 0.0]), expected, epsilon = 2e-3);
            }
        }
    }
}

#[test]
fn without_absorption_no_electron_is_lost_in_a_strained_column() {
    let transparent = PhysicsSettings {
        normal_absorption_ratio: 0.0,
        anomalous_absorption_ratio: 0.0,
        g_per_nm: g_along(Vector3::x(), 2.0),
        ..PhysicsSettings::default()
    };
    let foil = inclined(120.0, 150.0, Vector3::new(0.2, 0.1, 0.05));
    for at in [[0.0, 0.0], [2.0, 40.0], [-7.0, -30.0]] {
        let total: f64 = [Detector::BrightField, Detector::DarkField]
            .map(|detector| intensity(&foil, &PhysicsSettings { detector, ..transparent.clone() }, at))
            .iter()
            .sum();
        // The slices are unitary up to the 1e-8 of their series.
        assert_relative_eq!(total, 1.0, epsilon = 1e-6);
    }
}

/// R of a screw is along b everywhere.
#[test]
fn a_screw_with_g_perpendicular_to_b_is_invisible() {
    let along = Vector3::new(0.0, 0.6, 0.8);
    let screw = foil(100.0, vec![straight(Point3::origin(), along, along * B_NM, 62.5)]);
    let seen = PhysicsSettings { g_per_nm: g_along(Vector3::y(), 1.0), ..PhysicsSettings::default() };
    let unseen = PhysicsSettings { g_per_nm: g_along(Vector3::x(), 1.0), ..PhysicsSettings::default() };
    let found = |settings: &PhysicsSettings| {
        contrast(
            &profile(&screw, settings, 30.0, 1.0),
            Columns::new(&screw, settings, 0.0).unwrap().background([0.0; 2]),
        )
    };
    assert!(found(&unseen) < 0.01, "{}", found(&unseen));
    assert!(found(&seen) > 0.2, "{}", found(&seen));
}

/// An edge along y with b along the beam: g along y sees nothing (g.b = g.(b x u) = 0); g along x sees g.(b x u), which is
/// even across the line (ln r and cos 2 phi are), unlike the one-sided image of g.b.
#[test]
fn an_edge_with_g_perpendicular_to_b_shows_only_the_symmetric_residual() {
    let thickness = 100.0;
    let edge = horizontal(thickness, 40.0, Vector3::new(0.0, 0.0, B_NM));
    let settings = |g: Vector3| PhysicsSettings { g_per_nm: g_along(g, 1.0), ..PhysicsSettings::default() };
    let background = intensity(&foil(thickness, Vec::new()), &settings(Vector3::x()), [0.0; 2]);
    let unseen = profile(&edge, &settings(Vector3::y()), 30.0, 1.0);
    // The 1e-8 of the series in each slice.
    assert!(contrast(&unseen, background) < 1e-6);
    let residual = profile(&edge, &settings(Vector3::x()), 30.0, 1.0);
    assert!(contrast(&residual, background) > 0.02);
    let in_plane = horizontal(thickness, 40.0, Vector3::new(B_NM, 0.0, 0.0));
    let full = profile(&in_plane, &settings(Vector3::x()), 30.0, 1.0);
    // Nothing but g.(b x u) counts: adding to g along the line changes nothing.
    let slanted = profile(&edge, &settings(Vector3::new(1.0, 0.7, 0.0)), 30.0, 1.0);
    for (a, b) in residual.iter().zip(&slanted) {
        assert_relative_eq!(a.1, b.1, epsilon = 1e-9);
    }
    let lopsided = |profile: &[(f64, f64)]| {
        profile.iter().zip(profile.iter().rev()).map(|(a, b)| (a.1 - b.1).abs()).fold(0.0, f64::max)
    };
    // Mirror images of a column differ by rounding only.
    assert!(lopsided(&residual) < 1e-9 && lopsided(&full) > 0.02);
}

/// The oscillation along an inclined line against depth below the entrance surface, every nm: (depths, values).
fn along_inclined(settings: &PhysicsSettings, thickness: f64, across: f64) -> Vec<f64> {
    let foil = inclined(thickness, thickness, Vector3::new(B_NM, 0.0, 0.0));
    let columns = Columns::new(&foil, settings, 0.0).unwrap();
    let depths = (0..thickness as usize).map(|depth| depth as f64 - 0.5 * thickness);
    depths.map(|y| columns.intensity([across, y], &mut Scratch::default())).collect()
}

/// Period with the largest Fourier amplitude of `values` (one a nm) less their mean, nm.
fn dominant_period(values: &[f64], periods: std::ops::Range<usize>) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let power = |period: f64| {
        let terms = values.iter().enumerate();
        let sum: Complex<f64> = terms
            .map(|(i, value)| {
                // A Hann window keeps the ends from leaking.
                let window = (PI * i as f64 / values.len() as f64).sin().powi(2);
                Complex::new(0.0, 2.0 * PI * i as f64 / period).exp() * (window * (value - mean))
            })
            .sum();
        sum.norm()
    };
    periods.map(|period| period as f64).max_by(|a, b| power(*a).total_cmp(&power(*b))).expect("periods are not empty")
}

fn swing(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::MIN, f64::max) - values.iter().copied().fold(f64::MAX, f64::min)
}

/// Bloch waves scattered into each other at depth z beat with the unscattered ones: period xi_eff in z.
#[test]
fn an_inclined_line_oscillates_with_the_effective_extinction_distance() {
    for deviation_per_nm in [0.0, 0.01, 0.02] {
        let settings = PhysicsSettings {
            g_per_nm: g_along(Vector3::x(), 1.0),
            deviation_per_nm,
            extinction_distance_nm: 40.0,
            normal_absorption_ratio: 0.02,
            anomalous_absorption_ratio: 0.02,
            ..PhysicsSettings::default()
        };
        let xi_eff = effective_extinction_distance_nm(&settings);
        let thickness = (6.25 * xi_eff).round();
        // A quarter of xi_g off the core, where the scattering is weak: closer by, its second order (xi_eff / 2) is as strong.
        let period = dominant_period(&along_inclined(&settings, thickness, 10.0), 12..90);
        assert_relative_eq!(period, xi_eff, max_relative = 0.15);
    }
}

/// In a thick foil one Bloch wave is absorbed before (or after) mid-foil: no beating there.
#[test]
fn absorption_damps_the_oscillation_in_mid_foil() {
    let settings = |ratio: f64| PhysicsSettings {
        g_per_nm: g_along(Vector3::x(), 1.0),
        deviation_per_nm: 0.0,
        extinction_distance_nm: 40.0,
        normal_absorption_ratio: ratio,
        anomalous_absorption_ratio: ratio,
        ..PhysicsSettings::default()
    };
    let middle_over_ends = |ratio: f64| {
        let values = along_inclined(&settings(ratio), 240.0, 4.0);
        let ends = 0.5 * (swing(&values[10..60]) + swing(&values[180..230]));
        swing(&values[95..145]) / ends
    };
    assert!(middle_over_ends(0.1) < 0.6 * middle_over_ends(0.0), "{} {}", middle_over_ends(0.1), middle_over_ends(0.0));
}

/// Largest difference over the profile between a line at depth z0 and one at t - z0.
fn upside_down(burgers: Vector3, g: Vector3, detector: Detector, absorption: f64, deviation_per_nm: f64) -> f64 {
    let (thickness, z0) = (137.0, 31.0);
    let settings = PhysicsSettings {
        g_per_nm: g_along(g, 1.0),
        detector,
        deviation_per_nm,
        normal_absorption_ratio: absorption,
        anomalous_absorption_ratio: absorption,
        ..PhysicsSettings::default()
    };
    let above = profile(&horizontal(thickness, z0, burgers), &settings, 25.0, 0.9);
    let below = profile(&horizontal(thickness, thickness - z0, burgers), &settings, 25.0, 0.9);
    above.iter().zip(&below).map(|(a, b)| (a.1 - b.1).abs()).fold(0.0, f64::max)
}

/// Reversing the order of the slices transposes their product: phi_0 does not notice, phi_g becomes the other
/// off-diagonal element, equal to it in modulus only without absorption (unitarity). The strain of a screw, and of an
/// in-plane edge with g along b, is even in z about the core, so putting the line at t - z0 reverses the order.
#[test]
fn bright_field_does_not_know_which_way_up_the_foil_is_and_dark_field_does() {
    let screw = (Vector3::new(0.0, B_NM, 0.0), Vector3::y());
    let edge = (Vector3::new(B_NM, 0.0, 0.0), Vector3::x());
    for (burgers, g) in [screw, edge] {
        for s in [0.0, 0.008] {
            assert!(upside_down(burgers, g, Detector::BrightField, 0.1, s) < 1e-6);
            assert!(upside_down(burgers, g, Detector::DarkField, 0.1, s) > 0.01);
            assert!(upside_down(burgers, g, Detector::BrightField, 0.0, s) < 1e-6);
            assert!(upside_down(burgers, g, Detector::DarkField, 0.0, s) < 1e-6);
        }
    }
}

/// The strain of the g.(b x u) contrast is odd in z about the core. At s = 0, changing its sign swaps the two waves
/// (sigma_x M(sigma) sigma_x = M(-sigma)): then dark field is blind to the turn and bright field is not.
#[test]
fn for_the_residual_contrast_the_roles_of_bright_and_dark_field_change() {
    let (burgers, g) = (Vector3::new(0.0, 0.0, B_NM), Vector3::x());
    assert!(upside_down(burgers, g, Detector::DarkField, 0.1, 0.0) < 1e-6);
    assert!(upside_down(burgers, g, Detector::BrightField, 0.1, 0.0) > 1e-3);
    assert!(upside_down(burgers, g, Detector::BrightField, 0.0, 0.0) < 1e-6);
}

/// beta of a screw is odd in x and in g.
#[test]
fn minus_g_gives_the_mirrored_profile_of_a_screw() {
    let screw = horizontal(120.0, 47.0, Vector3::new(0.0, B_NM, 0.0));
    for detector in [Detector::BrightField, Detector::DarkField] {
        let plus = PhysicsSettings { g_per_nm: g_along(Vector3::y(), 1.0), detector, ..PhysicsSettings::default() };
        let minus = PhysicsSettings { g_per_nm: -plus.g_per_nm, ..plus.clone() };
        let (plus, minus) = (profile(&screw, &plus, 40.0, 0.8), profile(&screw, &minus, 40.0, 0.8));
        for (a, b) in plus.iter().zip(minus.iter().rev()) {
            assert_relative_eq!(a.1, b.1, epsilon = 1e-12);
        }
        assert!(plus.iter().zip(&minus).any(|(a, b)| (a.1 - b.1).abs() > 0.02));
    }
}

fn weak_beam(g_dot_b: f64, s: f64) -> PhysicsSettings {
    PhysicsSettings {
        g_per_nm: g_along(Vector3::y(), g_dot_b),
        deviation_per_nm: s,
        detector: Detector::DarkField,
        ..PhysicsSettings::default()
    }
}

fn weak_beam_peak_nm(order: f64, s: f64) -> (f64, f64) {
    // u = -y, and b along u: x is measured along z^ x u.
    let burgers = Vector3::new(0.0, -B_NM, 0.0) * if order > 10.0 { 4.0 } else { 1.0 };
    let settings = PhysicsSettings {
        g_per_nm: Vector3::y() * (order / burgers.norm()),
        reach_nm: 1e4,
        core_radius_nm: 0.05,
        ..weak_beam(order, s)
    };
    let half_width = 1.5 * order.abs() / (2.0 * PI * s.abs());
    let profile = profile(&horizontal(101.0, 50.5, burgers), &settings, half_width, half_width / 150.0);
    let peak = profile.iter().max_by(|a, b| a.1.total_cmp(&b.1)).expect("the profile has points");
    (peak.0, -settings.g_per_nm.dot(&burgers) / (2.0 * PI * s))
}

/// Planes near the core are turned back into the Bragg position where s + beta = 0 (Cockayne, Ray & Whelan 1969); for a
/// right-handed screw (b along u) beta = g.b / (2 pi x), x along z^ x u, at the depth of the core: x_c = -g.b / (2 pi s).
/// That is the turning point of the phase of the kinematical integral, hence the outer edge of the bright line: the
/// maximum lies on its inner side, and reaches it only for large g.b. For g.b = 2 the integral is elementary:
/// `int exp(2 pi i s z) (x + i z) / (x - i z) dz = 4 pi |x| exp(-2 pi |s x|)` on that side: a maximum at x_c / 2 exactly.
#[test]
fn the_weak_beam_line_lies_where_the_planes_are_turned_back_into_the_bragg_position() {
    for (order, s) in [(2.0, 0.2), (2.0, -0.2), (-2.0, 0.2), (-2.0, -0.2), (2.0, 0.15), (2.0, 0.3)] {
        let (peak, turning_point) = weak_beam_peak_nm(order, s);
        // w = s xi_g is 9 to 18 here: kinematical to a few percent; 20 percent allowed.
        assert_relative_eq!(peak, 0.5 * turning_point, max_relative = 0.2);
    }
    for s in [0.2, -0.2] {
        let (peak, turning_point) = weak_beam_peak_nm(20.0, s);
        assert_relative_eq!(peak, turning_point, max_relative = 0.2);
    }
}

#[test]
fn the_weak_beam_line_is_much_narrower_than_the_bright_field_one() {
    let foil = horizontal(101.0, 48.0, Vector3::new(0.0, -B_NM, 0.0));
    let width = |settings: &PhysicsSettings| {
        let profile = profile(&foil, settings, 40.0, 0.1);
        let background = Columns::new(&foil, settings, 0.0).unwrap().background([0.0; 2]);
        let peak = contrast(&profile, background);
        0.1 * profile.iter().filter(|(_, value)| (value / background - 1.0).abs() > 0.5 * peak).count() as f64
    };
    let bright_field =
        PhysicsSettings { deviation_per_nm: 0.0, detector: Detector::BrightField, ..weak_beam(2.0, 0.0) };
    let (narrow, wide) = (width(&weak_beam(2.0, 0.2)), width(&bright_field));
    assert!(narrow < 0.4 * wide, "{narrow} {wide}");
}

/// A cone of directions has a range of xi_eff and of phases: the beating averages out (Maher & Joy 1976). The paper's
/// 12.4 mrad.
#[test]
fn averaging_over_the_cone_of_convergence_reduces_the_oscillation() {
    let parallel = PhysicsSettings {
        g_per_nm: g_along(Vector3::x(), 1.0),
        deviation_per_nm: 0.003,
        extinction_distance_nm: 40.0,
        ..PhysicsSettings::default()
    };
    let detector = Detector::AnnularBrightField { inner_fraction: 0.5 };
    let annular = PhysicsSettings { convergence_mrad: 12.4, detector, ..parallel.clone() };
    let disc = PhysicsSettings { convergence_mrad: 12.4, ..parallel.clone() };
    let relative = |settings: &PhysicsSettings| {
        let values = along_inclined(settings, 200.0, 4.0);
        // Away from the ends, where the line leaves the foil.
        let inner = &values[30..170];
        swing(inner) / (inner.iter().sum::<f64>() / inner.len() as f64)
    };
    assert!(relative(&annular) < 0.5 * relative(&parallel), "{} {}", relative(&annular), relative(&parallel));
    assert!(relative(&disc) < 0.5 * relative(&parallel), "{} {}", relative(&disc), relative(&parallel));
}

/// ADF sees what the bright field loses to absorption: where a line darkens the bright field, it is bright.
#[test]
fn annular_dark_field_shows_a_line_brighter_than_its_background() {
    let bright_field = PhysicsSettings {
        g_per_nm: g_along(Vector3::x(), 1.0),
        convergence_mrad: 8.0,
        deviation_per_nm: 0.006,
        ..PhysicsSettings::default()
    };
    let detector = Detector::AnnularDarkField { diffracted_fraction: 0.8, diffuse_fraction: 0.5 };
    let dark_field = PhysicsSettings { detector, ..bright_field.clone() };
    let line = horizontal(120.0, 60.0, Vector3::new(B_NM, 0.0, 0.0));
    let mean_change = |settings: &PhysicsSettings| {
        let columns = Columns::new(&line, settings, 0.0).unwrap();
        (-10..=10).map(|x| columns.change([f64::from(x), 0.0], &mut Scratch::default())).sum::<f64>()
    };
    assert!(mean_change(&bright_field) < 0.0 && mean_change(&dark_field) > 0.0);
}

/// The far fields of a dipole cancel.
#[test]
fn a_narrow_dipole_has_less_far_contrast_than_one_of_its_lines() {
    let settings = PhysicsSettings { g_per_nm: g_along(Vector3::x(), 1.0), ..PhysicsSettings::default() };
    let line =
        |x: f64, z: f64, b: f64| straight(Point3::new(x, 0.0, z), -Vector3::y(), Vector3::new(b, 0.0, 0.0), 200.0);
    let single = foil(100.0, vec![line(0.0, 0.0, B_NM)]);
    let dipole = foil(100.0, vec![line(0.0, 0.0, B_NM), line(3.0, 3.0, -B_NM)]);
    let far = |foil: &Foil| {
        let columns = Columns::new(foil, &settings, 0.0).unwrap();
        columns.change([25.0, 0.0], &mut Scratch::default()).abs()
    };
    assert!(far(&dipole) < 0.3 * far(&single), "{} {}", far(&dipole), far(&single));
}

/// Fringes of a wedge: every xi_eff of thickness, in the image as a whole.
#[test]
fn a_wedge_shows_thickness_fringes() {
    let settings =
        PhysicsSettings { deviation_per_nm: 0.01, wedge: [0.5, 0.0], blur_nm: 0.0, ..PhysicsSettings::default() };
    let view = Camera::new([24, 300]);
    let image = image(&foil(200.0, Vec::new()), &settings, &view).unwrap().intensity;
    let row: Vec<f64> = image.row(12).iter().map(|value| f64::from(*value)).collect();
    let period_px = effective_extinction_distance_nm(&settings) / 0.5;
    // Decay by absorption pulls the maximum of the spectrum a little: 5 percent.
    assert_relative_eq!(dominant_period(&row, 40..200), period_px, max_relative = 0.05);
}

fn some_lines() -> Foil {
    let mut foil = inclined(100.0, 60.0, Vector3::new(B_NM, 0.0, 0.0));
    let points = (0..48)
        .map(|i| 2.0 * PI * f64::from(i) / 48.0)
        .map(|angle| Point3::new(-25.0 + 12.0 * angle.cos(), 12.0 * angle.sin(), 4.0 * angle.sin()))
        .collect();
    let burgers_nm = Some(Vector3::new(0.1, 0.1, 0.2));
    foil.dislocations.push(Dislocation { points, closed: true, burgers_nm, plane_normal: None });
    foil
}

/// The saving of columns must not be seen.
#[test]
fn the_image_is_what_every_pixel_computed_by_itself_gives() {
    let foil = some_lines();
    let settings = PhysicsSettings {
        g_per_nm: g_along(Vector3::new(0.8, 0.6, 0.0), 1.0),
        blur_nm: 0.0,
        wedge: [0.1, 0.05],
        bend_per_um: [0.02, 0.01, -0.03],
        ..PhysicsSettings::default()
    };
    let tilt_rad = 0.2;
    let view = Camera { shape: [90, 100], tilt_rad, axis_rad: 0.3, shift_px: [4.0, -7.5], scale: 1.0 / 1.3 };
    let image = image(&foil, &settings, &view).unwrap();
    let columns = Columns::new(&foil, &settings, tilt_rad).unwrap();
    let projection_from_image = view.image_from_projection().inverse();
    for ((row, column), value) in image.intensity.indexed_iter() {
        let at = projection_from_image * crate::geometry::Point2::new(column as f64, row as f64);
        let expected = columns.intensity([at.x, at.y], &mut Scratch::default());
        // Tolerance 0.003 of a maximum of about 0.5, several halvings.
        assert_relative_eq!(f64::from(*value), expected, epsilon = 0.008);
    }
}

#[test]
fn the_image_does_not_depend_on_the_number_of_threads() {
    let settings = PhysicsSettings { g_per_nm: g_along(Vector3::x(), 1.0), ..PhysicsSettings::default() };
    let view = Camera::new([80, 80]);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| image(&some_lines(), &settings, &view).unwrap())
    };
    assert_eq!(with(1), with(3));
}

/// The whole experiment turned about the beam by a quarter: same image, turned. (x, y, z) -> (-y, x, z).
#[test]
fn a_specimen_turned_about_the_beam_gives_the_turned_image() {
    let foil = some_lines();
    let turn = |v: &Vector3| Vector3::new(-v.y, v.x, v.z);
    let mut turned = foil.clone();
    for dislocation in &mut turned.dislocations {
        dislocation.burgers_nm = dislocation.burgers_nm.as_ref().map(turn);
        for point in &mut dislocation.points {
            *point = Point3::from(turn(&point.coords));
        }
    }
    let settings = PhysicsSettings {
        g_per_nm: g_along(Vector3::new(0.8, 0.6, 0.0), 1.0),
        interpolation_tolerance: 0.0,
        ..PhysicsSettings::default()
    };
    let settings_turned = PhysicsSettings { g_per_nm: turn(&settings.g_per_nm), ..settings.clone() };
    let view = Camera::new([61, 61]);
    let original = image(&foil, &settings, &view).unwrap().intensity;
    let found = image(&turned, &settings_turned, &view).unwrap().intensity;
    for ((row, column), value) in original.indexed_iter() {
        // (x, y) from the centre goes to (-y, x).
        assert_relative_eq!(found[[column, 60 - row]], *value, epsilon = 1e-5);
    }
}

/// The truth measures what the image shows: a weak-beam line on the side that the sign of s says, by the amount it says,
/// at the depth-dependent place of the tilted core.
#[test]
fn the_truth_finds_the_weak_beam_line_beside_its_core() {
    let burgers = Vector3::new(0.0, -B_NM, 0.0);
    let mut foil = horizontal(101.0, 70.0, burgers);
    let z = 70.0 - 50.5;
    foil.dislocations[0].points = (-40..=40).map(|i| Point3::new(0.0, -5.0 * f64::from(i), z)).collect();
    let tilt_rad = 0.07;
    let view = Camera { scale: 2.0, tilt_rad, ..Camera::new([64, 128]) };
    let settings = PhysicsSettings { blur_nm: 0.2, ..weak_beam(2.0, 0.15) };
    let truth = image(&foil, &settings, &view).unwrap().truth;
    let middle = &truth.lines[0].points[40];
    assert_relative_eq!(middle.core_px.x, 63.5 + z * tilt_rad.sin() / 0.5, epsilon = 1e-9);
    assert_relative_eq!(middle.core_px.y, 31.5, epsilon = 1e-9);
    let contrast = middle.contrast.expect("inside the image");
    let expected_nm = -settings.g_per_nm.dot(&burgers) / (2.0 * PI * 0.15);
    // u points to -y: its right on the screen is +x. The centre of the half-height region is a little further out than
    // the peak (the profile falls slowly on the far side).
    assert_relative_eq!(middle.across.x, 1.0, epsilon = 1e-9);
    // (see the weak-beam peak above: half of the turning point for g.b = 2).
    assert_relative_eq!(contrast.offset_px * 0.5, 0.5 * expected_nm, max_relative = 0.35);
    assert!(contrast.amplitude > 1.0);
    // Points far outside the image have no contrast, and say so.
    assert!(truth.lines[0].points[0].contrast.is_none());
}

#[test]
fn what_cannot_be_imaged_is_refused_with_its_number() {
    let mut nameless = some_lines();
    nameless.dislocations[1].burgers_nm = None;
    let view = Camera::new([16, 16]);
    let refused = |foil: &Foil, settings: &PhysicsSettings| image(foil, settings, &view).unwrap_err().to_string();
    assert!(refused(&nameless, &PhysicsSettings::default()).contains("dislocation 1"));
    let mut nowhere = some_lines();
    nowhere.dislocations[0].points[0].x = f64::NAN;
    assert!(refused(&nowhere, &PhysicsSettings::default()).contains("NaN"));
    let absurd = PhysicsSettings { poisson_ratio: 0.7, ..PhysicsSettings::default() };
    assert!(refused(&some_lines(), &absurd).contains("0.7"));
}

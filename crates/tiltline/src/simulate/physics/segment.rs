//! `d(g . R)/dz` of a straight segment of a dislocation in an isotropic crystal, for many depths of one column at once.
//!
//! From Burgers' formula (Hirth & Lothe 1982, chapter 4) for a curve made of straight pieces. With
//! `L(r) = integral over the piece of dl / |r - r'|`, rho the vector from the piece's line to r, `c = u x b`:
//!
//! `grad of (b Omega / 4 pi)  ->  -b (u x grad L) / 4 pi`,
//! `R = b Omega / 4 pi - (b x u) L / 4 pi - grad[(rho . c) L] / (8 pi (1 - nu))`,
//!
//! `beta = { (1 - 2 nu)(g.c) dL/dz - c_z g.grad L - (rho.c) g.grad dL/dz } / (8 pi (1 - nu)) - (g.b)(z^ x u).grad L / 4 pi`.
//!
//! Summed over a closed loop, a network whose Burgers vectors balance, or a line without ends, this is exact; one long
//! segment is the straight line of [`super::displacement`] (tested). So both the locally straight line near its core and
//! the cancelling far fields of loops and dipoles come out of one formula.
//!
//! nm and 1/nm; frame with z along the beam.

use std::f64::consts::PI;

use crate::geometry::{Point3, Vector3};

/// Keeps divisions finite on the line itself.
const TINY_NM2: f64 = 1e-12;

/// What the field of a line depends on besides its shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contrast {
    /// Burgers vector, nm, in the frame of the column.
    pub burgers_nm: Vector3,
    /// Diffraction vector, 1/nm, in the same frame.
    pub g_per_nm: Vector3,
    /// Poisson's ratio.
    pub poisson_ratio: f64,
}

/// Adds `scale * beta` of the chain of segments through `vertices` to `beta` at the depths `z` of the column (x, y).
///
/// `inverse` and `inverse_next` are scratch.
pub fn add_chain(
    contrast: &Contrast,
    vertices: &[Point3],
    [x, y]: [f64; 2],
    z: &[f64],
    scale: f64,
    beta: &mut [f64],
    [inverse, inverse_next]: [&mut Vec<f64>; 2],
) {
    let Some(first) = vertices.first() else { return };
    let inverse_distance = |vertex: &Point3, out: &mut Vec<f64>| {
        let lateral2 = (x - vertex.x).powi(2) + (y - vertex.y).powi(2) + TINY_NM2;
        out.clear();
        out.extend(z.iter().map(|z| 1.0 / (lateral2 + (z - vertex.z).powi(2)).sqrt()));
    };
    inverse_distance(first, inverse);
    for ends in vertices.windows(2) {
        inverse_distance(&ends[1], inverse_next);
        add_segment(contrast, [&ends[0], &ends[1]], [x, y], z, scale, beta, [inverse, inverse_next]);
        std::mem::swap(inverse, inverse_next);
    }
}

/// One segment; `inverse` are the inverse distances to its ends at every depth.
fn add_segment(
    contrast: &Contrast,
    [start, end]: [&Point3; 2],
    [x, y]: [f64; 2],
    z: &[f64],
    scale: f64,
    beta: &mut [f64],
    inverse: [&[f64]; 2],
) {
    let along = end - start;
    let length = along.norm();
    if length < 1e-9 {
        return;
    }
    let Contrast { burgers_nm: b, g_per_nm: g, poisson_ratio: nu } = *contrast;
    let u = along / length;
    let c = u.cross(&b);
    // Everything is a polynomial of the depth from z_0: rho = rho_0 + e dz, with e = z^ - u_z u.
    let z_0 = z[0];
    let offset = Point3::new(x, y, z_0) - start;
    let tau_0 = offset.dot(&u);
    let rho_0 = offset - u * tau_0;
    let e = Vector3::z() - u * u.z;
    let (g_u, g_rho_0, g_e) = (g.dot(&u), g.dot(&rho_0), g.dot(&e));
    let c_rho_0 = c.dot(&rho_0);
    let rho2_0 = rho_0.norm_squared() + TINY_NM2;
    let edge = scale / (8.0 * PI * (1.0 - nu));
    let dilatation = edge * (1.0 - 2.0 * nu) * g.dot(&c);
    let across = edge * c.z;
    // (z^ x u) . rho does not change with depth.
    let screw = scale * g.dot(&b) / (4.0 * PI) * Vector3::z().cross(&u).dot(&rho_0);
    let [inverse_start, inverse_end] = inverse;
    for (((beta, &z), &near), &far) in beta.iter_mut().zip(z).zip(inverse_start).zip(inverse_end) {
        let dz = z - z_0;
        let rho_z = rho_0.z + e.z * dz;
        let g_rho = g_rho_0 + g_e * dz;
        let c_rho = c_rho_0 + c.z * dz;
        let rho2 = rho2_0 + dz * (2.0 * rho_0.z + e.z * dz);
        let tau_start = tau_0 + u.z * dz;
        let tau_end = tau_start - length;
        // Integrals over the segment of 1/R^3, 1/R^5, tau/R^5, tau^2/R^5.
        let inverse_rho2 = 1.0 / rho2;
        let f3 = inverse_rho2 * (tau_start * near - tau_end * far);
        let (near3, far3) = (near * near * near, far * far * far);
        let f5 = inverse_rho2 * (1.0 / 3.0) * (tau_start * near3 - tau_end * far3 + 2.0 * f3);
        let t5 = (1.0 / 3.0) * (far3 - near3);
        let tt5 = f3 - rho2 * f5;
        let l_z = u.z * (near - far) - rho_z * f3;
        let l_g = g_u * (near - far) - g_rho * f3;
        let l_gz = 3.0 * (g_rho * rho_z * f5 + (g_rho * u.z + g_u * rho_z) * t5 + g_u * u.z * tt5) - g.z * f3;
        *beta += dilatation * l_z - across * l_g - edge * c_rho * l_gz + screw * f3;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::physics::displacement::StraightLine;
    use approx::assert_relative_eq;

    fn beta_of_chain(contrast: &Contrast, vertices: &[Point3], at: &Point3) -> f64 {
        let mut beta = [0.0];
        let (mut a, mut b) = (Vec::new(), Vec::new());
        add_chain(contrast, vertices, [at.x, at.y], &[at.z], 1.0, &mut beta, [&mut a, &mut b]);
        beta[0]
    }

    fn contrast() -> Contrast {
        Contrast {
            burgers_nm: Vector3::new(0.2, 0.1, -0.15),
            g_per_nm: Vector3::new(2.0, -3.0, 0.4),
            poisson_ratio: 0.31,
        }
    }

    #[test]
    fn a_long_segment_is_the_straight_line_of_hirth_and_lothe() {
        let contrast = contrast();
        for direction in [Vector3::new(0.3, 0.8, 0.5), Vector3::new(0.0, 1.0, 0.0), Vector3::new(-0.2, 0.1, 3.0)] {
            let line = StraightLine {
                point: Point3::new(1.0, -2.0, 0.5),
                direction: direction.normalize(),
                burgers_nm: contrast.burgers_nm,
                poisson_ratio: contrast.poisson_ratio,
            };
            let reach = line.direction * 1e6;
            let middle = line.point + line.direction * 2.0;
            let vertices = [line.point - reach, middle, line.point + reach];
            for at in [Point3::new(3.0, 1.0, 2.0), Point3::new(-20.0, -14.0, 9.0), Point3::new(2.0, -1.0, -3.0)] {
                let expected = line.beta(&at, &contrast.g_per_nm);
                let found = beta_of_chain(&contrast, &vertices, &at);
                // The ends at 1e6 nm leave (10 / 1e6)^2; rounding at that distance 1e-10 nm.
                assert_relative_eq!(found, expected, epsilon = 1e-9);
            }
        }
    }

    /// The lattice planes far from a small loop are undisturbed: the field of a dipole of area falls as 1/r^3, and beta,
    /// a derivative of the solid-angle-like displacement (1/r^2), with it.
    #[test]
    fn the_field_of_a_closed_loop_falls_with_the_cube_of_the_distance() {
        let contrast = contrast();
        let vertices: Vec<Point3> = (0..=40)
            .map(|i| 2.0 * PI * i as f64 / 40.0)
            .map(|angle| Point3::new(2.0 * angle.cos(), 2.0 * angle.sin(), 0.7 * angle.sin()))
            .collect();
        let direction = Vector3::new(0.5, -0.3, 0.8).normalize();
        let at = |distance: f64| beta_of_chain(&contrast, &vertices, &Point3::from(direction * distance));
        // (radius / distance)^2 = 4e-4 corrections.
        assert_relative_eq!(at(200.0) * 8.0, at(100.0), max_relative = 5e-3);
    }

    /// curl-free away from lines: the strain of a closed loop is a true gradient, so beta integrated along the beam past
    /// the loop (not through it) from far above to far below vanishes, and through it gives -+ g . b.
    #[test]
    fn through_a_loop_the_phase_changes_by_g_dot_b_and_outside_by_nothing() {
        let contrast = contrast();
        let vertices: Vec<Point3> = (0..=60)
            .map(|i| 2.0 * PI * i as f64 / 60.0)
            .map(|angle| Point3::new(5.0 * angle.cos(), 5.0 * angle.sin(), 0.0))
            .collect();
        let total = |x: f64| {
            let (steps, half) = (400_000, 4000.0);
            let h = 2.0 * half / steps as f64;
            let z: Vec<f64> = (0..steps).map(|i| -half + (i as f64 + 0.5) * h).collect();
            let mut beta = vec![0.0; steps];
            add_chain(&contrast, &vertices, [x, 1.0], &z, 1.0, &mut beta, [&mut Vec::new(), &mut Vec::new()]);
            h * beta.iter().sum::<f64>()
        };
        // The cut tails beyond +-4000 nm: area / (distance^2) = 5e-6 of b.
        assert_relative_eq!(total(12.0), 0.0, epsilon = 1e-4);
        // The loop goes round +z right-handed (x to y): a circuit through it along +z and back outside is right-handed
        // about the line, and gains b (Hirth & Lothe).
        let expected = contrast.g_per_nm.dot(&contrast.burgers_nm);
        assert_relative_eq!(total(1.0), expected, epsilon = 1e-4);
    }
}

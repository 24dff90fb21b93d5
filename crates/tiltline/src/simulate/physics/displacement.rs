//! Displacement of a straight, infinite mixed dislocation in an isotropic crystal, and its derivative along the beam.
//!
//! J. Hirth & J. Lothe, *Theory of Dislocations* (2nd ed. 1982), chapter 3 (screw; edge with the dilatation
//! terms); in the vector form of Hirsch et al. (1965), chapter 7:
//!
//! `R = 1/(2 pi) [ b theta + 1/(4 (1 - nu)) { b_e sin 2 phi + (b x u) (2 (1 - 2 nu) ln r + cos 2 phi) } ]`
//!
//! u is the line direction, theta and phi turn right-handed about u, phi from the edge part b_e. The sense of b is that of
//! Hirth & Lothe: the displacement grows by +b along a circuit that is right-handed about u. Frame: x right, y down, z
//! along the beam (right-handed). nm, and 1/nm for the derivative.
//!
//! This is the reference in closed form that the segments of [`super::segment`] must add up to; it knows nothing of ends
//! or curvature.

use std::f64::consts::PI;

use crate::geometry::{Point3, Vector3};

/// A straight, infinite dislocation.
#[derive(Clone, Debug, PartialEq)]
pub struct StraightLine {
    /// A point on it, nm.
    pub point: Point3,
    /// Its unit direction.
    pub direction: Vector3,
    /// Burgers vector, nm.
    pub burgers_nm: Vector3,
    /// Poisson's ratio.
    pub poisson_ratio: f64,
}

impl StraightLine {
    /// Displacement in nm at a point off the line, up to a rigid shift; jumps by b across the half-plane from the line
    /// against the edge part of b (against x, or y for a line along x, if it is a pure screw).
    pub fn displacement(&self, at: &Point3) -> Vector3 {
        let u = self.direction;
        let edge_part = self.burgers_nm - u * self.burgers_nm.dot(&u);
        let e1 = self.reference_direction(&edge_part);
        let e2 = u.cross(&e1);
        let offset = at - self.point;
        let (x1, x2) = (offset.dot(&e1), offset.dot(&e2));
        let r2 = x1 * x1 + x2 * x2;
        let (sin_2phi, cos_2phi) = (2.0 * x1 * x2 / r2, (x1 * x1 - x2 * x2) / r2);
        let nu = self.poisson_ratio;
        let across = self.burgers_nm.cross(&u) * ((1.0 - 2.0 * nu) * r2.ln() + cos_2phi);
        (self.burgers_nm * x2.atan2(x1) + (edge_part * sin_2phi + across) / (4.0 * (1.0 - nu))) / (2.0 * PI)
    }

    /// `d(g . R)/dz` in 1/nm, z along the beam.
    pub fn beta(&self, at: &Point3, g_per_nm: &Vector3) -> f64 {
        let u = self.direction;
        let edge_part = self.burgers_nm - u * self.burgers_nm.dot(&u);
        let e1 = self.reference_direction(&edge_part);
        let e2 = u.cross(&e1);
        let offset = at - self.point;
        let (x1, x2) = (offset.dot(&e1), offset.dot(&e2));
        let r2 = x1 * x1 + x2 * x2;
        let (sin_2phi, cos_2phi) = (2.0 * x1 * x2 / r2, (x1 * x1 - x2 * x2) / r2);
        // d(theta)/dz = d(phi)/dz and d(ln r)/dz; z changes x1 by e1.z and x2 by e2.z.
        let turn = (x1 * e2.z - x2 * e1.z) / r2;
        let stretch = (x1 * e1.z + x2 * e2.z) / r2;
        let nu = self.poisson_ratio;
        let across = g_per_nm.dot(&self.burgers_nm.cross(&u));
        let edge = g_per_nm.dot(&edge_part) * 2.0 * cos_2phi * turn
            + across * (2.0 * (1.0 - 2.0 * nu) * stretch - 2.0 * sin_2phi * turn);
        (g_per_nm.dot(&self.burgers_nm) * turn + edge / (4.0 * (1.0 - nu))) / (2.0 * PI)
    }

    fn reference_direction(&self, edge_part: &Vector3) -> Vector3 {
        if edge_part.norm() > 1e-12 {
            return edge_part.normalize();
        }
        let axis = if self.direction.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
        (axis - self.direction * axis.dot(&self.direction)).normalize()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn mixed() -> StraightLine {
        StraightLine {
            point: Point3::new(1.0, -2.0, 0.5),
            direction: Vector3::new(0.3, 0.8, 0.5).normalize(),
            burgers_nm: Vector3::new(0.2, 0.1, -0.15),
            poisson_ratio: 0.31,
        }
    }

    #[test]
    fn the_displacement_grows_by_b_along_a_right_handed_circuit_about_the_line() {
        let line = mixed();
        let side = line.direction.cross(&Vector3::z()).normalize();
        let third = line.direction.cross(&side);
        let steps = 3600;
        let place = |step: usize| {
            // Right-handed about u: from `side` towards `u x side`.
            let angle = 2.0 * PI * step as f64 / steps as f64;
            line.point + side * (3.0 * angle.cos()) + third * (3.0 * angle.sin())
        };
        let mut sum = Vector3::zeros();
        for step in 0..steps {
            let change = line.displacement(&place(step + 1)) - line.displacement(&place(step));
            // The branch cut takes b away once; the true field is continuous there.
            if change.norm() < 0.5 * line.burgers_nm.norm() {
                sum += change;
            }
        }
        // One step of 3600 is left out at the cut: it carries about b / 3600.
        assert_relative_eq!(sum, line.burgers_nm, epsilon = 3.0 * line.burgers_nm.norm() / steps as f64);
    }

    #[test]
    fn beta_is_the_derivative_of_the_displacement_along_the_beam() {
        let line = mixed();
        let g = Vector3::new(2.0, -3.0, 0.4);
        for at in [Point3::new(3.0, 1.0, 2.0), Point3::new(-2.0, -4.0, 1.0), Point3::new(2.0, -1.0, -3.0)] {
            let h = 1e-5;
            let up = g.dot(&line.displacement(&(at + Vector3::z() * h)));
            let down = g.dot(&line.displacement(&(at - Vector3::z() * h)));
            // Central differences in f64: h^2 and 1e-16 / h.
            assert_relative_eq!(line.beta(&at, &g), (up - down) / (2.0 * h), epsilon = 1e-8);
        }
    }

    /// Hirth & Lothe, chapter 3, written out for b along x and the line along z.
    #[test]
    fn an_edge_has_the_textbook_components() {
        let (b, nu) = (0.25, 0.3);
        let line = StraightLine {
            point: Point3::origin(),
            direction: Vector3::z(),
            burgers_nm: Vector3::new(b, 0.0, 0.0),
            poisson_ratio: nu,
        };
        let (x, y) = (1.3_f64, 0.7_f64);
        let r2 = x * x + y * y;
        let ux = b / (2.0 * PI) * (y.atan2(x) + x * y / (2.0 * (1.0 - nu) * r2));
        let uy = -b / (2.0 * PI)
            * ((1.0 - 2.0 * nu) / (4.0 * (1.0 - nu)) * r2.ln() + (x * x - y * y) / (4.0 * (1.0 - nu) * r2));
        let found = line.displacement(&Point3::new(x, y, 5.0));
        assert_relative_eq!(found, Vector3::new(ux, uy, 0.0), epsilon = 1e-12);
    }
}

//! Lattices, their slip systems and low-index reflections, and how a crystal lies in the foil.
//!
//! Slip systems after Hirth and Lothe, *Theory of Dislocations*, chapters 9 to 11; gamma-TiAl after Appel, Paul, Oehring,
//! *Gamma Titanium Aluminide Alloys*, chapter 5. Lengths in nm, reciprocal vectors in 1/nm (without 2 pi). The Cartesian
//! crystal frame has x along a1 and z along c.

use nalgebra::{Quaternion, UnitQuaternion};
use rand::RngExt;
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::geometry::Vector3;

/// A crystal structure with its lattice parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "structure", rename_all = "snake_case", deny_unknown_fields)]
pub enum Lattice {
    /// Face-centred cubic: slip of a/2<110> on {111}.
    Fcc {
        /// Lattice parameter.
        a_nm: f64,
    },
    /// Body-centred cubic: slip of a/2<111> on {110} and {112}.
    Bcc {
        /// Lattice parameter.
        a_nm: f64,
    },
    /// Hexagonal (wurtzite GaN, hcp metals): `<a>` on basal and prismatic planes, `<c+a>` on {11-22}.
    Hexagonal {
        /// Basal lattice parameter.
        a_nm: f64,
        /// Lattice parameter along the c axis.
        c_nm: f64,
    },
    /// L1_0 (gamma-TiAl): ordinary 1/2<110] and superpartial 1/2<101] on {111}.
    L10 {
        /// Lattice parameter in the layers.
        a_nm: f64,
        /// Lattice parameter across the layers.
        c_nm: f64,
    },
}

/// A slip plane and a Burgers vector in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlipSystem {
    /// Unit normal of the plane.
    pub normal: Vector3,
    /// Burgers vector in nm.
    pub burgers_nm: Vector3,
}

impl Lattice {
    /// Face-centred cubic aluminium, 0.4050 nm.
    pub const ALUMINIUM: Lattice = Lattice::Fcc { a_nm: 0.4050 };
    /// The Cantor alloy CoCrFeMnNi, face-centred cubic, 0.3597 nm.
    pub const CANTOR: Lattice = Lattice::Fcc { a_nm: 0.3597 };
    /// Body-centred cubic iron, 0.2866 nm.
    pub const IRON: Lattice = Lattice::Bcc { a_nm: 0.2866 };
    /// Wurtzite GaN, 0.3189 and 0.5186 nm.
    pub const GAN: Lattice = Lattice::Hexagonal { a_nm: 0.3189, c_nm: 0.5186 };
    /// Gamma-TiAl, 0.4005 and 0.4070 nm.
    pub const TIAL: Lattice = Lattice::L10 { a_nm: 0.4005, c_nm: 0.4070 };

    /// Edges of the conventional cell along x and z.
    fn edges_nm(&self) -> (f64, f64) {
        match *self {
            Lattice::Fcc { a_nm } | Lattice::Bcc { a_nm } => (a_nm, a_nm),
            Lattice::Hexagonal { a_nm, c_nm } | Lattice::L10 { a_nm, c_nm } => (a_nm, c_nm),
        }
    }

    /// Whether both lattice parameters are lengths of atoms: 0.1 to 3 nm.
    pub fn is_plausible(&self) -> bool {
        let (a_nm, c_nm) = self.edges_nm();
        [a_nm, c_nm].into_iter().all(|edge| (0.1..=3.0).contains(&edge))
    }

    /// The slip systems in the crystal frame; each Burgers vector lies in its plane.
    pub fn slip_systems(&self) -> Vec<SlipSystem> {
        let (a_nm, c_nm) = self.edges_nm();
        match self {
            Lattice::Fcc { .. } => cell_systems(&family([1, 1, 1]), &family([1, 1, 0]), 0.5, [a_nm, c_nm]),
            Lattice::L10 { .. } => cell_systems(&family([1, 1, 1]), &family([1, 1, 0]), 0.5, [a_nm, c_nm]),
            Lattice::Bcc { .. } => {
                let planes = [family([1, 1, 0]), family([1, 1, 2])].concat();
                cell_systems(&planes, &family([1, 1, 1]), 0.5, [a_nm, c_nm])
            }
            Lattice::Hexagonal { .. } => hexagonal_systems(a_nm, c_nm),
        }
    }

    /// Low-index reflections `g` in the crystal frame, 1/nm, one of each +-g.
    pub fn reflections(&self) -> Vec<Vector3> {
        let (a_nm, c_nm) = self.edges_nm();
        let cell = |families: &[[i32; 3]]| {
            let members = families.iter().flat_map(|&indices| family(indices));
            members.map(|g| Vector3::new(g[0] / a_nm, g[1] / a_nm, g[2] / c_nm)).collect()
        };
        match self {
            Lattice::Fcc { .. } | Lattice::L10 { .. } => cell(&[[1, 1, 1], [2, 0, 0], [2, 2, 0]]),
            Lattice::Bcc { .. } => cell(&[[1, 1, 0], [2, 0, 0], [2, 1, 1]]),
            Lattice::Hexagonal { .. } => {
                let axial = Vector3::new(0.0, 0.0, 2.0 / c_nm);
                let mut reflections = vec![axial];
                for axis in basal_axes(a_nm) {
                    // {1-100} lies between two of the a axes, {11-20} along one.
                    let prism = Vector3::z().cross(&axis).normalize() * (2.0 / (3f64.sqrt() * a_nm));
                    reflections.extend([prism, prism + 0.5 * axial, axis.normalize() * (2.0 / a_nm)]);
                }
                reflections
            }
        }
    }
}

/// The members of a family of directions or planes, one of each pair of opposites.
fn family(indices: [i32; 3]) -> Vec<Vector3> {
    let [h, k, l] = indices;
    let mut members: Vec<[i32; 3]> = Vec::new();
    for [x, y, z] in [[h, k, l], [h, l, k], [k, h, l], [k, l, h], [l, h, k], [l, k, h]] {
        for signs in 0..8 {
            let sign = |bit: i32, value: i32| if signs & bit == 0 { value } else { -value };
            let member = [sign(1, x), sign(2, y), sign(4, z)];
            if !members.contains(&member) && !members.contains(&member.map(|value| -value)) {
                members.push(member);
            }
        }
    }
    members.iter().map(|&[x, y, z]| Vector3::new(x.into(), y.into(), z.into())).collect()
}

/// All pairs of a plane and a direction in it, in a cell with edges (a, a, c).
fn cell_systems(planes: &[Vector3], directions: &[Vector3], factor: f64, [a_nm, c_nm]: [f64; 2]) -> Vec<SlipSystem> {
    let mut systems = Vec::new();
    for plane in planes {
        for direction in directions.iter().filter(|direction| plane.dot(direction) == 0.0) {
            let normal = Vector3::new(plane.x / a_nm, plane.y / a_nm, plane.z / c_nm).normalize();
            let burgers_nm = Vector3::new(direction.x * a_nm, direction.y * a_nm, direction.z * c_nm) * factor;
            systems.push(SlipSystem { normal, burgers_nm });
        }
    }
    systems
}

/// The three basal lattice vectors, 120 degrees apart; they sum to zero.
fn basal_axes(a_nm: f64) -> [Vector3; 3] {
    [0.0, 120.0, 240.0].map(|angle_deg: f64| {
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        Vector3::new(cos, sin, 0.0) * a_nm
    })
}

fn hexagonal_systems(a_nm: f64, c_nm: f64) -> Vec<SlipSystem> {
    let axial = Vector3::z() * c_nm;
    let mut systems = Vec::new();
    for basal in basal_axes(a_nm) {
        let across = Vector3::z().cross(&basal).normalize();
        systems.push(SlipSystem { normal: Vector3::z(), burgers_nm: basal });
        systems.push(SlipSystem { normal: across, burgers_nm: basal });
        for sign in [1.0, -1.0] {
            let burgers_nm = axial + basal * sign;
            systems.push(SlipSystem { normal: burgers_nm.cross(&across).normalize(), burgers_nm });
        }
    }
    systems
}

/// A crystal as it lies in the untilted specimen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crystal {
    /// Structure and lattice parameters.
    pub lattice: Lattice,
    /// Rotation from the crystal's Cartesian frame to the specimen frame.
    pub specimen_from_crystal: UnitQuaternion<f64>,
}

impl Crystal {
    /// A crystal turned at random, all orientations alike.
    pub fn random(lattice: Lattice, rng: &mut Pcg64) -> Self {
        Self { lattice, specimen_from_crystal: random_rotation(rng) }
    }

    /// The crystal turned so that a direction of the specimen frame comes to lie along another, and about that one by
    /// a further angle.
    pub fn aligned(self, from: &Vector3, to: &Vector3, about_rad: f64) -> Self {
        let bring = UnitQuaternion::rotation_between(from, to).unwrap_or_else(|| {
            // Opposite directions: half a turn about any axis across them.
            let across = if from.x.abs() < from.norm() * 0.7 { Vector3::x() } else { Vector3::y() };
            UnitQuaternion::from_scaled_axis(from.cross(&across).normalize() * std::f64::consts::PI)
        });
        let turn = UnitQuaternion::from_scaled_axis(to.normalize() * about_rad);
        Self { specimen_from_crystal: turn * bring * self.specimen_from_crystal, ..self }
    }

    /// The c axis (for cubic lattices `[001]`) in the specimen frame.
    pub fn axis(&self) -> Vector3 {
        self.specimen_from_crystal * Vector3::z()
    }

    /// The slip systems in the specimen frame.
    pub fn slip_systems(&self) -> Vec<SlipSystem> {
        let turn = self.specimen_from_crystal;
        let systems = self.lattice.slip_systems().into_iter();
        systems.map(|s| SlipSystem { normal: turn * s.normal, burgers_nm: turn * s.burgers_nm }).collect()
    }

    /// Low-index reflections in the specimen frame, 1/nm, those nearest to the plane of the foil first: the ones that a
    /// small tilt brings into a two-beam condition.
    pub fn reflections(&self) -> Vec<Vector3> {
        let mut reflections: Vec<Vector3> =
            self.lattice.reflections().iter().map(|g| self.specimen_from_crystal * g).collect();
        let steepness = |g: &Vector3| g.z.abs() / g.norm();
        reflections.sort_by(|first, second| steepness(first).total_cmp(&steepness(second)));
        reflections
    }
}

/// A rotation drawn uniformly (a normalised 4D Gaussian; Shoemake 1992).
pub fn random_rotation(rng: &mut Pcg64) -> UnitQuaternion<f64> {
    let mut normal = || rng.sample::<f64, _>(StandardNormal);
    UnitQuaternion::from_quaternion(Quaternion::new(normal(), normal(), normal(), normal()))
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;
    use rand::SeedableRng;

    use super::*;

    const LATTICES: [Lattice; 5] = [Lattice::ALUMINIUM, Lattice::CANTOR, Lattice::IRON, Lattice::GAN, Lattice::TIAL];

    #[test]
    fn the_textbook_numbers_of_slip_systems() {
        assert_eq!(Lattice::ALUMINIUM.slip_systems().len(), 12);
        assert_eq!(Lattice::IRON.slip_systems().len(), 12 + 12);
        assert_eq!(Lattice::TIAL.slip_systems().len(), 4 + 8);
        assert_eq!(Lattice::GAN.slip_systems().len(), 3 + 3 + 6);
    }

    #[test]
    fn every_burgers_vector_lies_in_its_plane_in_any_orientation() {
        let mut rng = Pcg64::seed_from_u64(3);
        for lattice in LATTICES {
            for system in Crystal::random(lattice, &mut rng).slip_systems() {
                assert_relative_eq!(system.normal.dot(&system.burgers_nm), 0.0, epsilon = 1e-12);
                assert_relative_eq!(system.normal.norm(), 1.0, epsilon = 1e-12);
            }
        }
    }

    #[test]
    fn the_length_of_burgers_vectors_by_hand() {
        for system in Lattice::ALUMINIUM.slip_systems() {
            assert_relative_eq!(system.burgers_nm.norm(), 0.4050 / 2f64.sqrt(), epsilon = 1e-12);
        }
        for system in Lattice::IRON.slip_systems() {
            assert_relative_eq!(system.burgers_nm.norm(), 0.2866 * 3f64.sqrt() / 2.0, epsilon = 1e-12);
        }
        // <a> or <c+a>, nothing else.
        for system in Lattice::GAN.slip_systems() {
            let norm = system.burgers_nm.norm();
            assert!((norm - 0.3189).abs() < 1e-12 || (norm - 0.3189f64.hypot(0.5186)).abs() < 1e-12);
        }
    }

    #[test]
    fn g_dot_b_of_perfect_dislocations_is_an_integer_and_some_are_zero() {
        // In L1_0 1/2<101] is a superpartial: half-integers are right there, so it is left out.
        for lattice in [Lattice::ALUMINIUM, Lattice::IRON, Lattice::GAN] {
            let mut invisible = 0;
            for g in lattice.reflections() {
                for system in lattice.slip_systems() {
                    let product = g.dot(&system.burgers_nm);
                    assert_relative_eq!(product, product.round(), epsilon = 1e-9);
                    invisible += usize::from(product.abs() < 1e-9);
                }
            }
            assert!(invisible > 0, "{lattice:?}");
        }
    }

    #[test]
    fn aligned_brings_a_direction_where_it_is_asked_to() {
        let mut rng = Pcg64::seed_from_u64(8);
        let crystal = Crystal::random(Lattice::GAN, &mut rng);
        let to = Vector3::new(0.3, -0.5, 0.2);
        assert_relative_eq!(crystal.aligned(&crystal.axis(), &to, 1.0).axis(), to.normalize(), epsilon = 1e-12);
        let opposite = -crystal.axis();
        assert_relative_eq!(crystal.aligned(&crystal.axis(), &opposite, 0.0).axis(), opposite, epsilon = 1e-12);
    }
}

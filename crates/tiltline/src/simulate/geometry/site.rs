//! Where a feature grows: the foil around it, the crystal it is in, and the frame of a slip plane.

use rand::RngExt;
use rand_pcg::Pcg64;

use super::crystal::{Crystal, SlipSystem};
use super::polyline::resample;
use super::settings::Range;
use crate::geometry::{Point3, Vector3};
use crate::simulate::foil::Dislocation;

/// The surroundings of one feature.
#[derive(Clone, Debug)]
pub struct Site<'a> {
    /// Thickness of the foil in nm.
    pub thickness_nm: f64,
    /// Side of the square that lines may fill, nm: the field of view and its margin.
    pub window_nm: f64,
    /// Middle of the feature.
    pub centre: Point3,
    /// Direction in the foil plane along which a boundary runs here, if the feature lies at one.
    pub boundary: Option<Vector3>,
    /// The crystal at the centre.
    pub crystal: &'a Crystal,
    /// The slip systems that are active in it; never empty.
    pub systems: &'a [SlipSystem],
    /// Length of line that the foil still lacks, nm: features of many lines take no more than this.
    pub budget_nm: f64,
    /// Greatest distance of neighbouring points, nm.
    pub spacing_nm: f64,
}

impl Site<'_> {
    /// One of the active slip systems, its Burgers vector with either sign.
    pub fn slip_system(&self, rng: &mut Pcg64) -> SlipSystem {
        let system = self.systems[rng.random_range(0..self.systems.len())];
        SlipSystem { burgers_nm: system.burgers_nm * sign(rng), ..system }
    }

    /// An active slip plane through the centre.
    pub fn slip_plane(&self, rng: &mut Pcg64) -> (PlaneFrame, SlipSystem) {
        let system = self.slip_system(rng);
        (PlaneFrame::new(&system.normal, &self.centre, self.thickness_nm), system)
    }

    /// Length of a line that certainly leaves the window.
    pub fn reach_nm(&self) -> f64 {
        2.0 * self.window_nm + 2.0 * self.thickness_nm
    }

    /// Number of similar lines, each about `length_nm` long, within a range and the budget; at least `range.low`.
    pub fn count(&self, range: Range, length_nm: f64, rng: &mut Pcg64) -> usize {
        let most = (self.budget_nm / length_nm.max(1.0)).clamp(range.low, range.high);
        Range::new(range.low, most).sample(rng).round().max(1.0) as usize
    }

    /// Carries the ends of an open line on to a surface where they lie inside the foil: the way they head, or down the
    /// plane (without one, to the nearer surface) where they run level.
    pub fn run_out(&self, points: &mut Vec<Point3>, plane_normal: Option<Vector3>) {
        for _ in 0..2 {
            points.reverse();
            let Some(&end) = points.last() else { return };
            if end.z.abs() >= 0.5 * self.thickness_nm {
                continue;
            }
            let before = points[points.len().saturating_sub(3)];
            let mut heading = (end - before).try_normalize(1e-9).unwrap_or_else(Vector3::zeros);
            if heading.z.abs() < 0.25 {
                let side = if heading.z.abs() > 0.1 { heading.z.signum() } else { end.z.signum() };
                let down =
                    plane_normal.map_or(Vector3::z(), |normal| PlaneFrame::new(&normal, &end, self.thickness_nm).down);
                heading += down * side;
            }
            let way = 0.51 * self.thickness_nm - heading.z.signum() * end.z;
            // On a level plane it leaves by the window.
            points.push(end + heading * (way / heading.z.abs().max(1e-6)).min(self.reach_nm()));
        }
    }

    /// The point carried to the nearer surface and a little beyond, off to the side by `lean` times the way in z: where
    /// the arm of a node leaves the foil.
    pub fn beyond_surface(&self, from: &Point3, lean: Vector3) -> Point3 {
        let side = if from.z < 0.0 { -1.0 } else { 1.0 };
        let way = 0.5 * self.thickness_nm - side * from.z;
        let step = (way + 0.02 * self.thickness_nm).max(0.02 * self.thickness_nm);
        from + Vector3::new(lean.x, lean.y, side) * step
    }
}

/// Coordinates in a plane: `s` along its trace on the surfaces (horizontal), `q` straight down the dip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneFrame {
    /// Origin, on the mid-plane of the foil.
    pub origin: Point3,
    /// Unit vector of `s`, in the plane of the foil.
    pub along: Vector3,
    /// Unit vector of `q`; its z is positive.
    pub down: Vector3,
    /// Unit normal.
    pub normal: Vector3,
    /// The plane meets the surfaces at `q = +-half_width_nm`.
    pub half_width_nm: f64,
}

impl PlaneFrame {
    /// The frame of the plane with this normal through a point, in a foil of this thickness. Planes within 1 degree of
    /// the foil plane count as dipping by 1 degree when it comes to their width.
    pub fn new(normal: &Vector3, through: &Point3, thickness_nm: f64) -> Self {
        let normal = normal.normalize();
        let horizontal = normal.cross(&Vector3::z());
        let along = if horizontal.norm() > 1e-9 { horizontal.normalize() } else { Vector3::x() };
        let mut down = normal.cross(&along);
        if down.z < 0.0 {
            down = -down;
        }
        let dip = down.z.max(0.0175);
        let origin = if down.z >= 0.0175 { through - down * (through.z / down.z) } else { *through };
        Self { origin, along, down, normal, half_width_nm: 0.5 * thickness_nm / dip }
    }

    /// The point with in-plane coordinates `[s, q]`.
    pub fn point(&self, [s, q]: [f64; 2]) -> Point3 {
        self.origin + self.along * s + self.down * q
    }

    /// `[s, q]` of a point's foot in the plane.
    pub fn coordinates(&self, point: &Point3) -> [f64; 2] {
        let offset = point - self.origin;
        [offset.dot(&self.along), offset.dot(&self.down)]
    }

    /// In-plane coordinates of a curve as points in the foil.
    pub fn points(&self, curve: &[[f64; 2]]) -> Vec<Point3> {
        curve.iter().map(|&at| self.point(at)).collect()
    }
}

/// A slow random waviness: sinusoids of several wavelengths, the longer the higher.
#[derive(Clone, Copy, Debug)]
pub struct Wave {
    terms: [[f64; 3]; 4],
}

impl Wave {
    /// Sinusoids around a wavelength; the sum has about this standard deviation, but no more than a twelfth of the wavelength:
    /// line tension lets no line run to and fro.
    pub fn new(amplitude: f64, wavelength: f64, rng: &mut Pcg64) -> Self {
        let wavelength = wavelength.max(1e-3);
        let scales = [2.6, 1.4, 0.8, 0.45].map(|scale| scale * Range::new(0.75, 1.35).sample(rng));
        let heights = scales.map(|scale| scale.powf(1.3) * rng.random_range(0.3..1.0));
        let deviation = heights.iter().map(|height| 0.5 * height * height).sum::<f64>().sqrt();
        let gain = amplitude.min(wavelength / 12.0) / deviation;
        Self {
            terms: std::array::from_fn(|term| {
                let number = std::f64::consts::TAU / (wavelength * scales[term]);
                [heights[term] * gain, number, rng.random_range(0.0..std::f64::consts::TAU)]
            }),
        }
    }

    /// The excursion at a distance along the line.
    pub fn at(&self, distance: f64) -> f64 {
        self.terms.iter().map(|[height, number, phase]| height * (number * distance + phase).sin()).sum()
    }
}

/// A line that starts and ends somewhere.
pub fn open_line(points: Vec<Point3>, burgers_nm: Vector3, plane_normal: Option<Vector3>) -> Dislocation {
    Dislocation { points, closed: false, burgers_nm: Some(burgers_nm), plane_normal }
}

/// `true` with a probability.
pub fn chance(probability: f64, rng: &mut Pcg64) -> bool {
    rng.random::<f64>() < probability
}

/// 1 or -1.
pub fn sign(rng: &mut Pcg64) -> f64 {
    if chance(0.5, rng) { 1.0 } else { -1.0 }
}

/// A horizontal unit vector.
pub fn azimuth(rng: &mut Pcg64) -> Vector3 {
    let (sin, cos) = rng.random_range(0.0..std::f64::consts::TAU).sin_cos();
    Vector3::new(cos, sin, 0.0)
}

/// A unit vector, all directions alike.
pub fn direction(rng: &mut Pcg64) -> Vector3 {
    let z: f64 = rng.random_range(-1.0..1.0);
    let level = azimuth(rng) * (1.0 - z * z).sqrt();
    Vector3::new(level.x, level.y, z)
}

/// Facets: the curve kept only at about every `facet_nm`, off by a tenth of that, with slightly rounded corners.
/// `across` are the directions in which a corner may move.
pub fn facetted(points: &[Point3], closed: bool, facet_nm: f64, across: &[Vector3], rng: &mut Pcg64) -> Vec<Point3> {
    let mut corners = resample(points, closed, facet_nm);
    let count = corners.len();
    if count < 4 {
        return points.to_vec();
    }
    let moved = if closed { 0..count } else { 1..count - 1 };
    for corner in &mut corners[moved] {
        for axis in across {
            *corner += axis * (0.1 * facet_nm * rng.random_range(-1.0..1.0));
        }
    }
    super::polyline::round_corners(&corners, closed, 3)
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn the_edges_of_a_plane_lie_on_the_surfaces() {
        let mut rng = Pcg64::seed_from_u64(5);
        for _ in 0..50 {
            let normal = direction(&mut rng);
            if normal.z.abs() > 0.99 {
                continue;
            }
            let through = Point3::new(30.0, -20.0, 17.0);
            let frame = PlaneFrame::new(&normal, &through, 120.0);
            assert_relative_eq!(frame.point([12.0, frame.half_width_nm]).z, 60.0, epsilon = 1e-9);
            assert_relative_eq!(frame.point([-7.0, -frame.half_width_nm]).z, -60.0, epsilon = 1e-9);
            // The point it was made through lies in it.
            assert_relative_eq!(frame.point(frame.coordinates(&through)), through, epsilon = 1e-9);
            assert_relative_eq!((frame.point([5.0, 9.0]) - through).dot(&normal), 0.0, epsilon = 1e-9);
        }
    }

    #[test]
    fn a_level_plane_keeps_its_depth() {
        let through = Point3::new(3.0, 4.0, 17.0);
        let frame = PlaneFrame::new(&Vector3::z(), &through, 100.0);
        assert_relative_eq!(frame.point([50.0, -80.0]).z, 17.0, epsilon = 1e-12);
    }
}

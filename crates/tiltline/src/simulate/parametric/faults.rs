//! Inclined planar faults (stacking faults, twins, antiphase boundaries): bands of equidistant fringes, which a detector
//! must not take for bundles of lines.

use ndarray::Array2;
use rand::RngExt;
use rand_pcg::Pcg64;
use rayon::prelude::*;

use crate::geometry::Vector3;
use crate::simulate::camera::Camera;
use crate::simulate::field::SmoothField;
use crate::simulate::parametric::{chance, log_uniform, per_view};

/// Random fringes are at least so far apart without tilt, px: no image shows nearer ones. Where a tilt brings them below half of it, nothing
/// is drawn.
const LEAST_PERIOD_PX: f64 = 4.0;

/// A plane through the foil whose fringes run along its trace, one for each step of depth.
///
/// Lengths across and along it are measured with its normal and are longer in the image: by `1 / sqrt(1 - normal.z^2)`.
/// In a column the fault lies at the depth where its plane crosses it, so bands widen, narrow and shift between views.
#[derive(Clone, Debug)]
pub struct Fault {
    /// Unit normal of the plane in the foil.
    normal: Vector3,
    /// Distance of the plane from the foil's centre, px.
    offset_px: f64,
    half_thickness_px: f64,
    /// Where it begins and ends along its trace, px from the centre, and how much its ends lean.
    ends: Option<([f64; 2], f64)>,
    /// Softness of its sides and ends, px.
    edge_px: f64,
    darkness: f64,
    /// What of the darkness is taken off everywhere, so that fringes are bright too.
    lift: f64,
    /// Depth between fringes, px, and where the first lies, radians.
    period_px: f64,
    phase: f64,
    /// Dark fringes are narrower than bright ones above 1.
    sharpness: f64,
    /// How far fringes fade towards the middle of the foil (absorption).
    fading: f64,
    bend: Option<(SmoothField, f64)>,
    view_seed: u64,
}

impl Fault {
    /// Parallel faults on planes of one kind; in some foils another kind crosses them.
    pub fn family(rng: &mut Pcg64, extent_px: f64, thickness_px: f64) -> Vec<Self> {
        let direction = rng.random_range(0.0..std::f64::consts::TAU);
        let model = Self::random(rng, extent_px, thickness_px, direction);
        let members = [1, 2, 3, 4, 7][rng.random_range(0..5)];
        let alike = chance(rng, 0.7);
        let mut faults = Vec::new();
        for _ in 0..members {
            let turned = direction + rng.random_range(-0.02..0.02);
            let own = Self::random(rng, extent_px, thickness_px, turned);
            faults.push(if alike {
                // Of one inclination, as fringes of one look have.
                let flat = (1.0 - model.normal.z.powi(2)).sqrt();
                let normal = Vector3::new(flat * turned.cos(), flat * turned.sin(), model.normal.z);
                let Self { offset_px, ends, view_seed, .. } = own;
                Self { normal, offset_px, ends, view_seed, ..model.clone() }
            } else {
                own
            });
        }
        faults
    }

    fn random(rng: &mut Pcg64, extent_px: f64, thickness_px: f64, direction: f64) -> Self {
        // Width of the band and distance of its fringes as the camera sees them, px.
        let width = log_uniform(rng, [10.0, 150.0]);
        let seen_period = log_uniform(rng, [LEAST_PERIOD_PX, 28.0]).min(width / 1.3);
        let normal = Vector3::new(direction.cos(), direction.sin(), width / thickness_px).normalize();
        let half = 0.6 * extent_px;
        Self {
            normal,
            offset_px: rng.random_range(-half..half),
            half_thickness_px: 0.5 * thickness_px,
            ends: chance(rng, 0.5).then(|| {
                let (middle, reach) = (rng.random_range(-half..half), extent_px * log_uniform(rng, [0.03, 0.5]));
                ([middle - reach, middle + reach], rng.random_range(-1.0..1.0))
            }),
            edge_px: log_uniform(rng, [0.7, 4.0]),
            darkness: log_uniform(rng, [0.08, 0.85]),
            lift: if chance(rng, 0.5) { rng.random_range(0.0..0.5) } else { 0.0 },
            period_px: seen_period / width * thickness_px,
            phase: rng.random_range(0.0..std::f64::consts::TAU),
            sharpness: log_uniform(rng, [0.6, 3.0]),
            fading: rng.random_range(0.0..0.9),
            bend: chance(rng, 0.4).then(|| {
                let length = log_uniform(rng, [15.0, 300.0]);
                (SmoothField::new(rng, 2.0 * extent_px, length), log_uniform(rng, [0.3, 0.03 * length]))
            }),
            view_seed: rng.random_range(0..u64::MAX),
        }
    }

    /// Paints the fault.
    pub fn paint(&self, camera: &Camera, index: usize, image: &mut Array2<f32>) {
        let [m00, m01, b0, m10, m11, b1] = camera.foil_from_image(0.0);
        // Distance to the plane changes by `slope` per px of depth along a column.
        let slope = self.normal.z - self.normal.x * camera.tilt_rad.tan();
        if (self.period_px * slope).abs() < 0.5 * LEAST_PERIOD_PX {
            return;
        }
        let half_band = (self.half_thickness_px * slope).abs();
        let reach = half_band + 4.0 * self.edge_px + self.bend.as_ref().map_or(0.0, |(_, amplitude)| 4.0 * amplitude);
        let look = (1.0 + 0.3 * per_view(self.view_seed, index), 0.8 * per_view(!self.view_seed, index));
        let columns = image.ncols();
        let pixels = image.as_slice_mut().expect("images made here are in standard layout");
        pixels.par_chunks_mut(columns).enumerate().for_each(|(row, line)| {
            for (column, value) in line.iter_mut().enumerate() {
                let (x, y) = (column as f64, row as f64);
                let (foil_x, foil_y) = (m00 * x + m01 * y + b0, m10 * x + m11 * y + b1);
                let mut q = self.normal.x * foil_x + self.normal.y * foil_y - self.offset_px;
                if q.abs() > reach {
                    continue;
                }
                if let Some((field, amplitude)) = &self.bend {
                    q += amplitude * f64::from(field.at(foil_x, foil_y));
                }
                let along = self.normal.x * foil_y - self.normal.y * foil_x;
                *value *= self.transmission(q, along, half_band, slope, look) as f32;
            }
        });
    }

    /// What is left of the intensity at distance `q` from the plane's trace at mid-foil and at `along` it, px. A view has a strength
    /// and a phase of its own, as its deviation from Bragg's angle has.
    fn transmission(&self, q: f64, along: f64, half_band: f64, slope: f64, (strength, shift): (f64, f64)) -> f64 {
        let rise = |u: f64| 0.5 + 0.5 * (u / self.edge_px).tanh();
        let mut inside = rise(q + half_band) * rise(half_band - q);
        if let Some(([first, last], lean)) = self.ends {
            let along = along + lean * q;
            inside *= rise(along - first) * rise(last - along);
        }
        // Of the fault in this column, above mid-foil.
        let height = q / slope;
        let wave = 0.5 + 0.5 * (std::f64::consts::TAU * height / self.period_px + self.phase + shift).cos();
        let from_middle = (height / self.half_thickness_px).powi(2).min(1.0);
        let fringe = wave.powf(self.sharpness) * (1.0 - self.fading * (1.0 - from_middle));
        (1.0 - self.darkness * strength * inside * (fringe - self.lift)).max(0.02)
    }
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;
    use rand::SeedableRng;

    use super::*;
    use crate::geometry::Point3;

    const THICKNESS_PX: f64 = 90.0;

    fn fault() -> Fault {
        Fault {
            normal: Vector3::new(0.8, 0.6, 0.9).normalize(),
            offset_px: 7.0,
            half_thickness_px: 0.5 * THICKNESS_PX,
            ends: None,
            edge_px: 0.5,
            darkness: 0.4,
            lift: 0.0,
            period_px: 15.0,
            phase: 0.3,
            sharpness: 1.0,
            fading: 0.0,
            bend: None,
            view_seed: 5,
        }
    }

    fn painted(fault: &Fault, tilt_deg: f64) -> (Camera, Array2<f32>) {
        let camera = Camera { tilt_rad: tilt_deg.to_radians(), axis_rad: 0.1, ..Camera::new([301, 301]) };
        let mut image = Array2::from_elem([301, 301], 1.0);
        fault.paint(&camera, 0, &mut image);
        (camera, image)
    }

    /// Fringes are at fixed depths on the plane, whatever the tilt: there the plane, projected, is dark, between them it is not, and
    /// beyond the surfaces there is nothing.
    #[test]
    fn fringes_lie_on_the_plane_at_fixed_depths() {
        let fault = fault();
        let strength = 0.4 * (1.0 + 0.3 * per_view(5, 0));
        let shift = 0.8 * per_view(!5, 0);
        for tilt_deg in [-25.0, 0.0, 25.0] {
            let (camera, image) = painted(&fault, tilt_deg);
            let value = |height: f64, along: f64| {
                let z = -height;
                // On the plane, `along` its trace.
                let across = (fault.offset_px - fault.normal.z * z) / (fault.normal.x.powi(2) + fault.normal.y.powi(2));
                let [x, y] = [fault.normal.x * across - 0.6 * along, fault.normal.y * across + 0.8 * along];
                let place = camera.project(&Point3::new(x, y, z));
                f64::from(image[[place.y.round() as usize, place.x.round() as usize]])
            };
            for turn in [-2.0, -1.0, 0.0, 1.0, 2.0] {
                let dark = 15.0 * (turn - (0.3 + shift) / std::f64::consts::TAU);
                for along in [-40.0, 0.0, 30.0] {
                    // Pixels are whole: a fringe is at least 6 px apart from the next in these views.
                    assert_relative_eq!(value(dark, along), 1.0 - strength, epsilon = 0.06);
                    assert_relative_eq!(value(dark + 7.5, along), 1.0, epsilon = 0.06);
                }
            }
            assert_relative_eq!(value(THICKNESS_PX, 0.0), 1.0, epsilon = 1e-3);
        }
    }

    /// It ends where it is said to, and where its plane is edge-on nothing is drawn: there are no fringes to be seen.
    #[test]
    fn a_fault_ends_along_its_trace_and_vanishes_edge_on() {
        let short = Fault { ends: Some(([-30.0, 30.0], 0.0)), ..fault() };
        let darkest = |image: &Array2<f32>| image.iter().copied().fold(1.0, f32::min);
        let (camera, image) = painted(&short, 0.0);
        assert!(darkest(&image) < 0.75);
        for ((row, column), value) in image.indexed_iter() {
            let [m00, m01, b0, m10, m11, b1] = camera.foil_from_image(0.0);
            let (x, y) = (column as f64, row as f64);
            let (x, y) = (m00 * x + m01 * y + b0, m10 * x + m11 * y + b1);
            let along = short.normal.x * y - short.normal.y * x;
            assert!(along.abs() < 33.0 || (value - 1.0).abs() < 1e-3, "{along} {value}");
        }
        let edge_on = (short.normal.z / short.normal.x).atan().to_degrees();
        assert_eq!(darkest(&painted(&fault(), edge_on).1), 1.0);
    }

    /// Random faults are bands with fringes: most are seen, none is below black, and fringes are at least as far apart as images show.
    #[test]
    fn random_faults_are_seen_and_never_below_black() {
        let mut rng = Pcg64::seed_from_u64(4);
        let (mut seen, mut all) = (0, 0);
        for _ in 0..30 {
            for fault in Fault::family(&mut rng, 300.0, THICKNESS_PX) {
                let (_, image) = painted(&fault, 8.0);
                assert!(image.iter().all(|value| (0.0..3.0).contains(value)));
                assert_relative_eq!(fault.normal.norm(), 1.0, epsilon = 1e-9);
                let across = fault.normal.x.hypot(fault.normal.y);
                assert!(fault.period_px * fault.normal.z / across > 0.99 * LEAST_PERIOD_PX);
                seen += usize::from(image.iter().any(|value| (value - 1.0).abs() > 0.02));
                all += 1;
            }
        }
        assert!(2 * seen > all, "{seen} of {all}");
    }

    /// A foil with faults is the foil without them, and they on top: nothing else of it is drawn anew.
    #[test]
    fn faults_change_nothing_else_of_a_foil() {
        use crate::simulate::parametric::{LookSettings, Specimen};
        let curve = vec![Point3::new(-40.0, 0.0, -10.0), Point3::new(40.0, 20.0, 10.0)];
        let specimen = |faults: f64| {
            let look = LookSettings { faults, ..LookSettings::default() };
            Specimen::new(std::slice::from_ref(&curve), &[], 200.0, THICKNESS_PX, &look, 11)
        };
        let (without, with) = (specimen(0.0), specimen(9.0));
        assert!(without.faults.is_empty() && !with.faults.is_empty());
        let rest = |specimen: Specimen| format!("{:?}", Specimen { faults: Vec::new(), ..specimen });
        assert_eq!(rest(without), rest(with));
    }
}

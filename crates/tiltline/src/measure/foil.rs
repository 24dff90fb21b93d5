//! Surfaces of the foil from the ends of its lines: a dislocation cannot end inside a crystal, so free ends mark the
//! surfaces, save where a line only fades or its match was lost.
//!
//! Two parallel planes `z = a x + b y + c` with two values of c are fitted robustly (MSAC, Torr and Zisserman 2000, seeded;
//! then least squares on the inliers). No end can lie outside the foil, so ends beyond a surface cost more than
//! ends between them. The fit is believed only where chance would hardly put so many ends so near two planes.

use nalgebra::{Matrix4, Vector4};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::curve::{Curve3, TraceEnd};
use crate::geometry::Point3;
use crate::measure::smooth::SmoothCurve;
use crate::measure::{END_ERROR_PX, Known, MeasureSettings};
use crate::reconstruction::Frame;

/// Steepest foil that is sought: the tilt of its normal to the beam, in degrees.
const MAX_NORMAL_TILT_DEG: f64 = 40.0;
/// Ends within this many of their standard deviations of a surface lie on it.
const INLIER_SIGMAS: f64 = 2.5;
/// What an end beyond a surface may cost, relative to one between the surfaces.
const OUTSIDE_COST: f64 = 4.0;
/// Fewest ends on each surface.
const MIN_ENDS_PER_SURFACE: usize = 3;
/// Probability that ends at random depths look like two surfaces, above which the fit is not believed.
const MAX_CHANCE: f64 = 0.01;
/// Random samples of four ends.
const SAMPLES: usize = 3000;
/// Steepest line, dz per dxy, whose end error is carried over to depth; beyond, the beam runs along the line.
const MAX_LINE_SLOPE: f64 = 5.0;

/// The two surfaces and what follows from them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Foil {
    /// Distance between the surfaces along the foil's normal.
    pub thickness: f64,
    /// Ends of its 95 percent interval, from the scatter of the line ends and the error of the tilt angle.
    pub thickness_interval: [f64; 2],
    /// One sigma of the thickness from the scatter alone, the tilt taken as exact.
    pub fit_sigma: f64,
    /// Angle of the foil's normal to the mid-view beam, in degrees.
    pub normal_tilt_deg: f64,
    /// Unit normal of the foil, pointing away from the viewer.
    pub normal: [f64; 3],
    /// The surfaces.
    pub surfaces: FoilSurfaces,
    /// Free ends on the two surfaces: towards the viewer, away from the viewer.
    pub ends_on_surfaces: [usize; 2],
    /// Free ends in all.
    pub ends: usize,
}

/// The planes `z = slope_x x + slope_y y + z_near` and `... + z_far`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FoilSurfaces {
    /// dz/dx of both.
    pub slope_x: f64,
    /// dz/dy of both.
    pub slope_y: f64,
    /// z of the surface towards the viewer, at x = y = 0.
    pub z_near: f64,
    /// z of the surface away from the viewer, at x = y = 0.
    pub z_far: f64,
}

impl Foil {
    /// `d ln(thickness) / d ln(depth scale)`: 1 for a foil at right angles to the beam, less where it leans, since the
    /// slopes grow with the depths.
    pub(super) fn thickness_by_scale(&self) -> f64 {
        self.normal_tilt_deg.to_radians().cos().powi(2)
    }
}

/// A free end of a line.
#[derive(Clone, Copy, Debug)]
struct End {
    position: Point3,
    sigma_z: f64,
}

impl FoilSurfaces {
    fn vector(&self) -> Vector4<f64> {
        Vector4::new(self.slope_x, self.slope_y, self.z_near, self.z_far)
    }

    fn from_vector(vector: &Vector4<f64>) -> Self {
        let (z_near, z_far) = (vector[2].min(vector[3]), vector[2].max(vector[3]));
        Self { slope_x: vector[0], slope_y: vector[1], z_near, z_far }
    }

    /// Depth of an end below each surface, in its standard deviations; positive away from the viewer.
    fn residuals(&self, end: &End) -> [f64; 2] {
        let level = end.position.z - self.slope_x * end.position.x - self.slope_y * end.position.y;
        [(level - self.z_near) / end.sigma_z, (level - self.z_far) / end.sigma_z]
    }

    /// The surface an end lies on, 0 near or 1 far.
    fn surface_of(&self, end: &End) -> Option<usize> {
        let [near, far] = self.residuals(end).map(f64::abs);
        let (surface, distance) = if near <= far { (0, near) } else { (1, far) };
        (distance <= INLIER_SIGMAS).then_some(surface)
    }

    fn cost(&self, end: &End) -> f64 {
        let [near, far] = self.residuals(end);
        let limit = INLIER_SIGMAS * INLIER_SIGMAS;
        if near < 0.0 {
            (near * near).min(OUTSIDE_COST * limit)
        } else if far > 0.0 {
            (far * far).min(OUTSIDE_COST * limit)
        } else {
            near.min(-far).powi(2).min(limit)
        }
    }

    fn steepness(&self) -> f64 {
        self.slope_x.hypot(self.slope_y)
    }
}

/// Fits the surfaces of the foil, or says why that cannot be done.
pub(super) fn fit(curves: &[Curve3], smooth: &[SmoothCurve], frame: &Frame, settings: &MeasureSettings) -> Known<Foil> {
    let ends = free_ends(curves, smooth, frame);
    let wanted = settings.min_surface_ends.max(2 * MIN_ENDS_PER_SURFACE);
    if ends.len() < wanted {
        return Known::Unknown(format!(
            "{} free line ends, {wanted} are needed to see the foil's surfaces",
            ends.len()
        ));
    }
    let Some(surfaces) = search(&ends) else {
        return Known::Unknown("the free line ends lie along one line, which fixes no surface".into());
    };
    let Some((surfaces, covariance)) = refine(surfaces, &ends) else {
        return Known::Unknown(format!("the {} free line ends do not lie on two parallel surfaces", ends.len()));
    };
    conclude(&surfaces, &covariance, &ends, frame)
}

fn free_ends(curves: &[Curve3], smooth: &[SmoothCurve], frame: &Frame) -> Vec<End> {
    let mut ends = Vec::new();
    for (curve, smooth) in curves.iter().zip(smooth).filter(|(curve, _)| !curve.closed) {
        let last = curve.points.len() - 1;
        // The slope near an end, over up to ten points.
        let inner = last.min(10);
        for (which, (at, inside)) in [(0, inner), (last, last - inner)].into_iter().enumerate() {
            if curve.ends[which] != TraceEnd::Free {
                continue;
            }
            let position = smooth.points[at];
            let step = smooth.points[inside] - position;
            let slope = (step.z.abs() / step.xy().norm().max(1e-9)).min(MAX_LINE_SLOPE);
            let sigma_z = curve.points[at].sigma_z.hypot(slope * END_ERROR_PX * frame.pixel).max(1e-6 * frame.pixel);
            ends.push(End { position, sigma_z });
        }
    }
    ends
}

/// The best of many planes through three ends, with the parallel plane through a fourth.
fn search(ends: &[End]) -> Option<FoilSurfaces> {
    // The sample is random only to bound the work; a fixed seed makes the result one of the curves alone.
    let mut rng = Pcg64::seed_from_u64(0);
    let max_slope = MAX_NORMAL_TILT_DEG.to_radians().tan();
    let mut best: Option<(f64, FoilSurfaces)> = None;
    for _ in 0..SAMPLES {
        let mut pick = [0; 4];
        for index in 0..4 {
            pick[index] = loop {
                let candidate = rng.random_range(0..ends.len());
                if !pick[..index].contains(&candidate) {
                    break candidate;
                }
            };
        }
        let [p, q, r, other] = pick.map(|index| ends[index].position);
        let normal = (q - p).cross(&(r - p));
        if normal.z.abs() < 1e-9 * normal.norm() || normal.z == 0.0 {
            continue;
        }
        let (slope_x, slope_y) = (-normal.x / normal.z, -normal.y / normal.z);
        let level = |point: &Point3| point.z - slope_x * point.x - slope_y * point.y;
        let surfaces = FoilSurfaces::from_vector(&Vector4::new(slope_x, slope_y, level(&p), level(&other)));
        if surfaces.steepness() > max_slope {
            continue;
        }
        let cost: f64 = ends.iter().map(|end| surfaces.cost(end)).sum();
        if best.as_ref().is_none_or(|(least, _)| cost < *least) {
            best = Some((cost, surfaces));
        }
    }
    best.map(|(_, surfaces)| surfaces)
}

/// Least squares on the inliers, which are then found anew; with the covariance of the four parameters.
fn refine(mut surfaces: FoilSurfaces, ends: &[End]) -> Option<(FoilSurfaces, Matrix4<f64>)> {
    let mut covariance = Matrix4::zeros();
    for _ in 0..10 {
        let (mut normal, mut right) = (Matrix4::<f64>::zeros(), Vector4::<f64>::zeros());
        for end in ends {
            let Some(surface) = surfaces.surface_of(end) else { continue };
            let mut row = Vector4::new(end.position.x, end.position.y, 0.0, 0.0);
            row[2 + surface] = 1.0;
            let weight = end.sigma_z.powi(-2);
            normal += row * row.transpose() * weight;
            right += row * (weight * end.position.z);
        }
        covariance = normal.try_inverse()?;
        let next = FoilSurfaces::from_vector(&(covariance * right));
        let change = (next.vector() - surfaces.vector()).amax();
        surfaces = next;
        if change == 0.0 {
            break;
        }
    }
    (surfaces.steepness() <= MAX_NORMAL_TILT_DEG.to_radians().tan()).then_some((surfaces, covariance))
}

fn conclude(surfaces: &FoilSurfaces, covariance: &Matrix4<f64>, ends: &[End], frame: &Frame) -> Known<Foil> {
    let mut ends_on_surfaces = [0; 2];
    let mut squares = 0.0;
    for end in ends {
        if let Some(surface) = surfaces.surface_of(end) {
            ends_on_surfaces[surface] += 1;
            squares += surfaces.residuals(end)[surface].powi(2);
        }
    }
    let inliers = ends_on_surfaces[0] + ends_on_surfaces[1];
    let gap = surfaces.z_far - surfaces.z_near;
    let unit = frame.unit.word();
    if ends_on_surfaces.iter().any(|&count| count < MIN_ENDS_PER_SURFACE) || inliers <= 4 {
        return Known::Unknown(format!(
            "of {} free line ends only {} and {} lie on the two best surfaces",
            ends.len(),
            ends_on_surfaces[0],
            ends_on_surfaces[1]
        ));
    }
    // Ends spread evenly over the depth would fall within reach of a surface with this probability.
    let reach = INLIER_SIGMAS * ends.iter().map(|end| end.sigma_z).sum::<f64>() / ends.len() as f64;
    let coverage = (4.0 * reach / (gap + 2.0 * reach)).min(1.0);
    // The four parameters take up four ends.
    let chance = binomial_tail(ends.len() - 4, inliers - 4, coverage);
    if chance > MAX_CHANCE {
        return Known::Unknown(format!(
            "{inliers} of {} free line ends lie within {reach:.1} {unit} of two surfaces {gap:.1} {unit} apart, which chance \
             gives with probability {chance:.2}",
            ends.len()
        ));
    }
    let freedom = (inliers - 4) as f64;
    let scatter2 = (squares / freedom).max(1.0);
    let (a, b) = (surfaces.slope_x, surfaces.slope_y);
    let stretch2 = 1.0 + a * a + b * b;
    let thickness = gap / stretch2.sqrt();
    let gradient = Vector4::new(-a * gap / stretch2, -b * gap / stretch2, -1.0, 1.0) / stretch2.sqrt();
    let fit_sigma = (gradient.dot(&(covariance * gradient)) * scatter2).sqrt();
    let cos = 1.0 / stretch2.sqrt();
    let mut foil = Foil {
        thickness,
        thickness_interval: [0.0; 2],
        fit_sigma,
        normal_tilt_deg: cos.acos().to_degrees(),
        normal: [-a * cos, -b * cos, cos],
        surfaces: *surfaces,
        ends_on_surfaces,
        ends: ends.len(),
    };
    let half = (student_95(freedom) * fit_sigma)
        .hypot(1.96 * foil.thickness_by_scale() * frame.relative_tilt_error * thickness);
    foil.thickness_interval = [(thickness - half).max(0.0), thickness + half];
    Known::Known(foil)
}

/// Two-sided 95 percent of Student's t (Abramowitz and Stegun, 26.7.5; within 2 percent from four degrees of freedom).
fn student_95(freedom: f64) -> f64 {
    let z = 1.959_964_f64;
    let (z3, z5) = (z.powi(3), z.powi(5));
    z + (z3 + z) / (4.0 * freedom) + (5.0 * z5 + 16.0 * z3 + 3.0 * z) / (96.0 * freedom * freedom)
}

/// Probability of `successes` or more out of `trials`.
fn binomial_tail(trials: usize, successes: usize, probability: f64) -> f64 {
    if probability >= 1.0 {
        return 1.0;
    }
    // Terms from zero successes up, each from the last, in logarithms so that none is lost.
    let mut log_term = trials as f64 * (1.0 - probability).ln();
    let mut tail = 0.0;
    for k in 0..=trials {
        if k >= successes {
            tail += log_term.exp();
        }
        log_term += ((trials - k) as f64 / (k + 1) as f64).ln() + (probability / (1.0 - probability)).ln();
    }
    tail.min(1.0)
}

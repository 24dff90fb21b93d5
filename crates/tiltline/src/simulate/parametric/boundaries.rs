//! What is straight and is not a dislocation: lamella and twin boundaries, slip traces.

use ndarray::Array2;
use rand::RngExt;
use rand_pcg::Pcg64;
use rayon::prelude::*;

use crate::geometry::{Point3, Vector3};
use crate::simulate::camera::Camera;
use crate::simulate::draw::stroke;
use crate::simulate::field::SmoothField;
use crate::simulate::geometry::polyline::HalfSpace;
use crate::simulate::parametric::{chance, log_uniform, per_view};

/// A planar boundary through the foil, seen edge-on as a thin dark line or inclined as a band with fringes.
///
/// In a column the boundary lies at the depth where its plane crosses it, so bands widen, narrow and shift between
/// views as they do in a microscope.
#[derive(Clone, Debug)]
pub struct Boundary {
    /// Unit normal of the plane in the foil.
    normal: Vector3,
    /// Distance of the plane from the foil's centre, px.
    offset_px: f64,
    half_thickness_px: f64,
    /// Softness of its edges, px.
    edge_px: f64,
    darkness: f64,
    /// Fringes: period in px of depth, strength.
    fringe: Option<(f64, f64)>,
    /// Change of grey from one side to the other.
    step: f64,
    /// A bright or dark rim beside it: offset, width in px and height.
    rim: Option<(f64, f64, f64)>,
    roughness: Option<(SmoothField, f64)>,
    view_seed: u64,
}

/// A family of parallel boundaries, as lamellae have them.
pub fn family(rng: &mut Pcg64, extent_px: f64, thickness_px: f64) -> Vec<Boundary> {
    let direction = rng.random_range(0.0..std::f64::consts::PI);
    // Mostly steep to the foil, as lamellae chosen for stereo work are; some far from it.
    let inclination: f64 = if chance(rng, 0.75) { rng.random_range(-0.12..0.12) } else { rng.random_range(-0.6..0.6) };
    let members = [1, 1, 2, 3, 5][rng.random_range(0..5)];
    let alike = chance(rng, 0.6);
    let first = Boundary::random(rng, extent_px, thickness_px, direction, inclination);
    let mut boundaries = vec![first];
    for _ in 1..members {
        let turn = rng.random_range(-0.03..0.03);
        let mut next = Boundary::random(rng, extent_px, thickness_px, direction + turn, inclination);
        if alike {
            let model = &boundaries[0];
            next =
                Boundary { normal: next.normal, offset_px: next.offset_px, view_seed: next.view_seed, ..model.clone() };
        }
        boundaries.push(next);
    }
    boundaries
}

/// Boundaries on given planes (px), mostly of one look.
pub fn on_planes(rng: &mut Pcg64, planes: &[HalfSpace], extent_px: f64, thickness_px: f64) -> Vec<Boundary> {
    let model = Boundary::random(rng, extent_px, thickness_px, 0.0, 0.0);
    let boundary = |plane: &HalfSpace| {
        let look = match chance(rng, 0.7) {
            true => model.clone(),
            false => Boundary::random(rng, extent_px, thickness_px, 0.0, 0.0),
        };
        Boundary { normal: plane.normal, offset_px: plane.offset, ..look }
    };
    planes.iter().map(boundary).collect()
}

impl Boundary {
    fn random(rng: &mut Pcg64, extent_px: f64, thickness_px: f64, direction: f64, inclination: f64) -> Self {
        let normal = Vector3::new(direction.cos(), direction.sin(), inclination).normalize();
        let thick = chance(rng, 0.35);
        Self {
            normal,
            offset_px: rng.random_range(-0.6..0.6) * extent_px,
            half_thickness_px: 0.5 * thickness_px,
            edge_px: if thick { log_uniform(rng, [3.0, 14.0]) } else { log_uniform(rng, [0.7, 4.0]) },
            darkness: log_uniform(rng, [0.05, 0.75]) * if chance(rng, 0.12) { -0.6 } else { 1.0 },
            fringe: chance(rng, 0.35).then(|| (rng.random_range(8.0..60.0), rng.random_range(0.2..0.9))),
            step: if chance(rng, 0.5) { rng.random_range(-0.35..0.35) } else { 0.0 },
            rim: chance(rng, 0.3).then(|| {
                let side = if chance(rng, 0.5) { 1.0 } else { -1.0 };
                (side * rng.random_range(2.0..8.0), rng.random_range(1.0..4.0), rng.random_range(-0.15..0.3))
            }),
            roughness: chance(rng, 0.6).then(|| {
                let length = log_uniform(rng, [3.0, 25.0]);
                (SmoothField::new(rng, 2.0 * extent_px, length), rng.random_range(0.2..1.6))
            }),
            view_seed: rng.random_range(0..u64::MAX),
        }
    }

    /// Paints the boundary.
    pub fn paint(&self, camera: &Camera, index: usize, image: &mut Array2<f32>) {
        let [m00, m01, b0, m10, m11, b1] = camera.foil_from_image(0.0);
        // Distance to the plane changes by `slope` per px of depth along a column.
        let slope = self.normal.z - self.normal.x * camera.tilt_rad.tan();
        let half_band = (self.half_thickness_px * slope).abs();
        let width = self.edge_px;
        let darkness = self.darkness * (1.0 + 0.25 * per_view(self.view_seed, index));
        // An edge-on boundary absorbs along the whole column: the narrower the band, the darker.
        let reach = half_band
            + 3.0 * width
            + self.rim.map_or(0.0, |(offset, rim_width, _)| offset.abs() + 3.0 * rim_width)
            + 4.0;
        let wander = self.roughness.as_ref().map_or(0.0, |(_, amplitude)| 3.0 * amplitude);
        let sides = [-0.5, 0.5].map(|side| (1.0 + self.step * side).max(0.02) as f32);
        let columns = image.ncols();
        let pixels = image.as_slice_mut().expect("images made here are in standard layout");
        pixels.par_chunks_mut(columns).enumerate().for_each(|(row, line)| {
            for (column, value) in line.iter_mut().enumerate() {
                let (x, y) = (column as f64, row as f64);
                let (foil_x, foil_y) = (m00 * x + m01 * y + b0, m10 * x + m11 * y + b1);
                let mut q = self.normal.x * foil_x + self.normal.y * foil_y - self.offset_px;
                if q.abs() > reach + wander {
                    // Far from the boundary only the grey of its side is left.
                    *value *= sides[usize::from(q > 0.0)];
                    continue;
                }
                if let Some((field, amplitude)) = &self.roughness {
                    q += amplitude * f64::from(field.at(foil_x, foil_y));
                }
                *value *= self.transmission(q, half_band, slope, darkness) as f32;
            }
        });
    }

    /// What is left of the intensity at distance q (px) from the plane's trace at mid-foil.
    fn transmission(&self, q: f64, half_band: f64, slope: f64, darkness: f64) -> f64 {
        let width = self.edge_px;
        let rise = |u: f64| 0.5 + 0.5 * (u / width).tanh();
        let band = rise(q + half_band + 0.5 * width) - rise(q - half_band - 0.5 * width);
        let mut dark = darkness * band;
        if let Some((period, strength)) = self.fringe
            && half_band > 2.0
        {
            dark *= 1.0 + strength * (std::f64::consts::TAU * q / slope / period).cos();
        }
        let mut value = 1.0 - dark + self.step * (rise(q) - 0.5);
        if let Some((offset, rim_width, height)) = self.rim {
            let edge = offset + half_band.copysign(offset);
            value += height * (-((q - edge) / rim_width).powi(2)).exp();
        }
        value.max(0.02)
    }
}

/// The dead straight mark a moving dislocation leaves on a surface: thin, often bright beside dark.
#[derive(Clone, Debug)]
pub struct SlipTrace {
    ends: [Point3; 2],
    sigma_px: f64,
    contrast: f64,
    /// Relative height and offset in sigma of a second, opposite line.
    partner: Option<(f64, f64)>,
    /// Broken into beads of surface dirt: period in px and strength.
    beads: Option<(f64, f64)>,
}

impl SlipTrace {
    /// Parallel traces of one slip system, evenly strong, on either surface.
    pub fn family(rng: &mut Pcg64, extent_px: f64, thickness_px: f64) -> Vec<Self> {
        let direction = rng.random_range(0.0..std::f64::consts::PI);
        let model = Self::random(rng, extent_px, thickness_px, direction);
        let members = [1, 1, 2, 3, 6][rng.random_range(0..5)];
        let alike = chance(rng, 0.7);
        let others: Vec<Self> = (1..members)
            .map(|_| {
                let turned = direction + rng.random_range(-0.01..0.01);
                let own = Self::random(rng, extent_px, thickness_px, turned);
                if alike { Self { ends: own.ends, ..model.clone() } } else { own }
            })
            .collect();
        std::iter::once(model).chain(others).collect()
    }

    /// A random trace on one of the surfaces.
    fn random(rng: &mut Pcg64, extent_px: f64, thickness_px: f64, direction: f64) -> Self {
        let along = Vector3::new(direction.cos(), direction.sin(), 0.0);
        let z = 0.5 * thickness_px * if chance(rng, 0.5) { 1.0 } else { -1.0 };
        let half = 0.5 * extent_px;
        let middle = Point3::new(rng.random_range(-half..half), rng.random_range(-half..half), z);
        let (back, forth) = if chance(rng, 0.6) {
            (2.0 * extent_px, 2.0 * extent_px)
        } else {
            (rng.random_range(0.1..0.6) * extent_px, rng.random_range(0.1..0.6) * extent_px)
        };
        let sign = if chance(rng, 0.5) { 1.0 } else { -1.0 };
        Self {
            ends: [middle - along * back, middle + along * forth],
            sigma_px: log_uniform(rng, [0.6, 3.0]),
            contrast: sign * log_uniform(rng, [0.02, 0.25]),
            partner: chance(rng, 0.5).then(|| (rng.random_range(0.3..1.0), rng.random_range(2.0..3.5))),
            beads: chance(rng, 0.15).then(|| (rng.random_range(5.0..25.0), rng.random_range(0.3..0.9))),
        }
    }

    /// Paints the trace.
    pub fn paint(&self, camera: &Camera, image: &mut Array2<f32>) {
        let line = camera.project_all(&self.ends);
        let (sigma, contrast) = (self.sigma_px as f32, self.contrast as f32);
        let length = (line[1] - line[0]).norm();
        stroke(camera.shape, &line, 6.0 * self.sigma_px, |row, column, near| {
            let trough = |u: f32| (-0.5 * u * u).exp();
            let u = near.across / sigma;
            let mut value = trough(u);
            if let Some((height, offset)) = self.partner {
                value -= height as f32 * trough(u - offset as f32);
            }
            if let Some((period, strength)) = self.beads {
                let along = f64::from(near.place) * length / period;
                value *= (1.0 - strength * (0.5 + 0.5 * (std::f64::consts::TAU * along).cos())) as f32;
            }
            image[[row, column]] *= 1.0 - contrast * value;
        });
    }
}

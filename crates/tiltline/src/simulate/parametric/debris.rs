//! Dirt on the surfaces: blobs, black-white beads, smudges, short scratches and mottled patches.

use ndarray::Array2;
use rand::RngExt;
use rand_pcg::Pcg64;

use crate::geometry::{Point3, Vector3};
use crate::simulate::camera::Camera;
use crate::simulate::draw::stroke;
use crate::simulate::field::SmoothField;
use crate::simulate::parametric::{chance, log_uniform};

/// One piece of dirt on a surface.
#[derive(Clone, Debug)]
pub struct Debris {
    position: Point3,
    kind: Kind,
}

#[derive(Clone, Debug)]
enum Kind {
    /// An irregular blob: radius px, contrast, outline roughness.
    Blob { radius_px: f64, contrast: f64, outline: SmoothField, roughness: f64 },
    /// A dark and a bright spot side by side (strain of a small particle).
    BlackWhite { radius_px: f64, contrast: f64, across: Vector3 },
    /// A short straight scratch or fibre, too short and too straight for a dislocation.
    Scratch { along: Vector3, sigma_px: f64, contrast: f64 },
    /// A soft smudge, longer than wide and sharper on one side: along, widths of both sides px, contrast.
    Smudge { along: Vector3, length_px: f64, widths_px: [f64; 2], contrast: f64 },
    /// A mottled patch: fine texture that fades outward.
    Patch { radius_px: f64, contrast: f64, texture: SmoothField },
}

impl Debris {
    /// A random piece.
    pub fn random(rng: &mut Pcg64, extent_px: f64, thickness_px: f64) -> Self {
        let half = 0.6 * extent_px;
        let z = 0.5 * thickness_px * if chance(rng, 0.5) { 1.0 } else { -1.0 };
        let position = Point3::new(rng.random_range(-half..half), rng.random_range(-half..half), z);
        let contrast = log_uniform(rng, [0.04, 0.6]) * if chance(rng, 0.2) { -0.5 } else { 1.0 };
        let angle = rng.random_range(0.0..std::f64::consts::TAU);
        let direction = Vector3::new(angle.cos(), angle.sin(), 0.0);
        let kind = match rng.random_range(0.0..1.0) {
            u if u < 0.58 => {
                let radius_px = log_uniform(rng, [1.2, 16.0]);
                let outline = SmoothField::new(rng, 6.0 * radius_px, (0.7 * radius_px).max(1.5));
                Kind::Blob { radius_px, contrast, outline, roughness: rng.random_range(0.0..0.7) }
            }
            u if u < 0.74 => Kind::BlackWhite { radius_px: log_uniform(rng, [1.2, 7.0]), contrast, across: direction },
            u if u < 0.87 => {
                let width_px = log_uniform(rng, [2.5, 16.0]);
                Kind::Smudge {
                    along: direction,
                    length_px: width_px * rng.random_range(1.0..2.5),
                    widths_px: [width_px, width_px * rng.random_range(0.15..1.0)],
                    contrast: contrast.abs().min(0.5),
                }
            }
            u if u < 0.96 => Kind::Scratch {
                along: direction * rng.random_range(3.0..10.0),
                sigma_px: rng.random_range(0.8..2.0),
                contrast,
            },
            _ => {
                let radius_px = rng.random_range(12.0..90.0);
                let length = log_uniform(rng, [1.5, 6.0]);
                let texture = SmoothField::new(rng, 4.0 * radius_px, length);
                Kind::Patch { radius_px, contrast: 0.4 * contrast.abs(), texture }
            }
        };
        Self { position, kind }
    }

    /// Paints the piece.
    pub fn paint(&self, camera: &Camera, image: &mut Array2<f32>) {
        let mut spot = |position: &Point3, reach: f64, paint: &mut dyn FnMut(&mut f32, f64, f64)| {
            let centre = camera.project(position);
            stroke(camera.shape, &[centre, centre], reach, |row, column, _| {
                paint(&mut image[[row, column]], column as f64 - centre.x, row as f64 - centre.y);
            });
        };
        match &self.kind {
            Kind::Blob { radius_px, contrast, outline, roughness } => {
                spot(&self.position, 3.0 * radius_px, &mut |value, dx, dy| {
                    let stretch = 1.0 + roughness * f64::from(outline.at(dx, dy));
                    let r2 = (dx * dx + dy * dy) / (radius_px * radius_px) * stretch.max(0.3);
                    *value *= 1.0 - (contrast * (-r2 * r2.sqrt().min(2.0)).exp()) as f32;
                });
            }
            Kind::BlackWhite { radius_px, contrast, across } => {
                spot(&self.position, 4.0 * radius_px, &mut |value, dx, dy| {
                    let u = (dx * across.x + dy * across.y) / radius_px;
                    let r2 = (dx * dx + dy * dy) / (radius_px * radius_px);
                    *value *= 1.0 - (1.6 * contrast * u * (-0.5 * r2).exp()) as f32;
                });
            }
            Kind::Smudge { along, length_px, widths_px: [soft, sharp], contrast } => {
                spot(&self.position, 3.0 * length_px.max(*soft), &mut |value, dx, dy| {
                    let (u, v) = (dx * along.x + dy * along.y, dx * along.y - dy * along.x);
                    let width = if v > 0.0 { soft } else { sharp };
                    *value *= 1.0 - (contrast * (-(u / length_px).powi(2) - (v / width).powi(2)).exp()) as f32;
                });
            }
            Kind::Scratch { along, sigma_px, contrast } => {
                let line = camera.project_all(&[self.position - along, self.position + along]);
                let gain = (-0.5 / (sigma_px * sigma_px)) as f32;
                stroke(camera.shape, &line, 4.0 * sigma_px, |row, column, near| {
                    image[[row, column]] *= 1.0 - *contrast as f32 * (gain * near.distance * near.distance).exp();
                });
            }
            Kind::Patch { radius_px, contrast, texture } => {
                spot(&self.position, 2.2 * radius_px, &mut |value, dx, dy| {
                    let envelope = (-(dx * dx + dy * dy) / (radius_px * radius_px)).exp();
                    *value *= (1.0 + contrast * envelope * f64::from(texture.at(dx, dy))).max(0.1) as f32;
                });
            }
        }
    }
}

//! Lamellae, and the dense dirt along their interfaces: what makes up most of a titanium aluminide image and is not a line
//! that anyone would trace.

use ndarray::Array2;
use rand::RngExt;
use rand_pcg::Pcg64;
use rayon::prelude::*;

use crate::geometry::Vector3;
use crate::simulate::camera::Camera;
use crate::simulate::field::SmoothField;
use crate::simulate::parametric::{chance, log_uniform, per_view};

/// A slab of another orientation between two parallel planes: nearly black, darker or brighter than the foil around it.
#[derive(Clone, Debug)]
pub struct Lamella {
    /// Unit normal of its planes in the foil.
    normal: Vector3,
    /// Distance of its middle from the foil's centre, px.
    offset_px: f64,
    half_width_px: f64,
    half_thickness_px: f64,
    /// Softness of both sides, px.
    edges_px: [f64; 2],
    /// What is left of the intensity inside.
    level: f64,
    /// Changes of grey along its inside.
    inside: SmoothField,
    view_seed: u64,
}

/// Lamellae side by side, of one direction.
pub fn stack(rng: &mut Pcg64, extent_px: f64, thickness_px: f64) -> Vec<Lamella> {
    let direction = rng.random_range(0.0..std::f64::consts::PI);
    let inclination = rng.random_range(-0.2..0.2) * rng.random_range(0.0..1.0);
    let members = [1, 1, 2, 4][rng.random_range(0..4)];
    let middle = rng.random_range(-0.5..0.5) * extent_px;
    let mut at = middle;
    (0..members)
        .map(|_| {
            let turned = direction + rng.random_range(-0.02..0.02);
            let half_width_px = 0.5 * log_uniform(rng, [4.0, 120.0]);
            let sharp = log_uniform(rng, [0.7, 3.0]);
            let soft = |rng: &mut Pcg64| if chance(rng, 0.4) { log_uniform(rng, [3.0, 14.0]) } else { sharp };
            let level = if chance(rng, 0.6) { rng.random_range(0.03..0.6) } else { rng.random_range(0.6..1.3) };
            at += half_width_px;
            let offset_px = at;
            at += half_width_px + log_uniform(rng, [3.0, 100.0]);
            Lamella {
                normal: Vector3::new(turned.cos(), turned.sin(), inclination).normalize(),
                offset_px,
                half_width_px,
                half_thickness_px: 0.5 * thickness_px,
                edges_px: [soft(rng), soft(rng)],
                level,
                inside: SmoothField::new(rng, 3.0 * extent_px, 40.0),
                view_seed: rng.random_range(0..u64::MAX),
            }
        })
        .collect()
}

/// Distance of a pixel's column from a plane at mid-foil and its change per px of depth.
fn slope(normal: &Vector3, camera: &Camera) -> f64 {
    normal.z - normal.x * camera.tilt_rad.tan()
}

/// Calls `shade(across, along)` for every pixel, in px of the foil from a plane's trace at mid-foil, and multiplies by what it
/// returns.
fn multiply(
    image: &mut Array2<f32>,
    camera: &Camera,
    normal: &Vector3,
    offset_px: f64,
    shade: impl Fn(f64, f64) -> f64 + Sync,
) {
    let [m00, m01, b0, m10, m11, b1] = camera.foil_from_image(0.0);
    let columns = image.ncols().max(1);
    let pixels = image.as_slice_mut().expect("images made here are in standard layout");
    pixels.par_chunks_mut(columns).enumerate().for_each(|(row, line)| {
        for (column, value) in line.iter_mut().enumerate() {
            let (x, y) = (column as f64, row as f64);
            let (foil_x, foil_y) = (m00 * x + m01 * y + b0, m10 * x + m11 * y + b1);
            let across = normal.x * foil_x + normal.y * foil_y - offset_px;
            *value *= shade(across, normal.x * foil_y - normal.y * foil_x) as f32;
        }
    });
}

impl Lamella {
    /// Paints the slab; where its planes lie obliquely to the beam its edges are as wide as their bands.
    pub fn paint(&self, camera: &Camera, index: usize, image: &mut Array2<f32>) {
        let band = (self.half_thickness_px * slope(&self.normal, camera)).abs();
        let [first, second] = self.edges_px.map(|edge| edge.hypot(0.6 * band));
        let level = (self.level * (1.0 + 0.3 * per_view(self.view_seed, index))).clamp(0.02, 1.4);
        multiply(image, camera, &self.normal, self.offset_px, |across, along| {
            let rise = |u: f64| 0.5 + 0.5 * u.tanh();
            let share = rise((across + self.half_width_px) / first) * rise((self.half_width_px - across) / second);
            if share < 1e-3 {
                return 1.0;
            }
            // Stretched along the lamella, as strain and thickness are.
            let change = 1.0 + 0.12 * f64::from(self.inside.at(across * 2.0, along * 0.3));
            1.0 + share * (level * change - 1.0)
        });
    }
}

/// Stretches of an interface with and without strokes are about this share of the field long.
const STRETCH: f64 = 0.2;

/// Strokes too dense and too short to tell apart along an interface: steps, ledges, debris, a web of interface dislocations.
#[derive(Clone, Debug)]
pub struct Hair {
    normal: Vector3,
    offset_px: f64,
    /// Standard deviation of the band across, px.
    width_px: f64,
    /// Texture, and the size of its strokes across and along, px.
    texture: SmoothField,
    stroke_px: [f64; 2],
    /// Where along the interface there is any.
    presence: SmoothField,
    strength: f64,
    wander: f64,
}

impl Hair {
    /// A random band of strokes.
    pub fn random(rng: &mut Pcg64, extent_px: f64) -> Self {
        let direction = rng.random_range(0.0..std::f64::consts::PI);
        let across = log_uniform(rng, [1.2, 3.5]);
        Self {
            normal: Vector3::new(direction.cos(), direction.sin(), 0.0),
            offset_px: rng.random_range(-0.6..0.6) * extent_px,
            width_px: log_uniform(rng, [3.0, 14.0]),
            texture: SmoothField::new(rng, 3.0 * extent_px, 4.0),
            stroke_px: [across, across * log_uniform(rng, [1.5, 8.0])],
            presence: SmoothField::new(rng, 3.0 * extent_px, STRETCH * extent_px),
            strength: log_uniform(rng, [0.1, 0.7]),
            wander: rng.random_range(0.0..4.0),
        }
    }

    /// Paints the strokes; they lie in the middle of the foil.
    pub fn paint(&self, camera: &Camera, image: &mut Array2<f32>) {
        multiply(image, camera, &self.normal, self.offset_px, |across, along| {
            let across = across + self.wander * f64::from(self.presence.at(along, 300.0));
            let u = across / self.width_px;
            if u.abs() > 3.5 {
                return 1.0;
            }
            let there = (0.5 + f64::from(self.presence.at(along, 0.0))).clamp(0.0, 1.0);
            let [fine, long] = self.stroke_px;
            let texture = f64::from(self.texture.at(across * 4.0 / fine, along * 4.0 / long));
            let dark = self.strength * there * (-0.5 * u * u).exp() * (0.4 + texture).clamp(0.0, 1.6);
            (1.0 - dark).max(0.05)
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    /// Seen along its planes a lamella has its width; its middle moves with nothing but the tilt's foreshortening.
    #[test]
    fn an_upright_lamella_is_as_wide_as_it_is() {
        let rng = &mut Pcg64::seed_from_u64(3);
        let mut lamella = stack(rng, 200.0, 30.0).remove(0);
        lamella = Lamella {
            normal: Vector3::x(),
            offset_px: 10.0,
            half_width_px: 20.0,
            edges_px: [0.7; 2],
            level: 0.1,
            ..lamella
        };
        let mut image = Array2::ones((200, 200));
        lamella.paint(&Camera::new([200, 200]), 0, &mut image);
        let dark: Vec<usize> = (0..200).filter(|column| image[[100, *column]] < 0.55).collect();
        // From -10 to 30 px about the centre at 99.5.
        assert!(dark.len().abs_diff(40) <= 1 && dark[0].abs_diff(90) <= 1, "{dark:?}");
    }

    #[test]
    fn hair_darkens_its_band_only() {
        let rng = &mut Pcg64::seed_from_u64(4);
        let hair =
            Hair { normal: Vector3::y(), offset_px: 0.0, width_px: 4.0, wander: 0.0, ..Hair::random(rng, 200.0) };
        let mut image = Array2::<f32>::ones((200, 200));
        hair.paint(&Camera::new([200, 200]), &mut image);
        assert!(image.iter().all(|value| (0.0..=1.0).contains(value)));
        let darkest =
            |rows: std::ops::Range<usize>| rows.map(|row| image.row(row).sum() / 200.0).fold(1.0_f32, f32::min);
        assert!(darkest(90..110) < 0.99 && darkest(0..60) == 1.0 && darkest(140..200) == 1.0);
    }
}

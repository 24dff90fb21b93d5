//! What lies behind the lines: gradients, mottling, bend contours, thickness fringes, edges of holes.

use ndarray::Array2;
use rand::RngExt;
use rand_pcg::Pcg64;
use rayon::prelude::*;

use crate::simulate::camera::Camera;
use crate::simulate::field::SmoothField;
use crate::simulate::parametric::{chance, log_uniform, per_view};

/// The background of a specimen, about 1.
#[derive(Clone, Debug)]
pub struct Background {
    gradient: [f64; 2],
    mottling: Vec<(SmoothField, f64)>,
    /// Texture fixed to the foil: what a matcher can hold on to.
    texture: (SmoothField, f64),
    /// Dark bands where the foil bends through the Bragg condition: field, level per px, width, depth.
    bend: Option<(SmoothField, f64, f64)>,
    /// Thickness fringes: field or slope, number of fringes, depth.
    fringes: Option<(SmoothField, [f64; 2], f64)>,
    /// A hole or the foil's edge: beyond this level of a field there is nothing, and it is bright or black.
    hole: Option<(SmoothField, f64, f64)>,
    extent_px: f64,
    view_seed: u64,
}

impl Background {
    /// A random background; `strength` 1 is lively, 0 flat.
    pub fn random(rng: &mut Pcg64, extent_px: f64, strength: f64) -> Self {
        let extent = 2.0 * extent_px;
        let field = |rng: &mut Pcg64, lengths: [f64; 2]| {
            let length = log_uniform(rng, lengths) * extent_px;
            SmoothField::new(rng, extent, length)
        };
        let mottling = [[0.25, 0.8], [0.06, 0.25]]
            .into_iter()
            .map(|lengths| (field(rng, lengths), strength * rng.random_range(0.0..0.13) * rng.random_range(0.0..1.0)))
            .collect();
        let texture_length = log_uniform(rng, [2.0, 12.0]);
        Self {
            gradient: [0, 1].map(|_| strength * rng.random_range(-0.5..0.5) * rng.random_range(0.0..1.0)),
            mottling,
            texture: (SmoothField::new(rng, extent, texture_length), rng.random_range(0.0..0.03)),
            bend: chance(rng, 0.25 * strength)
                .then(|| (field(rng, [0.3, 0.9]), rng.random_range(0.08..0.4), strength * rng.random_range(0.1..0.6))),
            fringes: chance(rng, 0.2 * strength).then(|| {
                let slope = [0, 1].map(|_| rng.random_range(-6.0..6.0) / extent_px);
                (field(rng, [0.4, 1.0]), slope, strength * rng.random_range(0.05..0.35))
            }),
            hole: chance(rng, 0.08 * strength).then(|| {
                let brightness = if chance(rng, 0.6) { rng.random_range(1.3..2.2) } else { rng.random_range(0.0..0.3) };
                (field(rng, [0.3, 0.8]), rng.random_range(0.9..1.8), brightness)
            }),
            extent_px,
            view_seed: rng.random_range(0..u64::MAX),
        }
    }

    /// The background as seen by a camera; bend contours sweep across the foil when it is tilted.
    pub fn paint(&self, camera: &Camera, index: usize) -> Array2<f32> {
        let [m00, m01, b0, m10, m11, b1] = camera.foil_from_image(0.0);
        let [height, width] = camera.shape;
        let sweep = 0.6 * per_view(self.view_seed, index);
        let mut pixels = vec![0.0_f32; height * width];
        pixels.par_chunks_mut(width.max(1)).enumerate().for_each(|(row, line)| {
            for (column, value) in line.iter_mut().enumerate() {
                let (x, y) = (column as f64, row as f64);
                *value = self.at(m00 * x + m01 * y + b0, m10 * x + m11 * y + b1, sweep) as f32;
            }
        });
        Array2::from_shape_vec((height, width), pixels).expect("the buffer has height * width values")
    }

    fn at(&self, x: f64, y: f64, sweep: f64) -> f64 {
        let mut value = 1.0 + (self.gradient[0] * x + self.gradient[1] * y) / self.extent_px;
        for (field, amplitude) in self.mottling.iter().chain([&self.texture]) {
            value += amplitude * f64::from(field.at(x, y));
        }
        if let Some((field, width, depth)) = &self.bend {
            let level = (f64::from(field.at(x, y)) + sweep) / width;
            value *= 1.0 - depth * (-level * level).exp();
        }
        if let Some((field, slope, depth)) = &self.fringes {
            let thickness = slope[0] * x + slope[1] * y + 0.8 * f64::from(field.at(x, y));
            value *= 1.0 - depth * (0.5 + 0.5 * (std::f64::consts::TAU * thickness).cos());
        }
        if let Some((field, level, brightness)) = &self.hole {
            let inside = 0.5 + 0.5 * ((f64::from(field.at(x, y)) - level) * 25.0).tanh();
            value = value * (1.0 - inside) + brightness * inside;
        }
        value.max(0.05)
    }
}

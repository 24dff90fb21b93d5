//! A foil with curves and specks at known places.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::geometry::{Point3, Vector3};

/// How a random scene is made.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneSettings {
    /// Side of the square field of view in px; curves stay inside it.
    pub size_px: f64,
    /// Thickness of the foil in px.
    pub thickness_px: f64,
    /// Number of threading, bowed curves.
    pub curves: usize,
    /// Number of specks: the texture that moves with the foil.
    pub specks: usize,
    /// Seed of everything random.
    pub seed: u64,
}

impl Default for SceneSettings {
    fn default() -> Self {
        Self { size_px: 512.0, thickness_px: 120.0, curves: 14, specks: 2500, seed: 1 }
    }
}

/// A round spot with a Gaussian profile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Speck {
    /// Place in the foil, px.
    pub position: Point3,
    /// Standard deviation of its profile in px.
    pub sigma_px: f64,
    /// Change of intensity at its centre (the background is 1).
    pub amplitude: f32,
}

/// Curves and specks in a foil; origin at its centre, z along the untilted beam, px.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    /// Polylines, points about 1 px apart.
    pub curves: Vec<Vec<Point3>>,
    /// Texture.
    pub specks: Vec<Speck>,
}

impl Scene {
    /// A random scene: smooth bowed curves, most of them from one surface of the foil to the other.
    pub fn random(settings: &SceneSettings) -> Self {
        let mut rng = Pcg64::seed_from_u64(settings.seed);
        let half = 0.5 * settings.size_px;
        let half_thickness = 0.5 * settings.thickness_px;
        let curves = (0..settings.curves).map(|_| random_curve(&mut rng, half * 0.9, half_thickness)).collect();
        let specks = (0..settings.specks)
            .map(|_| Speck {
                position: Point3::new(
                    rng.random_range(-1.3..1.3) * half,
                    rng.random_range(-1.3..1.3) * half,
                    rng.random_range(-1.0..1.0) * half_thickness,
                ),
                sigma_px: rng.random_range(1.2..5.0),
                amplitude: rng.random_range(-0.12..0.12),
            })
            .collect();
        Self { curves, specks }
    }
}

/// A cubic Bezier curve whose ends lie on opposite surfaces (or, one time in four, anywhere inside).
fn random_curve(rng: &mut Pcg64, half: f64, half_thickness: f64) -> Vec<Point3> {
    let inside = |rng: &mut Pcg64| Point3::new(rng.random_range(-half..half), rng.random_range(-half..half), 0.0);
    let mut start = inside(rng);
    let mut end = inside(rng);
    while (end - start).norm() < 0.5 * half || (end - start).norm() > 1.5 * half {
        end = inside(rng);
    }
    let threads = rng.random_range(0.0..1.0) < 0.75;
    let up: f64 = if rng.random_range(0.0..1.0) < 0.5 { 1.0 } else { -1.0 };
    let level = |rng: &mut Pcg64| rng.random_range(-half_thickness..half_thickness);
    (start.z, end.z) = if threads { (up * half_thickness, -up * half_thickness) } else { (level(rng), level(rng)) };
    let along = end - start;
    let across = Vector3::new(-along.y, along.x, 0.0);
    let control = |rng: &mut Pcg64, at: f64| {
        let mut point = start + along * at + across * rng.random_range(-0.35..0.35);
        point.z = (point.z + 0.3 * level(rng)).clamp(-half_thickness, half_thickness);
        point
    };
    let (first, second) = (control(rng, 0.33), control(rng, 0.67));
    bezier([start, first, second, end])
}

/// Points of a cubic Bezier curve about 1 px apart.
pub fn bezier(control: [Point3; 4]) -> Vec<Point3> {
    let length: f64 = control.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    let steps = length.ceil().max(2.0) as usize;
    (0..=steps)
        .map(|step| {
            let t = step as f64 / steps as f64;
            let s = 1.0 - t;
            let weights = [s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t];
            let sum = control.iter().zip(weights).fold(Vector3::zeros(), |sum, (point, w)| sum + point.coords * w);
            Point3::from(sum)
        })
        .collect()
}

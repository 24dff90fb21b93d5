//! Projects a scene at a tilt and renders it as a micrograph.

use ndarray::Array2;
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;

use crate::geometry::{Point2, Point3, Similarity2};
use crate::micrograph::Micrograph;
use crate::simulate::camera::Camera;
use crate::simulate::draw::profile;
use crate::simulate::scene::Scene;

/// How one view is taken.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewSettings {
    /// Rows and columns of the image.
    pub shape: [usize; 2],
    /// Tilt in radians.
    pub tilt_rad: f64,
    /// Direction of the tilt axis, radians clockwise on the screen from image y.
    pub axis_rad: f64,
    /// Magnification.
    pub scale: f64,
    /// Shift of the image on the screen, px.
    pub shift_px: [f64; 2],
    /// Standard deviation of the line profile, px.
    pub line_sigma_px: f64,
    /// Depth of the lines; the background is 1, dark lines are positive.
    pub line_contrast: f32,
    /// Standard deviation of the noise.
    pub noise: f32,
    /// Seed of the noise.
    pub seed: u64,
}

impl Default for ViewSettings {
    fn default() -> Self {
        Self {
            shape: [512, 512],
            tilt_rad: 0.0,
            axis_rad: 0.0,
            scale: 1.0,
            shift_px: [0.0, 0.0],
            line_sigma_px: 1.5,
            line_contrast: 0.5,
            noise: 0.05,
            seed: 1,
        }
    }
}

impl ViewSettings {
    /// The geometry of the view.
    pub fn camera(&self) -> Camera {
        Camera {
            shape: self.shape,
            tilt_rad: self.tilt_rad,
            axis_rad: self.axis_rad,
            scale: self.scale,
            shift_px: self.shift_px,
        }
    }

    /// Projected plane (origin at the foil's centre, tilt axis along y) to image px.
    pub fn image_from_projection(&self) -> Similarity2 {
        self.camera().image_from_projection()
    }

    /// Where a point of the foil lands in the image.
    pub fn project(&self, point: &Point3) -> Point2 {
        self.camera().project(point)
    }

    /// The curves of a scene in the image.
    pub fn project_curves(&self, scene: &Scene) -> Vec<Vec<Point2>> {
        scene.curves.iter().map(|curve| self.camera().project_all(curve)).collect()
    }
}

/// The micrograph of a scene: a background of 1, specks added, lines multiplied in (the foil is transparent), noise.
pub fn render(scene: &Scene, settings: &ViewSettings) -> Micrograph {
    let mut image = Array2::<f32>::from_elem(settings.shape, 1.0);
    for speck in &scene.specks {
        let centre = settings.project(&speck.position);
        let sigma = speck.sigma_px * settings.scale;
        profile(settings.shape, &[centre, centre], sigma, |row, column, value| {
            image[[row, column]] += speck.amplitude * value;
        });
    }
    let sigma = settings.line_sigma_px * settings.scale;
    for curve in settings.project_curves(scene) {
        profile(settings.shape, &curve, sigma, |row, column, value| {
            image[[row, column]] *= 1.0 - settings.line_contrast * value;
        });
    }
    if let Ok(noise) = Normal::new(0.0, settings.noise) {
        let mut rng = Pcg64::seed_from_u64(settings.seed);
        image.mapv_inplace(|value| value + noise.sample(&mut rng));
    }
    Micrograph { tilt_rad: Some(settings.tilt_rad), ..Micrograph::new(image) }
}

//! The example pair that ships with the project: rendered, not recorded.

use std::fs::File;
use std::path::Path;

use miette::{IntoDiagnostic, Result};
use ndarray::Array2;
use tiltline::simulate::{Scene, SceneSettings, ViewSettings, render};

use crate::venv::root;

/// Renders `examples/rendered_-4deg.png` and `examples/rendered_+4deg.png`.
///
/// 512x512 px; the right view is shifted, turned by half a degree and magnified by 0.4 percent, as a real one would be.
pub fn render_pair() -> Result<()> {
    let scene = Scene::random(&SceneSettings { seed: 20, curves: 16, ..SceneSettings::default() });
    let folder = root().join("examples");
    std::fs::create_dir_all(&folder).into_diagnostic()?;
    let left = ViewSettings { tilt_rad: (-4.0_f64).to_radians(), seed: 1, ..ViewSettings::default() };
    let right = ViewSettings {
        tilt_rad: 4.0_f64.to_radians(),
        axis_rad: 0.5_f64.to_radians(),
        scale: 1.004,
        shift_px: [17.0, -8.0],
        seed: 2,
        ..ViewSettings::default()
    };
    for (name, view) in [("rendered_-4deg.png", left), ("rendered_+4deg.png", right)] {
        write_png(&folder.join(name), &render(&scene, &view).pixels)?;
    }
    Ok(())
}

fn write_png(path: &Path, pixels: &Array2<f32>) -> Result<()> {
    let (height, width) = pixels.dim();
    let mut encoder = png::Encoder::new(File::create(path).into_diagnostic()?, width as u32, height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::High);
    let bytes: Vec<u8> = pixels.iter().map(|value| (value * 170.0).round().clamp(0.0, 255.0) as u8).collect();
    encoder.write_header().into_diagnostic()?.write_image_data(&bytes).into_diagnostic()
}

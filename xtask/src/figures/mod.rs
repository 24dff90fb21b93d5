//! The pictures of docs/simulator.md: `docs/figures/physics.png`, `docs/figures/families.png`.

mod families;
mod physics;

use std::path::Path;

use miette::{IntoDiagnostic, Result};
use ndarray::{Array2, s};

use crate::venv::root;

/// Space between pictures, px.
const GAP_PX: usize = 4;

/// Draws every figure again.
pub fn draw() -> Result<()> {
    let folder = root().join("docs/figures");
    std::fs::create_dir_all(&folder).into_diagnostic()?;
    write_png(&folder.join("physics.png"), &sheet(&physics::pictures()?, 5))?;
    write_png(&folder.join("families.png"), &sheet(&families::pictures()?, 4))
}

/// Pictures of one size, `across` in a row, on white.
fn sheet(pictures: &[Array2<f32>], across: usize) -> Array2<f32> {
    let [height, width] = pictures.first().map_or([0, 0], |picture| picture.dim().into());
    let (cell_height, cell_width) = (height + GAP_PX, width + GAP_PX);
    let mut sheet = Array2::ones([pictures.len().div_ceil(across) * cell_height, across * cell_width]);
    for (index, picture) in pictures.iter().enumerate() {
        let (top, left) = ((index / across) * cell_height, (index % across) * cell_width);
        sheet.slice_mut(s![top..top + height, left..left + width]).assign(picture);
    }
    sheet
}

/// Writes values from 0 to 1 as an 8-bit grey PNG.
fn write_png(path: &Path, values: &Array2<f32>) -> Result<()> {
    let (height, width) = values.dim();
    let file = std::fs::File::create(path).into_diagnostic()?;
    let mut encoder = png::Encoder::new(file, width as u32, height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::High);
    let bytes: Vec<u8> = values.iter().map(|value| (value * 255.0).round().clamp(0.0, 255.0) as u8).collect();
    encoder.write_header().into_diagnostic()?.write_image_data(&bytes).into_diagnostic()
}

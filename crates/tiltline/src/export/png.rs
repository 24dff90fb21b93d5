//! `lines_left.png`, `lines_right.png`: line probability on the grids of the input files, 8-bit grey PNG (W3C PNG
//! specification, third edition); 255 is probability 1.

use std::io::{self, Write};

use ndarray::Array2;
use rayon::prelude::*;

use crate::filter::sample_linear;
use crate::geometry::Point2;
use crate::micrograph::View;
use crate::reconstruction::Reconstruction;

/// Writes the line probability of a view, resampled from the rectified grid to that of the input file.
pub fn write_lines(reconstruction: &Reconstruction, view: View, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    let image = lines_on_input(reconstruction, view);
    let (height, width) = image.dim();
    let pixels = image.as_slice().expect("the image was made in standard layout");
    encode(out, [height, width], png::ColorType::Grayscale, pixels)
}

/// Line probability times 255 on the grid of a view's input file `[row, column]`; 0 where the rectified grid ends.
pub fn lines_on_input(reconstruction: &Reconstruction, view: View) -> Array2<u8> {
    let (height, width) = reconstruction.pair.view(view).pixels.dim();
    let probability = reconstruction.lines[view.index()].probability.view();
    let rectification = &reconstruction.rectified.rectification;
    let rectified_from_input = match view {
        View::Left => &rectification.rectified_from_left,
        View::Right => &rectification.rectified_from_right,
    };
    let mut image = Array2::<u8>::zeros((height, width));
    let pixels = image.as_slice_mut().expect("a new array is contiguous");
    pixels.par_chunks_mut(width.max(1)).enumerate().for_each(|(row, line)| {
        for (column, pixel) in line.iter_mut().enumerate() {
            let point = rectified_from_input * Point2::new(column as f64, row as f64);
            let value = sample_linear(&probability, point.x, point.y).unwrap_or(0.0);
            *pixel = (value.clamp(0.0, 1.0) * 255.0).round() as u8;
        }
    });
    image
}

/// Writes a grey picture `[row, column]`.
///
/// # Errors
/// Where `out` cannot be written to, or a side is longer than PNG allows.
pub fn write_grey(image: &Array2<u8>, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    let (height, width) = image.dim();
    let pixels: Vec<u8> = image.iter().copied().collect();
    encode(out, [height, width], png::ColorType::Grayscale, &pixels)
}

/// Encodes 8-bit rows, fast rather than small.
pub(crate) fn encode(
    out: &mut (impl Write + ?Sized),
    [height, width]: [usize; 2],
    colour: png::ColorType,
    pixels: &[u8],
) -> io::Result<()> {
    let side = |length: usize| {
        u32::try_from(length).map_err(|_| io::Error::other(format!("a PNG image cannot have {length} rows or columns")))
    };
    let mut encoder = png::Encoder::new(out, side(width)?, side(height)?);
    encoder.set_color(colour);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(pixels)?;
    writer.finish()?;
    Ok(())
}

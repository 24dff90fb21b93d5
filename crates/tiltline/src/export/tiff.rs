//! `disparity.tif`, `sigma.tif`, `rectified_left.tif`, `rectified_right.tif`: 32-bit float TIFF (TIFF 6.0) with an
//! ImageJ description ("Saving images with ImageJ", tag 270) that carries the pixel size in nm where it is known.
//!
//! All lie on the rectified grid. Disparity and its sigma are in rectified px, NaN off the lines.

use std::io::{self, Seek, Write};

use ndarray::Array2;
use tiff::encoder::compression::DeflateLevel;
use tiff::encoder::{Compression, Rational, TiffEncoder, TiffValue, colortype};
use tiff::tags::{ResolutionUnit, Tag};

use crate::curve::CurvePoint;
use crate::micrograph::View;
use crate::reconstruction::{LengthUnit, Reconstruction};

/// Steps along a line between two pixels that are painted, in px: short enough to leave no gap.
const STEP_PX: f64 = 0.5;

/// Writes `disparity.tif`.
pub fn write_disparity(reconstruction: &Reconstruction, out: &mut (impl Write + Seek + ?Sized)) -> io::Result<()> {
    let [disparity, _] = rasterise(reconstruction);
    write(reconstruction, &disparity, "disparity in px on the rectified-left grid, NaN off the lines", true, out)
}

/// Writes `sigma.tif`: one sigma of the disparity.
pub fn write_sigma(reconstruction: &Reconstruction, out: &mut (impl Write + Seek + ?Sized)) -> io::Result<()> {
    let [_, sigma] = rasterise(reconstruction);
    write(reconstruction, &sigma, "sigma of disparity in px on the rectified-left grid, NaN off the lines", true, out)
}

/// Writes a rectified image: normalised intensity, NaN where the view has no data.
pub fn write_rectified(
    reconstruction: &Reconstruction,
    view: View,
    out: &mut (impl Write + Seek + ?Sized),
) -> io::Result<()> {
    let content = "normalised intensity on the rectified grid, NaN outside the image";
    write(reconstruction, reconstruction.rectified.view(view), content, false, out)
}

/// Disparity and sigma in px on the rectified-left grid `[row, column]`, NaN off the lines.
///
/// Curves are drawn as connected lines one pixel wide; where two meet, the smaller sigma is kept.
pub fn rasterise(reconstruction: &Reconstruction) -> [Array2<f32>; 2] {
    let shape = reconstruction.rectified.left.dim();
    let mut disparity = Array2::from_elem(shape, f32::NAN);
    let mut sigma = Array2::from_elem(shape, f32::NAN);
    let mut paint = |a: &CurvePoint, b: &CurvePoint| {
        let along = b.left_rectified - a.left_rectified;
        let steps = (along.norm() / STEP_PX).ceil().max(1.0) as usize;
        for step in 0..=steps {
            let t = step as f64 / steps as f64;
            let position = a.left_rectified + along * t;
            let (column, row) = (position.x.round(), position.y.round());
            if row < 0.0 || column < 0.0 || row >= shape.0 as f64 || column >= shape.1 as f64 {
                continue;
            }
            let index = [row as usize, column as usize];
            let sigma_here = (a.sigma_disparity_px * (1.0 - t) + b.sigma_disparity_px * t) as f32;
            if sigma[index].is_nan() || sigma_here < sigma[index] {
                sigma[index] = sigma_here;
                disparity[index] = (a.disparity_px * (1.0 - t) + b.disparity_px * t) as f32;
            }
        }
    };
    for curve in &reconstruction.curves {
        for pair in curve.points.windows(2) {
            paint(&pair[0], &pair[1]);
        }
        if let (true, Some(first), Some(last)) = (curve.closed, curve.points.first(), curve.points.last()) {
            paint(last, first);
        }
    }
    [disparity, sigma]
}

/// Writes one image. `sparse` images are deflated (they are nearly all NaN); noise would only cost time.
fn write(
    reconstruction: &Reconstruction,
    image: &Array2<f32>,
    content: &str,
    sparse: bool,
    out: &mut (impl Write + Seek + ?Sized),
) -> io::Result<()> {
    let frame = &reconstruction.frame;
    let pixel_size_nm = (frame.unit == LengthUnit::Nm).then_some(frame.pixel);
    let image = image.as_standard_layout();
    let pixels = image.as_slice().expect("standard layout is contiguous");
    encode::<colortype::Gray32Float>(
        pixels,
        image.dim().into(),
        &Description { content, pixel_size_nm, tilt_deg: None },
        sparse,
        out,
    )
}

/// What a TIFF says beside its pixels.
pub(crate) struct Description<'a> {
    /// What the pixels are.
    pub content: &'a str,
    /// Side of a pixel, if known.
    pub pixel_size_nm: Option<f64>,
    /// Tilt of the specimen, if known.
    pub tilt_deg: Option<f64>,
}

/// Encodes rows of pixels with an ImageJ description.
pub(crate) fn encode<C: colortype::ColorType>(
    pixels: &[C::Inner],
    [height, width]: [usize; 2],
    description: &Description,
    sparse: bool,
    out: &mut (impl Write + Seek + ?Sized),
) -> io::Result<()>
where
    [C::Inner]: TiffValue,
{
    let compression = if sparse { Compression::Deflate(DeflateLevel::Fast) } else { Compression::Uncompressed };
    let (width, height) = (side(width)?, side(height)?);
    let mut encoder = TiffEncoder::new(out).map_err(io_error)?.with_compression(compression);
    let mut tiff = encoder.new_image::<C>(width, height).map_err(io_error)?;
    let unit = if description.pixel_size_nm.is_some() { "nm" } else { "pixel" };
    let mut text = format!("ImageJ=1.54\nunit={unit}\ncontent={}\n", description.content);
    if let Some(tilt_deg) = description.tilt_deg {
        text += &format!("tilt_deg={tilt_deg}\n");
    }
    tiff.encoder().write_tag(Tag::ImageDescription, text.as_str()).map_err(io_error)?;
    if let Some(size) = description.pixel_size_nm {
        // ImageJ counts pixels per unit; the tag's own unit is then none.
        tiff.resolution(ResolutionUnit::None, rational(1.0 / size));
    }
    tiff.write_data(pixels).map_err(io_error)
}

fn side(length: usize) -> io::Result<u32> {
    u32::try_from(length).map_err(|_| io::Error::other(format!("a TIFF image cannot have {length} rows or columns")))
}

/// A positive value as a fraction with nine digits or so.
fn rational(value: f64) -> Rational {
    let denominator = (4e9 / value.max(1.0)).min(1e9).floor().max(1.0);
    Rational { n: (value * denominator).round() as u32, d: denominator as u32 }
}

fn io_error(error: tiff::TiffError) -> io::Error {
    match error {
        tiff::TiffError::IoError(error) => error,
        other => io::Error::other(other),
    }
}

//! Pictures of the report: 8-bit grey JPEG (ITU-T T.81, baseline) of quality 85, in base64 (RFC 4648).

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use jpeg_encoder::{ColorType, Encoder};
use ndarray::Array2;
use serde::{Deserialize, Serialize};

use crate::filter::block_sums;
use crate::report::ReportError;

/// Quality of the JPEG pictures, 1 to 100.
pub const JPEG_QUALITY: u8 = 85;
/// Grey of pixels without data, which the page cuts off: the middle rings least in the blocks at the border.
const VOID: u8 = 128;

/// A grey picture as it stands in a `data:` address: JPEG in base64.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Picture(pub String);

impl Picture {
    /// Encodes an image `[row, column]` whose 0 and 1 become black and white.
    ///
    /// # Errors
    /// Where a side has more than 65535 px.
    pub fn encode(image: &Array2<f32>) -> Result<Self, ReportError> {
        let (rows, columns) = image.dim();
        let (Ok(width), Ok(height)) = (u16::try_from(columns), u16::try_from(rows)) else {
            return Err(ReportError::TooLarge { columns, rows });
        };
        let grey = |&value: &f32| if value.is_nan() { VOID } else { (255.0 * value.clamp(0.0, 1.0)).round() as u8 };
        let pixels: Vec<u8> = image.iter().map(grey).collect();
        let mut jpeg = Vec::new();
        Encoder::new(&mut jpeg, JPEG_QUALITY).encode(&pixels, width, height, ColorType::Luma)?;
        Ok(Self(STANDARD.encode(jpeg)))
    }

    /// Encodes an image averaged over blocks of `step` x `step` pixels.
    ///
    /// # Errors
    /// As for [`Picture::encode`].
    pub fn reduced(image: &Array2<f32>, step: usize) -> Result<Self, ReportError> {
        let area = (step * step) as f32;
        Self::encode(&block_sums(image, step).mapv_into(|sum| sum / area))
    }

    /// Its address, for an `href` or `src`.
    pub fn data_url(&self) -> String {
        format!("data:image/jpeg;base64,{}", self.0)
    }
}

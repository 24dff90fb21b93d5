//! What a file says about its images before any pixel is decoded.

use serde::Serialize;

use super::{Format, MAX_BYTES, MAX_PIXELS, ReadError};

/// What a header says.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// Kind of file.
    pub format: Format,
    /// Rows of the first page.
    pub rows: usize,
    /// Columns of the first page.
    pub columns: usize,
    /// Number of pages, slices or sections; at least 1.
    pub pages: usize,
    /// Type of a stored sample.
    pub sample: SampleType,
    /// Order of the bytes in the file.
    pub byte_order: ByteOrder,
    /// Side of a pixel in nm, if the file states it.
    pub pixel_size_nm: Option<Found<f64>>,
    /// Tilts in degrees, one a page, if they are stated.
    pub tilts_deg: Option<Found<Vec<f64>>>,
    /// Sentences about what is odd, for warnings.
    pub notes: Vec<String>,
}

/// A value and the place it was found at.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Found<T> {
    /// The value.
    pub value: T,
    /// The place, in words: "ImageJ description", "series.rawtlt".
    pub origin: String,
}

impl<T> Found<T> {
    /// A value found at a place.
    pub fn new(value: T, origin: impl Into<String>) -> Self {
        Self { value, origin: origin.into() }
    }
}

/// Order of the bytes of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ByteOrder {
    /// Least significant byte first.
    Little,
    /// Most significant byte first.
    Big,
}

/// Type of a stored sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SampleType {
    /// 8-bit unsigned integer.
    Uint8,
    /// 8-bit signed integer.
    Int8,
    /// 16-bit unsigned integer.
    Uint16,
    /// 16-bit signed integer.
    Int16,
    /// 32-bit unsigned integer.
    Uint32,
    /// 32-bit signed integer.
    Int32,
    /// 64-bit unsigned integer.
    Uint64,
    /// 64-bit signed integer.
    Int64,
    /// 16-bit IEEE float.
    Float16,
    /// 32-bit IEEE float.
    Float32,
    /// 64-bit IEEE float.
    Float64,
}

impl ByteOrder {
    /// The order in words.
    pub fn name(self) -> &'static str {
        match self {
            ByteOrder::Little => "little-endian",
            ByteOrder::Big => "big-endian",
        }
    }
}

impl SampleType {
    /// The type in words.
    pub fn name(self) -> &'static str {
        match self {
            SampleType::Uint8 => "8-bit unsigned",
            SampleType::Int8 => "8-bit signed",
            SampleType::Uint16 => "16-bit unsigned",
            SampleType::Int16 => "16-bit signed",
            SampleType::Uint32 => "32-bit unsigned",
            SampleType::Int32 => "32-bit signed",
            SampleType::Uint64 => "64-bit unsigned",
            SampleType::Int64 => "64-bit signed",
            SampleType::Float16 => "16-bit float",
            SampleType::Float32 => "32-bit float",
            SampleType::Float64 => "64-bit float",
        }
    }

    /// Bytes of a sample.
    pub fn bytes(self) -> u64 {
        match self {
            SampleType::Uint8 | SampleType::Int8 => 1,
            SampleType::Uint16 | SampleType::Int16 | SampleType::Float16 => 2,
            SampleType::Uint32 | SampleType::Int32 | SampleType::Float32 => 4,
            SampleType::Uint64 | SampleType::Int64 | SampleType::Float64 => 8,
        }
    }
}

impl Header {
    /// Takes a candidate pixel size, or notes why not: sizes along x and y must be positive and agree within 1 %.
    pub(super) fn take_pixel_size(&mut self, x_nm: f64, y_nm: f64, origin: &str) {
        let usable = |value: f64| value.is_finite() && value > 0.0;
        if !usable(x_nm) || !usable(y_nm) {
            self.notes.push(format!("pixel size in {origin} is {x_nm} x {y_nm} nm, which cannot be: it is not used"));
        } else if (x_nm / y_nm - 1.0).abs() > 0.01 {
            self.notes.push(format!(
                "pixels in {origin} are not square ({x_nm} x {y_nm} nm): the pixel size is not used; resample the image"
            ));
        } else {
            self.pixel_size_nm = Some(Found::new(x_nm, origin));
        }
    }
}

/// Refuses a page above the limits, before any memory is asked for; `sample_bytes` is per pixel, all channels.
pub(super) fn check_limits(path: &str, columns: u64, rows: u64, sample_bytes: u64) -> Result<(), ReadError> {
    let pixels = columns.saturating_mul(rows);
    let bytes = pixels.saturating_mul(sample_bytes);
    if pixels > MAX_PIXELS || bytes > MAX_BYTES {
        return Err(ReadError::TooLarge { path: path.to_owned(), columns, rows, bytes });
    }
    Ok(())
}

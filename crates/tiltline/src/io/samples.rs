//! Stored samples to f32: byte orders, types, colour channels that are grey after all, and statistics.
//!
//! f32 holds integers exactly up to 2^24; 32-bit and 64-bit samples above that are rounded to one part in 1.7e7, far
//! below the noise of any micrograph.

use ndarray::Array2;

use super::{ByteOrder, ReadError, SampleType};

/// Raw bytes to f32; `bytes` holds whole samples, a remainder is dropped.
pub fn decode(bytes: &[u8], sample: SampleType, order: ByteOrder) -> Vec<f32> {
    macro_rules! numbers {
        ($type:ty, $to_f32:expr) => {{
            let from = match order {
                ByteOrder::Little => <$type>::from_le_bytes,
                ByteOrder::Big => <$type>::from_be_bytes,
            };
            bytes.as_chunks::<{ size_of::<$type>() }>().0.iter().map(|chunk| $to_f32(from(*chunk))).collect()
        }};
    }
    match sample {
        SampleType::Uint8 => bytes.iter().map(|&byte| f32::from(byte)).collect(),
        SampleType::Int8 => bytes.iter().map(|&byte| f32::from(byte.cast_signed())).collect(),
        SampleType::Uint16 => numbers!(u16, f32::from),
        SampleType::Int16 => numbers!(i16, f32::from),
        SampleType::Uint32 => numbers!(u32, |value| value as f32),
        SampleType::Int32 => numbers!(i32, |value| value as f32),
        SampleType::Uint64 => numbers!(u64, |value| value as f32),
        SampleType::Int64 => numbers!(i64, |value| value as f32),
        SampleType::Float16 => numbers!(u16, half_to_f32),
        SampleType::Float32 => numbers!(f32, |value| value),
        SampleType::Float64 => numbers!(f64, |value| value as f32),
    }
}

/// An empty buffer with room for `bytes`, or the error that there is no memory.
pub(super) fn reserve(path: &str, bytes: u64) -> Result<Vec<u8>, ReadError> {
    let no_memory = || ReadError::NoMemory { path: path.to_owned(), bytes };
    let mut buffer = Vec::new();
    buffer.try_reserve_exact(usize::try_from(bytes).map_err(|_| no_memory())?).map_err(|_| no_memory())?;
    Ok(buffer)
}

/// IEEE 754 binary16 to f32.
fn half_to_f32(bits: u16) -> f32 {
    let sign = if bits & 0x8000 == 0 { 1.0 } else { -1.0 };
    let exponent = i32::from(bits >> 10 & 0x1f);
    let fraction = f32::from(bits & 0x3ff);
    match exponent {
        0 => sign * fraction * 2f32.powi(-24),
        31 if fraction == 0.0 => sign * f32::INFINITY,
        31 => f32::NAN,
        _ => sign * (1.0 + fraction / 1024.0) * 2f32.powi(exponent - 15),
    }
}

/// Where the channels of a pixel lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channels {
    /// Those of one pixel side by side.
    Interleaved(usize),
    /// One whole image after the other.
    Planar(usize),
}

/// Makes a grey image of samples with 1 to 4 channels: grey, grey and alpha, RGB, RGBA.
///
/// Colour channels must be equal everywhere, and alpha must be constant. `values` holds `rows * columns` pixels.
pub fn grey(
    path: &str,
    (rows, columns): (usize, usize),
    values: Vec<f32>,
    channels: Channels,
) -> Result<Array2<f32>, ReadError> {
    let not_grey = |what: String| ReadError::NotGrey { path: path.to_owned(), what };
    let pixels = rows * columns;
    let (count, step, stride) = match channels {
        Channels::Interleaved(count) => (count, 1, count),
        Channels::Planar(count) => (count, pixels, 1),
    };
    assert_eq!(values.len(), pixels * count, "a decoded page holds every channel of every pixel");
    let at = |pixel: usize, channel: usize| values[pixel * stride + channel * step];
    let colours = match count {
        1 => {
            return Ok(Array2::from_shape_vec((rows, columns), values).expect("the length was asserted above"));
        }
        2 => 1,
        3 | 4 => 3,
        _ => return Err(not_grey(format!("it has {count} channels a pixel"))),
    };
    let differing = |pixel: &usize| (1..colours).any(|channel| at(*pixel, channel) != at(*pixel, 0));
    if let Some(pixel) = (0..pixels).find(differing) {
        let (row, column) = (pixel / columns, pixel % columns);
        let [red, green, blue] = [0, 1, 2].map(|channel| at(pixel, channel));
        return Err(not_grey(format!(
            "red, green and blue differ, first at row {row}, column {column} ({red}, {green}, {blue})"
        )));
    }
    if count > colours && (1..pixels).any(|pixel| at(pixel, colours) != at(0, colours)) {
        return Err(not_grey("its transparency (alpha channel) is not constant".to_owned()));
    }
    Ok(Array2::from_shape_fn((rows, columns), |(row, column)| at(row * columns + column, 0)))
}

/// Refuses NaN and infinity.
pub(crate) fn require_finite(path: &str, pixels: &Array2<f32>) -> Result<(), ReadError> {
    let Some(((row, column), &value)) = pixels.indexed_iter().find(|(_, value)| !value.is_finite()) else {
        return Ok(());
    };
    let count = pixels.iter().filter(|value| !value.is_finite()).count();
    Err(ReadError::NotFinite { path: path.to_owned(), count, pixels: pixels.len(), row, column, value })
}

/// Statistics of the finite samples of one or more pages.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Statistics {
    /// Least value.
    pub min: f32,
    /// Largest value.
    pub max: f32,
    /// How many are finite.
    pub finite: u64,
    /// How many are not.
    pub not_finite: u64,
    /// How many equal the least value.
    pub at_min: u64,
    /// How many equal the largest value.
    pub at_max: u64,
    sum: f64,
}

impl Statistics {
    /// Of nothing yet.
    pub fn new() -> Self {
        Self { min: f32::INFINITY, max: f32::NEG_INFINITY, finite: 0, not_finite: 0, at_min: 0, at_max: 0, sum: 0.0 }
    }

    /// Takes a page in.
    pub fn add(&mut self, pixels: &Array2<f32>) {
        for &value in pixels {
            if !value.is_finite() {
                self.not_finite += 1;
                continue;
            }
            self.finite += 1;
            self.sum += f64::from(value);
            if value < self.min {
                (self.min, self.at_min) = (value, 0);
            }
            if value > self.max {
                (self.max, self.at_max) = (value, 0);
            }
            self.at_min += u64::from(value == self.min);
            self.at_max += u64::from(value == self.max);
        }
    }

    /// Mean of the finite samples; NaN where there are none.
    pub fn mean(&self) -> f64 {
        self.sum / self.finite as f64
    }
}

impl Default for Statistics {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn half_floats_have_their_tabled_values() {
        // IEEE 754 binary16: one, minus two, the largest, the least normal, the least subnormal.
        let table = [(0x3c00, 1.0), (0xc000, -2.0), (0x7bff, 65504.0), (0x0400, 6.103_515_6e-5), (1, 5.960_464_5e-8)];
        for (bits, value) in table {
            assert_eq!(half_to_f32(bits), value);
        }
        assert!(half_to_f32(0x7e00).is_nan());
        assert_eq!(half_to_f32(0xfc00), f32::NEG_INFINITY);
    }

    #[test]
    fn both_byte_orders_give_the_same_numbers() {
        assert_eq!(decode(&[0x01, 0x00, 0xff, 0xff], SampleType::Int16, ByteOrder::Little), [1.0, -1.0]);
        assert_eq!(decode(&[0x00, 0x01, 0xff, 0xff], SampleType::Int16, ByteOrder::Big), [1.0, -1.0]);
        assert_eq!(decode(&[0x80, 0x7f], SampleType::Int8, ByteOrder::Little), [-128.0, 127.0]);
    }

    #[test]
    fn equal_channels_are_grey_however_they_are_laid_out() {
        let expected = array![[5.0, 6.0]];
        let interleaved = vec![5.0, 5.0, 5.0, 255.0, 6.0, 6.0, 6.0, 255.0];
        assert_eq!(grey("a", (1, 2), interleaved, Channels::Interleaved(4)).unwrap(), expected);
        let planar = vec![5.0, 6.0, 5.0, 6.0, 5.0, 6.0];
        assert_eq!(grey("a", (1, 2), planar, Channels::Planar(3)).unwrap(), expected);
        let alpha = vec![5.0, 255.0, 6.0, 254.0];
        let error = grey("a.png", (1, 2), alpha, Channels::Interleaved(2)).unwrap_err().to_string();
        assert!(error.contains("a.png") && error.contains("alpha"), "{error}");
    }

    #[test]
    fn the_first_coloured_pixel_is_named() {
        let values = vec![5.0, 5.0, 5.0, 6.0, 7.0, 6.0];
        let error = grey("a.png", (2, 1), values, Channels::Interleaved(3)).unwrap_err().to_string();
        assert!(error.contains("row 1, column 0 (6, 7, 6)"), "{error}");
    }

    #[test]
    fn statistics_leave_out_what_is_not_finite() {
        let mut statistics = Statistics::new();
        statistics.add(&array![[1.0, f32::NAN, 3.0], [3.0, f32::INFINITY, 1.0]]);
        assert_eq!((statistics.min, statistics.max, statistics.mean()), (1.0, 3.0, 2.0));
        assert_eq!((statistics.finite, statistics.not_finite), (4, 2));
        assert_eq!((statistics.at_min, statistics.at_max), (2, 2));
    }
}

//! Numbers in text files: as many digits as mean something, never NaN or infinity.

use std::fmt;

use crate::reconstruction::Frame;

/// Whole numbers below this are exact in f64.
const EXACT: f64 = 9.007e15;

/// Decimals of image positions and disparities in px: a ten-thousandth of a pixel.
pub const PX_DECIMALS: usize = 4;

/// Decimals of lengths in the unit of a result: at least a ten-thousandth of a pixel.
pub fn length_decimals(frame: &Frame) -> usize {
    let pixel_digits = frame.pixel.log10().floor();
    (PX_DECIMALS as f64 - pixel_digits).clamp(0.0, 12.0) as usize
}

/// A coordinate with a fixed number of decimals; zero has no sign.
///
/// # Panics
/// If the value is not finite: a position that is not a number must never reach a file.
pub fn fixed(value: f64, decimals: usize) -> Fixed {
    assert!(value.is_finite(), "a coordinate to be written is {value}");
    Fixed { value, decimals }
}

/// What [`fixed`] returns: prints itself without an allocation, because a result has a million numbers.
#[derive(Clone, Copy, Debug)]
pub struct Fixed {
    value: f64,
    decimals: usize,
}

impl fmt::Display for Fixed {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let power = 10_u64.pow(self.decimals as u32);
        let scaled = (self.value * power as f64).round();
        if scaled.abs() >= EXACT {
            return write!(formatter, "{:.*}", self.decimals, self.value);
        }
        let sign = if scaled < 0.0 { "-" } else { "" };
        let (whole, rest) = (scaled.abs() as u64 / power, scaled.abs() as u64 % power);
        match self.decimals {
            0 => write!(formatter, "{sign}{whole}"),
            decimals => write!(formatter, "{sign}{whole}.{rest:0decimals$}"),
        }
    }
}

/// A value rounded to so many decimals, for formats that print the shortest form (JSON).
pub fn rounded(value: f64, decimals: usize) -> f64 {
    let power = 10.0_f64.powi(decimals as i32);
    let scaled = (value * power).round();
    // Adding zero takes the sign off a negative zero.
    if scaled.abs() < EXACT { scaled / power + 0.0 } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_has_no_sign_and_small_negatives_keep_theirs() {
        let cases = [(-0.00001, 4, "0.0000"), (-0.0001, 4, "-0.0001"), (-10.0, 0, "-10"), (1.5, 1, "1.5")];
        for (value, decimals, text) in cases {
            assert_eq!(fixed(value, decimals).to_string(), text);
        }
        assert_eq!(fixed(12.03456, 4).to_string(), "12.0346");
        assert_eq!(fixed(-1e300, 0).to_string(), format!("{:.0}", -1e300));
        assert!(rounded(-0.00001, 4).is_sign_positive());
    }

    #[test]
    #[should_panic(expected = "NaN")]
    fn a_position_that_is_not_a_number_is_never_written() {
        fixed(f64::NAN, 4);
    }
}

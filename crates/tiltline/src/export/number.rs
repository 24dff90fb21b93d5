//! Numbers in text files: as many digits as mean something, never NaN or infinity.

use crate::reconstruction::Frame;

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
pub fn fixed(value: f64, decimals: usize) -> String {
    assert!(value.is_finite(), "a coordinate to be written is {value}");
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(digits) if digits.bytes().all(|byte| byte == b'0' || byte == b'.') => digits.to_owned(),
        _ => text,
    }
}

/// A value rounded to so many decimals, for formats that print the shortest form (JSON).
pub fn rounded(value: f64, decimals: usize) -> f64 {
    let text = format!("{value:.decimals$}");
    // Adding zero takes the sign off a negative zero.
    text.parse::<f64>().map_or(value, |value| value + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_has_no_sign_and_small_negatives_keep_theirs() {
        assert_eq!(fixed(-0.00001, 4), "0.0000");
        assert_eq!(fixed(-0.0001, 4), "-0.0001");
        assert_eq!(fixed(-10.0, 0), "-10");
        assert!(rounded(-0.00001, 4).is_sign_positive());
    }

    #[test]
    #[should_panic(expected = "NaN")]
    fn a_position_that_is_not_a_number_is_never_written() {
        fixed(f64::NAN, 4);
    }
}

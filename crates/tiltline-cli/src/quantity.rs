//! Quantities with units, as users write them.

use std::str::FromStr;

/// Side of a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelSize {
    /// In nm.
    pub nm: f64,
}

/// Units and their length in nm. ASCII `u` stands for micro; both Unicode micro signs and Angstrom signs are taken.
const UNITS: [(&str, f64); 10] = [
    ("nm", 1.0),
    ("pm", 1e-3),
    ("um", 1e3),
    ("\u{b5}m", 1e3),
    ("\u{3bc}m", 1e3),
    ("mm", 1e6),
    ("A", 0.1),
    ("\u{c5}", 0.1),
    ("\u{212b}", 0.1),
    ("m", 1e9),
];

/// A number with six digits that count at most, and no zeros at its end: a pixel is never known better.
pub fn short(value: f64) -> String {
    format!("{value:.5e}").parse::<f64>().map_or_else(|_| value.to_string(), |rounded| rounded.to_string())
}

impl FromStr for PixelSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let text = text.trim();
        let (number, gain) = UNITS
            .iter()
            .find_map(|(unit, gain)| text.strip_suffix(unit).map(|number| (number.trim(), *gain)))
            .ok_or_else(|| format!("'{text}' has no unit; write for example 1.2nm, 3.4A or 0.001um"))?;
        let value: f64 = number.parse().map_err(|_| format!("'{number}' is not a number"))?;
        let nm = value * gain;
        if (1e-6..1e6).contains(&nm) {
            Ok(Self { nm })
        } else {
            Err(format!("a pixel of {nm} nm is not possible; give a size between 1e-6 and 1e6 nm"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn nm(text: &str) -> Result<f64, String> {
        text.parse::<PixelSize>().map(|size| size.nm)
    }

    #[test]
    fn every_unit_means_what_it_says() {
        for (text, expected) in
            [("1.2nm", 1.2), ("12 A", 1.2), ("12\u{c5}", 1.2), ("1200pm", 1.2), ("0.0012um", 1.2), ("1.2e-9m", 1.2)]
        {
            let value = nm(text).unwrap();
            assert!((value - expected).abs() < 1e-12, "{text}: {value}");
        }
    }

    #[test]
    fn a_size_without_unit_or_sense_is_refused() {
        for text in ["1.2", "nm", "-1nm", "0nm", "NaNnm", "infnm", ""] {
            assert!(nm(text).is_err(), "{text}");
        }
    }
}

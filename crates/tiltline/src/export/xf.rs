//! IMOD's `.xf` and `.tlt`: transforms and tilts of an aligned series, a line a section ([`crate::io::xf`] for the formula).

use std::io::{self, Write};

use crate::io::xf::SectionTransform;

/// Writes transforms as IMOD does (seven decimals for the matrix, three for the shift).
///
/// # Errors
/// Where `out` cannot be written to.
pub fn write_xf(transforms: &[SectionTransform], out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    for transform in transforms {
        let [a11, a12, a21, a22, dx, dy] = transform.numbers();
        writeln!(out, "{a11:12.7}{a12:12.7}{a21:12.7}{a22:12.7}{dx:12.3}{dy:12.3}")?;
    }
    Ok(())
}

/// Writes tilts in degrees.
///
/// # Errors
/// Where `out` cannot be written to.
pub fn write_tlt(tilts_deg: &[f64], out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    for tilt in tilts_deg {
        writeln!(out, "{tilt:8.3}")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::xf::parse;

    #[test]
    fn transforms_read_back() {
        let lines = [[0.98, 0.1, -0.1, 0.98, 12.5, -300.25], [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]];
        let transforms = lines.map(SectionTransform::from_numbers);
        let mut text = Vec::new();
        write_xf(&transforms, &mut text).unwrap();
        let text = String::from_utf8(text).unwrap();
        assert_eq!(text.lines().next().unwrap().len(), 4 * 12 + 2 * 12);
        assert_eq!(parse(&text).unwrap(), transforms);
    }
}

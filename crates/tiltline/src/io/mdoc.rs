//! SerialEM's `.mdoc`: a text of `[ZValue = k]` sections with `Key = value` lines (autodoc format, IMOD documentation).
//! Tilts are in degrees, `PixelSpacing` in Angstrom.

/// What an `.mdoc` says that is used here.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mdoc {
    /// Per section its number and its tilt in degrees, in the order of the text.
    pub sections: Vec<(usize, Option<f64>)>,
    /// Side of a pixel in nm.
    pub pixel_size_nm: Option<f64>,
}

/// Whether a text has sections of that format.
pub fn is_mdoc(text: &str) -> bool {
    text.lines().any(|line| section_number(line).is_some())
}

/// Parses an `.mdoc`; a value that is no number is an error that names its line.
pub fn parse(text: &str) -> Result<Mdoc, String> {
    let mut mdoc = Mdoc::default();
    for (index, line) in text.lines().enumerate() {
        if let Some(number) = section_number(line) {
            mdoc.sections.push((number, None));
            continue;
        }
        let Some((key, value)) = line.split_once('=') else { continue };
        let key = key.trim();
        if key != "TiltAngle" && key != "PixelSpacing" {
            continue;
        }
        let value: f64 = value.trim().parse().map_err(|_| format!("line {}: {key} is no number", index + 1))?;
        match (key, mdoc.sections.last_mut()) {
            ("TiltAngle", Some((_, tilt))) => *tilt = Some(value),
            ("PixelSpacing", _) if value > 0.0 && value.is_finite() => mdoc.pixel_size_nm = Some(0.1 * value),
            _ => {}
        }
    }
    Ok(mdoc)
}

impl Mdoc {
    /// Tilts by section number, which must count from 0 without gaps.
    pub fn tilts_deg(&self) -> Result<Vec<f64>, String> {
        let mut sections = self.sections.clone();
        sections.sort_by_key(|(number, _)| *number);
        let mut tilts = Vec::new();
        for (index, (number, tilt)) in sections.iter().enumerate() {
            if *number != index {
                return Err(format!("sections do not count from 0 to {}: {number} is next", sections.len() - 1));
            }
            tilts.push(tilt.ok_or_else(|| format!("section {number} has no TiltAngle"))?);
        }
        super::tilts::check(&tilts)?;
        Ok(tilts)
    }
}

/// The k of `[ZValue = k]`, or of `[FrameSet = k]` in the files that go with single frames.
fn section_number(line: &str) -> Option<usize> {
    let (key, value) = line.trim().strip_prefix('[')?.strip_suffix(']')?.split_once('=')?;
    if !matches!(key.trim(), "ZValue" | "FrameSet") {
        return None;
    }
    value.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "PixelSpacing = 12.5\nVoltage = 300\n\n[T = SerialEM: made by hand]\n\n[ZValue = 1]\n\
                        TiltAngle = 4.01\nMagnification = 9900\n\n[ZValue = 0]\nTiltAngle = -3.99\n";

    #[test]
    fn tilts_come_in_the_order_of_sections() {
        assert!(is_mdoc(TEXT));
        let mdoc = parse(TEXT).unwrap();
        assert_eq!(mdoc.tilts_deg().unwrap(), [-3.99, 4.01]);
        assert_eq!(mdoc.pixel_size_nm, Some(1.25));
    }

    #[test]
    fn gaps_and_words_are_errors() {
        assert!(parse(&TEXT.replace("4.01", "four")).unwrap_err().contains("line 7"));
        let gap = parse(&TEXT.replace("[ZValue = 1]", "[ZValue = 2]")).unwrap();
        assert!(gap.tilts_deg().unwrap_err().contains("2 is next"));
        let missing = parse(&TEXT.replace("TiltAngle = 4.01\n", "")).unwrap();
        assert!(missing.tilts_deg().unwrap_err().contains("section 1 has no TiltAngle"));
        assert!(!is_mdoc("1.0\n2.0\n"));
    }
}

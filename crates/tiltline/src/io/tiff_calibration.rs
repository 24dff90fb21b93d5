//! Pixel size in TIFF metadata, in nm, and the tilt.
//!
//! - FEI and Thermo Fisher: private tags 34680 (SFEG), 34682 (Helios), 34683 (Titan), an ini text with `PixelWidth` in
//!   m, or XML with `<PixelSize><X unit="m" unitPrefixPower="0">`.
//! - ImageJ: `unit=` in the image description, and XResolution as px per unit.
//! - OME-XML 2016-06: `PhysicalSizeX` with `PhysicalSizeXUnit`, micrometres where no unit is given.
//! - XResolution per cm or inch: only where it is finer than any print or scan, for 72, 96 or 300 dpi say nothing about
//!   the specimen.

use std::io::{Read, Seek};

use tiff::decoder::Decoder;
use tiff::decoder::ifd::Value;
use tiff::tags::{Tag, Type, ValueBuffer};

use super::{Found, Header};

/// A pixel this large or larger, in nm, may be a print's or a scanner's; the finest scanners reach 2 um.
const PRINT_PIXEL_NM: f64 = 1000.0;
const CM_NM: f64 = 1e7;
const INCH_NM: f64 = 2.54e7;
const FEI_TAGS: [u16; 3] = [34682, 34680, 34683];

/// Whether a pixel size from a resolution per cm, inch or metre can only be that of a microscope.
pub(super) fn finer_than_print(pixel_nm: f64) -> bool {
    pixel_nm < PRINT_PIXEL_NM
}

/// The tags of a directory that may tell the pixel size.
#[derive(Debug, Default)]
pub(super) struct Metadata {
    description: String,
    /// Pixels per unit along x and y.
    resolution: Option<[f64; 2]>,
    resolution_unit: u64,
    fei: Vec<String>,
}

impl Metadata {
    /// Reads the tags of the current directory; what cannot be read is left out.
    pub(super) fn read<R: Read + Seek>(decoder: &mut Decoder<R>) -> Self {
        let [x, y] = [Tag::XResolution, Tag::YResolution].map(|tag| rational(decoder, tag));
        Self {
            description: text(decoder, Tag::ImageDescription).unwrap_or_default(),
            resolution: x.zip(y).map(|(x, y)| [x, y]),
            // The default of the specification is inch.
            resolution_unit: decoder.find_tag_unsigned(Tag::ResolutionUnit).ok().flatten().unwrap_or(2),
            fei: FEI_TAGS.iter().filter_map(|&tag| text(decoder, Tag::Unknown(tag))).collect(),
        }
    }

    /// Number of images an ImageJ description speaks of.
    pub(super) fn image_j_images(&self) -> Option<usize> {
        self.image_j("images")?.parse().ok()
    }

    /// Gives the header the first pixel size that is stated.
    pub(super) fn take_pixel_size(&self, header: &mut Header) {
        let sources = [
            ("FEI metadata", self.fei_size()),
            ("ImageJ description", self.image_j_size()),
            ("OME-XML", self.ome_size()),
            ("TIFF resolution", self.plain_size()),
        ];
        for (origin, size) in sources {
            if let (None, Some([x_nm, y_nm])) = (&header.pixel_size_nm, size) {
                header.take_pixel_size(x_nm, y_nm, origin);
            }
        }
    }

    /// Gives the header the tilt that the ImageJ description of a single image states (`tilt_deg=`, as the simulator writes
    /// it).
    pub(super) fn take_tilt(&self, header: &mut Header) {
        let tilt = self.image_j("tilt_deg").and_then(|text| text.parse::<f64>().ok());
        if let (1, Some(tilt)) = (header.pages, tilt.filter(|tilt| tilt.abs() <= 360.0)) {
            header.tilts_deg = Some(Found::new(vec![tilt], "ImageJ description"));
        }
    }

    fn fei_size(&self) -> Option<[f64; 2]> {
        self.fei
            .iter()
            .find_map(|text| if text.trim_start().starts_with('<') { xml_size(text) } else { ini_size(text) })
    }

    fn image_j(&self, key: &str) -> Option<&str> {
        let lines = self.description.starts_with("ImageJ=").then(|| self.description.lines())?;
        lines.filter_map(|line| line.split_once('=')).find(|(name, _)| *name == key).map(|(_, value)| value.trim())
    }

    fn image_j_size(&self) -> Option<[f64; 2]> {
        let unit = self.image_j("unit")?;
        let unit_nm = unit_nm(unit)?;
        let size = self.resolution?.map(|per_unit| unit_nm / per_unit);
        // ImageJ makes "inch" and "cm" of an ordinary print resolution.
        let is_microscopic = unit_nm <= 1e3 || finer_than_print(size[0]);
        is_microscopic.then_some(size)
    }

    fn ome_size(&self) -> Option<[f64; 2]> {
        let pixels = &self.description[self.description.find("<Pixels")?..];
        let size = |axis: char| {
            let value: f64 = attribute(pixels, &format!("PhysicalSize{axis}"))?.parse().ok()?;
            let unit = attribute(pixels, &format!("PhysicalSize{axis}Unit")).unwrap_or("um");
            Some(value * unit_nm(unit)?)
        };
        Some([size('X')?, size('Y')?])
    }

    fn plain_size(&self) -> Option<[f64; 2]> {
        let unit_nm = match self.resolution_unit {
            2 => INCH_NM,
            3 => CM_NM,
            _ => return None,
        };
        let size = self.resolution?.map(|per_unit| unit_nm / per_unit);
        finer_than_print(size[0]).then_some(size)
    }
}

/// A unit of length in nm; `None` for "pixel" and what is not known.
fn unit_nm(unit: &str) -> Option<f64> {
    let unit = unit.trim().trim_matches('"');
    // ImageJ writes the micro sign as the escape \u00B5; both code points of the letter are in use.
    let unit = unit.replace("\\u00B5", "u").replace("\\u00b5", "u").replace(['\u{b5}', '\u{3bc}'], "u");
    let unit = unit.replace("\\u00C5", "A").replace("\\u00c5", "A").replace(['\u{c5}', '\u{212b}'], "A");
    Some(match unit.as_str() {
        "pm" => 1e-3,
        "A" | "Angstrom" | "angstrom" => 0.1,
        "nm" | "nanometer" | "nanometre" | "nanometers" => 1.0,
        "um" | "micron" | "microns" | "micrometer" | "micrometre" => 1e3,
        "mm" => 1e6,
        "cm" => CM_NM,
        "inch" | "in" | "inches" => INCH_NM,
        "m" => 1e9,
        _ => return None,
    })
}

/// `PixelWidth` and `PixelHeight` in m of an FEI ini text: of `[Scan]`, else `[EScan]`, else the first section with it.
fn ini_size(text: &str) -> Option<[f64; 2]> {
    let mut section = "";
    let mut sizes: Vec<(&str, f64, Option<f64>)> = Vec::new();
    for line in text.lines().map(str::trim) {
        if let Some(name) = line.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
            section = name;
        } else if let Some((key, value)) = line.split_once('=') {
            match (key.trim(), value.trim().parse::<f64>(), sizes.last_mut()) {
                ("PixelWidth", Ok(width), _) => sizes.push((section, width, None)),
                ("PixelHeight", Ok(value), Some((of, _, height))) if *of == section => *height = Some(value),
                _ => {}
            }
        }
    }
    let named = |wanted: &str| sizes.iter().find(|(name, _, _)| name.eq_ignore_ascii_case(wanted));
    let (_, width, height) = named("Scan").or_else(|| named("EScan")).or(sizes.first())?;
    Some([width * 1e9, height.unwrap_or(*width) * 1e9])
}

/// `<PixelSize><X unit="m" unitPrefixPower="-9">` of Thermo Fisher's XML; without a unit it says nothing.
fn xml_size(text: &str) -> Option<[f64; 2]> {
    let (_, body) = element(text, "PixelSize").or_else(|| element(text, "pixelSize"))?;
    let size = |axis: &str| {
        let (attributes, value) = element(body, axis)?;
        let unit_nm = unit_nm(attribute(attributes, "unit")?)?;
        let power: f64 = attribute(attributes, "unitPrefixPower").unwrap_or("0").parse().ok()?;
        Some(value.trim().parse::<f64>().ok()? * 10f64.powf(power) * unit_nm)
    };
    Some([size("X")?, size("Y")?])
}

/// Attributes and content of the first element of that name.
fn element<'a>(text: &'a str, name: &str) -> Option<(&'a str, &'a str)> {
    let is_end = |rest: &str| rest.starts_with(['>', ' ', '\t', '\r', '\n']);
    let open = format!("<{name}");
    let start = text.match_indices(&open).map(|(at, _)| at + open.len()).find(|&at| is_end(&text[at..]))?;
    let (attributes, rest) = text[start..].split_once('>')?;
    let (body, _) = rest.split_once(&format!("</{name}>"))?;
    Some((attributes, body))
}

/// Value of the first attribute of that name, in double quotes.
fn attribute<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    let key = format!("{name}=\"");
    let at =
        text.match_indices(&key).map(|(at, _)| at).find(|&at| at == 0 || text[..at].ends_with(char::is_whitespace))?;
    text[at + key.len()..].split_once('"').map(|(value, _)| value)
}

/// Text of a tag: UTF-8, or else Latin-1, as older programs write the micro sign.
fn text<R: Read + Seek>(decoder: &mut Decoder<R>, tag: Tag) -> Option<String> {
    let mut buffer = ValueBuffer::empty(Type::BYTE);
    decoder.image_ifd().find_tag_buf(tag, &mut buffer).ok()??;
    let bytes = buffer.as_bytes();
    let bytes = &bytes[..bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len())];
    Some(match std::str::from_utf8(bytes) {
        Ok(text) => text.to_owned(),
        Err(_) => bytes.iter().map(|&byte| char::from(byte)).collect(),
    })
}

fn rational<R: Read + Seek>(decoder: &mut Decoder<R>, tag: Tag) -> Option<f64> {
    match decoder.find_tag(tag).ok()?? {
        Value::Rational(numerator @ 1.., denominator @ 1..) => Some(f64::from(numerator) / f64::from(denominator)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn every_spelling_of_a_micrometre_is_one() {
        for unit in ["um", "micron", "\u{b5}m", "\u{3bc}m", "\\u00B5m", " microns "] {
            assert_eq!(unit_nm(unit), Some(1e3), "{unit}");
        }
        assert_eq!(unit_nm("pixel"), None);
        assert_eq!(unit_nm(""), None);
    }

    #[test]
    fn the_scan_section_of_an_fei_text_wins() {
        let text = "[IScan]\r\nPixelWidth=5e-9\r\n[Scan]\r\nPixelWidth=1.5e-09\r\nPixelHeight=1.6e-09\r\n";
        let [x, y] = ini_size(text).unwrap();
        // One rounding of a product of doubles.
        assert_relative_eq!(x, 1.5, max_relative = 1e-15);
        assert_relative_eq!(y, 1.6, max_relative = 1e-15);
        assert_eq!(ini_size("[Scan]\nPixelWidth=\n"), None);
    }

    #[test]
    fn a_pixel_size_in_xml_needs_its_unit() {
        let text = r#"<Metadata><PixelSizes/><PixelSize><X unit="m" unitPrefixPower="-9">0.25</X>
            <Y unit="m" unitPrefixPower="-9">0.25</Y></PixelSize></Metadata>"#;
        assert_relative_eq!(xml_size(text).unwrap()[0], 0.25, max_relative = 1e-12);
        assert_eq!(xml_size(&text.replace(r#"unit="m" "#, "")), None);
    }

    #[test]
    fn dots_per_inch_are_no_pixel_size() {
        let with = |resolution, description: &str| Metadata {
            description: description.to_owned(),
            resolution: Some([resolution; 2]),
            resolution_unit: 2,
            fei: Vec::new(),
        };
        for dpi in [72.0, 96.0, 300.0, 4800.0] {
            assert_eq!(with(dpi, "").plain_size(), None);
            assert_eq!(with(dpi, "ImageJ=1.54f\nunit=inch\n").image_j_size(), None);
        }
        assert_relative_eq!(with(2.54e7, "").plain_size().unwrap()[0], 1.0, max_relative = 1e-12);
        assert_relative_eq!(with(0.8, "ImageJ=1.54f\nunit=nm\n").image_j_size().unwrap()[0], 1.25);
    }
}

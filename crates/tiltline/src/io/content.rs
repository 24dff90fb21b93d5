//! Recognises a file by its first bytes.
//!
//! Signatures: PNG specification 5.2, TIFF 6.0 section 2 and BigTIFF, and for the formats that are only named in a
//! message the registry of `file(1)`.

use std::io::{Read, Seek};

use serde::Serialize;

use super::{Input, ReadError, mrc};

/// Kind of file that can be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Format {
    /// Portable Network Graphics.
    Png,
    /// Tagged Image File Format, or BigTIFF.
    Tiff,
    /// MRC, as also named `.st`, `.ali`, `.rec`, `.map`.
    Mrc,
}

impl Format {
    /// The format's name as the user knows it.
    pub fn name(self) -> &'static str {
        match self {
            Format::Png => "PNG",
            Format::Tiff => "TIFF",
            Format::Mrc => "MRC",
        }
    }
}

/// Start of a file, offset of the signature, and what it is.
const OTHERS: &[(&[u8], usize, &str)] = &[
    (b"\xff\xd8\xff", 0, "a JPEG image, whose compression damages fine lines"),
    (b"\x89HDF\r\n\x1a\n", 0, "an HDF5 file (EMD, Velox, NeXus or similar)"),
    (b"\x00\x00\x00\x03", 0, "a Gatan DigitalMicrograph dm3 file"),
    (b"\x00\x00\x00\x04", 0, "a Gatan DigitalMicrograph dm4 file"),
    (b"II\x97\x01", 0, "a TIA series file (SER or EMI)"),
    (b"\x93NUMPY", 0, "a NumPy array"),
    (b"GIF8", 0, "a GIF image"),
    (b"BM", 0, "a BMP image"),
    (b"RIFF", 0, "a RIFF file (WebP or similar)"),
    (b"\x00\x00\x00\x0cjP  ", 0, "a JPEG 2000 image"),
    (b"%PDF", 0, "a PDF document"),
    (b"PK\x03\x04", 0, "a ZIP archive: unpack it first"),
    (b"\x1f\x8b", 0, "a gzip archive: unpack it first"),
    (b"BZh", 0, "a bzip2 archive: unpack it first"),
    (b"\xfd7zXZ\x00", 0, "an xz archive: unpack it first"),
    (b"7z\xbc\xaf\x27\x1c", 0, "a 7z archive: unpack it first"),
    (b"\x28\xb5\x2f\xfd", 0, "a zstd archive: unpack it first"),
    (b"ustar", 257, "a tar archive: unpack it first"),
    (b"P2", 0, "a PGM image"),
    (b"P5", 0, "a PGM image"),
    (b"<?xml", 0, "an XML text"),
    (b"<!DOCTYPE", 0, "a web page: the download may have failed"),
    (b"<html", 0, "a web page: the download may have failed"),
];

/// Finds the format, or says what the file really is.
pub(super) fn recognise<R: Read + Seek>(input: &mut Input<R>) -> Result<Format, ReadError> {
    let start = input.bytes_at(0, 1024)?;
    if start.starts_with(b"\x89PNG\r\n\x1a\n") {
        return Ok(Format::Png);
    }
    if [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"].iter().any(|magic| start.starts_with(*magic)) {
        return Ok(Format::Tiff);
    }
    if mrc::looks_like_mrc(&start, input.length) {
        return Ok(Format::Mrc);
    }
    // A PNG that went through a text-mode transfer keeps its letters and loses the line ends around them.
    if start.get(1..4) == Some(b"PNG") {
        let what = "its signature was changed, as by a transfer in text mode".to_owned();
        return Err(ReadError::Corrupt { path: input.path.clone(), format: "PNG", what });
    }
    let path = input.path.clone();
    let other = OTHERS.iter().find(|(magic, offset, _)| start[(*offset).min(start.len())..].starts_with(magic));
    if let Some((_, _, found)) = other {
        return Err(ReadError::OtherFormat { path, found });
    }
    let is_text = start.iter().all(|byte| matches!(byte, b'\t' | b'\n' | b'\r' | b' '..=b'~'));
    if is_text {
        return Err(ReadError::OtherFormat { path, found: "a plain text" });
    }
    let start = start.iter().take(8).map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ");
    Err(ReadError::Unrecognised { path, length: input.length, start })
}

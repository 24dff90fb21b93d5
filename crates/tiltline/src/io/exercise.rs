//! What the fuzz targets and the property tests run: each reader on arbitrary bytes.
//!
//! A body returns or fails with an assertion; errors of the readers are as good as images. Asserted is what callers
//! rely on: shapes, one tilt a page, usable pixel sizes, and that no page is larger than its file can hold.

use super::{Input, MrcRows, Pages, ReadError, mdoc, mrc, png, tiff, tilts};

/// Pages that are read of a file; a hostile one may promise a million.
const PAGES: usize = 4;
/// Most pixels a byte can stand for: deflate's 1032 bytes, of 8 pixels each in a PNG of one bit; LZW's 2731 are fewer.
const PIXELS_A_BYTE: usize = 1032 * 8;

/// The PNG reader.
pub fn png(bytes: &[u8]) {
    pages(bytes, png::PngFile::open(Input::in_memory("fuzzed", bytes)));
}

/// The TIFF reader: directories, metadata, pages.
pub fn tiff(bytes: &[u8]) {
    pages(bytes, tiff::TiffFile::open(Input::in_memory("fuzzed", bytes)));
}

/// The MRC reader in both row orders: headers and sections.
pub fn mrc(bytes: &[u8]) {
    for rows in [MrcRows::BottomUp, MrcRows::TopDown] {
        pages(bytes, mrc::MrcFile::open(Input::in_memory("fuzzed", bytes), rows));
    }
}

/// The texts of tilts: the argument's forms, and one number a line.
pub fn tilts(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let results =
        [tilts::parse_argument(&text).unwrap_or_else(|| Err("no numbers".to_owned())), tilts::parse_lines(&text)];
    for list in results.into_iter().flatten() {
        assert!(!list.is_empty() && list.iter().all(|tilt| tilt.abs() <= 180.0), "tilts are some, and angles");
    }
}

/// The `.mdoc` parser.
pub fn mdoc(bytes: &[u8]) {
    let Ok(mdoc) = mdoc::parse(&String::from_utf8_lossy(bytes)) else { return };
    if let Ok(list) = mdoc.tilts_deg() {
        assert_eq!(list.len(), mdoc.sections.len(), "one tilt a section");
    }
}

fn pages<P: Pages>(bytes: &[u8], file: Result<P, ReadError>) {
    let Ok(mut file) = file else { return };
    let header = file.header().clone();
    assert!(header.pages > 0 && header.rows > 0 && header.columns > 0, "a header that opens has an image");
    if let Some(tilts) = header.tilts_deg {
        assert_eq!(tilts.value.len(), header.pages, "one tilt a page");
    }
    if let Some(size) = header.pixel_size_nm {
        assert!(size.value.is_finite() && size.value > 0.0, "a pixel size is a length");
    }
    for page in (0..header.pages.min(PAGES)).chain([header.pages - 1]) {
        if let Ok(pixels) = file.read_page(page) {
            assert!(pixels.len() <= bytes.len() * PIXELS_A_BYTE, "a page is no larger than its file can hold");
            assert!(pixels.is_standard_layout(), "rows lie in memory from top to bottom");
        }
    }
    assert!(file.read_page(header.pages).is_err(), "there is no page after the last");
}

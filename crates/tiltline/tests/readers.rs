//! The readers against files made by independent writers (`data/make.py`: Pillow, libtiff, tifffile, mrcfile), and
//! against files that are wrong in every way we could think of.
// clippy.toml allows these in `#[test]` functions, not in what they call; a skipped test says so.
#![allow(clippy::unwrap_used, clippy::print_stderr)]

use std::path::{Path, PathBuf};

use ndarray::Array2;
use tempfile::TempDir;
use tiltline::io::{self, ByteOrder, Format, MrcRows, ReadError, ReadOptions, SampleType, info, read_micrograph};

fn data(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name);
    path.to_str().unwrap().to_owned()
}

/// The pixels `make.py` wrote: 3 column + 11 row + 5 page, less 40 for signed types.
fn ramp(offset: f32, page: usize) -> Array2<f32> {
    Array2::from_shape_fn((6, 7), |(row, column)| (3 * column + 11 * row + 5 * page) as f32 + offset)
}

fn unsigned(page: usize) -> Array2<f32> {
    ramp(0.0, page)
}

fn signed(page: usize) -> Array2<f32> {
    ramp(-40.0, page)
}

/// An MRC file's rows lie bottom-up; `make.py` gives the array in the order of the file.
fn flipped(mut pixels: Array2<f32>) -> Array2<f32> {
    pixels.invert_axis(ndarray::Axis(0));
    pixels
}

fn pixels(name: &str) -> Array2<f32> {
    read_micrograph(&data(name)).unwrap().pixels
}

fn error_of(spec: &str) -> ReadError {
    read_micrograph(spec).unwrap_err()
}

/// The message of the error, which must name the file.
fn message(spec: &str) -> String {
    let text = error_of(spec).to_string();
    let path = spec.rsplit_once('#').map_or(spec, |(path, _)| path);
    assert!(text.contains(path), "the message does not name the file: {text}");
    text
}

struct Scratch(TempDir);

impl Scratch {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, bytes: &[u8]) -> String {
        std::fs::write(self.path(name), bytes).unwrap();
        self.path(name).to_str().unwrap().to_owned()
    }

    fn copy(&self, from: &str, name: &str) -> String {
        self.write(name, &std::fs::read(data(from)).unwrap())
    }
}

#[test]
fn png_pixels_are_what_pillow_wrote() {
    for name in ["grey8.png", "grey_alpha.png", "rgb_grey.png", "palette.png", "phys_5nm.png"] {
        assert_eq!(pixels(name), unsigned(0), "{name}");
    }
    assert_eq!(pixels("grey16.png"), unsigned(0) * 100.0);
    // One bit is spread over the 8-bit range.
    assert_eq!(pixels("bits1.png"), Array2::from_shape_fn((6, 7), |(_, column)| (255 * (column % 2)) as f32));
}

#[test]
fn tiff_pixels_are_what_tifffile_and_libtiff_wrote() {
    for name in ["u1", "u2", "u4", "bigtiff", "strips_lzw", "packbits", "rgb_grey", "rgb_planar", "dpi300", "ome"] {
        assert_eq!(pixels(&format!("{name}.tif")), unsigned(0), "{name}");
    }
    for name in ["i1", "i2", "i4", "f2", "f4", "f8", "big_endian", "strips_deflate", "float_predictor"] {
        assert_eq!(pixels(&format!("{name}.tif")), signed(0), "{name}");
    }
    assert_eq!(pixels("white_is_zero.tif"), 255.0 - unsigned(0));
}

#[test]
fn tiles_are_put_together() {
    let repeated = |one: Array2<f32>| Array2::from_shape_fn((18, 21), |(row, column)| one[[row % 6, column % 7]]);
    assert_eq!(pixels("tiles.tif"), repeated(unsigned(0)));
    assert_eq!(pixels("tiles_deflate.tif"), repeated(signed(0)));
}

#[test]
fn mrc_pixels_are_what_mrcfile_wrote_upside_down() {
    for name in ["mode0.mrc", "mode2.mrc", "mode12.mrc", "placeholder.mrc", "imod_signed.mrc"] {
        assert_eq!(pixels(name), flipped(signed(0)), "{name}");
    }
    assert_eq!(pixels("mode6.mrc"), flipped(unsigned(0)));
    // 150 to 223: negative if bytes were taken as signed.
    assert_eq!(pixels("imod_bytes.mrc"), flipped(unsigned(30)));
    let top_down = ReadOptions { mrc_rows: MrcRows::TopDown };
    assert_eq!(io::read_micrograph_with(&data("mode2.mrc"), &top_down).unwrap().micrograph.pixels, signed(0));
}

#[test]
fn pages_are_chosen_from_zero() {
    for page in 0..3 {
        assert_eq!(pixels(&format!("pages.tif#{page}")), signed(page));
        assert_eq!(pixels(&format!("mode1.mrc#{page}")), flipped(signed(page)));
    }
    for page in 0..4 {
        assert_eq!(pixels(&format!("imagej_stack.tif#{page}")), unsigned(page));
        assert_eq!(pixels(&format!("imagej_one_directory.tif#{page}")), unsigned(page));
    }
    assert_eq!(pixels("grey8.png#0"), unsigned(0));
    let text = message(&data("pages.tif"));
    assert!(text.contains("3 pages") && text.contains("pages.tif#0") && text.contains("pages.tif#2"), "{text}");
    assert!(matches!(error_of(&data("mode1.mrc#3")), ReadError::NoSuchPage { page: 3, pages: 3, .. }));
    assert!(matches!(error_of(&data("grey8.png#1")), ReadError::NoSuchPage { page: 1, pages: 1, .. }));
    assert!(message(&data("pages.tif#last")).contains("\"last\""));
}

#[test]
fn a_file_named_with_a_hash_opens_under_its_own_name() {
    let scratch = Scratch::new();
    let odd = scratch.copy("grey8.png", "frame#2");
    let micrograph = read_micrograph(&odd).unwrap();
    assert_eq!(micrograph.pixels, unsigned(0));
    assert_eq!(micrograph.source.path, odd);
    assert_eq!(read_micrograph(&format!("{odd}#0")).unwrap().pixels, unsigned(0));
}

#[test]
fn a_wrong_name_does_not_matter() {
    let scratch = Scratch::new();
    assert_eq!(read_micrograph(&scratch.copy("u2.tif", "image.png")).unwrap().pixels, unsigned(0));
    assert_eq!(read_micrograph(&scratch.copy("mode6.mrc", "image.tif")).unwrap().pixels, flipped(unsigned(0)));
    for (bytes, word) in [
        (&b"\xff\xd8\xff\xe0\0\x10JFIF"[..], "JPEG"),
        (b"\x89HDF\r\n\x1a\n", "HDF5"),
        (b"\0\0\0\x04\0\0\0\0", "dm4"),
        (b"PK\x03\x04", "ZIP"),
        (b"<html><body>404</body></html>", "web page"),
        (b"-4.0\n4.0\n", "plain text"),
    ] {
        let text = message(&scratch.write("image.tif", bytes));
        assert!(text.contains(word) && text.contains("PNG, TIFF and MRC"), "{text}");
    }
    assert!(message(&scratch.write("image.mrc", &[0xaa; 2000])).contains("2000 bytes, the first are aa aa"));
}

/// The SHA-256 of the file, from `sha256sum`.
#[test]
fn the_source_is_recorded() {
    let spec = data("u1.tif");
    let source = read_micrograph(&spec).unwrap().source;
    assert_eq!(source.path, spec);
    assert_eq!(source.sha256, "65ae89a137a098dfdaf20475f96830b40b1205237d283effa915ff305f380278");
}

#[test]
fn pixel_sizes_come_with_their_place() {
    for (name, size_nm, place) in [
        ("imagej_um.tif", 1.25, "ImageJ"),
        ("imagej_stack.tif#1", 4.0, "ImageJ"),
        ("fei_helios.tif", 1.25, "FEI"),
        ("fei_xml.tif", 0.75, "FEI"),
        ("ome.tif", 3.0, "OME"),
        ("resolution_2nm.tif", 2.0, "TIFF resolution"),
        ("phys_5nm.png", 5.0, "pHYs"),
        ("mode2.mrc", 1.25, "MRC header"),
        ("fei1.mrc#0", 2.5, "FEI extended header"),
        ("old_fei.st#1", 3.36, "FEI extended header"),
        ("old_big_endian.st#1", 3.36, "FEI extended header"),
    ] {
        let reading = io::read_micrograph_with(&data(name), &ReadOptions::default()).unwrap();
        let found = reading.pixel_size_nm.unwrap_or_else(|| panic!("{name} states a pixel size"));
        // MRC and old FEI headers hold f32, TIFF resolutions are ratios of 32-bit integers.
        approx::assert_relative_eq!(found.value, size_nm, max_relative = 1e-6);
        assert!(found.origin.contains(place), "{name}: {}", found.origin);
        assert_eq!(reading.micrograph.pixel_size_nm, Some(found.value));
    }
}

#[test]
fn what_is_no_pixel_size_is_not_taken_for_one() {
    for name in ["dpi300.tif", "u1.tif", "grey8.png", "placeholder.mrc", "serialem.st#0"] {
        assert_eq!(read_micrograph(&data(name)).unwrap().pixel_size_nm, None, "{name}");
    }
    assert!(info(&data("placeholder.mrc")).unwrap().warnings.iter().any(|text| text.contains("exactly 1 A")));
}

#[test]
fn tilts_come_from_extended_headers() {
    for (name, tilts) in [
        ("fei1.mrc", &[-10.0, 0.0, 10.0][..]),
        ("old_fei.st", &[-2.0, 2.0]),
        ("old_big_endian.st", &[-2.0, 2.0]),
        ("serialem.st", &[-60.0, 60.01]),
    ] {
        assert_eq!(info(&data(name)).unwrap().tilts_deg.as_deref(), Some(tilts), "{name}");
        let last = format!("{}#{}", data(name), tilts.len() - 1);
        let tilt_rad = read_micrograph(&last).unwrap().tilt_rad.unwrap();
        assert_eq!(tilt_rad, tilts[tilts.len() - 1].to_radians());
    }
    assert_eq!(info(&data("mode1.mrc")).unwrap().tilts_deg, None);
}

#[test]
fn tilts_beside_a_file_are_used_in_their_order() {
    let scratch = Scratch::new();
    let stack = scratch.copy("fei1.mrc", "series.mrc");
    let tilts = |expected: [f64; 3], place: &str| {
        let info = info(&stack).unwrap();
        assert_eq!(info.tilts_deg.as_deref(), Some(&expected[..]));
        assert_eq!(info.tilts_from.as_deref(), Some(place));
    };
    tilts([-10.0, 0.0, 10.0], "FEI extended header");
    let section = |k: usize, tilt: i32| format!("[ZValue = {k}]\nTiltAngle = {tilt}\n");
    let mdoc = [section(0, -9), section(1, 1), section(2, 9)].concat();
    scratch.write("series.mrc.mdoc", mdoc.as_bytes());
    tilts([-9.0, 1.0, 9.0], "series.mrc.mdoc");
    scratch.write("series.rawtlt", b"-8\n0\n8\n");
    tilts([-8.0, 0.0, 8.0], "series.rawtlt");
    scratch.write("series.tlt", b" -8.11\n 0.02\n 8.13\n");
    tilts([-8.11, 0.02, 8.13], "series.tlt");
    // One too few: passed over, and said.
    scratch.write("series.tlt", b"-8\n0\n");
    tilts([-8.0, 0.0, 8.0], "series.rawtlt");
    let warnings = info(&stack).unwrap().warnings;
    assert!(
        warnings.iter().any(|text| text.contains("series.tlt") && text.contains("2 tilt(s) for 3")),
        "{warnings:?}"
    );
}

#[test]
fn an_mdoc_gives_the_pixel_size_that_the_header_lacks() {
    let scratch = Scratch::new();
    let stack = scratch.copy("placeholder.mrc", "one.mrc");
    scratch.write("one.mrc.mdoc", b"PixelSpacing = 22.5\n[ZValue = 0]\nTiltAngle = 12\n");
    let info = info(&stack).unwrap();
    assert_eq!((info.pixel_size_nm, info.pixel_size_from.as_deref()), (Some(2.25), Some("one.mrc.mdoc")));
    assert_eq!(info.tilts_deg, Some(vec![12.0]));
}

#[test]
fn info_tells_what_is_in_a_file() {
    let found = info(&data("old_big_endian.st")).unwrap();
    assert_eq!((found.columns, found.rows, found.pages), (7, 6, 2));
    assert_eq!((found.format, found.sample_type, found.byte_order), (Format::Mrc, SampleType::Int16, ByteOrder::Big));
    let intensities = found.intensities.unwrap();
    // -40 on page 0; 3 * 6 + 11 * 5 + 5 - 40 on page 1; the mean of a ramp is that of its ends.
    assert_eq!((intensities.min, intensities.max, intensities.pages_measured), (-40.0, 38.0, 2));
    approx::assert_relative_eq!(intensities.mean, 3.0 * 3.0 + 11.0 * 2.5 + 2.5 - 40.0);
    assert!(found.warnings.iter().any(|text| text.contains("old-style header")));
    let page = info(&data("old_big_endian.st#1")).unwrap().intensities.unwrap();
    assert_eq!((page.min, page.first_page, page.pages_measured), (-35.0, 1, 1));
    let json = serde_json::to_value(&found).unwrap();
    assert_eq!(json["format"], "mrc");
    assert_eq!(json["sample_type"], "int16");
}

#[test]
fn info_doubts_constant_and_clipped_images_and_counts_nan() {
    let scratch = Scratch::new();
    let zeros = |kind: &[u8]| {
        let mut bytes = std::fs::read(data("mode6.mrc")).unwrap();
        bytes.truncate(1024);
        bytes.extend_from_slice(kind);
        scratch.write("image.mrc", &bytes)
    };
    let warnings = info(&zeros(&[0; 84])).unwrap().warnings;
    assert!(warnings.iter().any(|text| text.contains("constant: every pixel is 0")), "{warnings:?}");
    let mut half = [0; 84];
    half[42..].iter_mut().enumerate().for_each(|(index, byte)| *byte = index as u8);
    let warnings = info(&zeros(&half)).unwrap().warnings;
    assert!(warnings.iter().any(|text| text.contains("50.0 %") && text.contains("least value 0")), "{warnings:?}");
    let warnings = info(&data("nan.tif")).unwrap().warnings;
    assert!(warnings.iter().any(|text| text.contains("2 of 42 pixels are NaN or infinite")), "{warnings:?}");
}

#[test]
fn nan_is_refused_with_its_place() {
    let text = message(&data("nan.tif"));
    assert!(text.contains("2 of 42") && text.contains("NaN") && text.contains("row 2, column 3"), "{text}");
}

#[test]
fn colour_and_complex_data_are_refused() {
    assert!(
        message(&data("rgb_colour.png")).contains("red, green and blue differ, first at row 0, column 0 (0, 0, 1)")
    );
    assert!(message(&data("rgb_colour.tif")).contains("red, green and blue differ"));
    assert!(message(&data("mode16.mrc")).contains("RGB"));
    assert!(matches!(error_of(&data("complex.tif")), ReadError::Complex { .. }));
    assert!(matches!(error_of(&data("mode4.mrc")), ReadError::Complex { .. }));
}

#[test]
fn missing_empty_and_folders_are_said() {
    let scratch = Scratch::new();
    assert!(message(scratch.path("none.tif").to_str().unwrap()).contains("no such file"));
    assert!(message(&format!("{}#3", scratch.path("none.tif").display())).contains("no such file"));
    assert!(message(&scratch.write("empty.tif", b"")).contains("empty (0 bytes)"));
    assert!(message(scratch.path("").to_str().unwrap()).contains("folder"));
}

/// Cut anywhere, a file is an error that names it, and never an image.
#[test]
fn truncated_files_are_errors_wherever_they_are_cut() {
    let scratch = Scratch::new();
    for name in ["grey16.png", "u2.tif", "strips_lzw.tif", "strips_deflate.tif", "mode6.mrc", "old_fei.st"] {
        let whole = std::fs::read(data(name)).unwrap();
        let page = if name.ends_with(".st") { "#0" } else { "" };
        // The end chunk of a PNG (12 bytes) holds nothing of the image, and its check sums are 4 bytes.
        let end = if name.ends_with(".png") { whole.len() - 17 } else { whole.len() };
        for length in (1..end).step_by(7) {
            let cut = scratch.write("cut", &whole[..length]);
            message(&format!("{cut}{page}"));
        }
    }
    let whole = std::fs::read(data("mode1.mrc")).unwrap();
    let text = message(&format!("{}#0", scratch.write("cut.mrc", &whole[..1024 + 100])));
    assert!(text.contains("1276 bytes") && text.contains("1124") && text.contains("1 are complete"), "{text}");
}

#[test]
fn a_longer_file_than_its_header_says_is_a_warning() {
    let scratch = Scratch::new();
    let mut bytes = std::fs::read(data("mode6.mrc")).unwrap();
    bytes.extend_from_slice(&[0; 10]);
    let path = scratch.write("long.mrc", &bytes);
    let reading = io::read_micrograph_with(&path, &ReadOptions::default()).unwrap();
    assert_eq!(reading.micrograph.pixels, flipped(unsigned(0)));
    assert!(reading.warnings.iter().any(|warning| warning.message.contains("10 bytes longer")));
}

/// Headers that promise what no file of that length can hold: refused before memory is asked for.
#[test]
fn promises_beyond_the_file_or_the_limits_are_refused() {
    let scratch = Scratch::new();
    let patched = |name: &str, patches: &[(usize, &[u8])]| {
        let mut bytes = std::fs::read(data(name)).unwrap();
        for (offset, patch) in patches {
            bytes[*offset..offset + patch.len()].copy_from_slice(patch);
        }
        scratch.write("patched", &bytes)
    };
    let side = |value: u32| value.to_le_bytes();
    let large = patched("mode6.mrc", &[(0, &side(40_000)), (4, &side(40_000))]);
    assert!(matches!(error_of(&large), ReadError::Truncated { needed: 3_200_001_024, held: 1108, .. }));
    let larger = patched("mode6.mrc", &[(0, &side(1 << 20)), (4, &side(1 << 20))]);
    assert!(matches!(error_of(&larger), ReadError::TooLarge { columns: 1_048_576, rows: 1_048_576, .. }));
    let extended = patched("mode6.mrc", &[(92, &side(i32::MAX as u32))]);
    assert!(matches!(error_of(&extended), ReadError::Truncated { held: 1108, .. }));
    let negative = patched("mode6.mrc", &[(92, &side(u32::MAX))]);
    assert!(message(&negative).contains("-1 bytes"));
    let nonsense = patched("mode6.mrc", &[(12, &side(77))]);
    assert!(message(&nonsense).contains("mode 77"));

    // Width, height and rows of a strip of u2.tif: one strip that is far too short.
    let u2 = std::fs::read(data("u2.tif")).unwrap();
    let [width, height, strip] = [256, 257, 278].map(|tag| tiff_value(&u2, tag));
    let tall = |pixels| patched("u2.tif", &[(width, &side(pixels)), (height, &side(pixels)), (strip, &side(pixels))]);
    let error = error_of(&tall(30_000));
    assert!(matches!(error, ReadError::Truncated { needed: 1_800_000_000, held: 84, .. }), "{error}");
    let error = error_of(&tall(60_000));
    assert!(matches!(error, ReadError::TooLarge { columns: 60_000, rows: 60_000, .. }), "{error}");

    // A PNG header with its check sum: 100000 x 20000 px are 2e9, within the limit, and not in 100 bytes.
    let mut png = std::fs::read(data("grey8.png")).unwrap();
    for (sides, is_too_large) in [([100_000u32, 20_000], false), ([200_000, 200_000], true)] {
        png[16..20].copy_from_slice(&sides[0].to_be_bytes());
        png[20..24].copy_from_slice(&sides[1].to_be_bytes());
        let sum = crc32(&png[12..29]);
        png[29..33].copy_from_slice(&sum.to_be_bytes());
        let error = error_of(&scratch.write("large.png", &png));
        assert_eq!(matches!(error, ReadError::TooLarge { .. }), is_too_large, "{error}");
        assert_eq!(matches!(error, ReadError::Truncated { .. }), !is_too_large, "{error}");
    }
}

/// Offset of the value of a tag in the first directory of a little-endian TIFF (TIFF 6.0, section 2).
fn tiff_value(bytes: &[u8], tag: u16) -> usize {
    let short = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
    let directory = usize::from(short(4));
    let entries = (0..usize::from(short(directory))).map(|index| directory + 2 + 12 * index);
    entries.into_iter().find(|&entry| short(entry) == tag).unwrap() + 8
}

/// The check sum of PNG chunks (ISO 3309).
fn crc32(bytes: &[u8]) -> u32 {
    let step = |sum: u32, _: u32| if sum & 1 == 1 { sum >> 1 ^ 0xedb8_8320 } else { sum >> 1 };
    !bytes.iter().fold(!0, |sum, &byte| (0..8).fold(sum ^ u32::from(byte), step))
}

#[test]
fn tilts_are_read_from_files() {
    let scratch = Scratch::new();
    let list = scratch.write("a.rawtlt", b" -76.00\n -74.00\n");
    assert_eq!(io::parse_tilts(&list).unwrap(), [-76.0, -74.0]);
    let mdoc = scratch.write("a.mdoc", b"[ZValue = 0]\nTiltAngle = 1.5\n");
    assert_eq!(io::parse_tilts(&mdoc).unwrap(), [1.5]);
    let image = data("u1.tif");
    assert!(io::parse_tilts(&image).unwrap_err().to_string().contains("no text"));
    let empty = scratch.write("b.tlt", b"\n\n");
    assert!(io::parse_tilts(&empty).unwrap_err().to_string().contains("no tilts"));
}

/// A real tilt series (NIST), old header without MAP stamp, where the shared data are.
#[test]
fn a_real_tilt_series_reads() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let shared = std::env::var_os("TILTLINE_SHARED").map_or_else(|| root.join("../shared"), PathBuf::from);
    let series = shared.join("data/tilt-series/HAADF.mrc");
    let Some(series) = series.to_str().filter(|_| series.exists()) else {
        eprintln!("skipped: {} is absent (set TILTLINE_SHARED)", series.display());
        return;
    };
    let found = info(series).unwrap();
    assert_eq!((found.columns, found.rows, found.pages, found.sample_type), (256, 256, 77, SampleType::Int16));
    let tilts: Vec<f64> = (0..77).map(|index| -76.0 + 2.0 * f64::from(index)).collect();
    assert_eq!(found.tilts_deg, Some(tilts));
    assert_eq!(found.tilts_from.as_deref(), Some("HAADF.rawtlt"));
    approx::assert_relative_eq!(found.pixel_size_nm.unwrap(), 3.36, max_relative = 1e-6);
    let intensities = found.intensities.unwrap();
    assert_eq!((intensities.min, intensities.max), (-31908.0, 32325.0));
    let middle = read_micrograph(&format!("{series}#38")).unwrap();
    assert_eq!(middle.tilt_rad, Some(0.0));
}

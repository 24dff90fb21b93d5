//! Readers of micrographs and tilt series: one file a format, its specification named at the top.
//!
//! The format is recognised by content, never by the file's name. An image is asked for as `path`, or as `path#k`
//! for page or section k of a file that holds several; k counts from 0, as sections do in MRC and IMOD. What a header
//! promises is held against the length of the file, and against a limit, before memory is asked for.
//!
//! Pixel size and tilt are taken where a file states them, with the place they were found at, and are unknown
//! otherwise: a print resolution such as 72 dpi is not a pixel size.

mod beside;
mod content;
mod error;
#[doc(hidden)]
pub mod exercise;
mod header;
mod info;
mod input;
pub mod mdoc;
pub mod mrc;
mod mrc_extended;
pub mod png;
mod samples;
pub mod tiff;
mod tiff_calibration;
pub mod tilts;
pub mod xf;

use ndarray::Array2;
use serde::{Deserialize, Serialize};

pub use content::Format;
pub use error::ReadError;
pub use header::{ByteOrder, Found, Header, SampleType};
pub use info::{FileInfo, Intensities, info};
pub use input::Input;
pub(crate) use samples::require_finite;
pub use tilts::parse_tilts;

use crate::micrograph::{Micrograph, Source};
use crate::progress::Stage;
use crate::warning::Warning;

/// Most pixels a page may have: 2^31, a square of 46340 px (8 GiB once they are f32).
pub const MAX_PIXELS: u64 = 1 << 31;

/// Most bytes a page may take while it is decoded: 16 GiB.
pub const MAX_BYTES: u64 = 1 << 34;

/// How files are read where a format leaves a choice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReadOptions {
    /// Order of the rows in MRC files.
    pub mrc_rows: MrcRows,
}

/// Order of the rows in an MRC file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MrcRows {
    /// The first row stored is the bottom of the image, as the format has it: rows are flipped on reading.
    #[default]
    BottomUp,
    /// The first row stored is the top of the image, as some programs write it.
    TopDown,
}

/// A file of images whose header was read: what each format's reader offers.
pub trait Pages: std::fmt::Debug {
    /// What the header says.
    fn header(&self) -> &Header;

    /// The header, for what is found elsewhere.
    fn header_mut(&mut self) -> &mut Header;

    /// Reads one page, counted from 0, as `[row, column]` with row 0 at the top; values may be NaN or infinite.
    ///
    /// Fails where there is no such page, where the file does not hold what the header promises, and where the page
    /// is no grey image.
    fn read_page(&mut self, page: usize) -> Result<Array2<f32>, ReadError>;
}

/// A micrograph with what is known about where its numbers came from.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// The micrograph; its pixel size and tilt are the values below.
    pub micrograph: Micrograph,
    /// Side of a pixel in nm, if the file states it.
    pub pixel_size_nm: Option<Found<f64>>,
    /// Tilt of the specimen in degrees, if the file or one beside it states it.
    pub tilt_deg: Option<Found<f64>>,
    /// What the user should know about the file.
    pub warnings: Vec<Warning>,
}

/// Reads one micrograph, given as `path` or `path#k` with page k counted from 0.
///
/// A file that is itself named with `#` opens under its own name. A file of several pages needs `#k`. Pixels are all
/// finite in what is returned: NaN or infinity is an error that says how many there are.
///
/// ```no_run
/// let left = tiltline::io::read_micrograph("series.mrc#36")?;
/// println!("{} x {} px, {:?} nm/px", left.width(), left.height(), left.pixel_size_nm);
/// # Ok::<(), tiltline::io::ReadError>(())
/// ```
pub fn read_micrograph(spec: &str) -> Result<Micrograph, ReadError> {
    Ok(read_micrograph_with(spec, &ReadOptions::default())?.micrograph)
}

/// [`read_micrograph`] with options, and with where pixel size and tilt came from.
pub fn read_micrograph_with(spec: &str, options: &ReadOptions) -> Result<Reading, ReadError> {
    let (path, chosen) = input::split_spec(spec)?;
    let mut file = open(&path, options)?;
    let page = choose_page(file.header(), &path, chosen)?;
    let pixels = file.read_page(page)?;
    require_finite(spec, &pixels)?;
    let source = Source { path: spec.to_owned(), sha256: input::sha256(&path)? };
    let Header { pixel_size_nm, tilts_deg, notes, .. } = file.header().clone();
    let tilt_deg = tilts_deg.map(|found| Found { value: found.value[page], origin: found.origin });
    let warnings = notes.into_iter().map(|note| Warning::new(Stage::Read, format!("{path}: {note}"))).collect();
    let micrograph = Micrograph {
        pixels,
        pixel_size_nm: pixel_size_nm.as_ref().map(|found| found.value),
        tilt_rad: tilt_deg.as_ref().map(|found| found.value.to_radians()),
        source,
    };
    Ok(Reading { micrograph, pixel_size_nm, tilt_deg, warnings })
}

/// Opens a file of images by its content, and looks for tilts beside it.
///
/// The tilts of the header, where there are any, are one a page.
pub fn open(path: &str, options: &ReadOptions) -> Result<Box<dyn Pages>, ReadError> {
    let mut input = Input::open(path)?;
    let format = content::recognise(&mut input)?;
    let mut file: Box<dyn Pages> = match format {
        Format::Png => Box::new(png::PngFile::open(input)?),
        Format::Tiff => Box::new(tiff::TiffFile::open(input)?),
        Format::Mrc => Box::new(mrc::MrcFile::open(input, options.mrc_rows)?),
    };
    beside::look(path, file.header_mut());
    Ok(file)
}

fn choose_page(header: &Header, path: &str, chosen: Option<usize>) -> Result<usize, ReadError> {
    let pages = header.pages;
    match chosen {
        Some(page) if page < pages => Ok(page),
        Some(page) => Err(ReadError::NoSuchPage { path: path.to_owned(), page, pages }),
        None if pages == 1 => Ok(0),
        None => Err(ReadError::ManyPages { path: path.to_owned(), pages }),
    }
}

//! Why a file could not be read: every message names the file, the values and what to do.

use super::{MAX_BYTES, MAX_PIXELS};

/// Why a micrograph, a tilt series or a list of tilts could not be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// There is nothing under that name.
    #[error("{path}: no such file; check the name (a page of a stack is chosen as FILE#0)")]
    Missing {
        /// The path as given.
        path: String,
    },
    /// The operating system refused.
    #[error("{path}: cannot be read: {source}")]
    Io {
        /// The path as given.
        path: String,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// The path leads to a folder or a device.
    #[error("{path} is a {what}, not a file; name one image file in it or beside it")]
    NotAFile {
        /// The path as given.
        path: String,
        /// "folder" or "device".
        what: &'static str,
    },
    /// The file has no bytes.
    #[error("{path} is empty (0 bytes); copy or export it again")]
    Empty {
        /// The path as given.
        path: String,
    },
    /// What follows `#` is no page number.
    #[error("{spec}: {page:?} after # is not a page number; pages count from 0, as in FILE#0")]
    BadPage {
        /// What was given.
        spec: String,
        /// The part after `#`.
        page: String,
    },
    /// The content is of a known kind that is not read.
    #[error("{path} is {found}; Tiltline reads PNG, TIFF and MRC: export or convert it to one of them")]
    OtherFormat {
        /// The path as given.
        path: String,
        /// What it really is, with its article.
        found: &'static str,
    },
    /// The content is of no known kind.
    #[error(
        "{path} is no PNG, TIFF or MRC file ({length} bytes, the first are {start}); if its name says it should be \
         one, it is damaged: copy or export it again"
    )]
    Unrecognised {
        /// The path as given.
        path: String,
        /// Length of the file.
        length: u64,
        /// The first bytes in hexadecimal.
        start: String,
    },
    /// The file ends before what its header promises.
    #[error(
        "{path} is truncated: its header promises {promised}, which takes {needed} bytes, and there are {held}; copy \
         or export it again"
    )]
    Truncated {
        /// The path as given.
        path: String,
        /// What the header promises.
        promised: String,
        /// Bytes that would take.
        needed: u64,
        /// Bytes the file has for it.
        held: u64,
    },
    /// The page is larger than the limits.
    #[error(
        "{path}: a page of {columns} x {rows} px ({bytes} bytes decoded) is above the limits of {} px and {} bytes; \
         crop or bin it, or the header is damaged",
        MAX_PIXELS,
        MAX_BYTES
    )]
    TooLarge {
        /// The path as given.
        path: String,
        /// Columns of the page.
        columns: u64,
        /// Rows of the page.
        rows: u64,
        /// Bytes it takes decoded; saturates.
        bytes: u64,
    },
    /// The machine has not enough memory.
    #[error("{path}: there is no memory for a page of {bytes} bytes; crop or bin the image")]
    NoMemory {
        /// The path as given.
        path: String,
        /// Bytes asked for.
        bytes: u64,
    },
    /// The content contradicts itself or the format.
    #[error("{path} is a damaged {format} file: {what}; copy or export it again")]
    Corrupt {
        /// The path as given.
        path: String,
        /// Name of the format.
        format: &'static str,
        /// What is wrong.
        what: String,
    },
    /// A valid file of a kind that is not read.
    #[error("{path}: {what}; {remedy}")]
    Unsupported {
        /// The path as given.
        path: String,
        /// What the file holds.
        what: String,
        /// What to do.
        remedy: &'static str,
    },
    /// Colour.
    #[error("{path} is no grey image: {what}; convert it to grey")]
    NotGrey {
        /// The path as given.
        path: String,
        /// Where the channels differ, or what they are.
        what: String,
    },
    /// Complex numbers.
    #[error("{path} holds complex values ({what}), a Fourier transform or a wave; save its real part or its modulus")]
    Complex {
        /// The path as given.
        path: String,
        /// The format's name of the type.
        what: String,
    },
    /// Pixels that are no numbers.
    #[error(
        "{path}: {count} of {pixels} pixels are NaN or infinite, the first ({value}) at row {row}, column {column}; \
         replace them in the program that wrote the file"
    )]
    NotFinite {
        /// What was given.
        path: String,
        /// How many.
        count: usize,
        /// Of how many.
        pixels: usize,
        /// Row of the first, 0 at the top.
        row: usize,
        /// Column of the first.
        column: usize,
        /// The first.
        value: f32,
    },
    /// A stack was given without a page.
    #[error("{path} holds {pages} pages; choose one, from {path}#0 to {path}#{}", pages - 1)]
    ManyPages {
        /// The path as given.
        path: String,
        /// How many pages it holds.
        pages: usize,
    },
    /// There is no such page.
    #[error("{path}#{page}: the file holds {pages} page(s), counted from 0; the last is {path}#{}", pages - 1)]
    NoSuchPage {
        /// The path as given.
        path: String,
        /// The page that was asked for.
        page: usize,
        /// How many pages it holds.
        pages: usize,
    },
    /// A list, range or file of tilts that cannot be used.
    #[error("tilts {given:?}: {what}")]
    Tilts {
        /// What was given: the list, the range or the file.
        given: String,
        /// What is wrong with it and what to write instead.
        what: String,
    },
}

//! MRC and its kin `.st`, `.ali`, `.rec`, `.map`: our own reader.
//!
//! Format: MRC2014 (Cheng et al., J. Struct. Biol. 192, 2015, doi 10.1016/j.jsb.2015.04.002) and IMOD's notes on it
//! (bio3d.colorado.edu/imod/doc/mrc_format.txt) for older files, the sign of bytes and SerialEM's extended header. The
//! header is 1024 bytes, then comes the extended header, then sections of rows.
//!
//! Rows are stored bottom-up: they are flipped on reading unless [`MrcRows::TopDown`] is asked for. Header lengths are
//! in Angstrom: 10 A are 1 nm. A pixel of exactly 1 A is what programs write that know no pixel size, and is taken as
//! unknown.

use std::io::{Read, Seek};

use ndarray::Array2;

use super::header::check_limits;
use super::mrc_extended::{self, Extended};
use super::samples::{self, Channels};
use super::{ByteOrder, Format, Found, Header, Input, MrcRows, Pages, ReadError, SampleType};

/// Length of the main header.
const HEADER_BYTES: u64 = 1024;
/// Longest side that is taken for real when an unmarked file is recognised.
const MAX_SIDE: i32 = 1 << 20;
/// `imodStamp` of files written by IMOD and SerialEM: "IMOD" as a little-endian number.
const IMOD_STAMP: i32 = 1_146_047_817;
/// Every mode the format knows, read here or not.
const MODES: [i32; 9] = [0, 1, 2, 3, 4, 6, 12, 16, 101];

/// An MRC file whose header was read.
#[derive(Debug)]
pub struct MrcFile<R> {
    input: Input<R>,
    header: Header,
    data_offset: u64,
    rows_order: MrcRows,
}

/// Reads a section of an MRC file held in memory; `name` stands for its path in messages.
pub fn read_bytes(name: &str, bytes: &[u8], section: usize) -> Result<Array2<f32>, ReadError> {
    MrcFile::open(Input::in_memory(name, bytes), MrcRows::default())?.read_page(section)
}

/// Whether the first kilobyte can be an MRC header: marked "MAP", or an unmarked one whose numbers fit together.
pub(super) fn looks_like_mrc(start: &[u8], length: u64) -> bool {
    if start.get(208..211) == Some(b"MAP") {
        return true;
    }
    let Some(raw) = RawHeader::new(start) else { return false };
    [ByteOrder::Little, ByteOrder::Big].into_iter().any(|order| {
        let axes = [64, 68, 72].map(|offset| raw.int(offset, order));
        let mut sorted = axes;
        sorted.sort_unstable();
        let extended = i64::from(raw.int(92, order));
        raw.is_plausible(order) && (axes == [0; 3] || sorted == [1, 2, 3]) && extended >= 0 && extended as u64 <= length
    })
}

impl<R: Read + Seek> MrcFile<R> {
    /// Reads the headers, and holds them against the length of the file.
    pub fn open(mut input: Input<R>, rows_order: MrcRows) -> Result<Self, ReadError> {
        let start = input.bytes_at(0, HEADER_BYTES)?;
        let Some(raw) = RawHeader::new(&start) else {
            let (path, held) = (input.path, input.length);
            let promised = "a header of 1024 bytes".to_owned();
            return Err(ReadError::Truncated { path, promised, needed: HEADER_BYTES, held });
        };
        let order = raw.byte_order(input.length).ok_or_else(|| raw.damaged(&input.path))?;
        let [columns, rows, sections] = raw.size(order);
        let mut notes = Vec::new();
        let sample = raw.sample_type(order, &input.path, &mut notes)?;
        check_limits(&input.path, columns, rows, sample.bytes())?;

        let extended_bytes = raw.int(92, order);
        let extended_bytes = u64::try_from(extended_bytes).map_err(|_| ReadError::Corrupt {
            path: input.path.clone(),
            format: "MRC",
            what: format!("its extended header has {extended_bytes} bytes"),
        })?;
        let data_offset = HEADER_BYTES + extended_bytes;
        let section_bytes = columns * rows * sample.bytes();
        let needed = section_bytes.saturating_mul(sections).saturating_add(data_offset);
        if needed > input.length {
            let complete = input.length.saturating_sub(data_offset) / section_bytes;
            let promised = format!(
                "{sections} section(s) of {columns} x {rows} px in {} byte(s) each ({complete} are complete)",
                sample.bytes()
            );
            return Err(ReadError::Truncated { path: input.path, promised, needed, held: input.length });
        }
        if input.length > needed {
            let more = input.length - needed;
            notes.push(format!("the file is {more} bytes longer than its header says; they are ignored"));
        }
        if !raw.is_marked() {
            notes.push("old-style header without the MAP stamp".to_owned());
        }
        let axes = [64, 68, 72].map(|offset| raw.int(offset, order));
        if axes != [1, 2, 3] && axes != [0; 3] {
            notes.push(format!("axes are stored in the order {axes:?}; they are read as columns, rows, sections"));
        }
        let extended = mrc_extended::read(&mut input, &raw, order, sections, extended_bytes)?;
        let mut header = Header {
            format: Format::Mrc,
            rows: rows as usize,
            columns: columns as usize,
            pages: sections as usize,
            sample,
            byte_order: order,
            pixel_size_nm: None,
            tilts_deg: None,
            notes,
        };
        take_calibration(&mut header, &raw, order, extended);
        Ok(Self { input, header, data_offset, rows_order })
    }
}

impl<R: Read + Seek + std::fmt::Debug> Pages for MrcFile<R> {
    fn header(&self) -> &Header {
        &self.header
    }

    fn header_mut(&mut self) -> &mut Header {
        &mut self.header
    }

    fn read_page(&mut self, page: usize) -> Result<Array2<f32>, ReadError> {
        let Header { rows, columns, pages, sample, byte_order, .. } = self.header;
        let path = self.input.path.clone();
        if page >= pages {
            return Err(ReadError::NoSuchPage { path, page, pages });
        }
        let section_bytes = rows as u64 * columns as u64 * sample.bytes();
        let offset = self.data_offset + page as u64 * section_bytes;
        let bytes = self.input.bytes_at(offset, section_bytes)?;
        if bytes.len() as u64 != section_bytes {
            let (needed, held) = (section_bytes, bytes.len() as u64);
            return Err(ReadError::Truncated { path, promised: format!("section {page}"), needed, held });
        }
        let values = samples::decode(&bytes, sample, byte_order);
        let mut pixels = samples::grey(&path, (rows, columns), values, Channels::Interleaved(1))?;
        if self.rows_order == MrcRows::BottomUp {
            pixels.invert_axis(ndarray::Axis(0));
            // Later stages want rows that lie in memory from top to bottom.
            pixels = pixels.as_standard_layout().into_owned();
        }
        Ok(pixels)
    }
}

/// The 1024 bytes of the main header; offsets are those of the specification (word n is at 4 (n - 1)).
pub(super) struct RawHeader<'a>(&'a [u8; HEADER_BYTES as usize]);

impl<'a> RawHeader<'a> {
    fn new(start: &'a [u8]) -> Option<Self> {
        start.first_chunk().map(Self)
    }

    pub(super) fn bytes<const N: usize>(&self, offset: usize) -> [u8; N] {
        *self.0[offset..].first_chunk().expect("offsets are constants inside the header")
    }

    pub(super) fn int(&self, offset: usize, order: ByteOrder) -> i32 {
        match order {
            ByteOrder::Little => i32::from_le_bytes(self.bytes(offset)),
            ByteOrder::Big => i32::from_be_bytes(self.bytes(offset)),
        }
    }

    pub(super) fn short(&self, offset: usize, order: ByteOrder) -> i16 {
        match order {
            ByteOrder::Little => i16::from_le_bytes(self.bytes(offset)),
            ByteOrder::Big => i16::from_be_bytes(self.bytes(offset)),
        }
    }

    fn float(&self, offset: usize, order: ByteOrder) -> f64 {
        f64::from(f32::from_bits(self.int(offset, order).cast_unsigned()))
    }

    fn is_marked(&self) -> bool {
        self.0[208..211] == *b"MAP"
    }

    fn mode(&self, order: ByteOrder) -> i32 {
        self.int(12, order)
    }

    fn is_plausible(&self, order: ByteOrder) -> bool {
        let sides_fit = [0, 4, 8].into_iter().all(|offset| (1..=MAX_SIDE).contains(&self.int(offset, order)));
        sides_fit && MODES.contains(&self.mode(order))
    }

    /// Columns, rows, sections of a plausible header.
    fn size(&self, order: ByteOrder) -> [u64; 3] {
        [0, 4, 8].map(|offset| u64::from(self.int(offset, order).unsigned_abs()))
    }

    /// The order in which the header makes sense; where both do, the machine stamp, or else the length, decides.
    fn byte_order(&self, length: u64) -> Option<ByteOrder> {
        let plausible = |order| self.is_plausible(order).then_some(order);
        let (little, big) = (plausible(ByteOrder::Little), plausible(ByteOrder::Big));
        if little.is_none() || big.is_none() {
            return little.or(big);
        }
        let fits =
            |order| self.size(order).iter().fold(1, |product: u64, side| product.saturating_mul(*side)) <= length;
        match self.0[212] {
            0x44 => little,
            0x11 => big,
            _ if !fits(ByteOrder::Little) && fits(ByteOrder::Big) => big,
            _ => little,
        }
    }

    fn damaged(&self, path: &str) -> ReadError {
        let order = if self.0[212] == 0x11 { ByteOrder::Big } else { ByteOrder::Little };
        let [columns, rows, sections, mode] = [0, 4, 8, 12].map(|offset| self.int(offset, order));
        let what = format!(
            "its header says {columns} x {rows} px, {sections} section(s), mode {mode}: sides are 1 to {MAX_SIDE}, \
             modes {MODES:?}"
        );
        ReadError::Corrupt { path: path.to_owned(), format: "MRC", what }
    }

    fn sample_type(&self, order: ByteOrder, path: &str, notes: &mut Vec<String>) -> Result<SampleType, ReadError> {
        let path = path.to_owned();
        match self.mode(order) {
            0 if self.bytes_are_signed(order, notes) => Ok(SampleType::Int8),
            0 => Ok(SampleType::Uint8),
            1 => Ok(SampleType::Int16),
            2 => Ok(SampleType::Float32),
            6 => Ok(SampleType::Uint16),
            12 => Ok(SampleType::Float16),
            3 => Err(ReadError::Complex { path, what: "MRC mode 3, 16-bit integers".to_owned() }),
            4 => Err(ReadError::Complex { path, what: "MRC mode 4, 32-bit floats".to_owned() }),
            16 => Err(ReadError::NotGrey { path, what: "it holds RGB bytes (MRC mode 16)".to_owned() }),
            mode => Err(ReadError::Unsupported {
                path,
                what: format!("MRC mode {mode} (4 bits a pixel) is not read"),
                remedy: "convert it, for instance with IMOD: newstack -mode 1 FILE OUT",
            }),
        }
    }

    /// Sign of mode 0, by IMOD's rule: its own stamp says; else the least and largest value in the header tell.
    ///
    /// Where those are not set, MRC2014 files (version 2014x in the header) are signed, as that standard has it.
    fn bytes_are_signed(&self, order: ByteOrder, notes: &mut Vec<String>) -> bool {
        if self.int(152, order) == IMOD_STAMP {
            return self.int(156, order) & 1 == 1;
        }
        let (least, largest) = (self.float(76, order), self.float(80, order));
        if least < 0.0 || largest >= 128.0 {
            // Both at once is a header of another scale: the sign that loses less wins.
            return -least > largest - 128.0;
        }
        let signed = matches!(self.int(108, order), 20140..=20149);
        if least >= largest {
            let word = if signed { "signed" } else { "unsigned" };
            notes.push(format!("the header does not tell whether bytes are signed; they are read as {word}"));
        }
        signed
    }
}

/// Pixel size: cell length over its sampling (words 8 to 12), or else what the extended header says.
fn take_calibration(header: &mut Header, raw: &RawHeader<'_>, order: ByteOrder, extended: Extended) {
    let sampling = [28, 32].map(|offset| f64::from(raw.int(offset, order)));
    let lengths = [40, 44].map(|offset| raw.float(offset, order));
    let [x, y] = [0, 1].map(|axis| lengths[axis] / sampling[axis]);
    let stated = sampling.iter().all(|&value| value > 0.0) && lengths.iter().all(|&value| value != 0.0);
    let is_placeholder = (x - 1.0).abs() < 1e-6 && (y - 1.0).abs() < 1e-6;
    if stated && !is_placeholder {
        header.take_pixel_size(0.1 * x, 0.1 * y, "MRC header");
    }
    if header.pixel_size_nm.is_none()
        && let Some(Found { value, origin }) = extended.pixel_size_nm
    {
        header.take_pixel_size(value, value, &origin);
    }
    if header.pixel_size_nm.is_none() && stated && is_placeholder {
        header.notes.push(
            "the pixel size in the header is exactly 1 A, which is written where none is known: it is not used; give \
             --pixel-size"
                .to_owned(),
        );
    }
    header.tilts_deg = extended.tilts_deg;
}

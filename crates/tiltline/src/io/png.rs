//! PNG (Portable Network Graphics specification, third edition), by the `png` crate: grey in 8 and 16 bits.
//!
//! Fewer bits and palettes are expanded to 8 bits. Colour whose channels are equal everywhere is grey, and a constant
//! alpha is dropped. `pHYs` gives a pixel size only where it is finer than any print or screen.

use std::io::{BufRead, Seek, SeekFrom};

use ndarray::Array2;
use png::{BitDepth, ColorType, Decoder, DecodingError, Limits, PixelDimensions, Transformations, Unit};

use super::header::check_limits;
use super::samples::{self, Channels};
use super::tiff_calibration::finer_than_print;
use super::{ByteOrder, Format, Header, Input, Pages, ReadError, SampleType};

/// Deflate shrinks by at most 1032 (RFC 1951: 258 bytes for two bits, zlib's technical notes).
const DEFLATE_RATIO: u64 = 1032;

/// Bytes beyond the image itself that the decoder may take: a row, its filters, colour profiles are not kept.
const DECODER_SLACK: usize = 1 << 20;

/// A PNG file whose header was read.
#[derive(Debug)]
pub struct PngFile<R> {
    input: Input<R>,
    header: Header,
    channels: usize,
    /// Bytes that come out of deflate: rows as stored, with their filter bytes.
    stored_bytes: u64,
}

/// Reads a PNG held in memory; `name` stands for its path in messages.
pub fn read_bytes(name: &str, bytes: &[u8]) -> Result<Array2<f32>, ReadError> {
    PngFile::open(Input::in_memory(name, bytes))?.read_page(0)
}

impl<R: BufRead + Seek> PngFile<R> {
    /// Reads the header.
    pub fn open(mut input: Input<R>) -> Result<Self, ReadError> {
        input.reader.seek(SeekFrom::Start(0)).map_err(|error| super::input::io_error(&input.path, error))?;
        let mut decoder = decoder(&mut input.reader, 0);
        let (columns, rows) = {
            let info = decoder.read_header_info().map_err(|error| damaged(&input.path, &error))?;
            (info.width, info.height)
        };
        // Channels and depth after expansion are at most RGBA in 16 bits.
        check_limits(&input.path, u64::from(columns), u64::from(rows), 8)?;
        decoder.set_limits(Limits { bytes: row_bytes(columns) });
        let reader = decoder.read_info().map_err(|error| damaged(&input.path, &error))?;
        let (color, depth) = reader.output_color_type();
        let sample = if depth == BitDepth::Sixteen { SampleType::Uint16 } else { SampleType::Uint8 };
        let resolution = reader.info().pixel_dims;
        let channels = color.samples();
        let stored_bytes = reader.info().raw_bytes() as u64;
        let mut header = Header {
            format: Format::Png,
            rows: rows as usize,
            columns: columns as usize,
            pages: 1,
            sample,
            byte_order: ByteOrder::Big,
            pixel_size_nm: None,
            tilts_deg: None,
            notes: Vec::new(),
        };
        if let Some(resolution) = resolution {
            take_resolution(&mut header, resolution);
        }
        if color == ColorType::Indexed {
            let what = "its palette is damaged".to_owned();
            return Err(ReadError::Corrupt { path: input.path, format: "PNG", what });
        }
        Ok(Self { input, header, channels, stored_bytes })
    }
}

impl<R: BufRead + Seek + std::fmt::Debug> PngFile<R> {
    fn promised_bytes(&self) -> u64 {
        self.header.rows as u64 * self.header.columns as u64 * self.channels as u64 * self.header.sample.bytes()
    }
}

impl<R: BufRead + Seek> Pages for PngFile<R>
where
    R: std::fmt::Debug,
{
    fn header(&self) -> &Header {
        &self.header
    }

    fn header_mut(&mut self) -> &mut Header {
        &mut self.header
    }

    fn read_page(&mut self, page: usize) -> Result<Array2<f32>, ReadError> {
        let Header { rows, columns, sample, .. } = self.header;
        let bytes = self.promised_bytes();
        let path = &self.input.path;
        if page > 0 {
            return Err(ReadError::NoSuchPage { path: path.clone(), page, pages: 1 });
        }
        if self.stored_bytes > self.input.length.saturating_mul(DEFLATE_RATIO) {
            let promised = format!("{columns} x {rows} px (compressed)");
            return Err(ReadError::Truncated {
                path: path.clone(),
                promised,
                needed: self.stored_bytes,
                held: self.input.length,
            });
        }
        let reader = &mut self.input.reader;
        reader.seek(SeekFrom::Start(0)).map_err(|error| super::input::io_error(path, error))?;
        let mut reader =
            decoder(reader, row_bytes(columns as u32)).read_info().map_err(|error| damaged(path, &error))?;
        let mut buffer = samples::reserve(path, bytes)?;
        buffer.resize(bytes as usize, 0);
        reader.next_frame(&mut buffer).map_err(|error| damaged(path, &error))?;
        let values = samples::decode(&buffer, sample, ByteOrder::Big);
        samples::grey(path, (rows, columns), values, Channels::Interleaved(self.channels))
    }
}

fn decoder<R: BufRead + Seek>(reader: R, limit: usize) -> Decoder<R> {
    let mut decoder = Decoder::new_with_limits(reader, Limits { bytes: limit });
    decoder.set_transformations(Transformations::EXPAND);
    // Compressed texts and profiles could swell without bound, and nothing in them is used.
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    decoder
}

/// What the decoder may take beside the image: a few rows of RGBA in 16 bits.
fn row_bytes(columns: u32) -> usize {
    columns as usize * 8 * 4 + DECODER_SLACK
}

fn damaged(path: &str, error: &DecodingError) -> ReadError {
    let what = match error {
        DecodingError::IoError(source) if source.kind() == std::io::ErrorKind::UnexpectedEof => {
            "it ends before the image is complete".to_owned()
        }
        other => other.to_string(),
    };
    ReadError::Corrupt { path: path.to_owned(), format: "PNG", what }
}

fn take_resolution(header: &mut Header, resolution: PixelDimensions) {
    if resolution.unit != Unit::Meter || resolution.xppu == 0 || resolution.yppu == 0 {
        return;
    }
    let [x_nm, y_nm] = [resolution.xppu, resolution.yppu].map(|per_metre| 1e9 / f64::from(per_metre));
    if finer_than_print(x_nm) {
        header.take_pixel_size(x_nm, y_nm, "PNG pHYs");
    }
}

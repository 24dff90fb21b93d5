//! TIFF 6.0 and BigTIFF, by the `tiff` crate: grey integers and floats in strips or tiles, several pages, and ImageJ's
//! big stacks (one directory, further images right behind the first).
//!
//! Colour whose channels are equal everywhere is grey, and a constant alpha is dropped. White-is-zero is turned over,
//! so that large is bright. Pages that are marked as thumbnails (reduced resolution) do not count.

use std::collections::HashSet;
use std::io::{ErrorKind, Read, Seek, SeekFrom};

use ndarray::Array2;
use tiff::decoder::ifd::Value;
use tiff::decoder::{ChunkType, Decoder, DecodingResult, Limits};
use tiff::tags::{CompressionMethod, SampleFormat, Tag};
use tiff::{ColorType, TiffError};

use super::header::check_limits;
use super::input::io_error;
use super::samples::{self, Channels};
use super::{ByteOrder, Format, Header, Input, Pages, ReadError, SampleType, tiff_calibration};

/// Most by which a page can shrink: LZW codes of 12 bits stand for up to 4096 bytes, deflate stays below.
const LZW_RATIO: u64 = 2731;
/// Longest metadata value that is read.
const METADATA_BYTES: usize = 1 << 24;
/// Most pages that are looked for.
const MAX_PAGES: usize = 1 << 20;

const REMEDY: &str = "save it as grey TIFF of 8, 16 or 32 bits, uncompressed or with LZW or deflate";

/// A TIFF file whose directories were read.
#[derive(Debug)]
pub struct TiffFile<R: Read + Seek> {
    path: String,
    length: u64,
    /// Always there between calls; limits can only be set by value.
    decoder: Option<Decoder<R>>,
    header: Header,
    pages: Layout,
}

/// Where the pages are.
#[derive(Debug)]
enum Layout {
    /// Index in the chain of directories of each page.
    Directories(Vec<usize>),
    /// Offset of the first of the images that follow one another.
    Contiguous(u64),
}

/// Reads a page of a TIFF held in memory; `name` stands for its path in messages.
pub fn read_bytes(name: &str, bytes: &[u8], page: usize) -> Result<Array2<f32>, ReadError> {
    TiffFile::open(Input::in_memory(name, bytes))?.read_page(page)
}

impl<R: Read + Seek> TiffFile<R> {
    /// Reads the directories.
    pub fn open(mut input: Input<R>) -> Result<Self, ReadError> {
        let seek = input.reader.seek(SeekFrom::Start(0));
        seek.map_err(|error| io_error(&input.path, error))?;
        let Input { reader, path, length } = input;
        // The first directory is read under the crate's own limits: lists of tags may reserve 256 MB for a moment.
        let decoder = Decoder::new(reader).map_err(|error| failed(&path, error))?;
        let mut decoder = decoder.with_limits(limits(length, tag_bytes(length)));
        let mut notes = Vec::new();
        let directories = list_pages(&mut decoder, &path, &mut notes)?;
        let first = *directories.first().expect("the list is never empty");
        decoder.seek_to_image(first).map_err(|error| failed(&path, error))?;
        let (columns, rows) = decoder.dimensions().map_err(|error| failed(&path, error))?;
        let sample = sample_type(&mut decoder, &path)?;
        let byte_order = match decoder.byte_order() {
            tiff::tags::ByteOrder::LittleEndian => ByteOrder::Little,
            tiff::tags::ByteOrder::BigEndian => ByteOrder::Big,
        };
        let mut header = Header {
            format: Format::Tiff,
            rows: rows as usize,
            columns: columns as usize,
            pages: directories.len(),
            sample,
            byte_order,
            pixel_size_nm: None,
            tilts_deg: None,
            notes,
        };
        let metadata = tiff_calibration::Metadata::read(&mut decoder);
        metadata.take_pixel_size(&mut header);
        let mut pages = Layout::Directories(directories);
        if let Some(images) = metadata.image_j_images()
            && header.pages == 1
            && images > 1
            && let Some(offset) = contiguous_stack(&mut decoder, &path, length, &mut header, images)?
        {
            header.pages = images;
            pages = Layout::Contiguous(offset);
        }
        metadata.take_tilt(&mut header);
        Ok(Self { path, length, decoder: Some(decoder), header, pages })
    }

    fn decoder(&mut self) -> &mut Decoder<R> {
        self.decoder.as_mut().expect("the decoder is put back wherever it is taken")
    }

    fn set_limits(&mut self, bytes: usize) {
        let limits = limits(self.length, bytes);
        self.decoder = self.decoder.take().map(|decoder| decoder.with_limits(limits));
    }

    fn read_directory(&mut self, index: usize) -> Result<Array2<f32>, ReadError> {
        let path = self.path.clone();
        let decoder = self.decoder();
        decoder.seek_to_image(index).map_err(|error| failed(&path, error))?;
        let (columns, rows) = decoder.dimensions().map_err(|error| failed(&path, error))?;
        let sample = sample_type(decoder, &path)?;
        let count = first_value(decoder, Tag::SamplesPerPixel).unwrap_or(1);
        check_limits(&path, u64::from(columns), u64::from(rows), count.saturating_mul(sample.bytes()))?;
        check_color(&path, decoder.colortype().map_err(|error| failed(&path, error))?)?;
        let planar = first_value(decoder, Tag::PlanarConfiguration) == Some(2);
        let bytes = u64::from(columns) * u64::from(rows) * count * sample.bytes();
        let length = self.length;
        justify(self.decoder(), &path, length, (columns, rows), (count, sample, planar))?;

        let mut result = DecodingResult::U8(Vec::new());
        self.set_limits(usize::try_from(bytes).unwrap_or(usize::MAX));
        let read = self.decoder().read_image_to_buffer(&mut result);
        self.set_limits(tag_bytes(length));
        read.map_err(|error| failed(&path, error))?;
        let values = to_f32(result);
        let (shape, count) = ((rows as usize, columns as usize), count as usize);
        if values.len() != shape.0 * shape.1 * count {
            let what = format!("a page of {columns} x {rows} px with {count} channel(s) gave {} samples", values.len());
            return Err(ReadError::Corrupt { path, format: "TIFF", what });
        }
        let channels = if planar { Channels::Planar(count) } else { Channels::Interleaved(count) };
        samples::grey(&path, shape, values, channels)
    }

    fn read_contiguous(&mut self, first: u64, page: usize) -> Result<Array2<f32>, ReadError> {
        let Header { rows, columns, sample, byte_order, .. } = self.header;
        let bytes = rows as u64 * columns as u64 * sample.bytes();
        let mut buffer = samples::reserve(&self.path, bytes)?;
        let path = self.path.clone();
        let reader = self.decoder().inner();
        let read = reader
            .seek(SeekFrom::Start(first + page as u64 * bytes))
            .and_then(|_| reader.by_ref().take(bytes).read_to_end(&mut buffer));
        read.map_err(|source| io_error(&path, source))?;
        if buffer.len() as u64 != bytes {
            let promised = format!("image {page} of a stack");
            return Err(ReadError::Truncated { path, promised, needed: bytes, held: buffer.len() as u64 });
        }
        let values = samples::decode(&buffer, sample, byte_order);
        samples::grey(&path, (rows, columns), values, Channels::Interleaved(1))
    }
}

impl<R: Read + Seek + std::fmt::Debug> Pages for TiffFile<R> {
    fn header(&self) -> &Header {
        &self.header
    }

    fn header_mut(&mut self) -> &mut Header {
        &mut self.header
    }

    fn read_page(&mut self, page: usize) -> Result<Array2<f32>, ReadError> {
        if page >= self.header.pages {
            return Err(ReadError::NoSuchPage { path: self.path.clone(), page, pages: self.header.pages });
        }
        match &self.pages {
            Layout::Directories(indices) => self.read_directory(indices[page]),
            Layout::Contiguous(first) => self.read_contiguous(*first, page),
        }
    }
}

/// What the decoder may take: `bytes` for an image or for the values of a tag.
fn limits(length: u64, bytes: usize) -> Limits {
    let mut limits = Limits::default();
    limits.decoding_buffer_size = bytes;
    limits.intermediate_buffer_size = usize::try_from(length).unwrap_or(usize::MAX);
    limits.ifd_value_size = limits.intermediate_buffer_size.min(METADATA_BYTES);
    limits
}

/// Bytes that the values of a tag may take in memory, where one of a byte takes a whole `Value`.
fn tag_bytes(length: u64) -> usize {
    usize::try_from(length).unwrap_or(usize::MAX).min(METADATA_BYTES).saturating_mul(size_of::<Value>())
}

/// Walks the chain of directories; what is damaged or goes in a circle ends it with a note.
fn list_pages<R: Read + Seek>(
    decoder: &mut Decoder<R>,
    path: &str,
    notes: &mut Vec<String>,
) -> Result<Vec<usize>, ReadError> {
    let mut pages = Vec::new();
    let mut seen = HashSet::new();
    let mut first_size = None;
    let mut sizes_differ = false;
    let mut next = decoder.ifd_pointer();
    while let Some(pointer) = next {
        let index = seen.len();
        if index == MAX_PAGES || !seen.insert(pointer.0) {
            notes.push(format!("the chain of pages does not end after page {}; the rest is ignored", index - 1));
            break;
        }
        let directory = match decoder.read_directory(pointer) {
            Ok(directory) => directory,
            Err(error) if index == 0 => return Err(failed(path, error)),
            Err(error) => {
                notes.push(format!(
                    "the directory of page {index} is damaged ({error}); it and what follows is ignored"
                ));
                break;
            }
        };
        next = directory.next();
        let mut tags = decoder.read_directory_tags(&directory);
        let kind = tags.find_tag_unsigned::<u32>(Tag::NewSubfileType).ok().flatten().unwrap_or(0);
        let is_thumbnail = kind & 1 == 1 && index > 0;
        if is_thumbnail {
            continue;
        }
        let size = [Tag::ImageWidth, Tag::ImageLength].map(|tag| tags.find_tag_unsigned::<u32>(tag).ok().flatten());
        if *first_size.get_or_insert(size) != size && !sizes_differ {
            sizes_differ = true;
            let [columns, rows] = size.map(|side| side.map_or("?".to_owned(), |side| side.to_string()));
            notes.push(format!("pages differ in size: page {} is {columns} x {rows} px", pages.len()));
        }
        pages.push(index);
    }
    Ok(pages)
}

/// Type of the samples of the current directory.
fn sample_type<R: Read + Seek>(decoder: &mut Decoder<R>, path: &str) -> Result<SampleType, ReadError> {
    let bits = first_value(decoder, Tag::BitsPerSample).unwrap_or(1);
    let format = first_value(decoder, Tag::SampleFormat).unwrap_or(1);
    // SampleFormat 5 and 6 are complex integers and floats (TIFF Technical Note of 1995; libtiff).
    if let 5 | 6 = format {
        return Err(ReadError::Complex { path: path.to_owned(), what: format!("TIFF sample format {format}") });
    }
    // 4 is "undefined": libtiff reads it as unsigned.
    let format = if format == 4 { 1 } else { format };
    Ok(match (SampleFormat::from_u16_exhaustive(u16::try_from(format).unwrap_or(u16::MAX)), bits) {
        (SampleFormat::Uint, 8) => SampleType::Uint8,
        (SampleFormat::Uint, 16) => SampleType::Uint16,
        (SampleFormat::Uint, 32) => SampleType::Uint32,
        (SampleFormat::Uint, 64) => SampleType::Uint64,
        (SampleFormat::Int, 8) => SampleType::Int8,
        (SampleFormat::Int, 16) => SampleType::Int16,
        (SampleFormat::Int, 32) => SampleType::Int32,
        (SampleFormat::Int, 64) => SampleType::Int64,
        (SampleFormat::IEEEFP, 16) => SampleType::Float16,
        (SampleFormat::IEEEFP, 32) => SampleType::Float32,
        (SampleFormat::IEEEFP, 64) => SampleType::Float64,
        _ => {
            let what = format!("samples of {bits} bits in TIFF sample format {format} are not read");
            return Err(ReadError::Unsupported { path: path.to_owned(), what, remedy: REMEDY });
        }
    })
}

fn check_color(path: &str, color: ColorType) -> Result<(), ReadError> {
    match color {
        ColorType::Gray(_)
        | ColorType::GrayA(_)
        | ColorType::RGB(_)
        | ColorType::RGBA(_)
        | ColorType::Multiband { num_samples: 1..=2, .. } => Ok(()),
        other => Err(ReadError::NotGrey { path: path.to_owned(), what: format!("its pixels are {other:?}") }),
    }
}

/// Holds what a page promises against what the file has for it, before memory is asked for.
fn justify<R: Read + Seek>(
    decoder: &mut Decoder<R>,
    path: &str,
    length: u64,
    (columns, rows): (u32, u32),
    (count, sample, planar): (u64, SampleType, bool),
) -> Result<(), ReadError> {
    let is_tiled = decoder.get_chunk_type() == ChunkType::Tile;
    let (offsets, counts) =
        if is_tiled { (Tag::TileOffsets, Tag::TileByteCounts) } else { (Tag::StripOffsets, Tag::StripByteCounts) };
    let [offsets, counts] = [offsets, counts].map(|tag| values(decoder, tag));
    let needed = if is_tiled {
        // Tiles are stored whole, and the decoder takes a row of one at a time: the padding counts.
        let (tile_columns, tile_rows) = decoder.chunk_dimensions();
        let pixel_bytes = sample.bytes().saturating_mul(if planar { 1 } else { count });
        let tile_bytes = u64::from(tile_columns).saturating_mul(u64::from(tile_rows)).saturating_mul(pixel_bytes);
        tile_bytes.saturating_mul(counts.len() as u64)
    } else {
        u64::from(columns).saturating_mul(u64::from(rows)).saturating_mul(count.saturating_mul(sample.bytes()))
    };
    let chunks = offsets.iter().zip(&counts);
    let held = chunks.map(|(&offset, &bytes)| bytes.min(length.saturating_sub(offset))).fold(0, u64::saturating_add);
    let compression = first_value(decoder, Tag::Compression).unwrap_or(1);
    let is_raw = compression == u64::from(CompressionMethod::None.to_u16());
    let ratio = if is_raw { 1 } else { LZW_RATIO };
    let promised = || {
        let word = if is_raw { "" } else { " (compressed)" };
        format!("a page of {columns} x {rows} px{word}")
    };
    let end = offsets.iter().zip(&counts).map(|(&offset, &bytes)| offset.saturating_add(bytes)).max().unwrap_or(0);
    if end > length {
        return Err(ReadError::Truncated { path: path.to_owned(), promised: promised(), needed: end, held: length });
    }
    if needed > held.min(length).saturating_mul(ratio) {
        return Err(ReadError::Truncated { path: path.to_owned(), promised: promised(), needed, held });
    }
    Ok(())
}

/// Offset of the first of `images` that follow one another without directories, as ImageJ writes big stacks.
///
/// `None`, with a note, where the file holds the first one only: its description was kept by a program that saved it.
fn contiguous_stack<R: Read + Seek>(
    decoder: &mut Decoder<R>,
    path: &str,
    length: u64,
    header: &mut Header,
    images: usize,
) -> Result<Option<u64>, ReadError> {
    let image_bytes = (header.rows as u64 * header.columns as u64).saturating_mul(header.sample.bytes());
    let offsets = values(decoder, Tag::StripOffsets);
    let first = offsets.first().copied().unwrap_or(length);
    let held = length.saturating_sub(first);
    let is_raw = first_value(decoder, Tag::Compression).unwrap_or(1) == 1;
    let is_plain = first_value(decoder, Tag::SamplesPerPixel).unwrap_or(1) == 1
        && first_value(decoder, Tag::PhotometricInterpretation) == Some(1);
    let one_image = image_bytes.saturating_mul(2) > held;
    if !is_raw || !is_plain || offsets.is_empty() || one_image {
        header.notes.push(format!("the ImageJ description speaks of {images} images, the file holds 1"));
        return Ok(None);
    }
    let needed = image_bytes.saturating_mul(images as u64);
    if needed > held {
        let promised = format!("{images} images of {} x {} px", header.columns, header.rows);
        return Err(ReadError::Truncated { path: path.to_owned(), promised, needed, held });
    }
    Ok(Some(first))
}

fn values<R: Read + Seek>(decoder: &mut Decoder<R>, tag: Tag) -> Vec<u64> {
    decoder.find_tag_unsigned_vec(tag).ok().flatten().unwrap_or_default()
}

fn first_value<R: Read + Seek>(decoder: &mut Decoder<R>, tag: Tag) -> Option<u64> {
    values(decoder, tag).first().copied()
}

fn to_f32(result: DecodingResult) -> Vec<f32> {
    match result {
        DecodingResult::U8(values) => values.into_iter().map(f32::from).collect(),
        DecodingResult::I8(values) => values.into_iter().map(f32::from).collect(),
        DecodingResult::U16(values) => values.into_iter().map(f32::from).collect(),
        DecodingResult::I16(values) => values.into_iter().map(f32::from).collect(),
        DecodingResult::U32(values) => values.into_iter().map(|value| value as f32).collect(),
        DecodingResult::I32(values) => values.into_iter().map(|value| value as f32).collect(),
        DecodingResult::U64(values) => values.into_iter().map(|value| value as f32).collect(),
        DecodingResult::I64(values) => values.into_iter().map(|value| value as f32).collect(),
        DecodingResult::F16(values) => values.into_iter().map(f32::from).collect(),
        DecodingResult::F32(values) => values,
        DecodingResult::F64(values) => values.into_iter().map(|value| value as f32).collect(),
    }
}

/// Sorts the decoder's errors by what the user can do about them.
fn failed(path: &str, error: TiffError) -> ReadError {
    let path = path.to_owned();
    let corrupt = |path, what| ReadError::Corrupt { path, format: "TIFF", what };
    match error {
        TiffError::UnsupportedError(error) => ReadError::Unsupported { path, what: error.to_string(), remedy: REMEDY },
        TiffError::IoError(source) => match source.kind() {
            ErrorKind::UnexpectedEof => corrupt(path, "it ends before the image is complete".to_owned()),
            ErrorKind::InvalidData | ErrorKind::InvalidInput | ErrorKind::Other => corrupt(path, source.to_string()),
            _ => io_error(&path, source),
        },
        other => corrupt(path, other.to_string()),
    }
}

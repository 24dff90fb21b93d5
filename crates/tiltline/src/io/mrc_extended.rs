//! Extended headers of MRC files: tilt and pixel size per section.
//!
//! - `FEI1`, `FEI2`: records with their own length, MRC2014 extension as in Thermo Fisher's EPU manual (appendix) and
//!   mrcfile's table of it; a bit mask says which fields are set; angles in degrees, lengths in m.
//! - `SERI`: SerialEM, short integers, one flag a kind of item; tilt in hundredths of a degree comes first (IMOD's
//!   notes on the format).
//! - Unmarked FEI files: 32 floats a section, tilt in degrees first, pixel size in m twelfth (IMOD's notes).

use std::io::{Read, Seek};

use super::mrc::RawHeader;
use super::{ByteOrder, Found, Input, ReadError};

/// Length of an old FEI record: 32 floats.
const OLD_FEI_BYTES: usize = 128;
/// Longest record of any kind, which bounds what is read.
const MAX_RECORD: u64 = 4096;
/// Angles beyond this are no tilts.
const MAX_TILT_DEG: f64 = 180.0;

/// What an extended header tells.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Extended {
    /// One tilt a section, in degrees.
    pub tilts_deg: Option<Found<Vec<f64>>>,
    /// Side of a pixel in nm.
    pub pixel_size_nm: Option<Found<f64>>,
}

/// Reads an extended header; one of unknown kind, or with impossible values, tells nothing.
pub(super) fn read<R: Read + Seek>(
    input: &mut Input<R>,
    raw: &RawHeader<'_>,
    order: ByteOrder,
    sections: u64,
    length: u64,
) -> Result<Extended, ReadError> {
    if length == 0 {
        return Ok(Extended::default());
    }
    let bytes = input.bytes_at(1024, length.min(sections.saturating_mul(MAX_RECORD)))?;
    let sections = sections as usize;
    let (record_bytes, flags) = (raw.short(128, order), raw.short(130, order));
    let label = raw.bytes::<80>(224).to_ascii_lowercase();
    let is_old_fei = (record_bytes, flags) == (0, 32) && label.windows(3).any(|word| word == b"fei");
    Ok(match &raw.bytes::<4>(104) {
        b"FEI1" | b"FEI2" => fei(&bytes, sections, order),
        b"SERI" => serial_em(&bytes, sections, order, record_bytes, flags),
        _ if is_old_fei => old_fei(&bytes, sections, order),
        _ if seri_item_bytes(flags) == Some(record_bytes) => serial_em(&bytes, sections, order, record_bytes, flags),
        _ => Extended::default(),
    })
}

/// Keeps tilts that are one a section and can be tilts; a series of zeros only is a field that was not filled.
fn plausible(tilts: Option<Vec<f64>>, sections: usize, origin: &str) -> Option<Found<Vec<f64>>> {
    let tilts = tilts.filter(|tilts| tilts.len() == sections)?;
    let all_fit = tilts.iter().all(|tilt| tilt.abs() <= MAX_TILT_DEG);
    let all_zero = tilts.iter().all(|&tilt| tilt == 0.0);
    (all_fit && !all_zero).then(|| Found::new(tilts, origin))
}

fn metres(value: f64, origin: &str) -> Option<Found<f64>> {
    (value.is_finite() && value > 0.0).then(|| Found::new(value * 1e9, origin))
}

fn old_fei(bytes: &[u8], sections: usize, order: ByteOrder) -> Extended {
    let origin = "FEI extended header";
    let records: Vec<&[u8]> = bytes.chunks_exact(OLD_FEI_BYTES).take(sections).collect();
    let tilts = records.iter().map(|record| float(record, 0, order)).collect();
    let pixel_size_nm =
        records.first().and_then(|record| float(record, 44, order)).and_then(|size| metres(size, origin));
    Extended { tilts_deg: plausible(tilts, sections, origin), pixel_size_nm }
}

fn fei(bytes: &[u8], sections: usize, order: ByteOrder) -> Extended {
    let origin = "FEI extended header";
    // Bits of the mask: 7 is the alpha tilt, 14 the pixel size along x. The mask itself is little-endian always.
    let (tilt_bit, pixel_bit) = (1 << 7, 1 << 14);
    let record_bytes = word(bytes, 0, order).map_or(0, |size| size as usize);
    if !(164..=MAX_RECORD as usize).contains(&record_bytes) {
        return Extended::default();
    }
    let records: Vec<&[u8]> = bytes.chunks_exact(record_bytes).take(sections).collect();
    let field = |record: &[u8], bit: u32, offset: usize| {
        let mask = word(record, 8, ByteOrder::Little)?;
        if mask & bit == 0 { None } else { double(record, offset, order) }
    };
    let tilts = records.iter().map(|record| field(record, tilt_bit, 100)).collect();
    let pixel_size = records.first().and_then(|record| field(record, pixel_bit, 156));
    Extended {
        tilts_deg: plausible(tilts, sections, origin),
        pixel_size_nm: pixel_size.and_then(|size| metres(size, origin)),
    }
}

fn serial_em(bytes: &[u8], sections: usize, order: ByteOrder, record_bytes: i16, flags: i16) -> Extended {
    let Ok(record_bytes @ 2..) = usize::try_from(record_bytes) else { return Extended::default() };
    if flags & 1 == 0 {
        return Extended::default();
    }
    let tilt = |record: &[u8]| {
        let raw = *record.first_chunk()?;
        let hundredths = match order {
            ByteOrder::Little => i16::from_le_bytes(raw),
            ByteOrder::Big => i16::from_be_bytes(raw),
        };
        Some(f64::from(hundredths) / 100.0)
    };
    let tilts = bytes.chunks_exact(record_bytes).take(sections).map(tilt).collect();
    Extended { tilts_deg: plausible(tilts, sections, "SerialEM extended header"), pixel_size_nm: None }
}

/// Bytes a section takes with these SerialEM flags; `None` where they are no such flags.
fn seri_item_bytes(flags: i16) -> Option<i16> {
    const BYTES: [i16; 6] = [2, 6, 4, 2, 2, 4];
    if flags <= 0 || flags >= 1 << BYTES.len() {
        return None;
    }
    Some(BYTES.iter().enumerate().filter(|(bit, _)| flags >> bit & 1 == 1).map(|(_, bytes)| bytes).sum())
}

fn word(bytes: &[u8], offset: usize, order: ByteOrder) -> Option<u32> {
    let raw = *bytes.get(offset..)?.first_chunk()?;
    Some(match order {
        ByteOrder::Little => u32::from_le_bytes(raw),
        ByteOrder::Big => u32::from_be_bytes(raw),
    })
}

fn float(bytes: &[u8], offset: usize, order: ByteOrder) -> Option<f64> {
    word(bytes, offset, order).map(|bits| f64::from(f32::from_bits(bits)))
}

fn double(bytes: &[u8], offset: usize, order: ByteOrder) -> Option<f64> {
    let raw = *bytes.get(offset..)?.first_chunk()?;
    Some(match order {
        ByteOrder::Little => f64::from_le_bytes(raw),
        ByteOrder::Big => f64::from_be_bytes(raw),
    })
}

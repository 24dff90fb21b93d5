//! MRC stacks of 16-bit sections (MRC2014: Cheng et al., J. Struct. Biol. 192, 2015, doi 10.1016/j.jsb.2015.04.002).
//!
//! Little-endian, mode 1, no extended header. Rows are stored bottom-up: those of the sections given here, row 0 at the top,
//! are turned over. Header lengths are in Angstrom.

use std::io::{self, Write};

use ndarray::Array2;

/// Length of the header.
pub(super) const HEADER_BYTES: usize = 1024;

/// What a file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Images, 16-bit.
    Stack,
    /// A volume, 32-bit floats.
    Volume,
}

/// What the header says about the values.
#[derive(Clone, Copy, Debug)]
pub(super) struct Statistics {
    low: f64,
    high: f64,
    sum: f64,
    squares: f64,
    count: f64,
}

impl Default for Statistics {
    fn default() -> Self {
        Self { low: f64::INFINITY, high: f64::NEG_INFINITY, sum: 0.0, squares: 0.0, count: 0.0 }
    }
}

impl Statistics {
    pub(super) fn add(&mut self, value: f64) {
        (self.low, self.high) = (self.low.min(value), self.high.max(value));
        self.sum += value;
        self.squares += value * value;
        self.count += 1.0;
    }

    /// Least, largest, mean and standard deviation.
    fn values(&self) -> [f32; 4] {
        let mean = self.sum / self.count.max(1.0);
        let deviation = (self.squares / self.count.max(1.0) - mean * mean).max(0.0).sqrt();
        [self.low, self.high, mean, deviation].map(|value| value as f32)
    }
}

/// A number of the header.
pub(super) fn count(number: usize) -> io::Result<i32> {
    i32::try_from(number).map_err(|_| io::Error::other(format!("{number} does not fit into an MRC file")))
}

/// The header of columns, rows and sections.
pub(super) fn header(
    [nx, ny, nz]: [i32; 3],
    kind: Kind,
    pixel_size_nm: Option<f64>,
    statistics: &Statistics,
) -> [u8; HEADER_BYTES] {
    let mut header = [0_u8; HEADER_BYTES];
    let mut put = |offset: usize, bytes: [u8; 4]| header[offset..offset + 4].copy_from_slice(&bytes);
    // Mode, and the space group, which is 1 for a volume.
    let (mode, group) = match kind {
        Kind::Stack => (1, 0),
        Kind::Volume => (2, 1),
    };
    let ints = [(0, nx), (4, ny), (8, nz), (12, mode), (28, nx), (32, ny), (36, nz)];
    for (offset, value) in ints.into_iter().chain([(64, 1), (68, 2), (72, 3), (88, group), (108, 20141)]) {
        put(offset, value.to_le_bytes());
    }
    // 1 Angstrom stands for an unknown pixel size.
    let angstrom = pixel_size_nm.map_or(1.0, |size| 10.0 * size);
    let cell = |count: i32| (f64::from(count) * angstrom) as f32;
    let [low, high, mean, deviation] = statistics.values();
    let floats = [(40, cell(nx)), (44, cell(ny)), (48, cell(nz)), (52, 90.0), (56, 90.0), (60, 90.0)];
    for (offset, value) in floats.into_iter().chain([(76, low), (80, high), (84, mean), (216, deviation)]) {
        put(offset, value.to_le_bytes());
    }
    put(208, *b"MAP ");
    put(212, [0x44, 0x44, 0, 0]);
    header
}

/// Writes sections `[row, column]` of one shape as a stack.
pub fn write_stack(sections: &[Array2<i16>], pixel_size_nm: Option<f64>, out: &mut impl Write) -> io::Result<()> {
    let Some(first) = sections.first() else { return Err(io::Error::other("a stack needs at least one section")) };
    let shape = first.dim();
    if sections.iter().any(|section| section.dim() != shape) {
        return Err(io::Error::other("the sections of a stack have one shape"));
    }
    let (rows, columns) = shape;
    let size = [count(columns)?, count(rows)?, count(sections.len())?];
    let mut statistics = Statistics::default();
    sections.iter().flatten().for_each(|value| statistics.add(f64::from(*value)));
    let header = header(size, Kind::Stack, pixel_size_nm, &statistics);
    out.write_all(&header)?;
    let mut bytes = Vec::with_capacity(2 * columns);
    for section in sections {
        for row in section.rows().into_iter().rev() {
            bytes.clear();
            bytes.extend(row.iter().flat_map(|value| value.to_le_bytes()));
            out.write_all(&bytes)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::mrc::read_bytes;

    /// The reader is tested against files by others (`cargo xtask reference formats`).
    #[test]
    fn a_stack_reads_back_the_right_way_up() {
        let sections: Vec<Array2<i16>> = (0..3)
            .map(|k| Array2::from_shape_fn([4, 5], |(row, column)| 100 * k + 10 * row as i16 + column as i16))
            .collect();
        let mut bytes = Vec::new();
        write_stack(&sections, Some(0.25), &mut bytes).unwrap();
        assert_eq!(bytes.len(), 1024 + 3 * 4 * 5 * 2);
        for (index, section) in sections.iter().enumerate() {
            assert_eq!(read_bytes("stack.mrc", &bytes, index).unwrap(), section.mapv(f32::from));
        }
        // The first row stored is the bottom one.
        assert_eq!(&bytes[1024..1026], &30_i16.to_le_bytes());
        assert!(write_stack(&[], None, &mut Vec::new()).is_err());
    }
}

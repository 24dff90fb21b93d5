//! MRC stacks of 16-bit sections (MRC2014: Cheng et al., J. Struct. Biol. 192, 2015, doi 10.1016/j.jsb.2015.04.002).
//!
//! Little-endian, mode 1, no extended header. Rows are stored bottom-up: those of the sections given here, row 0 at the top,
//! are turned over. Header lengths are in Angstrom.

use std::io::{self, Write};

use ndarray::Array2;

/// Length of the header.
const HEADER_BYTES: usize = 1024;

/// Writes sections `[row, column]` of one shape as a stack.
pub fn write_stack(sections: &[Array2<i16>], pixel_size_nm: Option<f64>, out: &mut impl Write) -> io::Result<()> {
    let Some(first) = sections.first() else { return Err(io::Error::other("a stack needs at least one section")) };
    let shape = first.dim();
    if sections.iter().any(|section| section.dim() != shape) {
        return Err(io::Error::other("the sections of a stack have one shape"));
    }
    let (rows, columns) = shape;
    let count = |number: usize| {
        i32::try_from(number).map_err(|_| io::Error::other(format!("{number} does not fit into an MRC file")))
    };
    let (nx, ny, nz) = (count(columns)?, count(rows)?, count(sections.len())?);
    let mut header = [0_u8; HEADER_BYTES];
    let mut put = |offset: usize, bytes: [u8; 4]| header[offset..offset + 4].copy_from_slice(&bytes);
    let ints =
        [(0, nx), (4, ny), (8, nz), (12, 1), (28, nx), (32, ny), (36, nz), (64, 1), (68, 2), (72, 3), (108, 20141)];
    for (offset, value) in ints {
        put(offset, value.to_le_bytes());
    }
    // 1 Angstrom stands for an unknown pixel size.
    let angstrom = pixel_size_nm.map_or(1.0, |size| 10.0 * size);
    let values = sections.iter().flatten();
    let (mut low, mut high, mut sum, mut squares) = (i16::MAX, i16::MIN, 0.0_f64, 0.0_f64);
    for &value in values {
        (low, high) = (low.min(value), high.max(value));
        sum += f64::from(value);
        squares += f64::from(value) * f64::from(value);
    }
    let total = (rows * columns * sections.len()).max(1) as f64;
    let mean = sum / total;
    let deviation = (squares / total - mean * mean).max(0.0).sqrt();
    let cell = |count: i32| (f64::from(count) * angstrom) as f32;
    let floats = [
        (40, cell(nx)),
        (44, cell(ny)),
        (48, cell(nz)),
        (52, 90.0),
        (56, 90.0),
        (60, 90.0),
        (76, f32::from(low)),
        (80, f32::from(high)),
        (84, mean as f32),
        (216, deviation as f32),
    ];
    for (offset, value) in floats {
        put(offset, value.to_le_bytes());
    }
    put(208, *b"MAP ");
    put(212, [0x44, 0x44, 0, 0]);
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

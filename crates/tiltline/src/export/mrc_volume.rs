//! MRC volumes of 32-bit floats (MRC2014, as in [`super::mrc`]), written in slabs of rows as they are made.
//!
//! Sections are layers of z and axes are in the usual order (columns x, rows y, sections z). The format has y up, so rows are stored
//! bottom-up, as in images; with that alone the volume would be its own mirror image, so sections are turned over too: **the first
//! section is the farthest layer** (largest Z), and the stored axes (right, up, towards the viewer) are right-handed as those of
//! the program are (right, down, away).

use std::io::{self, Seek, SeekFrom, Write};

use ndarray::ArrayView3;

use super::mrc::{HEADER_BYTES, Kind, Statistics, count, header};

/// A volume being written.
#[derive(Debug)]
pub struct VolumeWriter<W> {
    out: W,
    /// Layers, rows, columns.
    shape: [usize; 3],
    pixel_size_nm: Option<f64>,
    statistics: Statistics,
    rows_written: usize,
}

impl<W: Write + Seek> VolumeWriter<W> {
    /// Begins a volume of `[z, y, x]` voxels.
    ///
    /// # Errors
    /// Where a side does not fit into the header, or writing fails.
    pub fn begin(mut out: W, shape: [usize; 3], pixel_size_nm: Option<f64>) -> io::Result<Self> {
        for side in shape {
            count(side)?;
        }
        out.write_all(&[0; HEADER_BYTES])?;
        Ok(Self { out, shape, pixel_size_nm, statistics: Statistics::default(), rows_written: 0 })
    }

    /// Writes the rows of a slab `[z, y, x]` whose first row is `first_row`; slabs may come in any order, each once.
    ///
    /// # Errors
    /// Where the slab does not fit into the volume, or writing fails.
    pub fn write_rows(&mut self, first_row: usize, slab: ArrayView3<'_, f32>) -> io::Result<()> {
        let [layers, rows, columns] = self.shape;
        let (slab_layers, slab_rows, slab_columns) = slab.dim();
        if (slab_layers, slab_columns) != (layers, columns) || first_row + slab_rows > rows {
            return Err(io::Error::other(format!(
                "rows {first_row} to {} of {slab_layers} layers and {slab_columns} columns do not lie in a volume of {:?}",
                first_row + slab_rows,
                self.shape
            )));
        }
        let mut bytes = Vec::with_capacity(4 * slab_rows * columns);
        for (z, layer) in slab.outer_iter().enumerate() {
            let section = (layers - 1 - z) as u64;
            let row = (rows - first_row - slab_rows) as u64;
            let offset = HEADER_BYTES as u64 + 4 * columns as u64 * (section * rows as u64 + row);
            bytes.clear();
            for line in layer.rows().into_iter().rev() {
                for value in line {
                    self.statistics.add(f64::from(*value));
                    bytes.extend(value.to_le_bytes());
                }
            }
            self.out.seek(SeekFrom::Start(offset))?;
            self.out.write_all(&bytes)?;
        }
        self.rows_written += slab_rows;
        Ok(())
    }

    /// Writes the header and gives the file back.
    ///
    /// # Errors
    /// Where rows are missing, or writing fails.
    pub fn finish(mut self) -> io::Result<W> {
        let [layers, rows, columns] = self.shape;
        if self.rows_written != rows {
            return Err(io::Error::other(format!("{} of {rows} rows were written", self.rows_written)));
        }
        let size = [count(columns)?, count(rows)?, count(layers)?];
        self.out.seek(SeekFrom::Start(0))?;
        self.out.write_all(&header(size, Kind::Volume, self.pixel_size_nm, &self.statistics))?;
        self.out.flush()?;
        Ok(self.out)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use ndarray::{Array3, s};

    use super::*;
    use crate::io::mrc::read_bytes;

    /// Read by others too: `cargo xtask reference tomography`.
    #[test]
    fn a_volume_in_slabs_reads_back_with_the_farthest_layer_first() {
        let volume = Array3::from_shape_fn((3, 7, 5), |(z, y, x)| (100 * z + 10 * y + x) as f32 - 50.0);
        let mut writer = VolumeWriter::begin(Cursor::new(Vec::new()), [3, 7, 5], Some(0.7)).unwrap();
        writer.write_rows(4, volume.slice(s![.., 4.., ..])).unwrap();
        assert!(writer.write_rows(6, volume.slice(s![.., 4.., ..])).is_err());
        writer.write_rows(0, volume.slice(s![.., ..4, ..])).unwrap();
        let bytes = writer.finish().unwrap().into_inner();
        assert_eq!(bytes.len(), 1024 + 4 * 3 * 7 * 5);
        for section in 0..3 {
            assert_eq!(read_bytes("volume.mrc", &bytes, section).unwrap(), volume.slice(s![2 - section, .., ..]));
        }
        let float = |offset: usize| f32::from_le_bytes(bytes[offset..offset + 4].try_into().unwrap());
        assert_eq!([float(76), float(80), float(40), float(48)], [-50.0, 214.0, 35.0, 21.0]);
        assert!((float(84) - volume.mean().unwrap()).abs() < 1e-4);
        assert!((float(216) - volume.std(0.0)).abs() < 1e-3);
        let unfinished = VolumeWriter::begin(Cursor::new(Vec::new()), [3, 7, 5], None).unwrap();
        assert!(unfinished.finish().is_err());
    }
}

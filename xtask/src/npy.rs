//! Writes arrays as `.npy` (format version 1.0, NumPy Enhancement Proposal 1) for the Python peers.

use std::io::Write;
use std::path::Path;

use miette::{IntoDiagnostic, Result};
use ndarray::Array2;

/// Writes a `[row, column]` array of f32.
pub fn write_f32(path: &Path, array: &Array2<f32>) -> Result<()> {
    let bytes = array.iter().flat_map(|value| value.to_le_bytes()).collect();
    write(path, "<f4", array.dim(), bytes)
}

/// Writes a `[row, column]` array of f64.
pub fn write_f64(path: &Path, array: &Array2<f64>) -> Result<()> {
    let bytes = array.iter().flat_map(|value| value.to_le_bytes()).collect();
    write(path, "<f8", array.dim(), bytes)
}

fn write(path: &Path, dtype: &str, (rows, columns): (usize, usize), bytes: Vec<u8>) -> Result<()> {
    let mut header = format!("{{'descr': '{dtype}', 'fortran_order': False, 'shape': ({rows}, {columns}), }}");
    // The preamble of 10 bytes, the header and its newline fill a multiple of 64 bytes.
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut file = std::fs::File::create(path).into_diagnostic()?;
    file.write_all(b"\x93NUMPY\x01\x00").into_diagnostic()?;
    file.write_all(&(header.len() as u16).to_le_bytes()).into_diagnostic()?;
    file.write_all(header.as_bytes()).into_diagnostic()?;
    file.write_all(&bytes).into_diagnostic()
}

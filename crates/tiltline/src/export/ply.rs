//! `curves.ply`: the Polygon File Format (Turk, "The PLY Polygon File Format", 1994), ascii, with vertices and edges.
//!
//! Coordinates and `sigma_z` are in the unit of the result, which a comment names; `flag` is 0 ok, 1 ill conditioned,
//! 2 bridged.

use std::io::{self, Write};

use crate::export::number::{PX_DECIMALS, fixed, length_decimals};
use crate::export::vtp::flag_code;
use crate::reconstruction::Reconstruction;

/// Writes `curves.ply`: a vertex a point, an edge between neighbours on a curve.
pub fn write(reconstruction: &Reconstruction, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    let curves = &reconstruction.curves;
    let decimals = length_decimals(&reconstruction.frame);
    let vertices: usize = curves.iter().map(|curve| curve.points.len()).sum();
    let edges: usize = curves.iter().map(|curve| curve.points.len() - usize::from(!curve.closed)).sum();
    writeln!(out, "ply\nformat ascii 1.0")?;
    writeln!(out, "comment Tiltline curves; unit {}; x right, y down, z away", reconstruction.frame.unit.word())?;
    writeln!(out, "comment flag: 0 ok, 1 ill conditioned, 2 bridged")?;
    writeln!(out, "element vertex {vertices}")?;
    for name in ["x", "y", "z", "sigma_z", "disparity_px", "sigma_disparity_px"] {
        writeln!(out, "property double {name}")?;
    }
    writeln!(out, "property int curve\nproperty uchar flag")?;
    writeln!(out, "element edge {edges}\nproperty int vertex1\nproperty int vertex2\nend_header")?;
    for (index, curve) in curves.iter().enumerate() {
        for point in &curve.points {
            for value in [point.position.x, point.position.y, point.position.z, point.sigma_z] {
                write!(out, "{} ", fixed(value, decimals))?;
            }
            let (disparity, sigma) = (point.disparity_px, point.sigma_disparity_px);
            write!(out, "{} {} ", fixed(disparity, PX_DECIMALS), fixed(sigma, PX_DECIMALS))?;
            writeln!(out, "{index} {}", flag_code(point.flag))?;
        }
    }
    let mut first = 0;
    for curve in curves {
        let last = first + curve.points.len() - 1;
        for vertex in first..last {
            writeln!(out, "{vertex} {}", vertex + 1)?;
        }
        if curve.closed {
            writeln!(out, "{last} {first}")?;
        }
        first = last + 1;
    }
    Ok(())
}

//! `curves.obj`: Wavefront OBJ ("Advanced Visualizer Manual", appendix B1): vertices `v`, groups `g`, polylines `l`.
//!
//! Coordinates are in the unit of the result, unflipped (x right, y down, z away from the viewer). Vertices count from 1.

use std::io::{self, Write};

use crate::export::number::{fixed, length_decimals};
use crate::reconstruction::Reconstruction;

/// Writes `curves.obj`: a group a curve; a closed curve returns to its first vertex.
pub fn write(reconstruction: &Reconstruction, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    let decimals = length_decimals(&reconstruction.frame);
    writeln!(out, "# Tiltline curves; unit {}; x right, y down, z away", reconstruction.frame.unit.word())?;
    let mut first = 1;
    for (index, curve) in reconstruction.curves.iter().enumerate() {
        writeln!(out, "g curve_{index}")?;
        for point in &curve.points {
            let [x, y, z] = [point.position.x, point.position.y, point.position.z].map(|value| fixed(value, decimals));
            writeln!(out, "v {x} {y} {z}")?;
        }
        write!(out, "l")?;
        for vertex in first..first + curve.points.len() {
            write!(out, " {vertex}")?;
        }
        if curve.closed {
            write!(out, " {first}")?;
        }
        writeln!(out)?;
        first += curve.points.len();
    }
    Ok(())
}

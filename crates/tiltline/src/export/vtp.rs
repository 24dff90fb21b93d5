//! `curves.vtp`: VTK XML PolyData ("VTK File Formats", vtk.org, section "XML File Formats"), ascii, one polyline a
//! curve, with data at points and at cells. ParaView opens it.
//!
//! Coordinates are in the unit of the result, which the names of the length arrays carry.

use std::fmt::Display;
use std::io::{self, Write};

use crate::curve::{Curve3, CurvePoint, Flag};
use crate::export::number::{PX_DECIMALS, fixed, length_decimals};
use crate::reconstruction::Reconstruction;

/// The number a flag has in formats without words: 0 ok, 1 ill conditioned, 2 bridged.
pub fn flag_code(flag: Flag) -> u8 {
    match flag {
        Flag::Ok => 0,
        Flag::IllConditioned => 1,
        Flag::Bridged => 2,
    }
}

/// Writes `curves.vtp`.
pub fn write(reconstruction: &Reconstruction, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    let curves = &reconstruction.curves;
    let decimals = length_decimals(&reconstruction.frame);
    let unit = reconstruction.frame.unit.word();
    let points = || curves.iter().flat_map(|curve| &curve.points);
    let px = |value: f64| fixed(value, PX_DECIMALS);
    let length = |value: f64| fixed(value, decimals);
    let point_data = |get: fn(&CurvePoint) -> f64| points().map(get);

    writeln!(out, "<?xml version=\"1.0\"?>")?;
    writeln!(
        out,
        "<!-- Tiltline curves; unit {unit}; x right, y down, z away; flag: 0 ok, 1 ill conditioned, 2 bridged -->"
    )?;
    writeln!(out, "<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">")?;
    writeln!(out, "<PolyData>")?;
    let (point_count, line_count) = (points().count(), curves.len());
    writeln!(
        out,
        "<Piece NumberOfPoints=\"{point_count}\" NumberOfVerts=\"0\" NumberOfLines=\"{line_count}\" NumberOfStrips=\"0\" NumberOfPolys=\"0\">"
    )?;
    writeln!(out, "<PointData Scalars=\"z_{unit}\">")?;
    array(out, "Float64", "disparity_px", point_data(|point| point.disparity_px).map(px))?;
    array(out, "Float64", "sigma_disparity_px", point_data(|point| point.sigma_disparity_px).map(px))?;
    array(out, "Float64", &format!("z_{unit}"), point_data(|point| point.position.z).map(length))?;
    array(out, "Float64", &format!("sigma_z_{unit}"), point_data(|point| point.sigma_z).map(length))?;
    array(out, "UInt8", "flag", points().map(|point| flag_code(point.flag)))?;
    let ids = curves.iter().enumerate().flat_map(|(index, curve)| curve.points.iter().map(move |_| index));
    array(out, "Int32", "curve", ids)?;
    writeln!(out, "</PointData>\n<CellData>")?;
    array(out, "Int32", "curve", 0..curves.len())?;
    let measured = &reconstruction.measures.per_curve;
    let lengths = curves.iter().enumerate().map(|(index, curve)| {
        // The smoothed length; that of the polyline grows with its noise.
        length(measured.get(index).map_or_else(|| curve.length(), |measures| measures.length))
    });
    array(out, "Float64", &format!("length_{unit}"), lengths)?;
    array(out, "UInt8", "closed", curves.iter().map(|curve| u8::from(curve.closed)))?;
    writeln!(out, "</CellData>\n<Points>")?;
    let xyz = points().map(|point| {
        let position = point.position;
        let [x, y, z] = [position.x, position.y, position.z].map(length);
        format!("{x} {y} {z}")
    });
    array(out, "Float64\" NumberOfComponents=\"3", "Points", xyz)?;
    writeln!(out, "</Points>\n<Lines>")?;
    let mut first = 0;
    let connectivity = curves.iter().map(|curve| {
        let mut vertices: Vec<String> = (first..first + curve.points.len()).map(|vertex| vertex.to_string()).collect();
        if curve.closed {
            vertices.push(first.to_string());
        }
        first += curve.points.len();
        vertices.join(" ")
    });
    array(out, "Int64", "connectivity", connectivity)?;
    let mut offset = 0;
    let offsets = curves.iter().map(|curve| {
        offset += vertex_count(curve);
        offset
    });
    array(out, "Int64", "offsets", offsets)?;
    writeln!(out, "</Lines>\n</Piece>\n</PolyData>\n</VTKFile>")
}

/// Vertices of a curve's polyline: a closed one names its first point twice.
fn vertex_count(curve: &Curve3) -> usize {
    curve.points.len() + usize::from(curve.closed)
}

fn array(
    out: &mut (impl Write + ?Sized),
    kind: &str,
    name: &str,
    values: impl Iterator<Item = impl Display>,
) -> io::Result<()> {
    writeln!(out, "<DataArray type=\"{kind}\" Name=\"{name}\" format=\"ascii\">")?;
    for value in values {
        writeln!(out, "{value}")?;
    }
    writeln!(out, "</DataArray>")
}

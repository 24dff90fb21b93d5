//! `curves.csv` and `lines.csv`: comma-separated values (RFC 4180, but with `\n` line ends).
//!
//! Image columns are in the pixels of the input files; `_nm` columns are `_px` where no pixel size is known.

use std::io::{self, Write};

use crate::export::number::{PX_DECIMALS, fixed, length_decimals};
use crate::micrograph::View;
use crate::reconstruction::{LengthUnit, Reconstruction};

/// Names of the columns of `curves.csv`, in order.
pub fn curve_columns(unit: LengthUnit) -> [String; 13] {
    let unit = unit.word();
    [
        "curve".into(),
        "point".into(),
        "x_left_px".into(),
        "y_left_px".into(),
        "x_right_px".into(),
        "y_right_px".into(),
        "disparity_px".into(),
        "sigma_disparity_px".into(),
        format!("x_{unit}"),
        format!("y_{unit}"),
        format!("z_{unit}"),
        format!("sigma_z_{unit}"),
        "flag".into(),
    ]
}

/// Writes `curves.csv`: one row a point of a matched curve, in the order of the curve.
pub fn write_curves(reconstruction: &Reconstruction, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    let decimals = length_decimals(&reconstruction.frame);
    writeln!(out, "{}", curve_columns(reconstruction.frame.unit).join(","))?;
    for (curve_index, curve) in reconstruction.curves.iter().enumerate() {
        for (point_index, point) in curve.points.iter().enumerate() {
            write!(out, "{curve_index},{point_index}")?;
            let in_px = [
                point.left_input.x,
                point.left_input.y,
                point.right_input.x,
                point.right_input.y,
                point.disparity_px,
                point.sigma_disparity_px,
            ];
            for value in in_px {
                write!(out, ",{}", fixed(value, PX_DECIMALS))?;
            }
            for value in [point.position.x, point.position.y, point.position.z, point.sigma_z] {
                write!(out, ",{}", fixed(value, decimals))?;
            }
            writeln!(out, ",{}", point.flag.word())?;
        }
    }
    Ok(())
}

/// Writes `lines.csv`: detected lines that found no match, in the pixels of their own input file.
pub fn write_lines(reconstruction: &Reconstruction, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    writeln!(out, "view,line,point,x_px,y_px")?;
    for (line_index, line) in reconstruction.unmatched.iter().enumerate() {
        let view = match line.view {
            View::Left => "left",
            View::Right => "right",
        };
        for (point_index, point) in line.points_input.iter().enumerate() {
            let (x, y) = (fixed(point.x, PX_DECIMALS), fixed(point.y, PX_DECIMALS));
            writeln!(out, "{view},{line_index},{point_index},{x},{y}")?;
        }
    }
    Ok(())
}

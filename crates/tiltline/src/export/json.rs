//! `curves.json`: everything in curves.csv under the same names, with the frame, measures, junctions and warnings
//! (JSON, RFC 8259). One line a curve, so that the file can be read and compared by eye.
//!
//! A number that is unknown is `null`.

use std::io::{self, Write};

use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};
use serde_json::Value;

use crate::curve::{Curve3, CurvePoint, TraceEnd};
use crate::export::csv::curve_columns;
use crate::export::graph::CurveGraph;
use crate::export::number::{PX_DECIMALS, length_decimals, rounded};
use crate::measure::Measures;
use crate::reconstruction::{LengthUnit, Reconstruction};

/// Version of the layout of this file; grows when a name changes or goes.
const FORMAT_VERSION: u32 = 1;
/// Digits of what was measured; none is known better.
const MEASURE_DIGITS: usize = 6;
/// Smaller values are rounding errors of a zero.
const NOUGHT: f64 = 1e-12;
/// Digits of maps and scales, which take part in further arithmetic.
const GEOMETRY_DIGITS: usize = 12;

/// Writes `curves.json`.
pub fn write(reconstruction: &Reconstruction, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    let unit = reconstruction.frame.unit;
    let decimals = length_decimals(&reconstruction.frame);
    let graph = CurveGraph::new(reconstruction);
    writeln!(out, "{{")?;
    entry(out, "format_version", &FORMAT_VERSION)?;
    entry(out, "tilts_deg", &[reconstruction.pair.tilts.left_rad, reconstruction.pair.tilts.right_rad].map(degrees))?;
    entry(out, "frame", &significant(serde_json::to_value(reconstruction.frame)?, GEOMETRY_DIGITS))?;
    let rectification = serde_json::to_value(&reconstruction.rectified.rectification)?;
    entry(out, "rectification", &significant(rectification, GEOMETRY_DIGITS))?;
    let measures = &reconstruction.measures;
    entry(out, "measures", &summary(measures, unit)?)?;
    entry(out, "warnings", &reconstruction.warnings)?;
    let junctions: Vec<Junction> = graph
        .junctions
        .iter()
        .map(|junction| Junction {
            position: [junction.position.x, junction.position.y, junction.position.z].map(|v| rounded(v, decimals)),
            sigma_z: rounded(junction.sigma_z, decimals),
            ends: junction
                .ends
                .iter()
                .map(|end| JunctionEnd {
                    curve: end.curve,
                    end: if end.end == 0 { "first" } else { "last" },
                    joined: end.joined,
                })
                .collect(),
        })
        .collect();
    list(out, "junctions", junctions.iter())?;
    writeln!(out, ",")?;
    // A trace's junction is known by its index in the left image; here by its index in the list above.
    let junction_of =
        |trace_junction: usize| graph.junctions.iter().position(|junction| junction.trace_junction == trace_junction);
    let mut curves = Vec::with_capacity(reconstruction.curves.len());
    for (index, curve) in reconstruction.curves.iter().enumerate() {
        curves.push(CurveEntry {
            curve: index,
            closed: curve.closed,
            ends: curve.ends.map(|end| End::new(end, &junction_of)),
            measures: significant(serde_json::to_value(measures.per_curve.get(index))?, MEASURE_DIGITS),
            points: Points { curve, unit, decimals },
        });
    }
    list(out, "curves", curves.iter())?;
    writeln!(out, "\n}}")
}

fn degrees(angle: f64) -> f64 {
    rounded(angle.to_degrees(), 6)
}

fn entry(out: &mut (impl Write + ?Sized), name: &str, value: &impl Serialize) -> io::Result<()> {
    write!(out, "\"{name}\": ")?;
    serde_json::to_writer(&mut *out, value)?;
    writeln!(out, ",")
}

fn list<T: Serialize>(out: &mut (impl Write + ?Sized), name: &str, items: impl Iterator<Item = T>) -> io::Result<()> {
    write!(out, "\"{name}\": [")?;
    for (index, item) in items.enumerate() {
        write!(out, "{}", if index == 0 { "\n" } else { ",\n" })?;
        serde_json::to_writer(&mut *out, &item)?;
    }
    write!(out, "]")
}

/// A value with its numbers rounded to so many digits that count.
pub(crate) fn significant(value: Value, digits: usize) -> Value {
    match value {
        Value::Number(number) if number.is_f64() => {
            let value = number.as_f64().filter(|value| value.abs() > NOUGHT).unwrap_or(0.0);
            let text = format!("{value:.*e}", digits - 1);
            text.parse().map_or(Value::Null, |rounded: f64| (rounded + 0.0).into())
        }
        Value::Array(items) => items.into_iter().map(|item| significant(item, digits)).collect(),
        Value::Object(entries) => entries.into_iter().map(|(name, entry)| (name, significant(entry, digits))).collect(),
        other => other,
    }
}

/// The measures of the whole result, without the table of curves, which stands with the curves.
fn summary(measures: &Measures, unit: LengthUnit) -> Result<Value, serde_json::Error> {
    let mut value = significant(serde_json::to_value(measures)?, MEASURE_DIGITS);
    if let Value::Object(entries) = &mut value {
        entries.remove("per_curve");
        entries.insert("unit".into(), unit.word().into());
    }
    Ok(value)
}

#[derive(Serialize)]
struct Junction {
    position: [f64; 3],
    sigma_z: f64,
    ends: Vec<JunctionEnd>,
}

#[derive(Serialize)]
struct JunctionEnd {
    curve: usize,
    end: &'static str,
    joined: bool,
}

#[derive(Serialize)]
#[serde(rename_all = "snake_case")]
enum End {
    Free,
    Border,
    Junction(usize),
}

impl End {
    fn new(end: TraceEnd, junction_of: &impl Fn(usize) -> Option<usize>) -> Self {
        match end {
            TraceEnd::Free => End::Free,
            TraceEnd::Border => End::Border,
            TraceEnd::Junction(index) => junction_of(index).map_or(End::Free, End::Junction),
        }
    }
}

#[derive(Serialize)]
struct CurveEntry<'a> {
    curve: usize,
    closed: bool,
    ends: [End; 2],
    measures: Value,
    points: Points<'a>,
}

/// The columns of curves.csv, an array each.
struct Points<'a> {
    curve: &'a Curve3,
    unit: LengthUnit,
    decimals: usize,
}

impl Serialize for Points<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let names = curve_columns(self.unit);
        let getters: [fn(&CurvePoint) -> f64; 10] = [
            |point| point.left_input.x,
            |point| point.left_input.y,
            |point| point.right_input.x,
            |point| point.right_input.y,
            |point| point.disparity_px,
            |point| point.sigma_disparity_px,
            |point| point.position.x,
            |point| point.position.y,
            |point| point.position.z,
            |point| point.sigma_z,
        ];
        let mut map = serializer.serialize_map(Some(getters.len() + 1))?;
        // The first two columns, curve and point, are the place in this file.
        for (index, get) in getters.iter().enumerate() {
            let decimals = if index < 6 { PX_DECIMALS } else { self.decimals };
            let values: Vec<f64> = self.curve.points.iter().map(|point| rounded(get(point), decimals)).collect();
            map.serialize_entry(&names[index + 2], &values)?;
        }
        let flags: Vec<&str> = self.curve.points.iter().map(|point| point.flag.word()).collect();
        map.serialize_entry(&names[12], &flags)?;
        map.end()
    }
}

//! `metrics.jsonl`, a line a report, and `curves.svg`, the same as a picture.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::TrainError;
use crate::weights::write_atomically;

/// One line: a step with means since the last line, or a validation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Line {
    /// Steps done.
    pub step: u64,
    /// "train" or "validation".
    pub kind: String,
    /// Learning rate.
    pub rate: f64,
    /// Time since the start, s.
    pub seconds: f64,
    /// Values by name.
    pub values: BTreeMap<String, f64>,
}

/// All lines so far.
#[derive(Clone, Debug, Default)]
pub struct Metrics(pub Vec<Line>);

impl Metrics {
    /// The lines of a run's folder up to a step: a resumed run forgets what was after its checkpoint.
    pub fn read(folder: &Path, last_step: u64) -> Self {
        let text = fs::read_to_string(folder.join("metrics.jsonl")).unwrap_or_default();
        let lines = text.lines().filter_map(|line| serde_json::from_str::<Line>(line).ok());
        Self(lines.filter(|line| line.step <= last_step).collect())
    }

    /// Writes both files.
    pub fn write(&self, folder: &Path) -> Result<(), TrainError> {
        let mut text = String::new();
        for line in &self.0 {
            text += &serde_json::to_string(line).expect("plain data has a JSON form");
            text += "\n";
        }
        for (name, bytes) in [("metrics.jsonl", text.into_bytes()), ("curves.svg", self.svg().into_bytes())] {
            let path = folder.join(name);
            write_atomically(&path, &bytes).map_err(|source| TrainError::Io { path, source })?;
        }
        Ok(())
    }

    /// Every value against the step, on a logarithmic axis each series shares.
    fn svg(&self) -> String {
        const SIZE: [f64; 2] = [760.0, 420.0];
        const BOX: [f64; 4] = [64.0, 16.0, 560.0, 370.0];
        // Colours that the colour-blind can tell apart (Okabe & Ito 2008).
        const COLOURS: [&str; 8] =
            ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#999999"];
        let mut series: BTreeMap<String, Vec<(f64, f64)>> = BTreeMap::new();
        for line in &self.0 {
            for (name, value) in line.values.iter().filter(|(_, value)| value.is_finite() && **value > 0.0) {
                series.entry(format!("{} {name}", line.kind)).or_default().push((line.step as f64, value.log10()));
            }
        }
        let points = || series.values().flatten();
        let last = points().map(|point| point.0).fold(1.0, f64::max);
        let low = points().map(|point| point.1).fold(f64::INFINITY, f64::min).floor().max(-6.0);
        let high = points().map(|point| point.1).fold(f64::NEG_INFINITY, f64::max).ceil().max(low + 1.0);
        let [left, top, right, bottom] = BOX;
        let x = |step: f64| left + (right - left) * step / last;
        let y = |value: f64| bottom - (bottom - top) * (value - low) / (high - low);
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" font-family=\"sans-serif\" font-size=\"12\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
            SIZE[0], SIZE[1]
        );
        if low.is_finite() {
            for decade in low as i32..=high as i32 {
                let at = y(f64::from(decade));
                let _ = writeln!(
                    svg,
                    "<line x1=\"{left}\" x2=\"{right}\" y1=\"{at:.1}\" y2=\"{at:.1}\" stroke=\"#ddd\"/>\
                     <text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">1e{decade}</text>",
                    left - 6.0,
                    at + 4.0
                );
            }
        }
        let _ = writeln!(
            svg,
            "<text x=\"{left}\" y=\"{0}\">0</text><text x=\"{right}\" y=\"{0}\" text-anchor=\"end\">step {last}</text>",
            bottom + 18.0
        );
        for (index, (name, points)) in series.iter().enumerate() {
            let colour = COLOURS[index % COLOURS.len()];
            let path: Vec<String> =
                points.iter().map(|(step, value)| format!("{:.1},{:.1}", x(*step), y(value.max(low)))).collect();
            let at = top + 16.0 * (index as f64 + 1.0);
            let _ = writeln!(
                svg,
                "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/>\
                 <text x=\"{}\" y=\"{at}\" fill=\"{colour}\">{name}</text>",
                path.join(" "),
                right + 12.0
            );
        }
        svg + "</svg>\n"
    }
}

//! The summary of a run: a table for people, JSON for programs.

use std::fmt;

use serde::Serialize;
use tiltline::curve::{Flag, TraceGraph};
use tiltline::geometry::{Point2, length2};
use tiltline::measure::{Density, DensityUnit, DepthRange, Foil, Known};
use tiltline::micrograph::View;
use tiltline::reconstruction::{LengthUnit, Reconstruction};
use tiltline::rectify::Rectification;
use tiltline::warning::Warning;

use crate::quantity::short;

/// What a user wants to know first.
#[derive(Debug, Serialize)]
pub struct Summary {
    /// Unit of all 3D lengths.
    pub unit: LengthUnit,
    /// Side of a pixel in nm; `null` where unknown.
    pub pixel_size_nm: Option<f64>,
    /// Tilts, and where they and the pixel size came from.
    pub provenance: Provenance,
    /// Which views of a series were used, and why; absent for a pair of files.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub views: Option<String>,
    /// How the images were made to match.
    pub rectification: Rectification,
    /// Detected lines in the left and the right image.
    pub lines: [LineCount; 2],
    /// Curves found in both.
    pub curves: usize,
    /// Length of the matched curves in the rectified left image, px.
    pub matched_length_px: f64,
    /// Length of detected lines without a match, left and right, px.
    pub unmatched_length_px: [f64; 2],
    /// Shares of points by flag: ok, ill conditioned, bridged.
    pub flags: [f64; 3],
    /// Smallest and largest disparity, px; `null` without curves.
    pub disparity_range_px: Option<[f64; 2]>,
    /// Median sigma of the disparity, px; `null` without curves.
    pub median_sigma_disparity_px: Option<f64>,
    /// Length in the foil and its sigma, in the unit.
    pub length: [f64; 2],
    /// Depth range, in the unit.
    pub depth: Option<DepthRange>,
    /// Relative error of all depths alike from the error of the tilt angle.
    pub relative_tilt_error: f64,
    /// Whether the user turned the sign of depth.
    pub depth_flipped: bool,
    /// The foil's surfaces, or why they are unknown.
    pub foil: Known<Foil>,
    /// Dislocation density, or why it is unknown.
    pub density: Known<Density>,
    /// Partial failures.
    pub warnings: Vec<Warning>,
}

/// Where the numbers about the pair came from.
#[derive(Debug, Serialize)]
pub struct Provenance {
    /// Tilts of left and right, degrees.
    pub tilts_deg: [f64; 2],
    /// Where the tilts came from.
    pub tilts_from: String,
    /// Where the pixel size came from; `null` where it is unknown.
    pub pixel_size_from: Option<String>,
}

/// Lines of one view.
#[derive(Debug, Serialize)]
pub struct LineCount {
    /// How many.
    pub count: usize,
    /// Their length, px.
    pub length_px: f64,
}

impl Summary {
    /// The summary of a result.
    pub fn of(result: &Reconstruction, provenance: Provenance) -> Self {
        let points: Vec<_> = result.curves.iter().flat_map(|curve| &curve.points).collect();
        let share =
            |flag: Flag| points.iter().filter(|point| point.flag == flag).count() as f64 / points.len().max(1) as f64;
        let mut sigmas: Vec<f64> = points.iter().map(|point| point.sigma_disparity_px).collect();
        sigmas.sort_unstable_by(f64::total_cmp);
        let disparities = points.iter().map(|point| point.disparity_px);
        let range = disparities.fold(None, |range: Option<[f64; 2]>, d| {
            Some(range.map_or([d, d], |[low, high]| [low.min(d), high.max(d)]))
        });
        let unmatched = |view: View| {
            let lines = result.unmatched.iter().filter(|line| line.view == view);
            lines.fold(0.0, |sum, line| sum + length2(&line.points_input))
        };
        let measures = &result.measures;
        Self {
            unit: result.frame.unit,
            pixel_size_nm: result.pair.pixel_size_nm(),
            provenance,
            views: None,
            rectification: result.rectified.rectification.clone(),
            lines: [0, 1].map(|view| count(&result.traces[view])),
            curves: result.curves.len(),
            matched_length_px: result.matched.iter().map(|curve| curve.length_px()).sum(),
            unmatched_length_px: View::BOTH.map(unmatched),
            flags: [Flag::Ok, Flag::IllConditioned, Flag::Bridged].map(share),
            disparity_range_px: range,
            median_sigma_disparity_px: sigmas.get(sigmas.len() / 2).copied(),
            length: [measures.total_length, measures.total_length_sigma],
            depth: measures.depth,
            relative_tilt_error: result.frame.relative_tilt_error,
            depth_flipped: result.frame.depth_flipped,
            foil: measures.foil.clone(),
            density: measures.density.clone(),
            warnings: result.warnings.clone(),
        }
    }
}

fn count(graph: &TraceGraph) -> LineCount {
    let length = |trace: &tiltline::curve::Trace| {
        let points: Vec<Point2> = trace.points.iter().map(|point| point.position).collect();
        length2(&points)
    };
    LineCount { count: graph.traces.len(), length_px: graph.traces.iter().map(length).sum() }
}

impl fmt::Display for Summary {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unit = self.unit.word();
        let mut row = |name: &str, text: String| writeln!(formatter, "{name:<15} {text}");
        let Provenance { tilts_deg: [left, right], tilts_from, pixel_size_from } = &self.provenance;
        let size = match (self.pixel_size_nm, pixel_size_from) {
            (Some(nm), Some(origin)) => format!("{} nm ({origin})", short(nm)),
            (Some(nm), None) => format!("{} nm", short(nm)),
            (None, _) => "of unknown size: lengths are in px".into(),
        };
        row("pair", format!("tilts {left} and {right}\u{b0} ({tilts_from}); pixels {size}"))?;
        if let Some(views) = &self.views {
            row("views", views.clone())?;
        }
        let r = &self.rectification;
        row(
            "rectification",
            format!(
                "{} of {} point matches, rows agree to {:.2} px rms; axis {:.2} \u{b1} {:.2}\u{b0}{}, rotation {:.3}\u{b0}, scale {:.4}",
                r.inliers,
                r.matches,
                r.rms_row_error_px,
                r.axis_deg,
                r.axis_sigma_deg,
                if r.axis_held_by_prior { " (as given, not seen)" } else { "" },
                r.relative_rotation_deg,
                r.relative_scale
            ),
        )?;
        let [left, right] = &self.lines;
        row(
            "lines",
            format!(
                "left {} ({:.0} px), right {} ({:.0} px)",
                left.count, left.length_px, right.count, right.length_px
            ),
        )?;
        row(
            "matched",
            format!(
                "{} curves, {:.0} px of the left image; without match {:.0} px left, {:.0} px right (lines.csv)",
                self.curves, self.matched_length_px, self.unmatched_length_px[0], self.unmatched_length_px[1]
            ),
        )?;
        if let (Some([low, high]), Some(sigma)) = (self.disparity_range_px, self.median_sigma_disparity_px) {
            row(
                "disparity",
                format!(
                    "{low:.2} to {high:.2} px, median sigma {sigma:.2} px; {:.0} % ill conditioned, {:.0} % bridged",
                    100.0 * self.flags[1],
                    100.0 * self.flags[2]
                ),
            )?;
        }
        row("length", format!("{:.0} \u{b1} {:.0} {unit} in the foil", self.length[0], self.length[1]))?;
        if let Some(depth) = &self.depth {
            row(
                "depth",
                format!(
                    "{:.1} to {:.1} {unit} (95 % of the length), sigma {:.1} {unit}; tilt error scales all by {:.1} %; \
                     sign {}",
                    depth.low,
                    depth.high,
                    depth.sigma_z,
                    100.0 * self.relative_tilt_error,
                    if self.depth_flipped { "turned as asked" } else { "as the tilts say" }
                ),
            )?;
        }
        row(
            "thickness",
            match &self.foil {
                Known::Known(foil) => format!(
                    "{:.0} {unit} (95 %: {:.0} to {:.0}), normal {:.0}\u{b0} from the beam",
                    foil.thickness, foil.thickness_interval[0], foil.thickness_interval[1], foil.normal_tilt_deg
                ),
                Known::Unknown(reason) => format!("unknown: {reason}"),
            },
        )?;
        row(
            "density",
            match &self.density {
                Known::Known(density) => format!(
                    "{:.2e} {} (95 %: {:.2e} to {:.2e}); {}",
                    density.value,
                    density_unit(density.unit),
                    density.low,
                    density.high,
                    density.note
                ),
                Known::Unknown(reason) => format!("unknown: {reason}"),
            },
        )?;
        for warning in &self.warnings {
            row("warning", warning.to_string())?;
        }
        Ok(())
    }
}

fn density_unit(unit: DensityUnit) -> &'static str {
    unit.word()
}

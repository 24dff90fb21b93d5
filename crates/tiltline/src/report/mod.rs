//! `report.html`: a result as one page that opens offline in any browser, and the same figures for print.
//!
//! [`Report`] is what is embedded in the page, once, as JSON: the page draws its views and makes its downloads from it,
//! and [`page::read`] takes it out again, so that figures can be made from a page alone. The page itself is built from
//! the sources in `web/` (`cargo xtask web`); its layout is described in docs/report.md.

pub mod figures;
pub mod image;
pub mod page;
pub mod series;
pub mod tomogram;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::curve::{Curve3, Flag, TraceEnd};
use crate::export::json::significant;
use crate::export::number::rounded;
use crate::export::vtp::flag_code;
use crate::geometry::Point2;
use crate::measure::Measures;
use crate::micrograph::{Source, View};
use crate::reconstruction::{Frame, Reconstruction};
use crate::rectify::Rectification;
use crate::report::image::Picture;
use crate::report::series::ReportSeries;
use crate::series::SeriesError;
use crate::warning::Warning;

/// Version of the layout of the embedded JSON; grows when a name changes or goes.
pub const FORMAT_VERSION: u32 = 1;
/// Decimals of positions on the rectified grid, px.
const POSITION_DECIMALS: usize = 3;
/// Decimals of disparities, their sigma and residuals, px: depth is many times disparity.
const DISPARITY_DECIMALS: usize = 4;
/// Decimals of detected lines, which are only looked at.
const LINE_DECIMALS: usize = 1;
/// Detected lines are drawn this close to their points, px.
const LINE_TOLERANCE_PX: f64 = 0.2;
/// Digits of measures; none is known better.
const MEASURE_DIGITS: usize = 6;
/// Digits of maps and scales, which take part in further arithmetic; so few are read back as they were written.
const GEOMETRY_DIGITS: usize = 12;

/// Why a page could not be made or read.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// A picture is too large for JPEG.
    #[error(
        "the rectified image has {columns} x {rows} px, and a JPEG image has 65535 at most along a side; crop the input"
    )]
    TooLarge {
        /// Columns of the rectified grid.
        columns: usize,
        /// Rows.
        rows: usize,
    },
    /// The JPEG encoder failed.
    #[error("cannot encode a picture of the report: {0}")]
    Jpeg(#[from] jpeg_encoder::EncodingError),
    /// The embedded JSON could not be written or understood.
    #[error("the data of the report cannot be read or written: {0}; reconstruct the pair again")]
    Json(#[from] serde_json::Error),
    /// A view of the series cannot be read again.
    #[error(transparent)]
    View(Box<SeriesError>),
    /// There is no report in a text.
    #[error(
        "this is not a report: it has no <script id=\"{}\">; name a folder or report.html that `tiltline reconstruct` wrote",
        page::DATA_ID
    )]
    NoData,
    /// The report is of another time.
    #[error(
        "the report has format version {found}, and this program reads {FORMAT_VERSION}: reconstruct the pair again"
    )]
    Version {
        /// Its version.
        found: u32,
    },
}

/// Everything the page shows.
///
/// Positions are on the rectified grid in px; 3D points follow from them with [`Report::position`]. Lengths in `measures`
/// are in the unit of the frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// [`FORMAT_VERSION`].
    pub format_version: u32,
    /// Version of the program that wrote it.
    pub program: String,
    /// Files of left and right.
    pub sources: [Source; 2],
    /// Tilts of left and right, degrees.
    pub tilts_deg: [f64; 2],
    /// Scale and origin of the 3D points.
    pub frame: Frame,
    /// How the images were made to match.
    pub rectification: Rectification,
    /// Point matches that agree with it.
    pub point_matches: PointColumns,
    /// Left and right.
    pub views: [ReportView; 2],
    /// The curves in their order in `curves.csv`.
    pub curves: Vec<ReportCurve>,
    /// Measures of the whole and, in `per_curve`, of each curve.
    pub measures: Measures,
    /// Partial failures.
    pub warnings: Vec<Warning>,
    /// The run record (`run.toml`), as text.
    pub run: String,
    /// The other views of the series that the pair is of, where they were looked at.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub series: Option<ReportSeries>,
}

/// One rectified image and what was found in it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReportView {
    /// The rectified image.
    pub image: Picture,
    /// Line probability on the same grid.
    pub probability: Picture,
    /// Corners of the input image on the rectified grid, px, in order around it.
    pub corners: [[f64; 2]; 4],
    /// Detected lines, each `x, y, x, y, ...` in rectified px.
    pub lines: Vec<Vec<f64>>,
    /// Stretches of them without a match.
    pub unmatched: Vec<Vec<f64>>,
    /// Length of the detected lines and of those without a match, px.
    pub length_px: [f64; 2],
}

/// Point matches on the rectified grid, a column each.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PointColumns {
    /// Column in the left image, px.
    pub x: Vec<f64>,
    /// Row in the left image, px.
    pub y: Vec<f64>,
    /// Disparity, `x_R - x_L`, px.
    pub disparity: Vec<f64>,
    /// Row residual, `y_R - y_L`, px.
    pub row: Vec<f64>,
}

/// A curve, a column for each quantity of its points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReportCurve {
    /// Whether the last point joins the first.
    pub closed: bool,
    /// What the first and last point end at: `free`, `border` or `junction`.
    pub ends: [CurveEnd; 2],
    /// Column in the rectified left image, px.
    pub x: Vec<f64>,
    /// Row, px.
    pub y: Vec<f64>,
    /// Disparity, px.
    pub disparity: Vec<f64>,
    /// One sigma of it, px.
    pub sigma: Vec<f64>,
    /// A digit a point: 0 ok, 1 ill conditioned, 2 bridged.
    pub flags: String,
}

/// What a curve ends at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CurveEnd {
    /// Inside the image.
    Free,
    /// At the border of the valid region.
    Border,
    /// Where it meets others.
    Junction,
}

impl Report {
    /// The report of a result; `run` is the text of its run record.
    ///
    /// # Errors
    /// Where a picture cannot be encoded.
    pub fn new(result: &Reconstruction, run: &str) -> Result<Self, ReportError> {
        let (left, right) = rayon::join(|| view(result, View::Left), || view(result, View::Right));
        let tilts = result.pair.tilts;
        Ok(Self {
            format_version: FORMAT_VERSION,
            program: env!("CARGO_PKG_VERSION").into(),
            sources: [result.pair.left.source.clone(), result.pair.right.source.clone()],
            tilts_deg: [tilts.left_rad, tilts.right_rad].map(|tilt| rounded(tilt.to_degrees(), 6)),
            frame: kept(&result.frame, GEOMETRY_DIGITS)?,
            // Without its points, which are in columns of their own.
            rectification: kept(&result.rectified.rectification, GEOMETRY_DIGITS)?,
            point_matches: point_columns(&result.rectified.rectification),
            views: [left?, right?],
            curves: result.curves.iter().map(curve).collect(),
            measures: kept(&result.measures, MEASURE_DIGITS)?,
            warnings: result.warnings.clone(),
            run: run.to_owned(),
            series: None,
        })
    }

    /// Place of a point in the mid-view frame, in the unit: x right, y down, z away from the viewer.
    pub fn position(&self, curve: &ReportCurve, point: usize) -> [f64; 3] {
        let Frame { pixel, centre_px: [cx, cy], depth_gain, median_z, .. } = self.frame;
        let (x, disparity) = (curve.x[point], curve.disparity[point]);
        let cos_half_phi = (0.5 * (self.tilts_deg[1] - self.tilts_deg[0]).to_radians()).cos();
        [
            (x + 0.5 * disparity - cx) / cos_half_phi * pixel,
            (curve.y[point] - cy) * pixel,
            disparity * depth_gain * pixel - median_z,
        ]
    }

    /// One sigma of a disparity as one sigma of z, in the unit.
    pub fn sigma_z(&self, sigma_px: f64) -> f64 {
        sigma_px * self.frame.depth_gain.abs() * self.frame.pixel
    }
}

/// A value with its numbers rounded as they are written, so that a report that was read is the one that was written.
fn kept<T: Serialize + DeserializeOwned>(value: &T, digits: usize) -> Result<T, serde_json::Error> {
    serde_json::from_value(significant(serde_json::to_value(value)?, digits))
}

fn point_columns(rectification: &Rectification) -> PointColumns {
    let mut columns = PointColumns::default();
    for pair in &rectification.points {
        let left = rectification.rectified_from_left * pair.left;
        let apart = rectification.rectified_from_right * pair.right - left;
        columns.x.push(rounded(left.x, 2));
        columns.y.push(rounded(left.y, 2));
        columns.disparity.push(rounded(apart.x, DISPARITY_DECIMALS));
        columns.row.push(rounded(apart.y, DISPARITY_DECIMALS));
    }
    columns
}

fn view(result: &Reconstruction, view: View) -> Result<ReportView, ReportError> {
    let map = result.rectified.rectification.rectified_from(view);
    let (rows, columns) = result.pair.view(view).pixels.dim();
    // Half a pixel beyond the centres of the outermost pixels.
    let [right, bottom] = [columns, rows].map(|side| side as f64 - 0.5);
    let corners = [[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]];
    let rectified = |line: &[Point2]| line.iter().map(|point| map * point).collect::<Vec<Point2>>();
    let traces = &result.traces[view.index()].traces;
    let lines: Vec<Vec<Point2>> = traces
        .iter()
        .map(|trace| {
            let closing = trace.closed.then(|| &trace.points[0]);
            trace.points.iter().chain(closing).map(|point| point.position).collect()
        })
        .collect();
    let unmatched = result.unmatched.iter().filter(|line| line.view == view);
    let unmatched: Vec<Vec<Point2>> = unmatched.map(|line| rectified(&line.points_input)).collect();
    let length =
        |lines: &[Vec<Point2>]| rounded(lines.iter().map(|line| crate::geometry::length2(line)).sum(), LINE_DECIMALS);
    let (image, probability) = rayon::join(
        || Picture::encode(result.rectified.view(view)),
        || Picture::encode(&result.lines[view.index()].probability),
    );
    Ok(ReportView {
        image: image?,
        probability: probability?,
        corners: corners.map(|[x, y]| {
            let corner = map * Point2::new(x, y);
            [corner.x, corner.y].map(|value| rounded(value, 2))
        }),
        length_px: [length(&lines), length(&unmatched)],
        lines: lines.iter().map(|line| thinned(line)).collect(),
        unmatched: unmatched.iter().map(|line| thinned(line)).collect(),
    })
}

fn curve(curve: &Curve3) -> ReportCurve {
    let points = &curve.points;
    let flag = |flag: Flag| char::from(b'0' + flag_code(flag));
    ReportCurve {
        closed: curve.closed,
        ends: curve.ends.map(|end| match end {
            TraceEnd::Free => CurveEnd::Free,
            TraceEnd::Border => CurveEnd::Border,
            TraceEnd::Junction(_) => CurveEnd::Junction,
        }),
        x: points.iter().map(|point| rounded(point.left_rectified.x, POSITION_DECIMALS)).collect(),
        y: points.iter().map(|point| rounded(point.left_rectified.y, POSITION_DECIMALS)).collect(),
        disparity: points.iter().map(|point| rounded(point.disparity_px, DISPARITY_DECIMALS)).collect(),
        sigma: points.iter().map(|point| rounded(point.sigma_disparity_px, DISPARITY_DECIMALS)).collect(),
        flags: points.iter().map(|point| flag(point.flag)).collect(),
    }
}

/// A line with the points left out that lie within [`LINE_TOLERANCE_PX`] of what is kept (Douglas and Peucker 1973), as
/// `x, y, x, y, ...`.
fn thinned(line: &[Point2]) -> Vec<f64> {
    let mut kept = vec![false; line.len()];
    let mut spans = vec![(0, line.len().saturating_sub(1))];
    while let Some((first, last)) = spans.pop() {
        let (Some(a), Some(b)) = (line.get(first), line.get(last)) else { continue };
        kept[first] = true;
        kept[last] = true;
        let chord = b - a;
        let distance = |point: &Point2| {
            let from_a = point - a;
            // Along a chord of no length every point counts by its distance.
            if chord.norm() > 1e-9 { chord.perp(&from_a).abs() / chord.norm() } else { from_a.norm() }
        };
        let inner = (first + 1..last).map(|index| (index, distance(&line[index])));
        if let Some((index, far)) = inner.max_by(|a, b| a.1.total_cmp(&b.1))
            && far > LINE_TOLERANCE_PX
        {
            spans.push((first, index));
            spans.push((index, last));
        }
    }
    let points = line.iter().zip(kept).filter(|(_, kept)| *kept);
    points.flat_map(|(point, _)| [point.x, point.y]).map(|value| rounded(value, LINE_DECIMALS)).collect()
}

#[cfg(test)]
mod tests;

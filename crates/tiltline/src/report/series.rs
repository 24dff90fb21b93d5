//! What the report of a series shows beside that of its pair: the curves in the other views, and beside a tomogram.

use serde::{Deserialize, Serialize};

use super::image::Picture;
use super::tomogram::ReportTomogram;
use super::{GEOMETRY_DIGITS, MEASURE_DIGITS, ReportError, kept, thinned};
use crate::export::number::rounded;
use crate::geometry::Point2;
use crate::micrograph::Micrograph;
use crate::series::{
    Distances, LineIndex, Reprojection, SavedCurves, Series, SeriesError, SeriesFit, ViewPose, chance_near_lines,
};
use crate::warning::Warning;

/// Pictures of views have at most so many px a side: they are looked at in a row.
const PICTURE_PX: usize = 448;
/// Tilts that differ by less are the same view's, degrees.
const SAME_TILT_DEG: f64 = 0.005;
/// Views that are pictured where none are named.
const PICTURES: usize = 8;

/// A series in the report.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ReportSeries {
    /// The file or folder.
    pub path: String,
    /// Whether the curves were fitted to these views; if not, the views beside the pair are an independent test.
    pub fitted: bool,
    /// The views by ascending tilt.
    pub views: Vec<ReportSeriesView>,
    /// What the other views say about the pair, in sentences.
    pub checks: Vec<String>,
    /// Doubts about the series and its alignment.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<Warning>,
    /// Pictures of some of the views.
    pub pictures: Vec<ViewPicture>,
    /// The comparison with a tomogram, if one was made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tomogram: Option<ReportTomogram>,
}

/// One view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReportSeriesView {
    /// Its tilt as the series has it, degrees.
    pub tilt_deg: f64,
    /// Whether it is of the pair.
    pub in_pair: bool,
    /// Whether more points lie on lines than would by chance.
    pub supported: bool,
    /// Distances of projected points to the nearest detected line, px of the view.
    pub distances: Option<Distances>,
    /// What the fit found as the error of the tilt, and one sigma of it, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tilt_error_deg: Option<[f64; 2]>,
}

/// A view to look at, with what is needed to draw the curves of the report on it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewPicture {
    /// Its tilt, degrees.
    pub tilt_deg: f64,
    /// Columns and rows of the view, px.
    pub size_px: [usize; 2],
    /// The view, averaged down to at most 448 px a side.
    pub image: Picture,
    /// Side of a pixel of `image` in px of the view.
    pub step_px: usize,
    /// Rows (a, b, c, d): px of the view are `a x + b y + c z + d` of a curve's position in the unit of the frame.
    pub projection: [[f64; 4]; 2],
    /// Detected lines, each `x, y, x, y, ...` in px of the view.
    pub lines: Vec<Vec<f64>>,
}

/// Rows that project positions of the result's curves, in its unit and with its sign of depth, into a view.
fn projection(pose: &ViewPose, curves: &SavedCurves) -> Result<[[f64; 4]; 2], ReportError> {
    let (_, pixel) = curves.unit;
    let sign = if curves.depth_flipped { -1.0 } else { 1.0 };
    let ([x, y], origin) = (pose.rows(), pose.origin());
    let row = |row: &crate::geometry::Vector3, shift: f64| [row.x / pixel, row.y / pixel, sign * row.z / pixel, shift];
    Ok(kept(&[row(&x, origin.x), row(&y, origin.y)], GEOMETRY_DIGITS)?)
}

impl ViewPicture {
    /// The picture of a view.
    ///
    /// # Errors
    /// Where it cannot be encoded.
    pub fn new(
        image: &Micrograph,
        tilt_deg: f64,
        pose: &ViewPose,
        lines: &LineIndex,
        curves: &SavedCurves,
    ) -> Result<Self, ReportError> {
        let pixels = image.normalised();
        let (rows, columns) = pixels.dim();
        let step_px = rows.max(columns).div_ceil(PICTURE_PX).max(1);
        let traces = lines.lines().traces.traces.iter();
        let points = |trace: &crate::curve::Trace| {
            let closing = trace.closed.then(|| &trace.points[0]);
            trace.points.iter().chain(closing).map(|point| point.position).collect::<Vec<Point2>>()
        };
        Ok(Self {
            tilt_deg,
            size_px: [columns, rows],
            image: Picture::reduced(&pixels, step_px)?,
            step_px,
            projection: projection(pose, curves)?,
            lines: traces.map(|trace| thinned(&points(trace))).collect(),
        })
    }
}

impl ReportSeries {
    /// Views that are pictured: so many at most, spread over the tilts, both ends among them.
    pub fn pictured(views: &[usize]) -> Vec<usize> {
        if views.len() <= PICTURES {
            return views.to_vec();
        }
        (0..PICTURES).map(|at| views[at * (views.len() - 1) / (PICTURES - 1)]).collect()
    }

    /// Of a re-projection; `pictured` are places in the series.
    ///
    /// # Errors
    /// Where a view cannot be read or encoded.
    pub fn of_reprojection(
        found: &Reprojection,
        series: &Series,
        curves: &SavedCurves,
        pictured: &[usize],
    ) -> Result<Self, ReportError> {
        let view = |view: &crate::series::ViewReprojection| {
            Ok(ReportSeriesView {
                tilt_deg: view.tilt_deg,
                in_pair: view.in_pair,
                supported: view.supported,
                distances: kept(&view.distances, MEASURE_DIGITS)?,
                tilt_error_deg: None,
            })
        };
        let drawn = found.views.iter().filter(|view| pictured.contains(&view.view));
        let pictures = drawn.map(|view| {
            let lines = LineIndex::new(view.lines.clone());
            ViewPicture::new(&read(series, view.view)?, view.tilt_deg, &view.pose, &lines, curves)
        });
        Ok(Self {
            path: series.path.clone(),
            fitted: false,
            views: found.views.iter().map(view).collect::<Result<_, ReportError>>()?,
            checks: found.checks.sentences(),
            warnings: found.warnings.clone(),
            pictures: pictures.collect::<Result<_, _>>()?,
            tomogram: None,
        })
    }

    /// What stays when curves that a report showed are drawn into views again: that they were fitted to views, what that found
    /// of the tilts, and the tomogram.
    #[must_use]
    pub fn after(mut self, before: Option<Self>) -> Self {
        let Some(before) = before else { return self };
        self.fitted |= before.fitted;
        for view in &mut self.views {
            let same = before.views.iter().find(|other| (other.tilt_deg - view.tilt_deg).abs() < SAME_TILT_DEG);
            view.tilt_error_deg = view.tilt_error_deg.or(same.and_then(|other| other.tilt_error_deg));
        }
        self.tomogram = self.tomogram.or(before.tomogram);
        self
    }

    /// Of a fit to all views.
    ///
    /// # Errors
    /// Where a view cannot be read or encoded.
    pub fn of_fit(fit: &SeriesFit, series: &Series) -> Result<Self, ReportError> {
        let curves = SavedCurves::of(&fit.reconstruction);
        let grown = &fit.grown;
        let mut order: Vec<usize> = (0..grown.views.len()).collect();
        order.sort_by_key(|place| grown.views[*place].view);
        let view = |place: &usize| {
            let view = &grown.views[*place];
            let projected: Vec<Vec<Point2>> = curves.projected(&view.pose);
            let chance = chance_near_lines(&view.lines);
            let error = (view.pose.tilt_rad - view.nominal_rad).to_degrees();
            Ok(ReportSeriesView {
                tilt_deg: series.views[view.view].tilt_deg,
                in_pair: *place < 2,
                supported: true,
                distances: kept(&Distances::to_lines(&projected, &view.lines, chance), MEASURE_DIGITS)?,
                tilt_error_deg: Some([error, grown.tilt_sigma_rad[*place].to_degrees()].map(|value| rounded(value, 5))),
            })
        };
        let pictures = Self::pictured(&order).into_iter().map(|place| {
            let view = &grown.views[place];
            let tilt_deg = series.views[view.view].tilt_deg;
            ViewPicture::new(&read(series, view.view)?, tilt_deg, &view.pose, &view.lines, &curves)
        });
        Ok(Self {
            path: series.path.clone(),
            fitted: true,
            views: order.iter().map(view).collect::<Result<_, ReportError>>()?,
            checks: Vec::new(),
            warnings: Vec::new(),
            pictures: pictures.collect::<Result<_, _>>()?,
            tomogram: None,
        })
    }
}

fn read(series: &Series, view: usize) -> Result<Micrograph, ReportError> {
    series.view(view).map_err(|error: SeriesError| ReportError::View(Box::new(error)))
}

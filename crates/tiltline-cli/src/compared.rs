//! A tomogram beside the curves of a result: the figures, and their place in the result's report.

use std::path::{Path, PathBuf};

use miette::{IntoDiagnostic, Result, WrapErr, miette};
use ndarray::{Array3, Axis};
use tiltline::filter::percentiles;
use tiltline::geometry::Point3;
use tiltline::report::image::Picture;
use tiltline::report::series::{ReportSeries, ReportTomogram};
use tiltline::series::{SavedCurves, Series};
use tiltline::tomography::Geometry;
use tiltline::tomography::compare::{REACH_PX, compare};

use crate::report::update;

/// Layers above and below the deepest curves, px.
const MARGIN_PX: f64 = 16.0;
/// A volume that is compared is held in memory as a whole; not more than so many voxels (4 bytes each).
const MOST_VOXELS: usize = 1 << 31;
/// Pictures of the volume have at most so many px a side.
const PICTURE_PX: usize = 768;

/// A result that a tomogram is compared with.
pub struct Compared {
    folder: PathBuf,
    curves: SavedCurves,
}

/// A volume of zeros in memory.
pub fn whole(shape: [usize; 3]) -> Result<Array3<f32>> {
    if shape.iter().product::<usize>() > MOST_VOXELS {
        let [depth, rows, columns] = shape;
        return Err(miette!(
            "a volume of {columns} x {rows} x {depth} voxels is too large to be compared with curves; give fewer layers with --depth"
        ));
    }
    Ok(Array3::zeros(shape))
}

impl Compared {
    /// Reads the curves of a result's folder.
    pub fn read(folder: &Path) -> Result<Self> {
        let curves = SavedCurves::read(folder).into_diagnostic()?;
        if curves.curves.is_empty() {
            return Err(miette!("{} has no curves: there is nothing to compare with", folder.display()));
        }
        Ok(Self { folder: folder.to_owned(), curves })
    }

    /// The alignment of the series that was refined on the curves.
    pub fn alignment(&self) -> Result<String> {
        let candidates = ["reprojection/series.xf", "series.xf"].map(|name| self.folder.join(name));
        let found = candidates.iter().find(|path| path.is_file()).ok_or_else(|| {
            let folder = self.folder.display();
            miette!(
                "there is no series.xf in {folder} or its reprojection: run `tiltline reproject {folder} SERIES -o \
                 {folder}/reprojection` first, or give --align"
            )
        })?;
        Ok(found.to_string_lossy().into_owned())
    }

    /// Layers that hold all curves.
    pub fn depth(&self) -> usize {
        let points = self.curves.curves.iter().flat_map(|curve| &curve.points);
        let deepest = points.map(|point| self.about_axis(point).z.abs()).fold(0.0, f64::max);
        (2.0 * (deepest + MARGIN_PX)).ceil() as usize
    }

    /// From the mid-view frame to that of the series, whose z is the beam at tilt zero.
    fn about_axis(&self, point: &Point3) -> Point3 {
        let (sin, cos) = self.curves.tilts.mid_rad().sin_cos();
        Point3::new(point.x * cos - point.z * sin, point.y, point.x * sin + point.z * cos)
    }

    /// Compares, puts the comparison into the report where there is one, and says it in words.
    pub fn report(self, volume: &Array3<f32>, geometry: &Geometry, method: String, series: &Series) -> Result<String> {
        let (layers, rows, columns) = volume.dim();
        let middle_row = 0.5 * (rows as f64 - 1.0);
        let place = |point: &Point3| {
            let point = self.about_axis(point);
            Point3::new(point.x, point.y + middle_row, point.z)
        };
        let curves: Vec<Vec<Point3>> =
            self.curves.curves.iter().map(|curve| curve.points.iter().map(place).collect()).collect();
        let along_px = REACH_PX * self.curves.tilts.depth_gain().abs();
        let Some((comparison, _)) = compare(volume, geometry, &curves, along_px) else {
            return Err(miette!(
                "there is nothing bright in the tomogram to compare with; are the lines dark? then give --flatten --invert"
            ));
        };
        let (_, pixel) = self.curves.unit;
        let sign = if self.curves.depth_flipped { -1.0 } else { 1.0 };
        let (sin, cos) = self.curves.tilts.mid_rad().sin_cos();
        let voxels = [
            [cos / pixel, 0.0, -sin * sign / pixel, geometry.axis_column],
            [0.0, 1.0 / pixel, 0.0, middle_row],
            [sin / pixel, 0.0, cos * sign / pixel, geometry.middle_layer()],
        ];
        let tomogram = ReportTomogram {
            method,
            comparison,
            size: [columns, rows, layers],
            above: picture(volume, Axis(0))?,
            edge: picture(volume, Axis(1))?,
            voxels,
        };
        let path = series.path.clone();
        let shown = update(&self.folder, |report| {
            let empty = ReportSeries {
                path,
                fitted: false,
                views: Vec::new(),
                checks: Vec::new(),
                pictures: Vec::new(),
                tomogram: None,
            };
            report.series.get_or_insert(empty).tomogram = Some(tomogram);
        })
        .wrap_err("cannot put the comparison into the report of the result")?;
        let percent = |[length, share]: [f64; 2]| format!("{:.0} % of {length:.0} px", 100.0 * share);
        let depth = comparison.depth_px.map_or(String::new(), |[off, spread]| {
            format!("; its z less theirs {off:+.1} px in the median, half within {spread:.1} px of that")
        });
        let page = if shown { "; both are in report.html" } else { "" };
        Ok(format!(
            "compared   curves with a line of the tomogram within {:.0} px across and {along_px:.0} px along the beam: {}; lines of the \
             tomogram with a curve: {}{depth} (threshold {:.4}, which suits the tomogram best){page}\n",
            REACH_PX,
            percent(comparison.result),
            percent(comparison.tomogram),
            comparison.threshold
        ))
    }
}

/// The largest value along an axis, as a picture.
fn picture(volume: &Array3<f32>, axis: Axis) -> Result<Picture> {
    let most = volume.fold_axis(axis, f32::NEG_INFINITY, |most, value| most.max(*value));
    let [low, high] = percentiles(&most, [0.02, 0.998]);
    let range = (high - low).max(f32::MIN_POSITIVE);
    let grey = most.mapv_into(|value| (value - low) / range);
    let step = grey.nrows().max(grey.ncols()).div_ceil(PICTURE_PX);
    Picture::reduced(&grey, step.max(1)).into_diagnostic()
}

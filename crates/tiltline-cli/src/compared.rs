//! A tomogram beside the curves of a result: which alignment the two share, the figures, and their place in the result's report.

use std::path::{Path, PathBuf};

use miette::{IntoDiagnostic, Result, miette};
use ndarray::Array3;
use serde_json::Value;
use tiltline::curve::Flag;
use tiltline::report::tomogram::ReportTomogram;
use tiltline::series::{SavedCurves, Series};
use tiltline::tomography::Geometry;

use crate::report::{check, update};

/// Layers above and below the deepest curves, px.
const MARGIN_PX: f64 = 16.0;
/// Share of the points that the layers hold: a wrong match may lie anywhere.
const HELD_SHARE: f64 = 0.99;
/// A volume that is compared is held in memory as a whole; not more than so many voxels (4 bytes each).
const MOST_VOXELS: usize = 1 << 31;

/// A result that a tomogram is compared with.
pub struct Compared {
    folder: PathBuf,
    curves: SavedCurves,
}

/// How views lie on each other with the curves' origin in the middle.
pub struct SharedAlignment {
    /// The transforms (`.xf`).
    pub transforms: String,
    /// Tilts that belong to them (`.tlt`), where a fit found them.
    pub tilts: Option<String>,
}

/// A volume of zeros.
pub fn volume_in_memory(shape: [usize; 3]) -> Result<Array3<f32>> {
    if shape.iter().product::<usize>() > MOST_VOXELS {
        let [depth, rows, columns] = shape;
        return Err(miette!(
            "a volume of {columns} x {rows} x {depth} voxels is too large to be compared with curves; give fewer layers with --depth"
        ));
    }
    Ok(Array3::zeros(shape))
}

impl Compared {
    /// Reads the curves of a result's folder (or its `curves.json`), and makes sure that its report can take more.
    pub fn read(result: &Path) -> Result<Self> {
        let curves = SavedCurves::read(result).into_diagnostic()?;
        if curves.curves.is_empty() {
            return Err(miette!("{} has no curves: there is nothing to compare with", result.display()));
        }
        let parent = result.parent().map_or_else(PathBuf::new, Path::to_owned);
        let folder = if result.is_dir() { result.to_owned() } else { parent };
        check(&folder)?;
        Ok(Self { folder, curves })
    }

    /// The alignment of the series that was refined on these curves: that of a re-projection, or that of the fit to all views.
    pub fn alignment(&self) -> Result<SharedAlignment> {
        let of = |folder: &Path, name: &str| folder.join(name).to_string_lossy().into_owned();
        let reprojection = self.folder.join("reprojection");
        if self.is_reprojected(&reprojection) {
            return Ok(SharedAlignment { transforms: of(&reprojection, "series.xf"), tilts: None });
        }
        if self.is_fitted() {
            let transforms = of(&self.folder, "series.xf");
            return Ok(SharedAlignment { transforms, tilts: Some(of(&self.folder, "series.tlt")) });
        }
        let folder = self.folder.display();
        Err(miette!(
            "{folder} has no alignment of the series that was made with its curves: run `tiltline reproject {folder} SERIES -o \
             {folder}/reprojection` first, or give the series.xf of such a run with --align"
        ))
    }

    /// Whether a folder has a re-projection of these very curves.
    fn is_reprojected(&self, folder: &Path) -> bool {
        let text = std::fs::read_to_string(folder.join("reprojection.json")).unwrap_or_default();
        let read: Option<Value> = serde_json::from_str(&text).ok();
        read.is_some_and(|json| json["curves_sha256"] == self.curves.sha256.as_str())
            && folder.join("series.xf").is_file()
    }

    /// Whether the result is of a fit to all views, so that the alignment beside it is its own.
    fn is_fitted(&self) -> bool {
        let text = std::fs::read_to_string(self.folder.join("run.toml")).unwrap_or_default();
        let Ok(record) = text.parse::<toml::Table>() else { return false };
        let series = record.get("run").and_then(|run| run.get("series")).is_some();
        let pair_only = record.get("acquisition").and_then(|acquisition| acquisition.get("pair_only"));
        series && pair_only.and_then(toml::Value::as_bool) != Some(true) && self.folder.join("series.xf").is_file()
    }

    /// Layers that hold nearly all measured points.
    pub fn depth(&self) -> usize {
        let (sin, cos) = self.curves.tilts.mid_rad().sin_cos();
        let points = self.curves.curves.iter().flat_map(|curve| curve.points.iter().zip(&curve.flags));
        let measured = points.filter(|(_, flag)| **flag == Flag::Ok);
        let mut depths: Vec<f64> = measured.map(|(point, _)| (point.x * sin + point.z * cos).abs()).collect();
        depths.sort_by(f64::total_cmp);
        let deepest = depths.get((depths.len() as f64 * HELD_SHARE) as usize).or(depths.last()).copied().unwrap_or(0.0);
        (2.0 * (deepest + MARGIN_PX)).ceil() as usize
    }

    /// Compares, puts the comparison into the report where there is one, and says it in words. The volume is written by now: what
    /// cannot be done is said, and is no failure.
    pub fn report(self, volume: &Array3<f32>, geometry: &Geometry, method: String, series: &Series) -> String {
        match ReportTomogram::new(volume, geometry, &self.curves, method) {
            Ok(Some(tomogram)) => {
                let mut text = in_words(&tomogram);
                let path = series.path.clone();
                let shown = update(&self.folder, |report| {
                    let series = report.series.get_or_insert_default();
                    series.tomogram = Some(tomogram);
                    if series.path.is_empty() {
                        series.path = path;
                    }
                });
                match shown {
                    Ok(true) => text += "shown      in report.html of the result\n",
                    Ok(false) => {}
                    Err(error) => text += &format!("warning    the report of the result does not show it: {error}\n"),
                }
                text
            }
            Ok(None) => "warning    there is nothing bright in the tomogram to compare with: are the lines dark? then give --flatten \
                         --invert\n"
                .into(),
            Err(error) => format!("warning    the tomogram cannot be compared: {error}\n"),
        }
    }
}

fn in_words(tomogram: &ReportTomogram) -> String {
    let comparison = &tomogram.comparison;
    let [across, along] = comparison.reach_px;
    let percent = |[length, share]: [f64; 2]| format!("{:.0} % of {length:.0} px", 100.0 * share);
    let depth = comparison.depth_px.map_or(String::new(), |[off, spread]| {
        format!("\n           z of the tomogram less theirs: median {off:+.1} px, half within {spread:.1} px of it")
    });
    format!(
        "compared   curves with a line of the tomogram within {across:.0} px across and {along:.0} px along the beam: {}\n           \
         lines of the tomogram with a curve: {}{depth}\n           at threshold {:.4}, at which both agree best\n",
        percent(comparison.result),
        percent(comparison.tomogram),
        comparison.threshold
    )
}

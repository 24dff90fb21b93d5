//! `tiltline reconstruct SERIES`: which views of a series are reconstructed, and what the record says of it.

use miette::{IntoDiagnostic, Result};
use serde::Serialize;
use tiltline::export::{self, xf};
use tiltline::io::parse_tilts;
use tiltline::reconstruction::Reconstruction;
use tiltline::report::series::ReportSeries;
use tiltline::series::{
    ChosenPair, Series, align, choose_pair, detect_lines, pair_at, reconstruct_series, typical_view,
};

use crate::args::Reconstruct;
use crate::config::Config;
use crate::method::Stages;
use crate::reconstruct::wrong_usage;

/// Name and content of a file of a result.
pub type NamedFile = (&'static str, Vec<u8>);

/// The part of `[run]` that says which views of which series were used.
#[derive(Clone, Debug, Serialize)]
pub struct SeriesRecord {
    /// The series as given.
    pub series: String,
    /// Where its tilts came from.
    pub tilts_from: String,
    /// Number of views.
    pub views: usize,
    /// Sections of left and right, counted from 0.
    pub pair_sections: [usize; 2],
    /// Tilts of left and right, degrees.
    pub pair_deg: [f64; 2],
    /// Why these.
    pub why: String,
}

/// A series with the pair that is reconstructed.
pub struct Chosen {
    /// The series.
    pub series: Series,
    /// The pair.
    pub pair: ChosenPair,
    /// Whether the pair alone is reconstructed: the user asked for one, or there are no other views.
    pub pair_only: bool,
}

impl Chosen {
    /// Opens the series of `tiltline reconstruct SERIES` and picks the pair; its tilts go into the settings.
    pub fn open(flags: &Reconstruct, config: &mut Config) -> Result<Self> {
        let series = Series::open(&flags.left, flags.tilts.as_deref(), &config.settings.read).into_diagnostic()?;
        let asked = match flags.pair.as_deref() {
            Some("auto") => None,
            Some(text) => Some(two_angles(text)),
            // The record of an earlier run names its pair.
            None => config.acquisition.tilts_deg,
        };
        let pair = match asked {
            Some(angles) => pair_at(&series, angles),
            None => choose_pair(&series),
        };
        let pair = pair.into_diagnostic()?;
        config.acquisition.tilts_deg = Some(pair.views.map(|view| series.views[view].tilt_deg));
        if config.acquisition.pixel_size_nm.is_none() {
            config.acquisition.pixel_size_nm = series.pixel_size.as_ref().map(|(size, _)| *size);
        }
        if flags.pair.is_some() {
            config.acquisition.pair_only = Some(true);
        }
        let pair_only = config.acquisition.pair_only.unwrap_or(false) || series.views.len() < 3;
        Ok(Self { series, pair, pair_only })
    }

    /// The two images, as every command understands them.
    pub fn images(&self) -> [&str; 2] {
        self.pair.views.map(|view| self.series.views[view].spec.as_str())
    }

    /// Fits the pair's curves to all views. Returns the result, the files that say how the views lie, and what the report shows.
    pub fn fit(
        &self,
        result: Reconstruction,
        config: &Config,
        stages: &Stages,
    ) -> Result<(Reconstruction, Vec<NamedFile>, ReportSeries)> {
        let axis_rad = result.rectified.rectification.rectified_from_left.isometry.rotation.angle();
        let aligned = align(&self.series, -axis_rad, &|_, _| ()).into_diagnostic()?;
        let (detector, trace) = (&*stages.detector, &config.settings.trace);
        let beside = typical_view(&self.series, detector).into_diagnostic()?;
        let mut lines_of = |view: usize| Ok(detect_lines(&self.series.view(view)?, beside.as_ref(), detector, trace));
        let fit = reconstruct_series(
            result,
            self.pair.views,
            &self.series,
            &aligned,
            &*stages.detector,
            &config.settings,
            &config.settings.series,
            &mut lines_of,
        )
        .into_diagnostic()?;
        let (mut views, mut transforms, mut tilts) = (Vec::new(), Vec::new(), Vec::new());
        export::reprojection::write_fitted_views(&fit, &self.series, &mut views).into_diagnostic()?;
        let (matrices, _) = fit.refined.transforms(&self.series);
        xf::write_xf(&matrices, &mut transforms).into_diagnostic()?;
        xf::write_tlt(&fit.refined.tilts_deg(&self.series), &mut tilts).into_diagnostic()?;
        let files = vec![("views.csv", views), ("series.xf", transforms), ("series.tlt", tilts)];
        let shown = ReportSeries::of_fit(&fit, &self.series).into_diagnostic()?;
        let mut reconstruction = fit.reconstruction;
        reconstruction.warnings.extend(aligned.warnings);
        Ok((reconstruction, files, shown))
    }

    /// The record.
    pub fn record(&self) -> SeriesRecord {
        let view = |view: usize| &self.series.views[view];
        SeriesRecord {
            series: self.series.path.clone(),
            tilts_from: self.series.tilts_from.clone(),
            views: self.series.views.len(),
            pair_sections: self.pair.views.map(|place| view(place).section),
            pair_deg: self.pair.views.map(|place| view(place).tilt_deg),
            why: self.pair.reason.clone(),
        }
    }
}

fn two_angles(text: &str) -> [f64; 2] {
    let angles = parse_tilts(text).unwrap_or_else(|error| wrong_usage(&format!("--pair {text}: {error}")));
    let [left, right] = angles[..] else {
        wrong_usage(&format!("--pair {text} gives {} angles; write two, as in --pair -4,4, or auto", angles.len()));
    };
    [left, right]
}

//! `tiltline reproject`: curves of a result in the views of a series, and what these say about the result.

use std::path::{Path, PathBuf};

use clap::Args;
use miette::{IntoDiagnostic, Result, miette};
use tiltline::export::{Staging, check_target, reprojection, xf};
use tiltline::io::{parse_tilts, xf as transforms};
use tiltline::progress::Stage;
use tiltline::report::series::ReportSeries;
use tiltline::series::{
    AlignedSeries, Reprojection, SavedCurves, Series, align, detect_lines, reproject, typical_view,
};
use tiltline::warning::Warning;

use crate::args::{Lines, Method, Verbosity};
use crate::interrupt;
use crate::method::{Detector, Stages};
use crate::output;
use crate::progress::Count;
use crate::reconstruct::{method, wrong_usage};
use crate::report;

/// Flags of `tiltline reproject`.
#[derive(Debug, Args)]
pub struct Reproject {
    /// Folder of a result, or its curves.json.
    pub result: PathBuf,
    /// The series: a stack (MRC, ST, TIFF) with its tilts, or a folder of images.
    pub series: String,
    /// Folder for the re-projection.
    #[arg(short, long, value_name = "FOLDER")]
    pub output: PathBuf,
    /// Tilts of all views in degrees: LIST, START:END:STEP, or a FILE (.tlt, .rawtlt, .mdoc; for a folder also .csv).
    #[arg(long, value_name = "LIST|START:END:STEP|FILE", allow_hyphen_values = true)]
    pub tilts: Option<String>,
    /// Angles of the views in degrees; the nearest view is taken. Without it, all.
    #[arg(long, value_name = "LIST", allow_hyphen_values = true)]
    pub views: Option<String>,
    /// Alignment of the series (IMOD's .xf, one line a section), instead of one by phase correlation.
    #[arg(long, value_name = "FILE.xf")]
    pub align: Option<String>,
    /// What finds lines; without it, what the result was made with.
    #[arg(long, value_name = "KIND")]
    pub detector: Option<Detector>,
    /// Weights of the network that finds lines.
    #[arg(long, value_name = "FILE")]
    pub weights: Vec<PathBuf>,
    /// Whether lines are darker or brighter than what surrounds them (for --detector ridge).
    #[arg(long, value_name = "CONTRAST")]
    pub lines: Option<Lines>,
    /// Write into a folder that has other content.
    #[arg(long)]
    pub force: bool,
    /// Print the result as JSON.
    #[arg(long)]
    pub json: bool,
    /// How much to say while working.
    #[command(flatten)]
    pub verbosity: Verbosity,
}

/// Runs the command.
pub fn run(flags: &Reproject) -> Result<()> {
    check_target(&flags.output, flags.force).into_diagnostic()?;
    let record = record_of(&flags.result);
    let config = method(&Method {
        detector: flags.detector,
        matcher: None,
        weights: flags.weights.clone(),
        lines: flags.lines,
        max_disparity: None,
        refine: None,
        seed: None,
        config: record,
    })?;
    let curves = SavedCurves::read(&flags.result).into_diagnostic()?;
    let series = Series::open(&flags.series, flags.tilts.as_deref(), &config.settings.read).into_diagnostic()?;
    let views = views(flags, &series)?;
    let stages = Stages::new(&config.method, &config.settings, None)?;
    let aligned = match &flags.align {
        Some(path) => {
            let read = transforms::read(path).into_diagnostic()?;
            AlignedSeries::from_transforms(&series, &read, path).into_diagnostic()?
        }
        None => {
            let count = Count::new("aligning", flags.verbosity);
            let aligned =
                align(&series, curves.poses[0].axis_rad(), &|done, of| count.show(done, of)).into_diagnostic();
            count.clear();
            aligned?
        }
    };
    let count = Count::new("finding lines", flags.verbosity);
    let mut done = 0;
    // A pose is looked for from its neighbour's: those between are needed too, and the alignment must not depend on what is shown.
    let all: Vec<usize> = (0..series.views.len()).collect();
    let beside = typical_view(&series, &*stages.detector).into_diagnostic()?;
    let mut lines_of = |view: usize| {
        count.show(done, all.len());
        done += 1;
        Ok(detect_lines(&series.view(view)?, beside.as_ref(), &*stages.detector, &config.settings.trace))
    };
    let found = reproject(&curves, &series, &aligned, &all, &mut lines_of).into_diagnostic();
    count.clear();
    let mut found = found?;
    found.views.retain(|view| views.contains(&view.view));
    let mut warnings = series.warnings.clone();
    warnings.extend(aligned.warnings.iter().cloned());
    warnings.append(&mut found.warnings);
    found.warnings = warnings;
    let pictures = pictures(flags, &views);
    interrupt::write_folder(&flags.output, flags.force, |staging| write(staging, &found, &curves, &series, &pictures))?;
    let shown = ReportSeries::of_reprojection(&found, &series, &curves, &ReportSeries::pictured(&pictures))
        .into_diagnostic()
        .and_then(|section| {
            report::update(&flags.result, |report| report.series = Some(section.after(report.series.take())))
        });
    let page = match shown {
        Ok(true) => ", and shown in report.html of the result",
        Ok(false) => "",
        Err(error) => {
            let message = format!("report.html of the result does not show this: {error}");
            found.warnings.push(Warning::new(Stage::Export, message));
            ""
        }
    };
    if flags.json {
        let mut text = Vec::new();
        reprojection::write_json(&found, &curves, &mut text).into_diagnostic()?;
        return output::print(&String::from_utf8_lossy(&text));
    }
    output::print(&format!("{}written to {}{page}\n", text(&found), flags.output.display()))
}

/// The record of the run, which says how lines were found.
fn record_of(result: &Path) -> Option<PathBuf> {
    let folder = if result.is_dir() { result.to_path_buf() } else { result.parent()?.to_path_buf() };
    Some(folder.join("run.toml")).filter(|record| record.is_file())
}

/// The views that are asked for, or all, by ascending tilt.
fn views(flags: &Reproject, series: &Series) -> Result<Vec<usize>> {
    let Some(text) = &flags.views else { return Ok((0..series.views.len()).collect()) };
    let angles = parse_tilts(text).unwrap_or_else(|error| wrong_usage(&format!("--views {text}: {error}")));
    let mut views =
        angles.iter().map(|angle| series.nearest(*angle)).collect::<Result<Vec<_>, _>>().into_diagnostic()?;
    views.sort_unstable();
    views.dedup();
    Ok(views)
}

fn pictures(flags: &Reproject, views: &[usize]) -> Vec<usize> {
    if flags.views.is_some() { views.to_vec() } else { ReportSeries::pictured(views) }
}

fn write(
    staging: &Staging,
    found: &Reprojection,
    curves: &SavedCurves,
    series: &Series,
    pictures: &[usize],
) -> Result<Vec<String>> {
    let mut names = Vec::new();
    let mut file = |name: &str, content: &dyn Fn(&mut dyn tiltline::export::WriteSeek) -> std::io::Result<()>| {
        names.push(name.to_owned());
        staging.write(name, |out| content(out)).into_diagnostic()
    };
    for view in found.views.iter().filter(|view| pictures.contains(&view.view)) {
        let image = series.view(view.view).into_diagnostic()?;
        let name = format!("view_{:+.1}deg.png", view.tilt_deg);
        file(&name, &|out| reprojection::write_view(&image, view, curves, out))?;
    }
    let (transforms, tilts_deg) = found.refined.transforms(series);
    file("series.xf", &|out| xf::write_xf(&transforms, out))?;
    file("series.tlt", &|out| xf::write_tlt(&tilts_deg, out))?;
    file("points.csv", &|out| reprojection::write_points(found, out))?;
    file("reprojection.csv", &|out| reprojection::write_csv(found, out))?;
    file("reprojection.json", &|out| reprojection::write_json(found, curves, out))?;
    if found.views.is_empty() {
        return Err(miette!("no view was asked for"));
    }
    Ok(names)
}

fn text(found: &Reprojection) -> String {
    let mut text =
        String::from("view        points  median px  95 % px  within 2 px  within 5 px  (by chance within 3 px)\n");
    for view in &found.views {
        let name = format!("{:+.1}\u{b0}{}", view.tilt_deg, if view.in_pair { " *" } else { "" });
        text += &match &view.distances {
            Some(d) => format!(
                "{name:<10} {:>7} {:>10.2} {:>8.1} {:>10.0} % {:>10.0} % {:>10.0} %{}\n",
                d.points,
                d.median_px,
                d.percent95_px,
                100.0 * d.within_2px,
                100.0 * d.within_5px,
                100.0 * d.chance_within_3px,
                if view.supported { "" } else { "  pose not supported" }
            ),
            None => format!("{name:<10}       0  no point in the image, or no line found\n"),
        };
    }
    text += "* a view of the pair\n";
    for sentence in found.checks.sentences() {
        text += &format!("check          {sentence}\n");
    }
    for warning in &found.warnings {
        text += &format!("warning        {warning}\n");
    }
    text
}

//! `tiltline reconstruct`: resolves flags, file and metadata, runs the pipeline, writes the folder, prints the summary.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Mutex;
use std::time::Instant;

use clap::CommandFactory;
use clap::error::ErrorKind;
use miette::{IntoDiagnostic, Result, miette};
use tiltline::export;
use tiltline::geometry::TiltPair;
use tiltline::io::{Found, Reading, parse_tilts, read_micrograph_with};
use tiltline::micrograph::StereoPair;
use tiltline::pipeline;
use tiltline::progress::{Event, Stage};
use tiltline::rectify::{Rectification, rectify_known};
use tiltline::refine::Refinement;
use tiltline::report::{Report, page};
use tiltline::ridge::LinePolarity;
use tiltline::warning::Warning;

use crate::args::{Cli, Lines, Method, Reconstruct, Refine};
use crate::config::{Config, RunRecord, run_toml};
use crate::interrupt;
use crate::method::{Detector, Stages};
use crate::output;
use crate::progress::Display;
use crate::series::Chosen;
use crate::summary::{Provenance, Summary};

/// Runs the command.
pub fn run(flags: &Reconstruct) -> Result<()> {
    let mut config = resolve(flags)?;
    export::check_target(&flags.output, flags.force).into_diagnostic()?;
    let display = Display::new(flags.verbosity);
    let stages = Stages::new(&config.method, &config.settings, None)?;
    let show = |event: &Event| display.show(event);
    let summary = match &flags.right {
        Some(right) => reconstruct([&flags.left, right], &mut config, &stages, &flags.output, flags.force, &show)?,
        None => {
            let chosen = Chosen::open(flags, &mut config)?;
            of_series(&chosen, &mut config, &stages, &flags.output, flags.force, &show)?
        }
    };
    display.clear();
    if flags.json {
        output::print(&(serde_json::to_string_pretty(&summary).into_diagnostic()? + "\n"))
    } else {
        output::print(&format!("{summary}written to {}\n", flags.output.display()))
    }
}

/// Reads a pair, reconstructs it and writes the folder; what the images' files say goes into the settings.
pub fn reconstruct(
    images: [&str; 2],
    config: &mut Config,
    stages: &Stages,
    output: &Path,
    force: bool,
    show: &(dyn Fn(&Event) + Sync),
) -> Result<Summary> {
    reconstruct_views(images, None, config, stages, output, force, show)
}

/// Reconstructs the pair that was picked from a series.
fn of_series(
    chosen: &Chosen,
    config: &mut Config,
    stages: &Stages,
    output: &Path,
    force: bool,
    show: &(dyn Fn(&Event) + Sync),
) -> Result<Summary> {
    let mut summary = reconstruct_views(chosen.images(), Some(chosen), config, stages, output, force, show)?;
    summary.provenance.tilts_from.clone_from(&chosen.series.tilts_from);
    summary.views = Some(chosen.pair.reason.clone());
    Ok(summary)
}

fn reconstruct_views(
    images: [&str; 2],
    chosen: Option<&Chosen>,
    config: &mut Config,
    stages: &Stages,
    output: &Path,
    force: bool,
    show: &(dyn Fn(&Event) + Sync),
) -> Result<Summary> {
    let seconds = Mutex::new(BTreeMap::new());
    let progress = |event: Event| {
        show(&event);
        if let Event::Finished(stage, time) = event {
            seconds.lock().expect("no thread panics while it holds the lock").insert(stage.word(), time);
        }
    };
    let (pair, provenance, warnings) = timed(&progress, Stage::Read, || read_pair(images, config))?;
    let sources = [pair.left.source.clone(), pair.right.source.clone()];
    let settings = &config.settings;
    let (detector, matcher) = (&*stages.detector, &*stages.matcher);
    let mut result = match &stages.geometry {
        None => pipeline::reconstruct(pair, detector, matcher, settings, &progress).into_diagnostic()?,
        Some(geometry) => {
            let (height, width) = pair.left.pixels.dim();
            let rectified = rectify_known(&pair, Rectification::of_truth(geometry, [height, width]));
            pipeline::reconstruct_rectified(pair, rectified, Vec::new(), detector, matcher, settings, &progress)
        }
    };
    // What a series' header says, its views' headers say again.
    let of_series = chosen.iter().flat_map(|chosen| chosen.series.warnings.clone());
    let mut said: Vec<Warning> = Vec::new();
    for warning in warnings.into_iter().chain(of_series) {
        if !said.contains(&warning) {
            said.push(warning);
        }
    }
    let mut warnings = said;
    warnings.append(&mut result.warnings);
    result.warnings = warnings;
    let (mut files, mut series) = (Vec::new(), None);
    if let Some(chosen) = chosen.filter(|chosen| !chosen.pair_only && !result.curves.is_empty()) {
        let fit = timed(&progress, Stage::Refine, || chosen.fit(result, config, stages))?;
        (result, files, series) = (fit.0, fit.1, Some(fit.2));
    }
    let [left, right] = sources;
    let record = RunRecord {
        version: env!("CARGO_PKG_VERSION"),
        detector: stages.names[0].clone(),
        matcher: stages.names[1].clone(),
        left,
        right,
        series: chosen.map(Chosen::record),
        seconds: seconds.lock().expect("no thread panics while it holds the lock").clone(),
    };
    timed(&progress, Stage::Export, || {
        let run = run_toml(config, &record)?;
        let report = Report::new(&result, &run).into_diagnostic()?;
        let report = page::write(&Report { series, ..report }).into_diagnostic()?;
        // The record comes last: it says that the rest is complete.
        files.extend([("report.html", report.into_bytes()), ("run.toml", run.into_bytes())]);
        interrupt::write_all(&result, &files, output, force)
    })?;
    Ok(Summary::of(&result, provenance))
}

/// Defaults, overridden by the settings file, overridden by flags.
fn resolve(flags: &Reconstruct) -> Result<Config> {
    let mut config = method(&flags.method)?;
    config.settings.flip_depth |= flags.flip_depth;
    let acquisition = &mut config.acquisition;
    // Those of a series are one a view.
    if let Some(text) = flags.tilts.as_ref().filter(|_| flags.right.is_some()) {
        let tilts = parse_tilts(text).unwrap_or_else(|error| wrong_usage(&format!("--tilts {text}: {error}")));
        let [left, right] = tilts[..] else {
            wrong_usage(&format!(
                "--tilts {text} gives {} tilts; a pair has two, for example --tilts -4,4",
                tilts.len()
            ));
        };
        acquisition.tilts_deg = Some([left, right]);
    }
    if let Some(size) = flags.pixel_size {
        acquisition.pixel_size_nm = Some(size.nm);
    }
    if let Some(axis_deg) = flags.tilt_axis.or(acquisition.tilt_axis_deg) {
        if !axis_deg.is_finite() {
            wrong_usage(&format!("--tilt-axis {axis_deg} is not an angle"));
        }
        acquisition.tilt_axis_deg = Some(axis_deg);
    }
    config.settings.validate().into_diagnostic()?;
    Ok(config)
}

/// Settings of detection and matching: defaults, overridden by the settings file, overridden by flags.
pub fn method(flags: &Method) -> Result<Config> {
    let mut config = match &flags.config {
        Some(path) => Config::read(path)?,
        None => Config::default(),
    };
    config.method.detector = flags.detector.unwrap_or(config.method.detector);
    config.method.matcher = flags.matcher.unwrap_or(config.method.matcher);
    if !flags.weights.is_empty() {
        config.method.weights.clone_from(&flags.weights);
    }
    let settings = &mut config.settings;
    if let Some(lines) = flags.lines {
        if config.method.detector == Detector::Net {
            wrong_usage(
                "--lines is for the ridge filter (--detector ridge): the network finds dark and bright lines alike",
            );
        }
        settings.ridge.lines = match lines {
            Lines::Dark => LinePolarity::Dark,
            Lines::Bright => LinePolarity::Bright,
            Lines::Auto => LinePolarity::Auto,
        };
    }
    if let Some(refine) = flags.refine {
        settings.refine.method = match refine {
            Refine::None => Refinement::None,
            Refine::Nearest => Refinement::Nearest,
            Refine::Curve => Refinement::Curve,
        };
    }
    if let Some(max_disparity_px) = flags.max_disparity {
        if !(max_disparity_px.is_finite() && max_disparity_px > 0.0) {
            wrong_usage(&format!("--max-disparity {max_disparity_px} is not a positive number of px"));
        }
        settings.matching.max_disparity_px = max_disparity_px;
    }
    settings.seed = flags.seed.unwrap_or(settings.seed);
    Ok(config)
}

/// Ends the program as a wrong flag does: a message with the usage, and exit code 2.
pub fn wrong_usage(message: &str) -> ! {
    Cli::command().error(ErrorKind::ValueValidation, message).exit()
}

/// Both images with their tilts and pixel size, where those came from, and doubts; what the files said goes into the
/// record.
fn read_pair(images: [&str; 2], config: &mut Config) -> Result<(StereoPair, Provenance, Vec<Warning>)> {
    let options = &config.settings.read;
    let [left, right] = images.map(|image| read_micrograph_with(image, options));
    let (mut left, mut right) = (left.into_diagnostic()?, right.into_diagnostic()?);
    let mut warnings = std::mem::take(&mut left.warnings);
    warnings.append(&mut right.warnings);
    let acquisition = &mut config.acquisition;
    let given = "as given".to_owned();
    let (tilts_deg, tilts_from) = match acquisition.tilts_deg {
        Some(tilts) => (tilts, given.clone()),
        None => {
            let [a, b] = [tilt_of(&left)?, tilt_of(&right)?];
            let origin = if a.origin == b.origin { a.origin.clone() } else { format!("{}; {}", a.origin, b.origin) };
            ([a.value, b.value], origin)
        }
    };
    acquisition.tilts_deg = Some(tilts_deg);
    let pixel_size_from = match acquisition.pixel_size_nm {
        Some(_) => Some(given),
        None => left.pixel_size_nm.as_ref().or(right.pixel_size_nm.as_ref()).map(|found| found.origin.clone()),
    };
    let (mut left, mut right) = (left.micrograph, right.micrograph);
    if let Some(size) = acquisition.pixel_size_nm {
        left.pixel_size_nm = Some(size);
        right.pixel_size_nm = Some(size);
    }
    let tilts = TiltPair::from_degrees(tilts_deg[0], tilts_deg[1]);
    let axis_deg = *acquisition.tilt_axis_deg.get_or_insert(0.0);
    let (pair, doubts) = StereoPair::new(left, right, tilts, axis_deg.to_radians()).into_diagnostic()?;
    warnings.extend(doubts);
    config.acquisition.pixel_size_nm = pair.pixel_size_nm();
    Ok((pair, Provenance { tilts_deg, tilts_from, pixel_size_from }, warnings))
}

fn tilt_of(reading: &Reading) -> Result<&Found<f64>> {
    reading.tilt_deg.as_ref().ok_or_else(|| {
        miette!(
            "the tilt of {} is not in its file; give both tilts, for example --tilts -4,4",
            reading.micrograph.source.path
        )
    })
}

fn timed<T>(progress: &dyn Fn(Event), stage: Stage, work: impl FnOnce() -> Result<T>) -> Result<T> {
    progress(Event::Started(stage));
    let start = Instant::now();
    let result = work()?;
    progress(Event::Finished(stage, start.elapsed().as_secs_f64()));
    Ok(result)
}

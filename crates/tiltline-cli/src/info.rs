//! `tiltline info`: what is in a micrograph or series.

use miette::{IntoDiagnostic, Result, WrapErr, miette};
use serde::Serialize;
use tiltline::io::{FileInfo, read_micrograph};
use tiltline::score::{ImageStatistics, detected_lines, image_statistics};

use crate::args::Info;
use crate::output;
use crate::quantity::short;

/// Describes each file; a file that cannot be read does not keep the others from being described.
pub fn run(flags: &Info) -> Result<()> {
    let mut failures = 0;
    let mut described = Vec::new();
    for file in &flags.files {
        match describe(file, flags.statistics).wrap_err_with(|| format!("cannot read {file}")) {
            Ok(description) if flags.json => described.push(description),
            Ok(description) => output::print(&table(&description))?,
            Err(error) => {
                failures += 1;
                eprintln!("{error:?}");
            }
        }
    }
    if flags.json {
        output::print(&(serde_json::to_string_pretty(&described).into_diagnostic()? + "\n"))?;
    }
    if failures > 0 {
        return Err(miette!("{failures} of {} files could not be read", flags.files.len()));
    }
    Ok(())
}

/// What is in a file, and what its image measures.
#[derive(Serialize)]
struct Description {
    #[serde(flatten)]
    info: FileInfo,
    #[serde(skip_serializing_if = "Option::is_none")]
    statistics: Option<ImageStatistics>,
}

fn describe(file: &str, statistics: bool) -> Result<Description> {
    let info = match file.rsplit_once('#') {
        // A section is described as the file it is in.
        Some((path, _)) if !std::path::Path::new(file).exists() => tiltline::io::info(path),
        _ => tiltline::io::info(file),
    };
    let measure = || {
        let image = read_micrograph(file).into_diagnostic()?.pixels;
        image_statistics(&image, &detected_lines(&image)).into_diagnostic()
    };
    Ok(Description { info: info.into_diagnostic()?, statistics: statistics.then(measure).transpose()? })
}

/// A file's description as lines of `name value`.
fn table(Description { info, statistics }: &Description) -> String {
    let mut text = format!("{}\n", info.path);
    let mut row = |name: &str, value: String| text.push_str(&format!("  {name:<12} {value}\n"));
    let from = |source: &Option<String>| source.as_ref().map_or(String::new(), |source| format!(" ({source})"));
    row("format", format!("{}, {}, {}", info.format.name(), info.sample_type.name(), info.byte_order.name()));
    row("size", format!("{} x {} px, {} page{}", info.columns, info.rows, info.pages, plural(info.pages)));
    let size = info.pixel_size_nm.map(|nm| format!("{} nm", short(nm)));
    row("pixel size", size.map_or("unknown".into(), |size| size + &from(&info.pixel_size_from)));
    let tilts = info.tilts_deg.as_deref().map(describe_tilts);
    row("tilts", tilts.map_or("unknown".into(), |tilts| tilts + &from(&info.tilts_from)));
    if let Some(range) = &info.intensities {
        let pages = if range.pages_measured == 1 && info.pages > 1 {
            format!(" (page {})", range.first_page)
        } else {
            String::new()
        };
        row("intensity", format!("{} to {}, mean {:.4}{pages}", range.min, range.max, range.mean));
    }
    if let Some(found) = statistics {
        let decibel = |value: Option<f64>| value.map_or("unknown".into(), |value| format!("{value:.1} dB"));
        row("SNR lines", decibel(found.snr_lines_db) + " (lines are those the ridge filter finds)");
        row("SNR backgr.", decibel(found.snr_background_db));
        let grey =
            |value: Option<f64>| value.map_or("unknown".into(), |value| format!("{value:.1} grey levels of 255"));
        row("contrast", grey(found.contrast_grey) + " (background less lines)");
        row("line share", format!("{:.1} % of the pixels", 100.0 * found.line_share));
    }
    for warning in &info.warnings {
        row("warning", warning.clone());
    }
    text
}

fn describe_tilts(tilts: &[f64]) -> String {
    match tilts {
        [] => "none".into(),
        [one] => format!("{one} degrees"),
        [first, .., last] => format!("{} from {first} to {last} degrees", tilts.len()),
    }
}

fn plural(count: usize) -> &'static str {
    if count == 1 { "" } else { "s" }
}

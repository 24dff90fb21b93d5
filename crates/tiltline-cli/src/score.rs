//! `tiltline score`: a result against its truth, or a whole benchmark.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use miette::{IntoDiagnostic, Result, WrapErr, miette};
use tiltline::dataset::{Dataset, MANIFEST};
use tiltline::export::Staging;
use tiltline::score::report::{Protocol, Provenance, Report};
use tiltline::score::{ResultCurves, ScoreSettings, score_pair};
use tiltline::truth::Truth;

use crate::bench::Record;
use crate::output;

/// Flags of `tiltline score`.
#[derive(Debug, Args)]
pub struct Score {
    /// Folder that `tiltline reconstruct` wrote (or a curves.csv), or one of `tiltline bench`.
    pub result: PathBuf,
    /// Truth: truth.json, or the folder of an item that holds one. Not given for a benchmark, which knows its own.
    pub truth: Option<PathBuf>,
    /// Which scores to print; the JSON has all.
    #[arg(long, default_value = "both")]
    pub protocol: ProtocolFlag,
    /// The two views of the truth that were reconstructed, counted from 0; without it those its data set names, or the first two.
    #[arg(long, value_name = "LEFT,RIGHT", value_delimiter = ',')]
    pub views: Option<Vec<usize>>,
    /// Print JSON instead of Markdown.
    #[arg(long)]
    pub json: bool,
    /// Also write scores.md and scores.json into this new folder.
    #[arg(short, long, value_name = "FOLDER")]
    pub output: Option<PathBuf>,
}

/// Protocols by their words.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum ProtocolFlag {
    /// The paper's: error of the right point on true left line.
    Paper,
    /// Curves in 3D: completeness and correctness.
    EndToEnd,
    /// Both.
    Both,
}

/// Runs the command.
pub fn run(flags: &Score) -> Result<()> {
    let report = match (Record::find(&flags.result)?, &flags.truth) {
        (Some(record), None) => benchmark(&flags.result, &record)?,
        (Some(_), Some(_)) => {
            return Err(miette!("{} is a benchmark and knows its truth: leave TRUTH out", flags.result.display()));
        }
        (None, Some(truth)) => single(flags, truth)?,
        (None, None) => {
            return Err(miette!(
                "{} is no folder of `tiltline bench`: give the truth to score it against",
                flags.result.display()
            ));
        }
    };
    let protocol = match flags.protocol {
        ProtocolFlag::Paper => Protocol::Paper,
        ProtocolFlag::EndToEnd => Protocol::EndToEnd,
        ProtocolFlag::Both => Protocol::Both,
    };
    let (markdown, json) = (report.to_markdown(protocol), report.to_json() + "\n");
    if let Some(folder) = &flags.output {
        let staging = Staging::begin(folder, false).into_diagnostic()?;
        let files = [("scores.md", &markdown), ("scores.json", &json)];
        for (name, text) in files {
            staging.write(name, |out| out.write_all(text.as_bytes())).into_diagnostic()?;
        }
        staging.commit(files.into_iter().map(|(name, _)| name)).into_diagnostic()?;
    }
    output::print(if flags.json { &json } else { &markdown })
}

fn single(flags: &Score, truth_path: &Path) -> Result<Report> {
    let path = if truth_path.is_dir() { truth_path.join("truth.json") } else { truth_path.to_owned() };
    let truth = Truth::read(&path).into_diagnostic()?;
    let home = home(&path)?;
    let [left, right] = match flags.views.as_deref() {
        Some(&[left, right]) => [left, right],
        Some(views) => return Err(miette!("--views takes two numbers, {} were given", views.len())),
        None => home.as_ref().map_or([0, 1], |(_, pair)| *pair),
    };
    let pair = truth.pair(left, right).into_diagnostic()?;
    let result = ResultCurves::read(&flags.result).into_diagnostic()?;
    let settings = ScoreSettings::default();
    let name = flags.result.display().to_string();
    let score = score_pair(&name, &result, &pair, &settings).into_diagnostic()?;
    let manifest = home.map(|(dataset, _)| dataset.manifest);
    let provenance = Provenance {
        dataset: manifest.as_ref().and_then(|manifest| manifest.name.clone()).or(truth.source.clone()),
        dataset_version: manifest.as_ref().and_then(|manifest| manifest.program.clone()),
        dataset_seed: manifest.and_then(|manifest| manifest.seed),
        method: None,
        weights_sha256: None,
        program: Some(env!("CARGO_PKG_VERSION").into()),
    };
    Ok(Report::new(provenance, settings, vec![score]))
}

/// The data set that a truth lies in and the views of its pair, if it lies in one.
fn home(truth: &Path) -> Result<Option<(Dataset, [usize; 2])>> {
    let truth = std::path::absolute(truth).into_diagnostic()?;
    let (Some(item), Some(folder)) = (truth.parent(), truth.parent().and_then(Path::parent)) else { return Ok(None) };
    if !folder.join(MANIFEST).is_file() {
        return Ok(None);
    }
    let dataset = Dataset::open(folder).into_diagnostic()?;
    let name = item.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let found = dataset.manifest.items.iter().find(|item| item.name == name).cloned();
    let Some(item) = found else { return Ok(None) };
    dataset.check_item(&item).into_diagnostic()?;
    Ok(Some((dataset, item.pair)))
}

fn benchmark(folder: &Path, record: &Record) -> Result<Report> {
    let dataset = record.dataset(folder)?;
    let settings = ScoreSettings::default();
    let scores = dataset.score(|item| Record::result(folder, item), &settings).into_diagnostic().wrap_err(
        "every pair of the set must have been run: `tiltline bench` with the same flags goes on where it stopped",
    )?;
    let provenance = Provenance {
        dataset: Some(record.set.clone()),
        dataset_version: dataset.manifest.program.clone(),
        dataset_seed: dataset.manifest.seed,
        method: Some(record.method()?),
        weights_sha256: None,
        program: Some(record.version.clone()),
    };
    if !scores.nothing_visible.is_empty() {
        eprintln!(
            "note: {} pairs have no line that is visible in both views and are not scored: {}",
            scores.nothing_visible.len(),
            scores.nothing_visible.join(", ")
        );
    }
    Ok(Report::new(provenance, settings, scores.pairs))
}

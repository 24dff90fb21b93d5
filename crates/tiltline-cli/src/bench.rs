//! `tiltline bench`: makes a fixed set of simulated pairs and reconstructs all of them, to be scored with `tiltline score`.

use std::path::{Path, PathBuf};

use clap::Args;
use miette::{IntoDiagnostic, Result, WrapErr, miette};
use serde::{Deserialize, Serialize};
use tiltline::dataset::sets::{SETS, Set};
use tiltline::dataset::{Dataset, Item, Manifest};
use tiltline::oracle::TruthOracle;
use tiltline::score::ResultCurves;
use tiltline::settings::Settings;
use tiltline::simulate::Lines;

use crate::args::{Method, Verbosity};
use crate::config::Config;
use crate::interrupt;
use crate::method::Stages;
use crate::output;
use crate::progress::Count;
use crate::reconstruct::{method, reconstruct};
use crate::simulate::make_shown;

/// Flags of `tiltline bench`.
#[derive(Debug, Args)]
#[command(after_help = sets())]
pub struct Bench {
    /// Name of a fixed set (below), or the folder of a data set with stereo pairs.
    pub set: String,
    /// Folder for the results. The same command again goes on where it stopped.
    #[arg(short, long, value_name = "FOLDER")]
    pub output: PathBuf,
    /// Where the set is, or is made; FOLDER/data if absent.
    #[arg(long, value_name = "FOLDER")]
    pub data: Option<PathBuf>,
    /// Rectify by the known geometry instead of estimating it: shows what the estimate loses.
    #[arg(long)]
    pub known_rectification: bool,
    /// How lines are found and matched.
    #[command(flatten)]
    pub method: Method,
    /// How much to say while working.
    #[command(flatten)]
    pub verbosity: Verbosity,
}

fn sets() -> String {
    let lines = SETS.iter().map(|set| format!("  {:<13} {}\n", set.name, set.purpose));
    format!(
        "Fixed sets (val-* for choosing, the others for reporting; nothing is trained on any):\n{}",
        lines.collect::<String>()
    )
}

/// Name of the record in the folder of a benchmark.
const RECORD: &str = "bench.toml";
/// Name of the file that says why a pair could not be reconstructed.
const FAILED: &str = "failed.txt";

/// `bench.toml`: what was run on what.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Record {
    /// Name of the set, or its folder.
    pub set: String,
    /// Where the data are, from the folder of the record.
    pub data: PathBuf,
    /// Hash of all data.
    pub data_sha256: String,
    /// Version of the program.
    pub version: String,
    /// Name of the detector.
    pub detector: String,
    /// Name of the matcher.
    pub matcher: String,
    /// Whether pairs are rectified by their known geometry.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub known_rectification: bool,
    /// Settings of the reconstruction.
    pub settings: Settings,
}

impl Record {
    /// Reads the record in the folder of a benchmark; none where there is none.
    pub fn find(folder: &Path) -> Result<Option<Self>> {
        let path = folder.join(RECORD);
        if !path.is_file() {
            return Ok(None);
        }
        let text = std::fs::read_to_string(&path).into_diagnostic()?;
        let record = toml::from_str(&text).into_diagnostic().wrap_err_with(|| format!("in {}", path.display()))?;
        Ok(Some(record))
    }

    /// The data that were reconstructed, if they are still the same.
    pub fn dataset(&self, folder: &Path) -> Result<Dataset> {
        let dataset = Dataset::open(folder.join(&self.data)).into_diagnostic()?;
        if dataset.manifest.content_hash() != self.data_sha256 {
            return Err(miette!(
                "{} is not the data set that was reconstructed: run the benchmark again in a new folder",
                dataset.folder.display()
            ));
        }
        Ok(dataset)
    }

    /// The result of an item: its curves, or none where the pair could not be reconstructed.
    pub fn result(folder: &Path, item: &Item) -> Result<ResultCurves, tiltline::score::ScoreError> {
        let folder = result_folder(folder, item);
        if folder.join(FAILED).is_file() { Ok(ResultCurves::none()) } else { ResultCurves::read(folder) }
    }

    /// How the result was made, in words: what differs from the defaults.
    pub fn method(&self) -> Result<String> {
        let table = |settings: &Settings| toml::Table::try_from(settings).into_diagnostic();
        let (given, defaults) = (table(&self.settings)?, table(&Settings::default())?);
        let mut changes = Vec::new();
        differences("", &given, &defaults, &mut changes);
        let changes = if changes.is_empty() { "defaults".into() } else { changes.join(", ") };
        let known = if self.known_rectification { "known rectification, " } else { "" };
        Ok(format!("{known}{} detector, {} matcher, {changes}", self.detector, self.matcher))
    }
}

fn differences(prefix: &str, given: &toml::Table, defaults: &toml::Table, changes: &mut Vec<String>) {
    for (key, value) in given {
        match (value, defaults.get(key)) {
            (toml::Value::Table(inner), Some(toml::Value::Table(default))) => {
                differences(&format!("{prefix}{key}."), inner, default, changes);
            }
            (_, default) if default != Some(value) => changes.push(format!("{prefix}{key} = {value}")),
            _ => {}
        }
    }
}

fn result_folder(folder: &Path, item: &Item) -> PathBuf {
    folder.join("results").join(&item.name)
}

/// Runs the command.
pub fn run(flags: &Bench) -> Result<()> {
    let config = method(&flags.method)?;
    config.settings.validate().into_diagnostic()?;
    let (dataset, data) = data(flags)?;
    let items = &dataset.manifest.items;
    let oracle = match items.first().filter(|_| config.method.needs_truth()) {
        Some(item) => Some(oracle(&dataset, item)?),
        None => None,
    };
    let stages = Stages::new(&config.method, &config.settings, oracle.as_ref())?;
    let record = Record {
        set: dataset.manifest.name.clone().unwrap_or_else(|| flags.set.clone()),
        data,
        data_sha256: dataset.manifest.content_hash(),
        version: env!("CARGO_PKG_VERSION").into(),
        detector: stages.names[0].clone(),
        matcher: stages.names[1].clone(),
        known_rectification: flags.known_rectification,
        settings: config.settings.clone(),
    };
    begin(&flags.output, &record)?;
    interrupt::resumable();
    let count = Count::new("reconstructing", flags.verbosity);
    let mut failed = 0;
    for (index, item) in items.iter().enumerate() {
        count.show(index, items.len());
        failed += usize::from(!reconstructed(&dataset, item, &config, &stages, flags)?);
    }
    count.clear();
    let folder = flags.output.display();
    let mut text = format!("{} pairs reconstructed in {folder}", items.len() - failed);
    if failed > 0 {
        text += &format!(
            "; {failed} could not be ({FAILED} in their folders says why) and score as if nothing had been found"
        );
    }
    output::print(&format!("{text}\nscore them: tiltline score {folder}\n"))
}

/// What knows the truth about an item.
fn oracle(dataset: &Dataset, item: &Item) -> Result<TruthOracle> {
    let truth = dataset.truth(item).into_diagnostic()?;
    Ok(TruthOracle::new(&truth.pair(item.pair[0], item.pair[1]).into_diagnostic()?))
}

/// The data, made if need be, and their place as seen from the folder of the results.
fn data(flags: &Bench) -> Result<(Dataset, PathBuf)> {
    let absolute = |path: &Path| std::path::absolute(path).into_diagnostic();
    if Path::new(&flags.set).is_dir() {
        if flags.data.is_some() {
            return Err(miette!("{} is a folder: it is the data, and --data has no meaning", flags.set));
        }
        let dataset = Dataset::open(&flags.set).into_diagnostic()?;
        dataset.check().into_diagnostic()?;
        return Ok((dataset, absolute(Path::new(&flags.set))?));
    }
    let set = Set::named(&flags.set).into_diagnostic()?;
    let (folder, place) = match &flags.data {
        Some(folder) => (folder.clone(), absolute(folder)?),
        None => (flags.output.join("data"), PathBuf::from("data")),
    };
    if let Some(parent) = folder.parent() {
        std::fs::create_dir_all(parent).into_diagnostic()?;
    }
    let plan: Manifest = set.manifest();
    let (dataset, _) = make_shown(&plan, Lines::Random, &folder, flags.verbosity)?;
    let hash = dataset.manifest.content_hash();
    if let Some(published) = set.published_hash().filter(|published| *published != hash) {
        eprintln!(
            "warning: this {} is not the published one (SHA-256 {hash}, published {published}): made by another version, or on a \
             system whose mathematical functions round differently; compare its figures with each other only",
            set.name
        );
    }
    Ok((dataset, place))
}

/// Notes what is run, or makes sure that the folder holds the same.
fn begin(folder: &Path, record: &Record) -> Result<()> {
    match Record::find(folder)? {
        Some(existing) if existing == *record => Ok(()),
        Some(_) => Err(miette!(
            "{} holds another benchmark (other data, settings or version): name another folder (nothing was written)",
            folder.display()
        )),
        None => {
            let results = folder.join("results");
            if results.exists() {
                return Err(miette!("{} is there but no {RECORD}: name another folder", results.display()));
            }
            std::fs::create_dir_all(&results).into_diagnostic()?;
            let text = toml::to_string(record).into_diagnostic()?;
            std::fs::write(folder.join(RECORD), text).into_diagnostic()
        }
    }
}

/// Reconstructs an item unless that was done; false where it cannot be.
fn reconstructed(dataset: &Dataset, item: &Item, config: &Config, stages: &Stages, flags: &Bench) -> Result<bool> {
    let target = result_folder(&flags.output, item);
    if target.exists() {
        return Ok(!target.join(FAILED).is_file());
    }
    let truth = dataset.truth(item).into_diagnostic()?;
    let pair = truth.pair(item.pair[0], item.pair[1]).into_diagnostic()?;
    let images = [pair.left, pair.right].map(|view| dataset.path(item, &view.name).to_string_lossy().into_owned());
    let mut config = config.clone();
    if let Some(tilts) = pair.tilts {
        config.acquisition.tilts_deg =
            Some([tilts.left_rad, tilts.right_rad].map(|tilt| (tilt.to_degrees() * 1e6).round() / 1e6));
    }
    let own = if config.method.needs_truth() || flags.known_rectification {
        let mut own = Stages::new(&config.method, &config.settings, Some(&TruthOracle::new(&pair)))?;
        if flags.known_rectification {
            let unknown = || miette!("the geometry of {} is not known: leave --known-rectification out", item.name);
            own.geometry = Some(pair.geometry.ok_or_else(unknown)?);
        }
        Some(own)
    } else {
        None
    };
    let stages = own.as_ref().unwrap_or(stages);
    match reconstruct([&images[0], &images[1]], &mut config, stages, &target, false, &|_| {}) {
        Ok(_) => Ok(true),
        Err(error) => {
            std::fs::create_dir_all(&target).into_diagnostic()?;
            std::fs::write(target.join(FAILED), format!("{error:?}\n")).into_diagnostic()?;
            Ok(false)
        }
    }
}

//! `tiltline figures`: the paper's Tables 1 to 3 and Figures 4 to 12 on this project's benchmark, as Markdown and PNG.
//!
//! What is measured is kept in a work folder, so that the same command goes on where it stopped; trainings are read from their
//! records unless `--retrain`.

mod cache;
mod plan;
mod series;
mod tables;
mod trainings;

use std::path::{Path, PathBuf};

use clap::Args;
use miette::{IntoDiagnostic, Result, miette};
use tiltline::dataset::{Dataset, Manifest};
use tiltline::figures::page::{self, Provenance, Section};
use tiltline::simulate::Lines;

use crate::args::Verbosity;
use crate::config::Config;
use crate::interrupt;
use crate::method::Stages;
use crate::output;
use crate::simulate::make_shown;
use cache::Cache;
use plan::Plan;

/// Name of the page.
const PAGE: &str = "README.md";
/// Stands in a page of a quick run.
const SMALL: &str = "**Made with --small: these figures mean nothing.**\n";

/// Flags of `tiltline figures`.
#[derive(Debug, Args)]
#[command(after_help = TIMES)]
pub struct Figures {
    /// Folder for README.md and its pictures; files of the same names are replaced, others stay. Records of trainings are read from
    /// its folder `records`.
    #[arg(short, long, value_name = "FOLDER")]
    pub output: PathBuf,
    /// Folder for data sets and measurements, from which the same command goes on where it stopped [default: FOLDER/.work].
    #[arg(long, value_name = "FOLDER")]
    pub work: Option<PathBuf>,
    /// Train the networks of Table 2 and Figure 12 again, and replace their records.
    #[arg(long)]
    pub retrain: bool,
    /// A minute's work instead of the benchmark: one small foil a set, few views, trainings of a few steps. Shows whether all runs; its
    /// figures mean nothing.
    #[arg(long)]
    pub small: bool,
    /// How much to say while working.
    #[command(flatten)]
    pub verbosity: Verbosity,
}

const TIMES: &str = "On two cores the benchmark takes about an hour, and --retrain half an hour more.";

/// What all tables and figures are made with.
struct Work<'a> {
    flags: &'a Figures,
    plan: Plan,
    folder: PathBuf,
    cache: Cache,
    config: Config,
    stages: Stages,
}

/// A table or figure, and the files it refers to.
struct Made {
    section: Section,
    files: Vec<(String, Vec<u8>)>,
}

/// Runs the command.
pub fn run(flags: &Figures) -> Result<()> {
    interrupt::resumable();
    let folder = flags.work.clone().unwrap_or_else(|| flags.output.join(".work"));
    std::fs::create_dir_all(&folder).into_diagnostic()?;
    let plan = if flags.small { Plan::small() } else { Plan::published()? };
    let config = Config::default();
    may_write(flags)?;
    let stages = Stages::new(&config.method, &config.settings, None)?;
    // What is measured depends on the settings too; of changed code a new version tells.
    let settings = toml::to_string(&config.settings).into_diagnostic()?;
    let [detector, matcher] = &stages.names;
    let cache = Cache::new(&folder.join("measured"), [detector, matcher, &settings])?;
    let work = Work { flags, plan, folder, cache, config, stages };
    if flags.retrain {
        trainings::retrain(&work)?;
    }

    let foils = work.dataset(&work.plan.series)?;
    let angles = work.dataset(&work.plan.angles)?;
    let pairs = work.dataset(&work.plan.pairs)?;
    let sample = work.dataset(&work.plan.training)?;
    let mut made = series::foil(&work, &foils)?;
    made.push(series::views(&work, &foils)?);
    made.push(tables::angles(&work, &angles)?);
    made.push(trainings::losses(&work)?);
    made.extend(tables::images(&work, &sample, &pairs)?);
    made.push(trainings::low_contrast(&work)?);

    let sets = [&foils, &angles, &pairs, &sample].map(|set| {
        let Manifest { name, seed, .. } = &set.manifest;
        (name.clone().unwrap_or_default(), *seed, set.manifest.content_hash())
    });
    let provenance =
        Provenance { version: env!("CARGO_PKG_VERSION").into(), method: work.stages.names.clone(), sets: sets.into() };
    let notes = if flags.small { SMALL } else { "" };
    let sections: Vec<Section> = made.iter().map(|made| made.section.clone()).collect();
    let page = page::write(&provenance, notes, &sections);
    let mut files: Vec<(String, Vec<u8>)> = made.into_iter().flat_map(|made| made.files).collect();
    // The page comes last: it says that the rest is complete.
    files.push((PAGE.into(), page.into_bytes()));
    write(&flags.output, &files)?;
    output::print(&format!("{} tables and figures in {}\n", sections.len(), flags.output.join(PAGE).display()))
}

/// Refuses to write over a page that is not this command's, or over figures that mean something with such as do not.
fn may_write(flags: &Figures) -> Result<()> {
    let path = flags.output.join(PAGE);
    let Ok(there) = std::fs::read_to_string(&path) else { return Ok(()) };
    if !there.starts_with(page::TITLE) {
        return Err(miette!("{} is not a page of `tiltline figures`; name another folder", path.display()));
    }
    if flags.small && !there.contains(SMALL) {
        return Err(miette!("{} is of the whole benchmark: name another folder for --small", path.display()));
    }
    Ok(())
}

/// Files into a folder: all or none.
fn write(folder: &Path, files: &[(String, Vec<u8>)]) -> Result<()> {
    interrupt::write_folder(folder, true, |staging| {
        for (name, bytes) in files {
            staging.write(name, |out| out.write_all(bytes)).into_diagnostic()?;
        }
        Ok(files.iter().map(|(name, _)| name.clone()).collect())
    })
}

impl Work<'_> {
    /// A set in the work folder, made if need be.
    fn dataset(&self, plan: &Manifest) -> Result<Dataset> {
        let name = plan.name.clone().unwrap_or_default();
        self.say(&format!("data: {name}"));
        let sets = self.folder.join("sets");
        std::fs::create_dir_all(&sets).into_diagnostic()?;
        Ok(make_shown(plan, Lines::Random, &sets.join(name), self.flags.verbosity)?.0)
    }

    /// A line about what is done now.
    fn say(&self, what: &str) {
        if !self.flags.verbosity.quiet {
            eprintln!("{what}");
        }
    }
}

//! `tiltline train`: networks from simulated or labelled images, in a folder that a later call goes on from.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use clap::{Args, ValueEnum};
use miette::{IntoDiagnostic, Result, WrapErr, miette};
use tiltline::simulate::Family;
use tiltline_nets::device::{Place, prepare_memory};
use tiltline_nets::infer::Named;
use tiltline_nets::train::{Event, MetricsLine, Run, Task, TrainSettings};
use tiltline_nets::weights::Weights;

use crate::args::Verbosity;
use crate::interrupt;
use crate::output;
use crate::reconstruct::wrong_usage;

/// Flags of `tiltline train`.
#[derive(Debug, Args)]
pub struct Train {
    /// What is trained. `detector` needs images with lines; `matcher` also pairs, and a detector's weights; `joint` trains both.
    #[arg(required_unless_present = "resume")]
    pub task: Option<What>,
    /// Folder of the run: weights, checkpoints, metrics.jsonl, curves.svg.
    #[arg(short, long, value_name = "FOLDER", required_unless_present = "resume")]
    pub output: Option<PathBuf>,
    /// Go on with the run of a folder from its last checkpoint.
    #[arg(long, value_name = "FOLDER", conflicts_with_all = ["task", "output", "config", "from", "data", "simulate", "seed"])]
    pub resume: Option<PathBuf>,
    /// Folder of a data set to train on (several: repeat it). Without --simulate, nothing else is trained on.
    #[arg(long, value_name = "FOLDER")]
    pub data: Vec<PathBuf>,
    /// Family of simulated foils to train on (several: repeat it): gan, tial, cantor, mixed. All of them without --data.
    #[arg(long, value_name = "FAMILY", value_parser = family)]
    pub simulate: Vec<Family>,
    /// Weights to start from: a detector's, a matcher's, or both (repeat it). `shipped` are those that are part of the program, where no
    /// file gives the network; without --config, a training from them has 200 steps at a low rate.
    #[arg(long, value_name = "FILE|shipped")]
    pub from: Vec<PathBuf>,
    /// Settings file; the train.toml of an earlier run repeats it. Flags override it.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Steps in all.
    #[arg(long, value_name = "N")]
    pub steps: Option<u64>,
    /// Seed of weights and data.
    #[arg(long, value_parser = clap::value_parser!(u64).range(..=i64::MAX as u64))]
    pub seed: Option<u64>,
    /// What to compute on.
    #[arg(long, value_name = "DEVICE", default_value = "cpu")]
    pub device: Device,
    /// How much to say while working.
    #[command(flatten)]
    pub verbosity: Verbosity,
}

/// What is trained.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum What {
    /// The line detector.
    Detector,
    /// The matcher, on what a given detector finds.
    Matcher,
    /// Both together.
    Joint,
}

/// What networks run on.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub enum Device {
    /// The processor.
    #[default]
    Cpu,
    /// A graphics card (programs built with the feature wgpu).
    Wgpu,
    /// An Nvidia card (programs built with the feature cuda).
    Cuda,
}

impl Device {
    /// The device itself.
    pub fn place(self) -> Place {
        match self {
            Device::Cpu => Place::Cpu,
            Device::Wgpu => Place::Wgpu,
            Device::Cuda => Place::Cuda,
        }
    }
}

/// Word for the weights that are part of the program.
const SHIPPED: &str = "shipped";

fn family(word: &str) -> Result<Family, String> {
    Family::ALL
        .into_iter()
        .find(|family| family.word() == word)
        .ok_or_else(|| format!("one of {}", Family::ALL.map(Family::word).join(", ")))
}

/// Runs the command.
pub fn run(flags: &Train) -> Result<()> {
    prepare_memory();
    let device = flags.device.place().device().into_diagnostic()?;
    let mut run = match &flags.resume {
        Some(folder) => Run::resume(folder, flags.steps, device).into_diagnostic()?,
        None => {
            let output = flags.output.as_deref().unwrap_or_else(|| wrong_usage("--output FOLDER is missing"));
            let settings = settings(flags)?;
            let from = weights(&flags.from, settings.task)?;
            Run::start(settings, output, &from, device).into_diagnostic()?
        }
    };
    let folder = flags.resume.as_deref().or(flags.output.as_deref()).unwrap_or(Path::new("."));
    let steps = run.settings().steps;
    if !flags.verbosity.quiet {
        eprintln!("{}", run.needs());
    }
    if run.step() >= steps {
        return Err(miette!("{} is at step {} of {steps}; give more with --steps", folder.display(), run.step()));
    }
    let stop = interrupt::ask_to_stop();
    let mut report = |event: &Event<'_>| {
        match event {
            Event::LeftOut(folder) => {
                eprintln!("warning: {} is left out: its views cannot be rectified", folder.display());
            }
            Event::Line { line, steps } if !flags.verbosity.quiet => eprintln!("{}", described(line, *steps)),
            _ => (),
        }
        !stop.load(Ordering::Relaxed)
    };
    run.train(&mut report).into_diagnostic()?;
    if run.step() < steps {
        output::print(&format!(
            "stopped at step {} of {steps}, all saved; go on with: tiltline train --resume {}\n",
            run.step(),
            folder.display()
        ))?;
        std::process::exit(interrupt::INTERRUPTED);
    }
    output::print(&format!("trained {steps} steps; weights in {}\n", folder.display()))
}

/// A line of the metrics for a reader, with the time left.
fn described(line: &MetricsLine, steps: u64) -> String {
    let values: Vec<String> = line.values.iter().map(|(name, value)| format!("{name} {value:.4}")).collect();
    let left = line.seconds / line.step.max(1) as f64 * (steps - line.step.min(steps)) as f64;
    let left = format!("{}:{:02} h left", left as u64 / 3600, left as u64 / 60 % 60);
    format!("{:>7} / {steps} {:<10} {}  rate {:.1e}  {left}", line.step, line.kind, values.join("  "), line.rate)
}

/// The weights of files, and those of the program for what the task needs and no file gives.
fn weights(from: &[PathBuf], task: Task) -> Result<Vec<(PathBuf, Weights)>> {
    let (shipped, files): (Vec<&PathBuf>, Vec<&PathBuf>) = from.iter().partition(|path| *path == Path::new(SHIPPED));
    let mut all = files.into_iter().map(|path| Named::read(path).into_diagnostic()).collect::<Result<Vec<_>>>()?;
    if !shipped.is_empty() {
        let mut own = vec![Named::built_in_detector().into_diagnostic()?];
        if task != Task::Detector {
            own.push(Named::built_in_matcher().into_diagnostic()?);
        }
        let given: Vec<&str> = all.iter().map(|named| named.weights.network.word()).collect();
        own.retain(|named| !given.contains(&named.weights.network.word()));
        all.extend(own);
    }
    Ok(all.into_iter().map(|named| (named.path, named.weights)).collect())
}

/// Defaults, overridden by the settings file, overridden by flags.
fn settings(flags: &Train) -> Result<TrainSettings> {
    let mut settings = match &flags.config {
        Some(path) => {
            let text = std::fs::read_to_string(path)
                .into_diagnostic()
                .wrap_err_with(|| format!("cannot read the settings file {}", path.display()))?;
            toml::from_str(&text)
                .into_diagnostic()
                .wrap_err_with(|| format!("in the settings file {}", path.display()))?
        }
        // What is good already is changed little: higher rates forget it.
        None if flags.from.iter().any(|path| path == Path::new(SHIPPED)) => TrainSettings {
            steps: 200,
            learning_rate: Some(if matches!(flags.task, Some(What::Detector)) { 2e-4 } else { 1e-4 }),
            warm_up: 20,
            validate_every: 100,
            ..TrainSettings::default()
        },
        None => TrainSettings::default(),
    };
    match flags.task {
        Some(What::Detector) => settings.task = Task::Detector,
        Some(What::Matcher) => settings.task = Task::Matcher,
        Some(What::Joint) => settings.task = Task::Joint,
        None => {}
    }
    if !flags.data.is_empty() {
        settings.data.folders.clone_from(&flags.data);
        settings.data.families.clear();
    }
    if !flags.simulate.is_empty() {
        settings.data.families.clone_from(&flags.simulate);
    }
    settings.steps = flags.steps.unwrap_or(settings.steps);
    settings.seed = flags.seed.unwrap_or(settings.seed);
    Ok(settings)
}

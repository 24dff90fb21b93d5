//! `tiltline simulate`: a data set of simulated foils.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use miette::{IntoDiagnostic, Result, WrapErr};
use tiltline::dataset::{Dataset, GeometryFile, Made, Manifest, make};
use tiltline::io::parse_tilts;
use tiltline::simulate::paradis::{Network, ReadOptions};
use tiltline::simulate::{self, Lines, SimulateSettings};

use crate::args::Verbosity;
use crate::interrupt;
use crate::output;
use crate::progress::Count;
use crate::reconstruct::wrong_usage;

/// Flags of `tiltline simulate`.
#[derive(Debug, Args)]
pub struct Simulate {
    /// Folder of the data set. A set that is there already is checked, mended and completed, if seed and settings are the same.
    #[arg(short, long, value_name = "FOLDER")]
    pub output: PathBuf,
    /// Kind of specimen and microscopy: the defaults of everything.
    #[arg(long)]
    pub family: Option<Family>,
    /// Drawn line profiles (fast, diverse), or two-beam diffraction.
    #[arg(long)]
    pub mode: Option<Mode>,
    /// Settings file (TOML) over the family's defaults; every key is in the dataset.toml of any set.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// ParaDiS network (.data) that foils are cut from at random places, instead of random foils.
    #[arg(long, value_name = "FILE")]
    pub geometry: Option<PathBuf>,
    /// Tilts in degrees: LIST (-4,4), START:END:STEP, or a FILE (.tlt, .rawtlt, .mdoc).
    #[arg(long, value_name = "LIST|START:END:STEP|FILE", allow_hyphen_values = true)]
    pub tilts: Option<String>,
    /// Rows and columns of the images, px.
    #[arg(long, value_name = "PX")]
    pub size: Option<usize>,
    /// Number of foils.
    #[arg(long, default_value_t = 10)]
    pub count: u32,
    /// Seed of everything random.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// How much to say while working.
    #[command(flatten)]
    pub verbosity: Verbosity,
}

/// Families by their words.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Family {
    /// Threading lines, few and clear.
    Gan,
    /// Bowed lines and tangles between lamella boundaries.
    Tial,
    /// Pile-ups and networks, dense and weak.
    Cantor,
    /// Everything.
    Mixed,
}

/// Modes by their words.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Mode {
    /// Drawn profiles.
    Parametric,
    /// Two-beam diffraction.
    Physics,
}

/// Runs the command.
pub fn run(flags: &Simulate) -> Result<()> {
    let settings = settings(flags)?;
    let network = flags.geometry.as_deref().map(network).transpose()?;
    let (lines, geometry) = match &network {
        Some((network, file)) => (Lines::Network(network), Some(file.clone())),
        None => (Lines::Random, None),
    };
    let plan = Manifest::simulated(settings, flags.seed, flags.count, geometry).into_diagnostic()?;
    let (dataset, made) = make_shown(&plan, lines, &flags.output, flags.verbosity)?;
    let mended = match made.mended.len() {
        0 => String::new(),
        count => format!(", {count} damaged ones made again ({})", made.mended.join(", ")),
    };
    let Made { made, kept, .. } = made;
    let foils = dataset.manifest.items.len();
    let text = format!("{foils} foils in {}: {made} made, {kept} kept{mended}\n", flags.output.display());
    output::print(&text)
}

/// Makes a data set with a bar.
pub fn make_shown(plan: &Manifest, lines: Lines<'_>, folder: &Path, verbosity: Verbosity) -> Result<(Dataset, Made)> {
    interrupt::resumable();
    let count = Count::new("simulating", verbosity);
    let progress = |done: usize, of: usize| {
        count.show(done, of);
        true
    };
    let made = make(plan, lines, folder, &progress).into_diagnostic();
    count.clear();
    made
}

fn settings(flags: &Simulate) -> Result<SimulateSettings> {
    let family = flags.family.map(|family| match family {
        Family::Gan => simulate::Family::Gan,
        Family::Tial => simulate::Family::Tial,
        Family::Cantor => simulate::Family::Cantor,
        Family::Mixed => simulate::Family::Mixed,
    });
    let mut settings = match &flags.config {
        Some(path) => {
            let text = std::fs::read_to_string(path)
                .into_diagnostic()
                .wrap_err_with(|| format!("cannot read the settings file {}", path.display()))?;
            let read = SimulateSettings::from_toml(&text, family).into_diagnostic();
            read.wrap_err_with(|| format!("in the settings file {}", path.display()))?
        }
        None => SimulateSettings::of_family(family.unwrap_or_default()),
    };
    if let Some(mode) = flags.mode {
        settings.mode = match mode {
            Mode::Parametric => simulate::Mode::Parametric,
            Mode::Physics => simulate::Mode::Physics,
        };
    }
    if let Some(text) = &flags.tilts {
        settings.tilts_deg = parse_tilts(text).unwrap_or_else(|error| wrong_usage(&format!("--tilts {text}: {error}")));
    }
    settings.size_px = flags.size.unwrap_or(settings.size_px);
    Ok(settings)
}

fn network(path: &Path) -> Result<(Network, GeometryFile)> {
    let network = Network::read(path, &ReadOptions::default())
        .into_diagnostic()
        .wrap_err_with(|| format!("cannot use the network {}", path.display()))?;
    Ok((network, GeometryFile::of(path).into_diagnostic()?))
}

//! The command line as typed flags; each command validates its own.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;

use crate::quantity::PixelSize;

/// 3D reconstruction of dislocations from two electron micrographs a few degrees apart.
#[derive(Debug, Parser)]
#[command(name = "tiltline", version, max_term_width = 110, after_help = EXIT_CODES)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

const EXIT_CODES: &str = "Exit codes: 0 done (perhaps with warnings), 1 failed, 2 wrong usage, 130 interrupted.";

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Reconstruct the 3D curves of a stereo pair, or of a tilt series.
    Reconstruct(Box<Reconstruct>),
    /// Re-project the curves of a result into the views of a tilt series, and measure how well they fit.
    Reproject(Box<crate::reproject::Reproject>),
    /// Simulate micrographs of foils with exact truth: a data set.
    Simulate(Box<crate::simulate::Simulate>),
    /// Score a result against the truth, or a whole benchmark.
    Score(crate::score::Score),
    /// Reconstruct a fixed set of simulated pairs, to be scored.
    Bench(Box<crate::bench::Bench>),
    /// Check a data set, or add images labelled by hand to one.
    Dataset(crate::dataset::DatasetArgs),
    /// Train networks on simulated foils or on labelled images.
    Train(Box<crate::train::Train>),
    /// Open the report of a result in the browser.
    View(View),
    /// Make the report of a result again, and its figures for print.
    Report(Report),
    /// Make a tomogram of a tilt series.
    Tomography(Box<crate::tomography::Tomography>),
    /// Make the paper's tables and figures on this project's benchmark.
    Figures(Box<crate::figures::Figures>),
    /// Say what is in a micrograph or series: size, type, pixel size, tilts, range, warnings.
    Info(Info),
    /// Print a completion script for a shell.
    Completions {
        /// The shell.
        shell: Shell,
    },
}

/// Flags of `tiltline view`.
#[derive(Debug, Args)]
pub struct View {
    /// Folder that `tiltline reconstruct` wrote, or a report.html.
    pub result: PathBuf,
}

/// Flags of `tiltline report`.
#[derive(Debug, Args)]
pub struct Report {
    /// Folder that `tiltline reconstruct` wrote, or a report.html.
    pub result: PathBuf,
    /// Draw the figures for print too: figures/NAME.svg and .png (300 dpi) beside the report.
    #[arg(long)]
    pub png: bool,
}

/// Flags of `tiltline reconstruct`.
#[derive(Debug, Args)]
pub struct Reconstruct {
    /// First image (PNG, TIFF, MRC); FILE#k takes page or section k of a stack, counted from 0. Alone: a tilt series, a stack
    /// with its tilts or a folder of images.
    #[arg(value_name = "LEFT|SERIES")]
    pub left: String,
    /// Second image, at another tilt.
    pub right: Option<String>,
    /// Folder for the results.
    #[arg(short, long, value_name = "FOLDER")]
    pub output: PathBuf,
    /// Tilts in degrees, of left and right or of every view of a series: LIST (-4,4), START:END:STEP, or a FILE (.tlt, .rawtlt,
    /// .mdoc; for a folder also a .csv of file and tilt).
    #[arg(long, value_name = "LIST|START:END:STEP|FILE", allow_hyphen_values = true)]
    pub tilts: Option<String>,
    /// Of a series, the two views that are reconstructed, by their angles (-4,4; the nearest views are taken), or auto.
    #[arg(long, value_name = "LEFT,RIGHT|auto", allow_hyphen_values = true, conflicts_with = "right")]
    pub pair: Option<String>,
    /// Side of a pixel of the left image, with its unit: 1.2nm, 3.4A, 0.001um. Overrides the files'.
    #[arg(long, value_name = "SIZE")]
    pub pixel_size: Option<PixelSize>,
    /// Direction of the tilt axis, degrees clockwise on the screen from image y (0 vertical, 90 horizontal).
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true)]
    pub tilt_axis: Option<f64>,
    /// How lines are found and matched.
    #[command(flatten)]
    pub method: Method,
    /// Report the other sign of depth: no number of projections can tell which is right.
    #[arg(long)]
    pub flip_depth: bool,
    /// Write into a folder that has other content.
    #[arg(long)]
    pub force: bool,
    /// Print the summary as JSON.
    #[arg(long)]
    pub json: bool,
    /// How much to say while working.
    #[command(flatten)]
    pub verbosity: Verbosity,
}

/// How lines are found and matched: the same for one pair and for a benchmark.
#[derive(Clone, Debug, Args)]
pub struct Method {
    /// What finds lines.
    #[arg(long, value_name = "KIND")]
    pub detector: Option<crate::method::Detector>,
    /// What finds disparities.
    #[arg(long, value_name = "KIND")]
    pub matcher: Option<crate::method::Matcher>,
    /// Weights of a network, a detector's or a matcher's (both: repeat it), instead of those that are part of the program.
    #[arg(long, value_name = "FILE")]
    pub weights: Vec<PathBuf>,
    /// Whether lines are darker or brighter than what surrounds them (for --detector ridge; the network finds both)
    #[arg(long, value_name = "CONTRAST")]
    pub lines: Option<Lines>,
    /// Largest disparity to look for, in px of the left image; without it, from the spread of the point matches.
    #[arg(long, value_name = "PX")]
    pub max_disparity: Option<f64>,
    /// How disparities are refined.
    #[arg(long, value_name = "METHOD")]
    pub refine: Option<Refine>,
    /// Seed of everything random.
    // A settings file cannot hold more than 63 bits.
    #[arg(long, value_parser = clap::value_parser!(u64).range(..=i64::MAX as u64))]
    pub seed: Option<u64>,
    /// Settings file; the run.toml of an earlier run repeats it. Flags override it.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

/// Flags of `tiltline info`.
#[derive(Debug, Args)]
pub struct Info {
    /// Micrographs or series.
    #[arg(required = true)]
    pub files: Vec<String>,
    /// Also measure the image as the paper's Table 3 does: signal-to-noise ratio of lines and of background, contrast. Lines are
    /// those that the ridge filter finds. Stacks need FILE#k.
    #[arg(long)]
    pub statistics: bool,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// How much to say while working; results and errors are always said.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct Verbosity {
    /// No progress.
    #[arg(short, long, conflicts_with = "verbose")]
    pub quiet: bool,
    /// Each stage with its time.
    #[arg(short, long)]
    pub verbose: bool,
}

/// Contrast of the lines.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Lines {
    /// Darker than the background (bright field).
    Dark,
    /// Brighter (dark field, weak beam).
    Bright,
    /// Whichever is stronger.
    Auto,
}

/// Refinement method.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Refine {
    /// Not at all.
    None,
    /// The paper's: to the nearest detected pixel within 3 px.
    Nearest,
    /// Along the whole curve.
    Curve,
}

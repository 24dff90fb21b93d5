//! `tiltline dataset`: checks a data set, and brings images labelled by hand into one.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};
use miette::{IntoDiagnostic, Result, miette};
use tiltline::dataset::Dataset;
use tiltline::dataset::label::{LabelledPair, add_labelled};
use tiltline::io::parse_tilts;
use tiltline::simulate::geometry::Split;

use crate::output;
use crate::quantity::PixelSize;
use crate::reconstruct::wrong_usage;

/// Flags of `tiltline dataset`.
#[derive(Debug, Args)]
pub struct DatasetArgs {
    /// What to do.
    #[command(subcommand)]
    pub action: Action,
}

/// What to do with a data set.
#[derive(Debug, Subcommand)]
pub enum Action {
    /// Compare every file with its hash in the manifest.
    Check {
        /// The data set.
        folder: PathBuf,
    },
    /// Add a stereo pair labelled in LabelMe: lines as linestrips, the same line with the same label in both images. Label
    /// rectified images, as `tiltline reconstruct` writes them: rows are taken as epipolar lines.
    Add(Add),
}

/// Flags of `tiltline dataset add`.
#[derive(Debug, Args)]
pub struct Add {
    /// The data set; made where it does not exist.
    pub folder: PathBuf,
    /// Left and right image, and their LabelMe files.
    #[arg(num_args = 4, value_names = ["LEFT", "RIGHT", "LEFT.json", "RIGHT.json"], required = true)]
    pub files: Vec<PathBuf>,
    /// Name of the pair: a folder in the data set.
    #[arg(long)]
    pub name: String,
    /// Tilts of left and right in degrees, if known.
    #[arg(long, value_name = "LEFT,RIGHT", allow_hyphen_values = true)]
    pub tilts: Option<String>,
    /// Side of a pixel of the left image, with its unit, if known.
    #[arg(long, value_name = "SIZE")]
    pub pixel_size: Option<PixelSize>,
    /// Look of the images, for scores by family: any word.
    #[arg(long)]
    pub family: Option<String>,
    /// What the pair is for.
    #[arg(long, default_value = "train")]
    pub split: SplitFlag,
}

/// Splits by their words.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum SplitFlag {
    /// Fitting weights.
    Train,
    /// Choosing between weights.
    Val,
    /// Reporting, first subset.
    TestA,
    /// Reporting, second subset.
    TestB,
}

/// Runs the command.
pub fn run(flags: &DatasetArgs) -> Result<()> {
    match &flags.action {
        Action::Check { folder } => {
            let dataset = Dataset::open(folder).into_diagnostic()?;
            dataset.check().into_diagnostic()?;
            let files: usize = dataset.manifest.items.iter().map(|item| item.files.len()).sum();
            let items = dataset.manifest.items.len();
            output::print(&format!("{}: {items} items, {files} files, all as they were written\n", folder.display()))
        }
        Action::Add(flags) => add(flags),
    }
}

fn add(flags: &Add) -> Result<()> {
    let [left, right, left_labels, right_labels] = &flags.files[..] else {
        return Err(miette!("four files are needed: left, right, and the labels of each"));
    };
    let tilts_deg = flags.tilts.as_ref().map(|text| match parse_tilts(text).as_deref() {
        Ok(&[left, right]) => [left, right],
        Ok(tilts) => wrong_usage(&format!("--tilts {text} gives {} tilts; a pair has two", tilts.len())),
        Err(error) => wrong_usage(&format!("--tilts {text}: {error}")),
    });
    let pair = LabelledPair {
        name: &flags.name,
        images: [left, right],
        labels: [left_labels, right_labels],
        tilts_deg,
        pixel_size_nm: flags.pixel_size.map(|size| size.nm),
        family: flags.family.clone(),
        split: match flags.split {
            SplitFlag::Train => Split::Train,
            SplitFlag::Val => Split::Val,
            SplitFlag::TestA => Split::TestA,
            SplitFlag::TestB => Split::TestB,
        },
    };
    for warning in add_labelled(&flags.folder, &pair).into_diagnostic()? {
        eprintln!("warning: {warning}");
    }
    output::print(&format!("{} added to {}\n", flags.name, flags.folder.display()))
}

//! Why a tilt series could not be used: every message names the series, the values and what to do.

use std::path::PathBuf;

use crate::io::ReadError;

/// Why a tilt series could not be read, aligned, or made use of.
#[derive(Debug, thiserror::Error)]
pub enum SeriesError {
    /// A file of it could not be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// A folder could not be listed.
    #[error("{folder}: the folder cannot be read: {source}")]
    Folder {
        /// The folder.
        folder: String,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// A folder without images.
    #[error("{folder} holds no TIFF, PNG or MRC image; name the series file, or the folder of its images")]
    NoImages {
        /// The folder.
        folder: String,
    },
    /// Too few views.
    #[error(
        "{path} has {views} view(s), and a tilt series needs at least 2; for single images give LEFT and RIGHT to \
         `tiltline reconstruct`"
    )]
    TooFewViews {
        /// The series.
        path: String,
        /// How many there are.
        views: usize,
    },
    /// No tilts anywhere.
    #[error("{path}: the tilts of its {views} views are not known: give --tilts START:END:STEP or a file{notes}")]
    NoTilts {
        /// The series.
        path: String,
        /// Number of views.
        views: usize,
        /// What was found and not used, each after "; ".
        notes: String,
    },
    /// Another number of tilts than of views.
    #[error(
        "{path} has {views} views and {from} gives {tilts} tilts; one tilt a view is needed, in the order of the views"
    )]
    WrongCount {
        /// The series.
        path: String,
        /// Number of views.
        views: usize,
        /// Where the tilts come from.
        from: String,
        /// Number of tilts.
        tilts: usize,
    },
    /// All views were taken at one tilt.
    #[error("{path}: every view has the tilt {tilt_deg} degrees; the list of tilts was not recorded, or was reset")]
    OneTilt {
        /// The series.
        path: String,
        /// The tilt.
        tilt_deg: f64,
    },
    /// Images of several sizes.
    #[error(
        "{first} is {first_size} and {other} is {other_size}; the views of a series need one size: crop or pad them"
    )]
    Sizes {
        /// The first image.
        first: String,
        /// Its columns and rows.
        first_size: String,
        /// An image of another size.
        other: String,
        /// Its columns and rows.
        other_size: String,
    },
    /// A file in a folder holds several pages.
    #[error("{path} holds {pages} pages: in a folder each image is one view; give that file itself as the series")]
    StackInFolder {
        /// The file.
        path: String,
        /// Its pages.
        pages: usize,
    },
    /// A table of tilts that cannot be used.
    #[error("{path}: {what}")]
    Table {
        /// The table.
        path: String,
        /// What is wrong and what to write instead.
        what: String,
    },
    /// No view near the angle that was asked for.
    #[error(
        "there is no view at {asked_deg} degrees: the nearest is at {nearest_deg}, further than half a step ({half_step_deg} \
         degrees) away; the views go from {first_deg} to {last_deg} degrees"
    )]
    NoView {
        /// The angle.
        asked_deg: f64,
        /// The nearest view.
        nearest_deg: f64,
        /// How far it may be off.
        half_step_deg: f64,
        /// The least tilt.
        first_deg: f64,
        /// The largest tilt.
        last_deg: f64,
    },
    /// Two angles mean one view.
    #[error("{first_deg} and {second_deg} degrees both mean the view at {view_deg}; a pair needs two views")]
    OneView {
        /// The first angle.
        first_deg: f64,
        /// The second angle.
        second_deg: f64,
        /// The view they mean.
        view_deg: f64,
    },
    /// Views that show nothing.
    #[error("{path}: {what}")]
    Blank {
        /// The series or the view.
        path: String,
        /// Which views, and what to do.
        what: String,
    },
    /// Images that do not show one thing.
    #[error("{path}: {what}")]
    Align {
        /// The series.
        path: String,
        /// What failed and what to try.
        what: String,
    },
    /// A result that cannot be read back.
    #[error("{}: {what}", path.display())]
    Result {
        /// The file.
        path: PathBuf,
        /// What is wrong and what to do.
        what: String,
    },
}

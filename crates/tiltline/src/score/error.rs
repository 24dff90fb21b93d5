//! Why a result could not be scored.

use std::path::PathBuf;

use crate::truth::TruthError;

/// Why a result could not be scored; every message says what to change.
#[derive(Debug, thiserror::Error)]
pub enum ScoreError {
    /// A file of the result could not be read.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A table that is not one of ours.
    #[error("{}: columns are '{found}', '{expected}' expected", path.display())]
    Columns {
        /// The file.
        path: PathBuf,
        /// Its first line.
        found: String,
        /// What it should be.
        expected: String,
    },
    /// A row that cannot be read.
    #[error("{}, line {line}: {message}", path.display())]
    Row {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What is wrong.
        message: String,
    },
    /// The result has points far outside the images of the truth.
    #[error(
        "the result reaches ({x:.1}, {y:.1}) px in the {view} image and the truth's is {width}x{height} px: \
         this truth belongs to another image, or to another crop of it"
    )]
    ImageSize {
        /// The view.
        view: &'static str,
        /// The furthest point.
        x: f64,
        /// The furthest point.
        y: f64,
        /// Columns in the truth.
        width: usize,
        /// Rows in the truth.
        height: usize,
    },
    /// The truth is unusable.
    #[error(transparent)]
    Truth(#[from] TruthError),
    /// No curve of the truth can be seen in both views.
    #[error(
        "no curve of the truth is visible in both '{left}' and '{right}': nothing can be scored \
         ({curves} curves in the truth)"
    )]
    NothingToFind {
        /// Left view.
        left: String,
        /// Right view.
        right: String,
        /// Number of curves.
        curves: usize,
    },
    /// Lengths in nm cannot be compared with lengths in px.
    #[error("the result is in nm and the truth in px: give the truth its pixel size, or reconstruct without one")]
    Unit,
    /// An image and its mask do not fit.
    #[error("image is {}x{} px and mask {}x{} px (columns x rows)", image[1], image[0], mask[1], mask[0])]
    MaskSize {
        /// Rows and columns of the image.
        image: [usize; 2],
        /// Rows and columns of the mask.
        mask: [usize; 2],
    },
}

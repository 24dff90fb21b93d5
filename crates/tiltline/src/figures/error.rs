//! Why a figure could not be made.

use crate::dataset::DatasetError;
use crate::io::ReadError;
use crate::pair::PairError;
use crate::pipeline::PipelineError;
use crate::score::ScoreError;
use crate::series::SeriesError;
use crate::simulate::SimulateError;
use crate::tomography::TomographyError;
use crate::tomography::against_truth::JudgeError;
use crate::truth::TruthError;

/// Why a figure could not be made.
#[derive(Debug, thiserror::Error)]
pub enum FiguresError {
    /// The data set.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// An image.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Two images that are no pair.
    #[error(transparent)]
    Pair(#[from] PairError),
    /// The truth has no such views.
    #[error(transparent)]
    Truth(#[from] TruthError),
    /// The pair could not be reconstructed.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// The series.
    #[error(transparent)]
    Series(#[from] SeriesError),
    /// A tomogram could not be judged.
    #[error(transparent)]
    Judge(#[from] JudgeError),
    /// A choice of views is not possible.
    #[error(transparent)]
    Tomography(#[from] TomographyError),
    /// A result cannot be scored.
    #[error(transparent)]
    Score(#[from] ScoreError),
    /// A foil cannot be simulated.
    #[error(transparent)]
    Simulate(#[from] SimulateError),
    /// Tilts that nobody knows.
    #[error("the truth of {item} has no tilts; figures are made of simulated items only")]
    NoTilts {
        /// The item.
        item: String,
    },
    /// A file that was to be encoded in memory.
    #[error("a picture of {width} x {height} px cannot be encoded: {source}")]
    Picture {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Why.
        source: std::io::Error,
    },
}

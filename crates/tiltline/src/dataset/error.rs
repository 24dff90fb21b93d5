//! Why a data set could not be made, read or trusted.

use std::path::PathBuf;

use crate::io::ReadError;
use crate::simulate::SimulateError;
use crate::truth::TruthError;

/// Why a data set could not be made, read or trusted; every message says what to change.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The manifest is not one.
    #[error("{}: {source} (the keys are listed in docs/formats.md, \"Data sets\")", path.display())]
    Toml {
        /// The file.
        path: PathBuf,
        /// Where and what.
        source: toml::de::Error,
    },
    /// A manifest of another version.
    #[error("{}: data set version {found}; this program reads version {known}", path.display())]
    Version {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: u32,
        /// The version that is read.
        known: u32,
    },
    /// A manifest that contradicts itself.
    #[error("{}: {problem}", path.display())]
    Manifest {
        /// The file.
        path: PathBuf,
        /// What is wrong and what to do.
        problem: String,
    },
    /// A file has another content than when it was written.
    #[error(
        "{} is damaged or was changed: its SHA-256 is {found}, the manifest says {expected}; `tiltline simulate` with the settings of \
         the set makes it again, or restore the file", path.display()
    )]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Hash in the manifest.
        expected: String,
        /// Hash of the file.
        found: String,
    },
    /// An item that was planned but not made.
    #[error("item {item} of {} was never completed; run the command that made the set again, it goes on where it stopped", folder.display())]
    Unfinished {
        /// The data set.
        folder: PathBuf,
        /// The item.
        item: String,
    },
    /// A folder that looks like an item but is not named.
    #[error("{} holds the item {item}, which its manifest does not name: remove the folder, or add it to the manifest", folder.display())]
    NotInManifest {
        /// The data set.
        folder: PathBuf,
        /// The folder's name.
        item: String,
    },
    /// The folder holds something else.
    #[error("{} is not empty and has no {}: name another folder (nothing was written)", folder.display(), super::MANIFEST)]
    Foreign {
        /// The folder.
        folder: PathBuf,
    },
    /// The folder holds another data set.
    #[error(
        "{} holds another data set ({difference}): name another folder, or give the seed and settings of that set to go on with it \
         (nothing was written)", folder.display()
    )]
    Other {
        /// The folder.
        folder: PathBuf,
        /// What differs.
        difference: String,
    },
    /// A seed beyond those of users.
    #[error("seed {seed} is kept for the fixed sets; give one below {limit}")]
    Seed {
        /// The seed.
        seed: u64,
        /// Seeds are below this.
        limit: u64,
    },
    /// A name that no set has.
    #[error("there is no set '{name}'; the sets are {known}")]
    UnknownSet {
        /// The name.
        name: String,
        /// All names.
        known: String,
    },
    /// An image has another size than its truth.
    #[error("{} is {columns} x {rows} px, its labels say {label_columns} x {label_rows} px: label the image itself, not a resized copy", path.display())]
    ImageSize {
        /// The image.
        path: PathBuf,
        /// Its columns.
        columns: usize,
        /// Its rows.
        rows: usize,
        /// Columns in the labels.
        label_columns: usize,
        /// Rows in the labels.
        label_rows: usize,
    },
    /// Settings that cannot be simulated.
    #[error(transparent)]
    Simulate(#[from] SimulateError),
    /// A truth that cannot be read or written.
    #[error(transparent)]
    Truth(#[from] TruthError),
    /// An image that cannot be read.
    #[error(transparent)]
    Image(#[from] ReadError),
    /// Stopped by the caller.
    #[error("stopped; what was complete is kept, and the same command goes on from there")]
    Stopped,
}

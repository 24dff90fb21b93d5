//! Data sets: folders of views with their truth, simulated or labelled by hand, and a manifest that knows every file
//! (docs/formats.md, "Data sets").
//!
//! ```text
//! data/dataset.toml      manifest: where the data come from, and the SHA-256 of every file
//! data/00000/            one item: truth.json, its images, and what is drawn from the truth (masks, disparity)
//! ```
//!
//! [`make`] simulates what a manifest plans and takes up where it was interrupted; [`sets`] are the fixed sets that scores are
//! reported on; [`label`] brings images labelled by hand into the same form.

mod error;
mod item;
pub mod label;
mod make;
mod manifest;
mod scores;
pub mod sets;

use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

pub use error::DatasetError;
pub use item::{LINE_WIDTH_PX, disparity_map, line_mask};
pub use make::{Made, make};
pub use manifest::{DatasetFormat, GeometryFile, Item, MANIFEST, Manifest};
pub use scores::{SetScoreError, SetScores};

use crate::truth::Truth;

/// A data set on disk.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// Its folder.
    pub folder: PathBuf,
    /// What is in it.
    pub manifest: Manifest,
}

impl Dataset {
    /// Opens a data set; its files are not looked at yet.
    ///
    /// # Errors
    /// Where there is no manifest or it cannot be understood.
    pub fn open(folder: impl Into<PathBuf>) -> Result<Self, DatasetError> {
        let folder = folder.into();
        let manifest = Manifest::read(&folder.join(MANIFEST))?;
        Ok(Self { folder, manifest })
    }

    /// The path of a file of an item.
    pub fn path(&self, item: &Item, file: &str) -> PathBuf {
        self.folder.join(&item.name).join(file)
    }

    /// The truth of an item.
    ///
    /// # Errors
    /// Where its file is missing or not a truth.
    pub fn truth(&self, item: &Item) -> Result<Truth, DatasetError> {
        Ok(Truth::read(self.path(item, &item.truth))?)
    }

    /// Compares an item's files with their hashes.
    ///
    /// # Errors
    /// The first file that is missing, cannot be read or has another content; an item that was never completed.
    pub fn check_item(&self, item: &Item) -> Result<(), DatasetError> {
        if item.files.is_empty() {
            return Err(DatasetError::Unfinished { folder: self.folder.clone(), item: item.name.clone() });
        }
        for (name, expected) in &item.files {
            let path = self.path(item, name);
            let found = hash_file(&path)?;
            if found != *expected {
                return Err(DatasetError::Damaged { path, expected: expected.clone(), found });
            }
        }
        Ok(())
    }

    /// Compares all files with their hashes.
    ///
    /// # Errors
    /// As [`Dataset::check_item`], and where the folder holds items that the manifest does not name.
    pub fn check(&self) -> Result<(), DatasetError> {
        self.manifest.items.iter().try_for_each(|item| self.check_item(item))?;
        let io = |source| DatasetError::Io { path: self.folder.clone(), source };
        for entry in std::fs::read_dir(&self.folder).map_err(io)? {
            let entry = entry.map_err(io)?;
            let name = entry.file_name().to_string_lossy().into_owned();
            let known = self.manifest.items.iter().any(|item| item.name == name);
            if !known && entry.path().join("truth.json").is_file() {
                return Err(DatasetError::NotInManifest { folder: self.folder.clone(), item: name });
            }
        }
        Ok(())
    }
}

/// SHA-256 of a file in hexadecimal.
pub(crate) fn hash_file(path: &Path) -> Result<String, DatasetError> {
    std::fs::read(path).map(|bytes| hash(&bytes)).map_err(|source| DatasetError::Io { path: path.into(), source })
}

/// SHA-256 of bytes in hexadecimal.
pub(crate) fn hash(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests;

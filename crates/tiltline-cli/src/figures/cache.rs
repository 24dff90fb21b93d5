//! Measurements in files, so that an interrupted run goes on where it stopped.

use std::io::Write;
use std::path::{Path, PathBuf};

use miette::{IntoDiagnostic, Result, WrapErr};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use tiltline::temporary;

/// A folder of measurements.
pub struct Cache {
    folder: PathBuf,
    /// What every measurement depends on: version, detector, matcher, settings.
    method: Vec<String>,
}

#[derive(Serialize, Deserialize)]
struct Entry<T> {
    /// What it was measured with and on; another key is another measurement.
    key: Vec<String>,
    value: T,
}

impl Cache {
    /// The measurements in a folder, which is made; `method` is the detector, the matcher and the settings.
    pub fn new(folder: &Path, [detector, matcher, settings]: [&str; 3]) -> Result<Self> {
        std::fs::create_dir_all(folder).into_diagnostic()?;
        let method = [env!("CARGO_PKG_VERSION"), detector, matcher, settings].map(str::to_owned).into();
        Ok(Self { folder: folder.into(), method })
    }

    /// The measurement of a name on `data` (hashes, settings), if it was made.
    pub fn get<T: DeserializeOwned>(&self, name: &str, data: &str) -> Option<T> {
        let text = std::fs::read_to_string(self.path(name)).ok()?;
        // A file of another version, or a damaged one, is measured again.
        let entry: Entry<T> = serde_json::from_str(&text).ok()?;
        (entry.key == self.key(data)).then_some(entry.value)
    }

    /// Takes up a measurement, or makes and keeps it.
    pub fn taken<T: Serialize + DeserializeOwned>(
        &self,
        name: &str,
        data: &str,
        measure: impl FnOnce() -> Result<T>,
    ) -> Result<T> {
        match self.get(name, data) {
            Some(value) => Ok(value),
            None => {
                let entry = Entry { key: self.key(data), value: measure()? };
                let text = serde_json::to_string(&entry).into_diagnostic()?;
                self.put(name, text.as_bytes())
                    .into_diagnostic()
                    .wrap_err_with(|| format!("cannot write {}", self.path(name).display()))?;
                Ok(entry.value)
            }
        }
    }

    fn put(&self, name: &str, text: &[u8]) -> std::io::Result<()> {
        let mut file = temporary::file_in(&self.folder, ".tiltline-")?;
        file.write_all(text)?;
        file.persist(self.path(name)).map_err(|error| error.error)?;
        Ok(())
    }

    fn key(&self, data: &str) -> Vec<String> {
        self.method.iter().cloned().chain([data.to_owned()]).collect()
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.json"))
    }
}

//! Checkpoints: weights, running statistics and the optimiser's moments in one safetensors file, written whole or not at all.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use safetensors::tensor::{Dtype, TensorView};
use safetensors::{SafeTensors, serialize};
use serde::{Deserialize, Serialize};

use super::TrainError;
use crate::weights::{Named, Record, Values, write_atomically};

/// Checkpoints that are kept; the best weights are kept apart.
const KEPT: usize = 3;
const KEY: &str = "tiltline-checkpoint";

/// Where a run stands.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Steps done.
    pub step: u64,
    /// Steps of the optimiser.
    pub time: u64,
    /// Best validation score so far (lower is better), and its step.
    pub best: Option<(f64, u64)>,
    /// Time spent so far, s.
    pub seconds: f64,
    /// What the weights started from.
    #[serde(default)]
    pub record: Record,
}

/// A checkpoint in memory.
pub struct Checkpoint {
    /// Where the run stood.
    pub progress: Progress,
    /// Weights by name.
    pub weights: Named,
    /// The optimiser's moments by name.
    pub moments: Named,
}

impl Checkpoint {
    /// Writes `checkpoint-STEP.safetensors` into the run's folder and removes all but the last few.
    pub fn write(&self, folder: &Path) -> Result<PathBuf, TrainError> {
        let path = folder.join(format!("checkpoint-{:08}.safetensors", self.progress.step));
        let io = |source| TrainError::Io { path: path.clone(), source };
        let all = [("weights", &self.weights), ("adam", &self.moments)];
        let encoded: Vec<(String, &Values, Vec<u8>)> = all
            .iter()
            .flat_map(|(group, named)| named.iter().map(move |(name, values)| (format!("{group}.{name}"), values)))
            .map(|(name, values)| (name, values, values.values.iter().flat_map(|value| value.to_le_bytes()).collect()))
            .collect();
        let views = encoded.iter().map(|(name, values, bytes)| {
            let view = TensorView::new(Dtype::F32, values.shape.clone(), bytes).expect("the bytes are the shape's");
            (name.as_str(), view)
        });
        let metadata = serde_json::to_string(&self.progress).expect("plain data has a JSON form");
        let bytes = serialize(views, Some(HashMap::from([(KEY.into(), metadata)]))).expect("names and sizes are sound");
        write_atomically(&path, &bytes).map_err(io)?;
        let all = checkpoints(folder)?;
        for old in &all[..all.len().saturating_sub(KEPT)] {
            fs::remove_file(old).map_err(|source| TrainError::Io { path: old.clone(), source })?;
        }
        Ok(path)
    }

    /// The newest checkpoint of a run's folder.
    pub fn newest(folder: &Path) -> Result<Self, TrainError> {
        let path = checkpoints(folder)?.pop().ok_or_else(|| TrainError::NoCheckpoint(folder.into()))?;
        let bytes = fs::read(&path).map_err(|source| TrainError::Io { path: path.clone(), source })?;
        let damaged = |why: String| TrainError::Damaged { path: path.clone(), why };
        let file = SafeTensors::deserialize(&bytes).map_err(|error| damaged(error.to_string()))?;
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|error| damaged(error.to_string()))?;
        let text = header.metadata().as_ref().and_then(|metadata| metadata.get(KEY));
        let text = text.ok_or_else(|| damaged("it is not a checkpoint".into()))?;
        let progress = serde_json::from_str(text).map_err(|error| damaged(error.to_string()))?;
        let mut groups = [Named::new(), Named::new()];
        for (name, view) in file.iter() {
            let values = view.data().as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
            let values = Values { shape: view.shape().to_vec(), values };
            match name.split_once('.') {
                Some(("weights", name)) => groups[0].insert(name.to_owned(), values),
                Some(("adam", name)) => groups[1].insert(name.to_owned(), values),
                _ => return Err(damaged(format!("{name} does not belong into a checkpoint"))),
            };
        }
        let [weights, moments] = groups;
        Ok(Self { progress, weights, moments })
    }
}

/// All checkpoints of a folder, oldest first.
fn checkpoints(folder: &Path) -> Result<Vec<PathBuf>, TrainError> {
    let io = |source| TrainError::Io { path: folder.into(), source };
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).map_err(io)? {
        let name = entry.map_err(io)?.file_name();
        let name = name.to_string_lossy();
        if name.starts_with("checkpoint-") && name.ends_with(".safetensors") {
            found.push(folder.join(&*name));
        }
    }
    found.sort();
    Ok(found)
}

//! `dataset.toml`: what a data set is made of, where it comes from, and the hash of every file in it.

use std::collections::{BTreeMap, HashSet};
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::DatasetError;
use crate::simulate::SimulateSettings;
use crate::simulate::geometry::Split;

/// Name of the manifest in the folder of a data set.
pub const MANIFEST: &str = "dataset.toml";
/// The version that is read and written.
pub const DATASET_VERSION: u32 = 1;
/// Seeds of users are below this, those of the fixed sets from here to twice this.
pub const USER_SEEDS: u64 = 1 << 29;

/// The name of the format, the first entry of every manifest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum DatasetFormat {
    /// The only one.
    #[default]
    #[serde(rename = "tiltline-dataset")]
    TiltlineDataset,
}

/// What a data set is made of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Always `tiltline-dataset`.
    pub format: DatasetFormat,
    /// Version of the format.
    pub version: u32,
    /// Name of a fixed set, or any name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Version of the program that simulated it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub program: Option<String>,
    /// Seed of the simulation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// The network its foils were cut from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub geometry: Option<GeometryFile>,
    /// Settings of the simulation by a name that items refer to.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub settings: BTreeMap<String, SimulateSettings>,
    /// The items, in order.
    #[serde(default)]
    pub items: Vec<Item>,
}

/// A file of geometry that a simulation used.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GeometryFile {
    /// Its name, without folders.
    pub file: String,
    /// SHA-256 of its content.
    pub sha256: String,
}

impl GeometryFile {
    /// The entry for a file.
    ///
    /// # Errors
    /// Where it cannot be read.
    pub fn of(path: &Path) -> Result<Self, DatasetError> {
        let file = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        Ok(Self { file, sha256: super::hash_file(path)? })
    }
}

/// One specimen in its views.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Item {
    /// Name of its folder.
    pub name: String,
    /// What it is for. All views of one foil are in one split.
    #[serde(default = "train")]
    pub split: Split,
    /// Name of its truth file.
    #[serde(default = "truth_name")]
    pub truth: String,
    /// Views that make the stereo pair, left and right, counted from 0 in the order of the truth.
    #[serde(default = "first_two")]
    pub pair: [usize; 2],
    /// Its settings, by name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub settings: Option<String>,
    /// Number of its foil within seed and split.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub foil: Option<u32>,
    /// Name and SHA-256 of each of its files; empty until the item is complete.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub files: BTreeMap<String, String>,
}

fn train() -> Split {
    Split::Train
}

fn truth_name() -> String {
    "truth.json".into()
}

fn first_two() -> [usize; 2] {
    [0, 1]
}

impl Item {
    /// An item to be made.
    pub fn planned(name: String, split: Split, settings: &str, foil: u32, pair: [usize; 2]) -> Self {
        let (settings, foil) = (Some(settings.to_owned()), Some(foil));
        Self { name, split, truth: truth_name(), pair, settings, foil, files: BTreeMap::new() }
    }

    /// The same without the hashes of what was made.
    fn plan(&self) -> Self {
        Self { files: BTreeMap::new(), ..self.clone() }
    }
}

impl Manifest {
    /// A data set without items.
    pub fn empty() -> Self {
        Self {
            format: DatasetFormat::TiltlineDataset,
            version: DATASET_VERSION,
            name: None,
            program: None,
            seed: None,
            geometry: None,
            settings: BTreeMap::new(),
            items: Vec::new(),
        }
    }

    /// The plan of a user's simulated set. Foils are dealt to the splits in turn, 7 of 10 to train and one each to val, test-a
    /// and test-b, so that a longer set holds the shorter one.
    ///
    /// # Errors
    /// Where the settings are not possible or the seed is kept for the fixed sets.
    pub fn simulated(
        settings: SimulateSettings,
        seed: u64,
        count: u32,
        geometry: Option<GeometryFile>,
    ) -> Result<Self, DatasetError> {
        settings.validate()?;
        if seed >= USER_SEEDS {
            return Err(DatasetError::Seed { seed, limit: USER_SEEDS });
        }
        let pair = nearest_pair(&settings.tilts_deg);
        let items = (0..count).map(|foil| {
            let split = match foil % 10 {
                7 => Split::Val,
                8 => Split::TestA,
                9 => Split::TestB,
                _ => Split::Train,
            };
            Item::planned(format!("{foil:05}"), split, "all", foil, pair)
        });
        Ok(Self {
            program: Some(env!("CARGO_PKG_VERSION").into()),
            seed: Some(seed),
            geometry,
            items: items.collect(),
            settings: BTreeMap::from([("all".to_owned(), settings)]),
            ..Self::empty()
        })
    }

    /// Reads and checks a manifest.
    ///
    /// # Errors
    /// Where it cannot be read, is not one, or contradicts itself.
    pub fn read(path: &Path) -> Result<Self, DatasetError> {
        let text = std::fs::read_to_string(path).map_err(|source| DatasetError::Io { path: path.into(), source })?;
        let manifest: Self =
            toml::from_str(&text).map_err(|source| DatasetError::Toml { path: path.into(), source })?;
        manifest.validate(path)?;
        Ok(manifest)
    }

    /// The text of the manifest.
    pub fn to_toml(&self) -> String {
        let body = toml::to_string(self).expect("a manifest is plain data");
        format!("# A Tiltline data set; docs/formats.md says what is in it.\n\n{body}")
    }

    /// Writes the manifest; an older one is replaced only when this one is complete.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), DatasetError> {
        let path = folder.join(MANIFEST);
        let io = |source| DatasetError::Io { path: path.clone(), source };
        let file = crate::temporary::file_in(folder, ".tiltline-").map_err(io)?;
        std::fs::write(file.path(), self.to_toml()).map_err(io)?;
        file.persist(&path).map_err(|error| io(error.error))?;
        Ok(())
    }

    /// What differs between this plan and a set that is there; `None` where one goes on with the other.
    pub fn difference(&self, existing: &Manifest) -> Option<String> {
        let differ = |what: &str, ours: String, theirs: String| {
            (ours != theirs).then(|| format!("its {what} is {theirs}, not {ours}"))
        };
        let optional = |value: &Option<String>| value.clone().unwrap_or_else(|| "none".into());
        differ("name", optional(&self.name), optional(&existing.name))
            .or_else(|| differ("seed", format!("{:?}", self.seed), format!("{:?}", existing.seed)))
            .or_else(|| differ("program version", optional(&self.program), optional(&existing.program)))
            .or_else(|| differ("geometry", format!("{:?}", self.geometry), format!("{:?}", existing.geometry)))
            .or_else(|| (self.settings != existing.settings).then(|| "its settings differ".to_owned()))
            .or_else(|| {
                let mut pairs = self.items.iter().zip(&existing.items);
                let other = pairs.find(|(ours, theirs)| ours.plan() != theirs.plan());
                other.map(|(_, theirs)| format!("its item {} differs", theirs.name))
            })
    }

    /// One hash for all content: SHA-256 over the names and hashes of all files of all items.
    pub fn content_hash(&self) -> String {
        let lines = self
            .items
            .iter()
            .flat_map(|item| item.files.iter().map(move |(name, hash)| format!("{}/{name} {hash}\n", item.name)));
        super::hash(lines.collect::<String>().as_bytes())
    }

    /// Fails where the manifest contradicts itself; `path` is for messages.
    pub(super) fn validate(&self, path: &Path) -> Result<(), DatasetError> {
        if self.version != DATASET_VERSION {
            return Err(DatasetError::Version { path: path.into(), found: self.version, known: DATASET_VERSION });
        }
        let problem = |problem: String| Err(DatasetError::Manifest { path: path.into(), problem });
        let mut names = HashSet::new();
        for item in &self.items {
            for name in std::iter::once(&item.name).chain([&item.truth]).chain(item.files.keys()) {
                // A manifest may come from elsewhere: it must not lead out of its folder.
                if Path::new(name).file_name() != Some(name.as_ref()) {
                    return problem(format!("'{name}' is not the name of a file or folder"));
                }
            }
            if !names.insert(&item.name) {
                return problem(format!("item {} is there twice; give each item a name of its own", item.name));
            }
            if let Some(settings) = item.settings.as_ref().filter(|name| !self.settings.contains_key(*name)) {
                return problem(format!("item {} refers to settings '{settings}', which are not there", item.name));
            }
            if item.pair[0] == item.pair[1] {
                return problem(format!("the pair of item {} is view {} twice", item.name, item.pair[0]));
            }
        }
        Ok(())
    }
}

/// The two views of a series nearest to -4 and 4 degrees: what a pair is taken from; of a series without them, first and last.
pub(super) fn nearest_pair(tilts_deg: &[f64]) -> [usize; 2] {
    if tilts_deg.len() == 2 {
        return [0, 1];
    }
    let nearest = |wanted: f64| {
        let distance = |index: &usize| (tilts_deg[*index] - wanted).abs();
        (0..tilts_deg.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0)
    };
    match [nearest(-4.0), nearest(4.0)] {
        [left, right] if left == right => [0, tilts_deg.len().saturating_sub(1)],
        pair => pair,
    }
}

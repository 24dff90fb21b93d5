//! Weights by name: setting them at random, and writing and reading them as safetensors files.
//!
//! A file holds the weights of one network as f32 or f16 and, in its metadata, what it takes to use them: the kind and
//! configuration of the network, how images must be normalised, and the record of its training. Nothing in it is ever
//! executed, and no size that it states is believed before it was checked against the file's own size.

use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Tensor, TensorData};
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;
use safetensors::tensor::{Dtype, TensorView};
use safetensors::{SafeTensors, serialize};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::config::{ConfigError, DetectorConfig, MatcherConfig};

/// A file above this size is no weight file of ours: the largest configuration that makes sense is far below.
const MOST_BYTES: u64 = 512 << 20;
/// Metadata key of everything below.
const KEY: &str = "tiltline";
/// Version of the metadata.
const FORMAT: u32 = 1;
/// How images are normalised before they go in; there is one way so far.
const NORMALISATION: &str = "flattened-1";

/// Which network, and what it is made of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NetworkConfig {
    /// Finds lines.
    Detector(DetectorConfig),
    /// Finds disparities.
    Matcher(MatcherConfig),
}

impl NetworkConfig {
    /// "detector" or "matcher".
    pub fn word(&self) -> &'static str {
        match self {
            Self::Detector(_) => "detector",
            Self::Matcher(_) => "matcher",
        }
    }

    /// The weights of the largest layers: the network has more.
    fn least_weights(&self) -> usize {
        match self {
            Self::Detector(config) => 9 * (config.channels << config.depth).pow(2),
            Self::Matcher(config) => {
                let MatcherConfig { features, channels, hourglasses, .. } = *config;
                9 * features.pow(2) + 27 * hourglasses * (2 * channels).pow(2)
            }
        }
    }

    fn validate(&self) -> Result<(), ConfigError> {
        match self {
            Self::Detector(config) => config.validate(),
            Self::Matcher(config) => config.validate(),
        }
    }
}

/// How weights came about: free text by key, such as data, seed, steps, time, commit.
pub type Record = BTreeMap<String, String>;

#[derive(Debug, Serialize, Deserialize)]
struct Metadata {
    format: u32,
    network: NetworkConfig,
    normalisation: String,
    #[serde(default)]
    record: Record,
}

/// A named tensor on the host.
#[derive(Clone, Debug, PartialEq)]
pub struct Values {
    /// Shape.
    pub shape: Vec<usize>,
    /// Row-major.
    pub values: Vec<f32>,
}

/// All tensors of a network, by name.
pub type Named = BTreeMap<String, Values>;

/// A weight file in memory.
#[derive(Clone, Debug)]
pub struct Weights {
    /// The network they belong to.
    pub network: NetworkConfig,
    /// How they came about.
    pub record: Record,
    /// The weights.
    pub tensors: Named,
    /// SHA-256 of the file's bytes, in hexadecimal; empty for weights that were never in a file.
    pub sha256: String,
}

/// How numbers are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// 4 bytes.
    Single,
    /// 2 bytes; relative error up to 0.0005.
    Half,
}

/// Why weights cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum WeightsError {
    /// The file cannot be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Not such a file at all.
    #[error("{path} is no weight file: {why}; give a .safetensors file written by `tiltline train`")]
    Foreign {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        why: String,
    },
    /// A file of another network.
    #[error("{path} holds the weights of a {found}, not of a {wanted}")]
    Kind {
        /// The file.
        path: PathBuf,
        /// What it holds.
        found: &'static str,
        /// What was asked for.
        wanted: &'static str,
    },
    /// A configuration that no network can have.
    #[error("{path}: {source}")]
    Config {
        /// The file.
        path: PathBuf,
        /// Which number.
        source: ConfigError,
    },
    /// Tensors that are not those of the configuration.
    #[error("{path} does not fit its own configuration: {why}; it was damaged, or written by another version")]
    Mismatch {
        /// The file.
        path: PathBuf,
        /// Which tensor.
        why: String,
    },
}

struct Collect {
    path: Vec<String>,
    named: Named,
}

impl ModuleVisitor for Collect {
    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.push(name.to_owned());
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let tensor = param.val();
        let shape = tensor.dims().to_vec();
        let values = tensor.into_data().convert::<f32>().try_to_vec().expect("the data was just converted to f32");
        self.named.insert(self.path.join("."), Values { shape, values });
    }
}

/// All tensors of a module by name, running statistics too.
pub fn collect(module: &impl Module) -> Named {
    let mut collect = Collect { path: Vec::new(), named: Named::new() };
    module.visit(&mut collect);
    collect.named
}

/// Goes over the float tensors of a module by name and replaces their values.
struct Replace<F> {
    path: Vec<String>,
    value: F,
}

impl<F: FnMut(&str, &[usize]) -> Option<Vec<f32>>> ModuleMapper for Replace<F> {
    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.push(name.to_owned());
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }

    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let (id, old, mapper) = param.consume();
        let shape = old.dims();
        let Some(values) = (self.value)(&self.path.join("."), &shape) else {
            return Param::from_mapped_value(id, old, mapper);
        };
        let new = Tensor::<D>::from_data(TensorData::new(values, shape), &old.device().inner());
        let new = if old.device().is_autodiff() { new.autodiff() } else { new };
        Param::from_mapped_value(id, new.set_require_grad(old.is_require_grad()), mapper)
    }
}

/// The module with other values where `value` gives some for a name and shape.
pub fn replace<M: Module>(module: M, value: impl FnMut(&str, &[usize]) -> Option<Vec<f32>>) -> M {
    module.map(&mut Replace { path: Vec::new(), value })
}

/// The module with random weights (He et al. 2015: normal with variance 2 / fan-in), each tensor from a stream of its own
/// made of the seed and its name, so that they do not depend on the order or number of layers. Norms and biases stay as they are.
pub fn initialise<M: Module>(module: M, seed: u64) -> M {
    replace(module, |name, shape| {
        (shape.len() > 2).then(|| {
            let digest = Sha256::digest([&seed.to_le_bytes(), name.as_bytes()].concat());
            let stream = u64::from_le_bytes(digest[..8].try_into().expect("a digest has 32 bytes"));
            // Of a transposed convolution with stride 2 each output sees about 1 / 2^dimensions of the weights.
            let doubles = name.contains("up.") && !name.contains("bias");
            let taps: usize = shape[2..].iter().product();
            let fan_in = if doubles {
                (shape[0] * taps) as f64 / f64::from(1_u32 << (shape.len() - 2))
            } else {
                (shape[1] * taps) as f64
            };
            let normal = Normal::new(0.0, (2.0 / fan_in).sqrt()).expect("the deviation is finite");
            let mut rng = Pcg64::seed_from_u64(stream);
            (0..shape.iter().product()).map(|_| normal.sample(&mut rng) as f32).collect()
        })
    })
}

impl Weights {
    /// The weights of a module.
    pub fn of(module: &impl Module, network: NetworkConfig, record: Record) -> Self {
        Self { network, record, tensors: collect(module), sha256: String::new() }
    }

    /// Puts the weights into a module of their configuration. `path` is for messages.
    ///
    /// # Errors
    /// [`WeightsError::Mismatch`] where a tensor is missing, left over, or of another shape.
    pub fn load_into<M: Module>(&self, module: M, path: &Path) -> Result<M, WeightsError> {
        let wrong = |why: String| WeightsError::Mismatch { path: path.into(), why };
        let wanted = collect(&module);
        for (name, values) in &wanted {
            match self.tensors.get(name) {
                None => return Err(wrong(format!("{name} is missing"))),
                Some(found) if found.shape != values.shape => {
                    return Err(wrong(format!("{name} is {:?}, not {:?}", found.shape, values.shape)));
                }
                Some(_) => {}
            }
        }
        if let Some(name) = self.tensors.keys().find(|name| !wanted.contains_key(*name)) {
            return Err(wrong(format!("{name} is left over")));
        }
        Ok(replace(module, |name, _| self.tensors.get(name).map(|found| found.values.clone())))
    }

    /// The file's bytes.
    pub fn to_bytes(&self, precision: Precision) -> Vec<u8> {
        let metadata = Metadata {
            format: FORMAT,
            network: self.network.clone(),
            normalisation: NORMALISATION.into(),
            record: self.record.clone(),
        };
        let metadata = serde_json::to_string(&metadata).expect("plain data has a JSON form");
        let (dtype, encode): (Dtype, fn(f32) -> Vec<u8>) = match precision {
            Precision::Single => (Dtype::F32, |value| value.to_le_bytes().to_vec()),
            Precision::Half => (Dtype::F16, |value| half_bits(value).to_le_bytes().to_vec()),
        };
        let encoded: Vec<(&String, &Values, Vec<u8>)> = self
            .tensors
            .iter()
            .map(|(name, tensor)| (name, tensor, tensor.values.iter().flat_map(|value| encode(*value)).collect()))
            .collect();
        let views = encoded.iter().map(|(name, tensor, bytes)| {
            let view = TensorView::new(dtype, tensor.shape.clone(), bytes).expect("the bytes are those of the shape");
            (name.as_str(), view)
        });
        serialize(views, Some(HashMap::from([(KEY.to_owned(), metadata)]))).expect("names and sizes are sound")
    }

    /// Writes the file whole or not at all.
    ///
    /// # Errors
    /// Where the folder cannot be written to.
    pub fn write(&self, path: &Path, precision: Precision) -> Result<(), WeightsError> {
        write_atomically(path, &self.to_bytes(precision))
            .map_err(|source| WeightsError::Io { path: path.into(), source })
    }

    /// Reads a file.
    ///
    /// # Errors
    /// Where it is not there, not such a file, truncated, or of a configuration that cannot be.
    pub fn read(path: &Path) -> Result<Self, WeightsError> {
        let io = |source| WeightsError::Io { path: path.into(), source };
        let size = fs::metadata(path).map_err(io)?.len();
        if size > MOST_BYTES {
            let why = format!("it has {size} bytes, more than any network here");
            return Err(WeightsError::Foreign { path: path.into(), why });
        }
        Self::from_bytes(&fs::read(path).map_err(io)?, path)
    }

    /// From the bytes of a file; `path` is for messages.
    ///
    /// # Errors
    /// As for [`Weights::read`].
    pub fn from_bytes(bytes: &[u8], path: &Path) -> Result<Self, WeightsError> {
        let foreign = |why: String| WeightsError::Foreign { path: path.into(), why };
        let file = SafeTensors::deserialize(bytes).map_err(|error| foreign(error.to_string()))?;
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(|error| foreign(error.to_string()))?;
        let text = header.metadata().as_ref().and_then(|metadata| metadata.get(KEY));
        let text = text.ok_or_else(|| foreign("it has no configuration of a Tiltline network".into()))?;
        let metadata: Metadata = serde_json::from_str(text).map_err(|error| foreign(error.to_string()))?;
        if metadata.format != FORMAT || metadata.normalisation != NORMALISATION {
            let Metadata { format, normalisation, .. } = metadata;
            return Err(foreign(format!(
                "its format is {format} with normalisation {normalisation}; this version reads {FORMAT} with {NORMALISATION}"
            )));
        }
        let config = |source| WeightsError::Config { path: path.into(), source };
        metadata.network.validate().map_err(config)?;
        // Networks are made before their weights are compared with the file's: none that cannot be in it.
        let least = 2 * metadata.network.least_weights();
        if least > bytes.len() {
            return Err(foreign(format!(
                "its network has weights of {least} bytes or more, and the file has {}",
                bytes.len()
            )));
        }
        let mut tensors = Named::new();
        for (name, view) in file.iter() {
            let values = match view.dtype() {
                Dtype::F32 => {
                    view.data().as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect::<Vec<_>>()
                }
                Dtype::F16 => {
                    let halves = view.data().as_chunks::<2>().0.iter();
                    halves.map(|bytes| half_value(u16::from_le_bytes(*bytes))).collect()
                }
                other => return Err(foreign(format!("{name} is stored as {other:?}, not as F32 or F16"))),
            };
            if let Some(value) = values.iter().find(|value| !value.is_finite()) {
                return Err(foreign(format!("{name} holds {value}")));
            }
            tensors.insert(name.to_owned(), Values { shape: view.shape().to_vec(), values });
        }
        let sha256 = Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Self { network: metadata.network, record: metadata.record, tensors, sha256 })
    }

    /// The error for weights of the other kind.
    pub fn kind_error(&self, wanted: &'static str, path: &Path) -> WeightsError {
        WeightsError::Kind { path: path.into(), found: self.network.word(), wanted }
    }
}

/// Writes bytes beside the target and moves them into its place once they are on the disk.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut file = tiltline::temporary::file_in(folder, ".tiltline-")?;
    file.write_all(bytes)?;
    file.as_file().sync_all()?;
    file.persist(path).map_err(|error| error.error)?;
    Ok(())
}

/// IEEE 754 binary16, rounded to nearest even; what is too large becomes the largest finite value.
fn half_bits(value: f32) -> u16 {
    let sign = ((value.to_bits() >> 16) & 0x8000) as u16;
    let size = value.abs().min(65504.0);
    if size < 6.103_515_6e-5 {
        // Subnormal: multiples of 2^-24.
        return sign | (size * 16_777_216.0).round_ties_even() as u16;
    }
    let bits = size.to_bits();
    let rounded = bits + 0x0fff + ((bits >> 13) & 1);
    sign | (((rounded >> 13) - (112 << 10)) as u16).min(0x7bff)
}

fn half_value(bits: u16) -> f32 {
    let sign = u32::from(bits & 0x8000) << 16;
    let (exponent, fraction) = (u32::from(bits >> 10) & 0x1f, u32::from(bits & 0x3ff));
    let size = match exponent {
        0 => fraction as f32 / 16_777_216.0,
        31 => f32::from_bits(0x7f80_0000 | (fraction << 13)),
        _ => f32::from_bits(((exponent + 112) << 23) | (fraction << 13)),
    };
    f32::from_bits(size.to_bits() | sign)
}

#[cfg(test)]
mod tests;

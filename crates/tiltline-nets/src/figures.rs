//! The trainings behind the paper's Table 2 (terms of the loss) and Figure 12 (one image of low contrast), and the scores of what
//! came of them. What is shown of them is in [`tiltline::figures`].

use std::fs;
use std::path::{Path, PathBuf};

use burn::tensor::Device;
use ndarray::Array2;
use tiltline::dataset::{Dataset, Item};
use tiltline::figures::losses::{CurvePoint, DenseScore};

use crate::config::MatcherInput;
use crate::data::{DataError, DataSettings, whole};
use crate::detector::Detector;
use crate::device::{NotBuilt, Place};
use crate::infer::Named;
use crate::losses::LossWeights;
use crate::matcher::Matcher;
use crate::networks::Networks;
use crate::score::found_disparity;
use crate::train::{Event, MetricsLine, Run, Task, TrainError, TrainSettings};
use crate::weights::{NetworkConfig, Weights, WeightsError};

/// How long the trainings are, and on what crops.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget {
    /// Steps of each training of Table 2.
    pub loss_steps: u64,
    /// Steps of each training of Figure 12.
    pub detector_steps: u64,
    /// Side of the crops of Table 2, px.
    pub loss_crop_px: usize,
    /// Side of the crops of Figure 12, px.
    pub detector_crop_px: usize,
    /// Side of the simulated images, px.
    pub simulated_px: usize,
}

impl Budget {
    /// That of the published table and figure: about five minutes a training on two cores for Table 2, two for Figure 12.
    pub const PUBLISHED: Self =
        Self { loss_steps: 400, detector_steps: 200, loss_crop_px: 192, detector_crop_px: 224, simulated_px: 512 };
}

/// Why a training or its score failed.
#[derive(Debug, thiserror::Error)]
pub enum ExperimentError {
    /// The training.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// The processor, which every program can use.
    #[error(transparent)]
    Device(#[from] NotBuilt),
    /// Weights.
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// Data to score on.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A folder with another training.
    #[error("{0} holds a training with other settings: remove it, or name another work folder")]
    Other(PathBuf),
    /// The training was stopped.
    #[error("stopped at step {step} of {steps}; the same command goes on from there")]
    Stopped {
        /// Where.
        step: u64,
        /// Of how many.
        steps: u64,
    },
    /// A matcher that cannot be scored here.
    #[error("{0} looks at a detector's features; only matchers that look at images are compared")]
    Features(PathBuf),
}

/// Settings of the training with weights of the disparity, warp and variance terms: the shipped matcher's network from random
/// weights, on mixed simulated pairs. Nothing but the terms differs.
pub fn loss_settings([disparity, warp, variance]: [f64; 3], budget: &Budget) -> TrainSettings {
    TrainSettings {
        task: Task::Matcher,
        steps: budget.loss_steps,
        learning_rate: Some(1e-3),
        warm_up: 50,
        seed: 71,
        report_every: 20,
        validate_every: 100,
        validation_count: 16,
        losses: LossWeights { disparity, variance, warp, entropy: 0.0, ..LossWeights::default() },
        data: DataSettings {
            physics: 0.05,
            clutter: 0.6,
            faults: 0.0,
            crop_px: budget.loss_crop_px,
            simulated_px: budget.simulated_px,
            batch: 2,
            ..DataSettings::default()
        },
        ..TrainSettings::default()
    }
}

/// Settings of further training of the detector on its usual simulated images, and, half of the time, on the training images of
/// `extra`.
pub fn fine_tuning(extra: Option<&Path>, budget: &Budget) -> TrainSettings {
    TrainSettings {
        task: Task::Detector,
        steps: budget.detector_steps,
        learning_rate: Some(2e-4),
        warm_up: 20,
        seed: 73,
        report_every: 20,
        validate_every: 100,
        validation_count: 16,
        losses: LossWeights { line: 2.5, ..LossWeights::default() },
        data: DataSettings {
            physics: 0.05,
            clutter: 1.0,
            crop_px: budget.detector_crop_px,
            simulated_px: budget.simulated_px,
            folders: extra.map(Path::to_owned).into_iter().collect(),
            ..DataSettings::default()
        },
        ..TrainSettings::default()
    }
}

/// A training that is done.
pub struct Trained {
    /// The weights that came out.
    pub weights: Named,
    /// All settings, TOML, without folders of this machine.
    pub settings: String,
    /// How long it took, s.
    pub seconds: f64,
    /// Its curve.
    pub curve: Vec<CurvePoint>,
}

/// Trains in `folder` from `from`, or takes up what is there. `report` is told of each line of the metrics and stops the work by
/// returning false; what is done stays.
///
/// # Errors
/// Where the folder holds another training, data cannot be made, or the work was stopped.
pub fn trained(
    settings: TrainSettings,
    folder: &Path,
    from: &Named,
    report: &mut dyn FnMut(&Event<'_>) -> bool,
) -> Result<Trained, ExperimentError> {
    let device = Place::Cpu.device()?;
    let mut run = if folder.join("train.toml").is_file() {
        Run::resume(folder, None, device.clone())?
    } else {
        Run::start(settings.clone(), folder, &[(from.path.clone(), from.weights.clone())], device.clone())?
    };
    let wanted = match &from.weights.network {
        NetworkConfig::Detector(config) => TrainSettings { detector: config.clone(), ..settings.clone() },
        NetworkConfig::Matcher(config) => TrainSettings { matcher: config.clone(), ..settings.clone() },
    };
    if *run.settings() != wanted {
        return Err(ExperimentError::Other(folder.into()));
    }
    if run.step() < wanted.steps {
        run.train(report)?;
    }
    if run.step() < wanted.steps {
        return Err(ExperimentError::Stopped { step: run.step(), steps: wanted.steps });
    }
    let metrics = folder.join("metrics.jsonl");
    let text = fs::read_to_string(&metrics).map_err(|source| TrainError::Io { path: metrics, source })?;
    let lines: Vec<MetricsLine> = text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
    let curve = lines.iter().filter(|line| line.kind == "train").map(|line| CurvePoint {
        step: line.step,
        loss: line.values.get("loss").copied().unwrap_or(f64::NAN),
        epe_px: line.values.get("epe").copied(),
    });
    let mut shown = wanted;
    let names = shown.data.folders.iter().map(|folder| folder.file_name().map_or_else(PathBuf::new, PathBuf::from));
    shown.data.folders = names.collect();
    Ok(Trained {
        weights: Named::read(&folder.join("last.safetensors"))?,
        settings: toml::to_string(&shown).expect("plain data has a TOML form"),
        seconds: lines.last().map_or(0.0, |line| line.seconds),
        curve: curve.collect(),
    })
}

/// Errors of a matcher alone, dense, at the true line pixels of pairs that are rectified as the main job does it: on the largest square
/// of each that the network can take. No offset is taken out, nothing is refined.
///
/// # Errors
/// Where weights do not fit, or a pair cannot be read or rectified.
pub fn dense_scores(
    detector: &Named,
    matcher: &Named,
    dataset: &Dataset,
    progress: &dyn Fn(usize, usize),
) -> Result<Vec<DenseScore>, ExperimentError> {
    let device = Place::Cpu.device()?;
    let (networks, settings) = networks(detector, matcher, &device)?;
    let network = networks.matcher.as_ref().expect("it was just made");
    let items = &dataset.manifest.items;
    let mut scores = Vec::with_capacity(items.len());
    for (index, item) in items.iter().enumerate() {
        progress(index, items.len());
        let family = family(dataset, item);
        // A pair that cannot be rectified has no grid that a dense matcher could be scored on.
        let Some(batch) = whole(dataset, item)? else { continue };
        let found = found_disparity(&networks, network, &batch, &settings, &device);
        scores.push(DenseScore::of(&item.name, &family, &found, &batch.disparity));
    }
    Ok(scores)
}

/// The family of an item's settings.
fn family(dataset: &Dataset, item: &Item) -> String {
    let settings = item.settings.as_ref().and_then(|key| dataset.manifest.settings.get(key));
    settings.map_or_else(String::new, |settings| settings.family.word().into())
}

fn networks(detector: &Named, matcher: &Named, device: &Device) -> Result<(Networks, TrainSettings), ExperimentError> {
    let NetworkConfig::Detector(detector_config) = &detector.weights.network else {
        return Err(detector.weights.kind_error("detector", &detector.path).into());
    };
    let NetworkConfig::Matcher(matcher_config) = &matcher.weights.network else {
        return Err(matcher.weights.kind_error("matcher", &matcher.path).into());
    };
    if matcher_config.input == MatcherInput::Features {
        return Err(ExperimentError::Features(matcher.path.clone()));
    }
    let settings = TrainSettings {
        task: Task::Matcher,
        detector: detector_config.clone(),
        matcher: matcher_config.clone(),
        ..TrainSettings::default()
    };
    let load = |weights: &Weights| weights.load_into(Detector::new(detector_config, device), &detector.path);
    let matcher = matcher.weights.load_into(Matcher::new(matcher_config, device), &matcher.path)?;
    Ok((Networks { detector: load(&detector.weights)?, matcher: Some(matcher) }, settings))
}

/// Line probabilities `[row, column]` of an image as it is recorded, at its own magnification.
///
/// # Errors
/// Where the weights are not a detector's.
pub fn probability(detector: &Named, image: &Array2<f32>) -> Result<Array2<f32>, ExperimentError> {
    let network = crate::infer::NetDetector::new(detector, &Place::Cpu.device()?)?;
    Ok(network.probability(image, 0))
}

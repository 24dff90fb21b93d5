//! Training: batches in, weights out; resumable, and the same for any number of threads.
//!
//! A run is a folder: `train.toml` (all settings), `checkpoint-*.safetensors` (the last few), `best.safetensors` and
//! `last.safetensors` (weights to use), `metrics.jsonl`, `curves.svg`, `validation.png`.

mod adam;
mod checkpoint;
mod memory;
mod metrics;
mod picture;
mod step;

pub use step::images;

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use burn::module::Module;
use burn::optim::GradientsParams;
use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use tiltline::simulate::geometry::Split;

use crate::config::{ConfigError, DetectorConfig, MatcherConfig, MatcherInput};
use crate::data::{Batch, DataError, DataSettings, Queue, Source, Task as DataTask, validation};
use crate::losses::LossWeights;
use crate::networks::Networks;
use crate::score::validate;
use crate::weights::{
    NetworkConfig, Precision, Record, Values, Weights, WeightsError, initialise, replace, write_atomically,
};
use checkpoint::{Checkpoint, Progress};
use metrics::{Line, Metrics};
use step::{detector_loss, matcher_loss};

/// What is trained.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Task {
    /// The detector alone.
    #[default]
    Detector,
    /// The matcher, with a detector that stays as it is.
    Matcher,
    /// Both.
    Joint,
}

/// Everything a run depends on, except the weights it starts from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainSettings {
    /// What is trained.
    pub task: Task,
    /// Steps in all.
    pub steps: u64,
    /// Highest learning rate: reached after the first steps, falling to a hundredth as a cosine. Absent: 1e-3 for the detector,
    /// 1e-4 for the others, as in the paper.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub learning_rate: Option<f64>,
    /// Steps over which the learning rate rises.
    pub warm_up: u64,
    /// Seed of weights and data.
    pub seed: u64,
    /// Steps between lines of `metrics.jsonl`.
    pub report_every: u64,
    /// Steps between checkpoints.
    pub checkpoint_every: u64,
    /// Steps between validations.
    pub validate_every: u64,
    /// Validation crops.
    pub validation_count: usize,
    /// The detector.
    pub detector: DetectorConfig,
    /// The matcher.
    pub matcher: MatcherConfig,
    /// Weights of the loss's terms.
    pub losses: LossWeights,
    /// Where batches come from.
    pub data: DataSettings,
}

impl Default for TrainSettings {
    fn default() -> Self {
        Self {
            task: Task::Detector,
            steps: 2000,
            learning_rate: None,
            warm_up: 50,
            seed: 1,
            report_every: 20,
            checkpoint_every: 100,
            validate_every: 250,
            validation_count: 16,
            detector: DetectorConfig::default(),
            matcher: MatcherConfig::default(),
            losses: LossWeights::default(),
            data: DataSettings::default(),
        }
    }
}

impl TrainSettings {
    /// Sides of crops must be multiples of this, px.
    fn multiple(&self) -> usize {
        let detector = self.detector.multiple();
        // Powers of two, all of them.
        if self.task == Task::Detector { detector } else { detector.max(self.matcher.multiple()) }
    }
}

/// Why a training stopped.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// Settings that no network can have.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// No data.
    #[error(transparent)]
    Data(#[from] DataError),
    /// Weights to start from.
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// A file cannot be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Settings that cannot be understood.
    #[error("{path}: {source}")]
    Settings {
        /// The file.
        path: PathBuf,
        /// Why.
        source: toml::de::Error,
    },
    /// Nothing to go on from.
    #[error("{0} has no checkpoint; start the run again without --resume")]
    NoCheckpoint(PathBuf),
    /// A checkpoint that cannot be used.
    #[error("{path} is damaged: {why}; remove it to go on from the one before")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        why: String,
    },
    /// A folder that is in use.
    #[error("{0} holds a training run; go on with --resume {0}, or give another folder")]
    Occupied(PathBuf),
    /// The matcher needs to see what a detector finds.
    #[error("a matcher is trained on what a detector finds; give its weights with --from FILE")]
    NoDetector,
    /// The loss is no number.
    #[error(
        "loss or weights are no numbers any more at step {step} (loss {loss}); the last good weights are those of the last checkpoint in \
         {folder}: write a lower learning_rate into its train.toml, and go on with --resume"
    )]
    NotFinite {
        /// The loss.
        loss: f64,
        /// The step.
        step: u64,
        /// The run.
        folder: PathBuf,
    },
}

/// What a run reports.
#[derive(Clone, Debug)]
pub enum Event<'a> {
    /// A line was added to the metrics.
    Line {
        /// The line.
        line: &'a Line,
        /// Steps in all.
        steps: u64,
    },
    /// A pair of the data cannot be rectified and is left out; its folder.
    LeftOut(&'a Path),
    /// A step was done.
    Step,
    /// A checkpoint was written.
    Saved(&'a Path),
}

pub use adam::Adam;
pub use metrics::Line as MetricsLine;

/// A training run.
pub struct Run {
    settings: TrainSettings,
    folder: PathBuf,
    networks: Networks,
    adam: Adam,
    progress: Progress,
    metrics: Metrics,
    record: Record,
    device: Device,
}

impl Run {
    /// A new run in a folder, from given weights or from random ones.
    ///
    /// # Errors
    /// Where the folder holds a run already, or weights are missing or do not fit.
    pub fn start(
        mut settings: TrainSettings,
        folder: &Path,
        from: &[(PathBuf, Weights)],
        device: Device,
    ) -> Result<Self, TrainError> {
        let io = |source| TrainError::Io { path: folder.into(), source };
        let data_task = if settings.task == Task::Detector { DataTask::Detector } else { DataTask::Matcher };
        settings.data.fits(settings.multiple())?;
        let line = settings.losses.line;
        if !(line > 0.0 && line.is_finite()) {
            let wanted = "above 0";
            return Err(DataError::Setting { name: "losses.line", value: line.to_string(), wanted }.into());
        }
        Source::new(&settings.data, data_task, settings.seed, Split::Train)?;
        if folder.join("train.toml").exists() {
            return Err(TrainError::Occupied(folder.into()));
        }
        for (_, weights) in from {
            match &weights.network {
                NetworkConfig::Detector(config) => settings.detector = config.clone(),
                NetworkConfig::Matcher(config) => settings.matcher = config.clone(),
            }
        }
        let mut record = Record::new();
        let mut networks = Self::networks(&settings, &device)?;
        networks = initialise(networks, settings.seed);
        let mut detector = false;
        for (path, weights) in from {
            record.insert(format!("from-{}", weights.network.word()), weights.sha256.clone());
            match &weights.network {
                NetworkConfig::Detector(_) => {
                    networks.detector = weights.load_into(networks.detector, path)?;
                    if settings.task == Task::Detector {
                        networks.detector = networks.detector.shifted(settings.losses.line.ln() as f32);
                    }
                    detector = true;
                }
                NetworkConfig::Matcher(_) => {
                    let matcher = networks.matcher.take().map(|matcher| weights.load_into(matcher, path));
                    networks.matcher = matcher.transpose()?;
                }
            }
        }
        if settings.task == Task::Matcher && !detector {
            return Err(TrainError::NoDetector);
        }
        fs::create_dir_all(folder).map_err(io)?;
        let text = toml::to_string_pretty(&settings).expect("plain data has a TOML form");
        let run = Self {
            settings,
            folder: folder.into(),
            networks,
            adam: Adam::default(),
            progress: Progress { record: record.clone(), ..Progress::default() },
            metrics: Metrics::default(),
            record,
            device,
        };
        // So that a run can be resumed from its first step, and a lost first checkpoint never means other weights.
        run.checkpoint()?;
        // Last: a folder holds a run once it can be resumed.
        write_atomically(&folder.join("train.toml"), text.as_bytes()).map_err(io)?;
        Ok(run)
    }

    /// The run of a folder, from its last checkpoint. `steps` sets another end.
    ///
    /// # Errors
    /// Where there is no run, or its files are damaged.
    pub fn resume(folder: &Path, steps: Option<u64>, device: Device) -> Result<Self, TrainError> {
        let path = folder.join("train.toml");
        let text = fs::read_to_string(&path).map_err(|source| TrainError::Io { path: path.clone(), source })?;
        let mut settings: TrainSettings =
            toml::from_str(&text).map_err(|source| TrainError::Settings { path: path.clone(), source })?;
        settings.steps = steps.unwrap_or(settings.steps);
        let checkpoint = Checkpoint::newest(folder)?;
        let networks = Self::networks(&settings, &device)?;
        let wanted = crate::weights::collect(&networks);
        let fits = |(name, values): (&String, &Values)| {
            checkpoint.weights.get(name).is_some_and(|found| found.shape == values.shape)
        };
        if wanted.len() != checkpoint.weights.len() || !wanted.iter().all(fits) {
            let why = "its checkpoint holds other networks than its train.toml".to_owned();
            return Err(TrainError::Damaged { path: folder.into(), why });
        }
        let networks = replace(networks, |name, _| checkpoint.weights.get(name).map(|found| found.values.clone()));
        let adam = Adam::from_named(&checkpoint.moments, checkpoint.progress.time, &device);
        let metrics = Metrics::read(folder, checkpoint.progress.step);
        let progress = checkpoint.progress;
        let record = progress.record.clone();
        Ok(Self { settings, folder: folder.into(), networks, adam, progress, metrics, record, device })
    }

    fn networks(settings: &TrainSettings, device: &Device) -> Result<Networks, TrainError> {
        settings.detector.validate()?;
        settings.matcher.validate()?;
        let (matcher, channels) = (&settings.matcher, settings.detector.channels);
        if matcher.input == MatcherInput::Features && matcher.input_channels != channels {
            let wanted = "detector.channels, because matcher.input is features";
            return Err(ConfigError { name: "matcher.input_channels", value: matcher.input_channels, wanted }.into());
        }
        let matcher = (settings.task != Task::Detector).then_some(&settings.matcher);
        Ok(Networks::new(&settings.detector, matcher, &device.clone().autodiff()))
    }

    /// The settings, with the configurations of the weights it started from.
    pub fn settings(&self) -> &TrainSettings {
        &self.settings
    }

    /// Steps done.
    pub fn step(&self) -> u64 {
        self.progress.step
    }

    /// What a step will take, for a reader; warns where the machine has less.
    pub fn needs(&self) -> String {
        memory::described(&self.settings)
    }

    /// Trains up to the last step, or until `report` says no; then saves.
    ///
    /// # Errors
    /// Where data cannot be made, files not be written, or the loss is no number any more.
    pub fn train(&mut self, report: &mut dyn FnMut(&Event<'_>) -> bool) -> Result<(), TrainError> {
        let task = if self.settings.task == Task::Detector { DataTask::Detector } else { DataTask::Matcher };
        let (data, seed) = (&self.settings.data, self.settings.seed);
        let validation = validation(data, task, self.settings.validation_count)?;
        let mut queue = Queue::start(data, task, seed, self.progress.step)?;
        let mut sums: BTreeMap<String, (f64, u64)> = BTreeMap::new();
        let mut told = 0;
        let start = Instant::now();
        let before = self.progress.seconds;
        while self.progress.step < self.settings.steps {
            let batch = queue.next_batch();
            for folder in queue.left_out().iter().skip(told) {
                report(&Event::LeftOut(folder));
                told += 1;
            }
            let batch = batch?;
            let rate = self.rate();
            for (name, value) in self.learn(&batch, rate)? {
                let sum = sums.entry(name.to_owned()).or_default();
                *sum = (sum.0 + value, sum.1 + 1);
            }
            self.progress.step += 1;
            self.progress.seconds = before + start.elapsed().as_secs_f64();
            let (step, last) = (self.progress.step, self.progress.step == self.settings.steps);
            let mut go_on = report(&Event::Step);
            if last || step.is_multiple_of(self.settings.report_every.max(1)) {
                let means = std::mem::take(&mut sums);
                let means = means.into_iter().map(|(name, (sum, count))| (name, sum / count as f64)).collect();
                go_on &= self.report("train", rate, means, report)?;
            }
            if last || step.is_multiple_of(self.settings.validate_every.max(1)) {
                let networks = self.networks.valid();
                let values = validate(&networks, &validation, &self.settings, &self.device);
                let path = self.folder.join("validation.png");
                picture::write(&path, &networks, &validation, &self.settings, &self.device)?;
                // Where nothing is labelled the last are the best.
                let score = values.get("error").copied();
                go_on &= self.report("validation", rate, values, report)?;
                let better = |score: f64| self.progress.best.is_none_or(|(best, _)| score < best);
                if score.is_none_or(|score| score.is_finite() && better(score)) {
                    self.progress.best = score.map(|score| (score, step)).or(self.progress.best);
                    self.write_weights("best")?;
                }
            }
            if last || !go_on || step.is_multiple_of(self.settings.checkpoint_every.max(1)) {
                let path = self.checkpoint()?;
                self.write_weights("last")?;
                go_on &= report(&Event::Saved(&path));
            }
            if !go_on {
                break;
            }
        }
        Ok(())
    }

    /// One step: the parts of the loss by name.
    fn learn(&mut self, batch: &Batch, rate: f64) -> Result<Vec<(&'static str, f64)>, TrainError> {
        let device = self.device.clone().autodiff();
        let joint = self.settings.task == Task::Joint;
        let loss = match &self.networks.matcher {
            Some(matcher) if joint => {
                matcher_loss(&self.networks.detector, matcher, batch, &self.settings, true, &device)
            }
            // A detector that is not trained is used as it will be: with its running statistics, and without gradients.
            Some(matcher) => {
                matcher_loss(&self.networks.detector.valid(), matcher, batch, &self.settings, false, &device)
            }
            None => detector_loss(&self.networks.detector, batch, &self.settings, &device),
        };
        let value = loss.value();
        if !value.is_finite() {
            let (step, folder) = (self.progress.step, self.folder.clone());
            return Err(TrainError::NotFinite { loss: value, step, folder });
        }
        let mut parts = loss.parts;
        parts.push(("loss", value));
        if let Some(total) = loss.total {
            let gradients = GradientsParams::from_grads(total.backward(), &self.networks);
            self.networks = self.adam.step(self.networks.clone(), gradients, rate);
        }
        Ok(parts)
    }

    fn rate(&self) -> f64 {
        let Self { settings, progress, .. } = self;
        let (step, warm_up) = (progress.step as f64 + 1.0, settings.warm_up as f64);
        let highest = settings.learning_rate.unwrap_or(if settings.task == Task::Detector { 1e-3 } else { 1e-4 });
        if step < warm_up {
            return highest * step / warm_up;
        }
        let done = ((step - warm_up) / (settings.steps as f64 - warm_up).max(1.0)).clamp(0.0, 1.0);
        highest * (0.01 + 0.99 * 0.5 * (1.0 + (std::f64::consts::PI * done).cos()))
    }

    fn report(
        &mut self,
        kind: &str,
        rate: f64,
        values: BTreeMap<String, f64>,
        report: &mut dyn FnMut(&Event<'_>) -> bool,
    ) -> Result<bool, TrainError> {
        let Progress { step, seconds, .. } = self.progress;
        let line = Line { step, kind: kind.into(), rate, seconds, values };
        let go_on = report(&Event::Line { line: &line, steps: self.settings.steps });
        self.metrics.0.push(line);
        self.metrics.write(&self.folder)?;
        Ok(go_on)
    }

    fn checkpoint(&self) -> Result<PathBuf, TrainError> {
        let progress = Progress { time: self.adam.time, ..self.progress.clone() };
        let weights = crate::weights::collect(&self.networks);
        // A finite loss can have gradients that are not: the checkpoint before stays the newest.
        if weights.values().any(|values| values.values.iter().any(|value| !value.is_finite())) {
            let (step, folder) = (self.progress.step, self.folder.clone());
            return Err(TrainError::NotFinite { loss: f64::NAN, step, folder });
        }
        Checkpoint { progress, weights, moments: self.adam.to_named() }.write(&self.folder)
    }

    /// Writes `NAME.safetensors`, or one file for each network of a joint run: `NAME-detector`, `NAME-matcher`.
    fn write_weights(&self, name: &str) -> Result<(), TrainError> {
        let mut record = self.record.clone();
        record.insert("steps".into(), self.progress.step.to_string());
        record.insert("seconds".into(), format!("{:.0}", self.progress.seconds));
        record.insert("version".into(), env!("CARGO_PKG_VERSION").into());
        record.insert("settings".into(), toml::to_string(&self.settings).expect("plain data has a TOML form"));
        if let Some(line) = self.metrics.0.iter().rev().find(|line| line.kind == "validation") {
            record.insert("validation".into(), serde_json::to_string(&line.values).expect("plain data"));
        }
        let networks = self.networks.valid();
        let detector = || NetworkConfig::Detector(self.settings.detector.clone());
        let matcher = || NetworkConfig::Matcher(self.settings.matcher.clone());
        let path = |suffix: &str| self.folder.join(format!("{name}{suffix}.safetensors"));
        let both = self.settings.task == Task::Joint;
        if self.settings.task != Task::Matcher {
            // A line pixel that counts for several in the loss has its odds raised as much: taken back, so that the files of a detector
            // speak of probabilities as they are. A joint matcher knows its detector as it is.
            let calibrated =
                networks.detector.clone().shifted(if both { 0.0 } else { -self.settings.losses.line.ln() as f32 });
            let weights = Weights::of(&calibrated, detector(), record.clone());
            weights.write(&path(if both { "-detector" } else { "" }), Precision::Single)?;
        }
        if let Some(network) = &networks.matcher {
            let weights = Weights::of(network, matcher(), record);
            weights.write(&path(if both { "-matcher" } else { "" }), Precision::Single)?;
        }
        Ok(())
    }
}

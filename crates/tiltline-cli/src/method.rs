//! Which detector and which matcher a reconstruction uses, and the weights of those that are networks.

use std::path::PathBuf;

use clap::ValueEnum;
use miette::{IntoDiagnostic, Result, miette};
use serde::{Deserialize, Serialize};
use tiltline::matching::ClassicalMatcher;
use tiltline::oracle::TruthOracle;
use tiltline::pipeline::{Detect, Match};
use tiltline::ridge::RidgeDetector;
use tiltline::settings::Settings;
use tiltline::truth::PairGeometry;
use tiltline_nets::device::{Place, prepare_memory};
use tiltline_nets::infer::{Named, NetDetector, NetMatcher};
use tiltline_nets::weights::NetworkConfig;

/// What finds lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Detector {
    /// A network.
    #[default]
    Net,
    /// The ridge filter, which needs no weights.
    Ridge,
    /// The truth about the pair (`tiltline bench` only): shows what the other stages lose.
    Truth,
}

/// What finds disparities.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Matcher {
    /// A network.
    #[default]
    Net,
    /// Dynamic programming along the lines, which needs no weights.
    Classical,
    /// The truth about the pair (`tiltline bench` only): shows what the other stages lose.
    Truth,
}

/// The section `[method]` of a settings file.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MethodSettings {
    /// What finds lines.
    pub detector: Detector,
    /// What finds disparities.
    pub matcher: Matcher,
    /// Weight files; networks without one use those that are part of the program.
    pub weights: Vec<PathBuf>,
}

/// The stages, ready to work.
pub struct Stages {
    /// Finds lines.
    pub detector: Box<dyn Detect>,
    /// Finds disparities.
    pub matcher: Box<dyn Match>,
    /// Names for records; those of networks with the hash of their weights.
    pub names: [String; 2],
    /// The geometry of the pair, where it is known and must not be estimated.
    pub geometry: Option<PairGeometry>,
}

impl MethodSettings {
    /// Whether a stage is the truth, which only a benchmark knows.
    pub fn needs_truth(&self) -> bool {
        self.detector == Detector::Truth || self.matcher == Matcher::Truth
    }
}

impl Stages {
    /// The stages of some settings, and of the truth about the pair where it is known.
    pub fn new(method: &MethodSettings, settings: &Settings, truth: Option<&TruthOracle>) -> Result<Self> {
        let known = || {
            let message = "the truth is a detector or matcher of `tiltline bench` only: name another";
            truth.cloned().ok_or_else(|| miette!("{message}"))
        };
        let mut given: Vec<Named> =
            method.weights.iter().map(|path| Named::read(path).into_diagnostic()).collect::<Result<_>>()?;
        let nets = [method.detector == Detector::Net, method.matcher == Matcher::Net];
        if nets.contains(&true) {
            prepare_memory();
        }
        let device = Place::Cpu.device().into_diagnostic()?;
        let mut taken: Option<Named> = None;
        let mut take = |detector: bool| -> Result<Named> {
            // A matcher of features looks at those of the detector in use.
            if let (true, Some(named)) = (detector, &taken) {
                return Ok(named.clone());
            }
            let found =
                given.iter().position(|named| matches!(named.weights.network, NetworkConfig::Detector(_)) == detector);
            let named = match found {
                Some(index) => given.remove(index),
                None if detector => Named::built_in_detector().into_diagnostic()?,
                None => Named::built_in_matcher().into_diagnostic()?,
            };
            if detector {
                taken = Some(named.clone());
            }
            Ok(named)
        };
        let name = |named: &Named| format!("net {}", &named.weights.sha256[..16]);
        let (detector, detector_name): (Box<dyn Detect>, String) = match method.detector {
            Detector::Net => {
                let named = take(true)?;
                (Box::new(NetDetector::new(&named, &device).into_diagnostic()?), name(&named))
            }
            Detector::Ridge => (Box::new(RidgeDetector { settings: settings.ridge.clone() }), "ridge".into()),
            Detector::Truth => (Box::new(known()?), "truth".into()),
        };
        let (matcher, matcher_name): (Box<dyn Match>, String) = match method.matcher {
            Matcher::Net => {
                let named = take(false)?;
                let features = match &named.weights.network {
                    NetworkConfig::Matcher(config) if config.input == tiltline_nets::config::MatcherInput::Features => {
                        let detector = take(true)?;
                        if let Some(known) =
                            named.weights.record.get("from-detector").filter(|known| **known != detector.weights.sha256)
                        {
                            return Err(miette!(
                                "{} was trained on the features of the detector with SHA-256 {known}; give that one with --weights",
                                named.path.display()
                            ));
                        }
                        Some(NetDetector::new(&detector, &device).into_diagnostic()?)
                    }
                    _ => None,
                };
                let matcher =
                    NetMatcher::new(&named, features, settings.matching.clone(), &device).into_diagnostic()?;
                (Box::new(matcher), name(&named))
            }
            Matcher::Classical => {
                (Box::new(ClassicalMatcher { settings: settings.matching.clone() }), "classical".into())
            }
            Matcher::Truth => (Box::new(known()?), "truth".into()),
        };
        if let Some(unused) = given.first() {
            return Err(miette!(
                "{} holds the weights of a {}, which is not used; add --{} net, or leave the file out",
                unused.path.display(),
                unused.weights.network.word(),
                unused.weights.network.word()
            ));
        }
        Ok(Self { detector, matcher, names: [detector_name, matcher_name], geometry: None })
    }
}

//! Which detector and which matcher a reconstruction uses, and the weights of those that are networks.

use std::path::PathBuf;

use clap::ValueEnum;
use miette::{IntoDiagnostic, Result, miette};
use serde::{Deserialize, Serialize};
use tiltline::matching::ClassicalMatcher;
use tiltline::pipeline::{Detect, Match};
use tiltline::ridge::RidgeDetector;
use tiltline::settings::Settings;
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
}

impl Stages {
    /// The stages of some settings.
    pub fn new(method: &MethodSettings, settings: &Settings) -> Result<Self> {
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
        let (ridge, classical) = (("ridge".to_owned()), "classical".to_owned());
        let (detector, detector_name): (Box<dyn Detect>, String) = if nets[0] {
            let named = take(true)?;
            (Box::new(NetDetector::new(&named, &device).into_diagnostic()?), name(&named))
        } else {
            (Box::new(RidgeDetector { settings: settings.ridge.clone() }), ridge)
        };
        let (matcher, matcher_name): (Box<dyn Match>, String) = if nets[1] {
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
            let matcher = NetMatcher::new(&named, features, settings.matching.clone(), &device).into_diagnostic()?;
            (Box::new(matcher), name(&named))
        } else {
            (Box::new(ClassicalMatcher { settings: settings.matching.clone() }), classical)
        };
        if let Some(unused) = given.first() {
            return Err(miette!(
                "{} holds the weights of a {}, which is not used; add --{} net, or leave the file out",
                unused.path.display(),
                unused.weights.network.word(),
                unused.weights.network.word()
            ));
        }
        Ok(Self { detector, matcher, names: [detector_name, matcher_name] })
    }
}

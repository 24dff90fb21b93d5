//! Settings from a TOML file, and the record of a run, `run.toml`, which is such a file.

use std::collections::BTreeMap;
use std::path::Path;

use miette::{IntoDiagnostic, Result, WrapErr, miette};
use serde::{Deserialize, Serialize};
use tiltline::settings::Settings;

use crate::method::MethodSettings;
use crate::series::SeriesRecord;

/// What is known about the pair beside its pixels.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Acquisition {
    /// Tilts of left and right in degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tilts_deg: Option<[f64; 2]>,
    /// Of a tilt series: whether the pair alone is reconstructed, and the other views are left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pair_only: Option<bool>,
    /// Side of a pixel of the left image in nm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pixel_size_nm: Option<f64>,
    /// Direction of the tilt axis, degrees clockwise on the screen from image y.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tilt_axis_deg: Option<f64>,
}

/// A settings file: `[acquisition]`, `[method]`, the library's settings, and `[run]`, which is a record and has no effect.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Config {
    /// What is known about the pair.
    pub acquisition: Acquisition,
    /// Which detector and matcher.
    pub method: MethodSettings,
    /// The library's settings.
    pub settings: Settings,
}

impl Config {
    /// Reads a settings file; a key that means nothing is an error.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path)
            .into_diagnostic()
            .wrap_err_with(|| format!("cannot read the settings file {}", path.display()))?;
        Self::parse(&text).wrap_err_with(|| format!("in the settings file {}", path.display()))
    }

    fn parse(text: &str) -> Result<Self> {
        let mut table: toml::Table = text.parse().into_diagnostic()?;
        table.remove("run");
        let acquisition = match table.remove("acquisition") {
            Some(section) => section.try_into().map_err(|error| miette!("[acquisition] {error}"))?,
            None => Acquisition::default(),
        };
        let method = match table.remove("method") {
            Some(section) => section.try_into().map_err(|error| miette!("[method] {error}"))?,
            None => MethodSettings::default(),
        };
        let settings = table.try_into().into_diagnostic()?;
        Ok(Self { acquisition, method, settings })
    }
}

/// The `[run]` section of `run.toml`: what a reader, or the same command again, needs to know of a run.
#[derive(Clone, Debug, Serialize)]
pub struct RunRecord {
    /// Version of the program.
    pub version: &'static str,
    /// Name of the detector.
    pub detector: String,
    /// Name of the matcher.
    pub matcher: String,
    /// Path and SHA-256 of the left file.
    pub left: tiltline::micrograph::Source,
    /// Path and SHA-256 of the right file.
    pub right: tiltline::micrograph::Source,
    /// The series the pair was taken from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub series: Option<SeriesRecord>,
    /// Seconds each stage took.
    pub seconds: BTreeMap<&'static str, f64>,
}

/// The text of `run.toml`.
pub fn run_toml(config: &Config, record: &RunRecord) -> Result<String> {
    let mut table = toml::Table::try_from(&config.settings).into_diagnostic()?;
    table.insert("acquisition".into(), toml::Value::try_from(&config.acquisition).into_diagnostic()?);
    table.insert("method".into(), toml::Value::try_from(&config.method).into_diagnostic()?);
    table.insert("run".into(), toml::Value::try_from(record).into_diagnostic()?);
    let body = toml::to_string_pretty(&table).into_diagnostic()?;
    Ok(format!("# Written by tiltline. `tiltline reconstruct LEFT RIGHT --config run.toml` repeats the run.\n\n{body}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_key_is_an_error_and_names_itself() {
        for text in ["sead = 1", "[rectify]\nmodle = 'affine'", "[acquisition]\ntilt = 3", "[mtach]"] {
            let error = format!("{:?}", Config::parse(text).unwrap_err());
            let key = ["sead", "modle", "tilt", "mtach"].into_iter().find(|key| text.contains(key)).unwrap();
            assert!(error.contains(key), "{text}: {error}");
        }
    }

    #[test]
    fn a_run_record_reads_back_as_the_settings_it_was_made_with() {
        let mut config = Config::default();
        config.settings.seed = 7;
        config.settings.flip_depth = true;
        config.acquisition.tilts_deg = Some([-4.0, 4.0]);
        let source = tiltline::micrograph::Source { path: "a \"b\".tif#3".into(), sha256: "00".into() };
        let record = RunRecord {
            version: "0",
            detector: "ridge".into(),
            matcher: "classical".into(),
            left: source.clone(),
            right: source,
            series: None,
            seconds: BTreeMap::from([("read", 0.25)]),
        };
        let text = run_toml(&config, &record).unwrap();
        assert_eq!(Config::parse(&text).unwrap(), config);
    }
}

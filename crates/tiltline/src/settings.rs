//! Every setting of the main job with its default. Flags override a TOML file, which overrides these; a key that is
//! not here is an error.

use serde::{Deserialize, Serialize};

use crate::io::ReadOptions;
use crate::matching::MatchSettings;
use crate::measure::MeasureSettings;
use crate::rectify::RectifySettings;
use crate::refine::RefineSettings;
use crate::ridge::RidgeSettings;
use crate::series::FitSettings;
use crate::trace::TraceSettings;

/// Settings of `tiltline reconstruct`, a section a stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Seed of everything random (RANSAC sampling).
    pub seed: u64,
    /// Depth sign: `true` reports -Z, for a user who knows that the tilts' sense is the other one.
    pub flip_depth: bool,
    /// How files are read where their format leaves a choice.
    pub read: ReadOptions,
    /// Making epipolar lines rows.
    pub rectify: RectifySettings,
    /// The classical line detector.
    pub ridge: RidgeSettings,
    /// Centrelines.
    pub trace: TraceSettings,
    /// The classical matcher.
    #[serde(rename = "match")]
    pub matching: MatchSettings,
    /// Sub-pixel disparity.
    pub refine: RefineSettings,
    /// Lengths, thickness, density.
    pub measure: MeasureSettings,
    /// The fit to all views of a tilt series.
    pub series: FitSettings,
}

/// A setting that makes no sense.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("the setting {key} is {value}; it must be {wanted}")]
pub struct SettingsError {
    /// Section and name, as in the settings file.
    pub key: &'static str,
    /// What was given.
    pub value: f64,
    /// What is possible.
    pub wanted: &'static str,
}

impl Settings {
    /// Refuses values with which no stage could work.
    pub fn validate(&self) -> Result<(), SettingsError> {
        let positive = |value: f64| value.is_finite() && value > 0.0;
        let not_negative = |value: f64| value.is_finite() && value >= 0.0;
        let share = |value: f64| (0.0..=1.0).contains(&value);
        let [narrow, wide] = self.ridge.width_px;
        let (low, high) = (f64::from(self.trace.low), f64::from(self.trace.high));
        let checks = [
            (
                "rectify.axis_prior_sigma_deg",
                self.rectify.axis_prior_sigma_deg,
                not_negative as fn(f64) -> bool,
                "0 or more",
            ),
            ("ridge.width_px", narrow, positive, "more than 0"),
            ("ridge.width_px", wide, positive, "more than 0"),
            ("ridge.sensitivity", self.ridge.sensitivity, positive, "more than 0"),
            ("trace.low", low, share, "between 0 and trace.high"),
            ("trace.high", high, share, "between trace.low and 1"),
            ("trace.min_length_px", self.trace.min_length_px, not_negative, "0 or more"),
            ("match.max_disparity_px", self.matching.max_disparity_px, not_negative, "0 (from the images) or more"),
            ("refine.max_distance_px", self.refine.max_distance_px, not_negative, "0 or more"),
            ("series.tilt_sigma_deg", self.series.tilt_sigma_deg, not_negative, "0 or more"),
            ("series.turn_sigma_deg", self.series.turn_sigma_deg, not_negative, "0 or more"),
            ("series.axis_sigma_deg", self.series.axis_sigma_deg, not_negative, "0 or more"),
            ("series.scale_sigma", self.series.scale_sigma, not_negative, "0 or more"),
            ("series.pair_row_sigma_px", self.series.pair_row_sigma_px, not_negative, "0 or more"),
            ("series.roughness", self.series.roughness, positive, "more than 0"),
            ("series.reach_px", self.series.reach_px, positive, "more than 0"),
            ("measure.tilt_sigma_deg", self.measure.tilt_sigma_deg, not_negative, "0 or more"),
        ];
        for (key, value, possible, wanted) in checks {
            if !possible(value) {
                return Err(SettingsError { key, value, wanted });
            }
        }
        if low > high {
            return Err(SettingsError { key: "trace.low", value: low, wanted: "between 0 and trace.high" });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_possible_and_nonsense_is_named() {
        assert_eq!(Settings::default().validate(), Ok(()));
        let mut settings = Settings::default();
        settings.measure.tilt_sigma_deg = f64::NAN;
        assert_eq!(settings.validate().unwrap_err().key, "measure.tilt_sigma_deg");
        let mut settings = Settings::default();
        (settings.trace.low, settings.trace.high) = (0.6, 0.5);
        assert_eq!(settings.validate().unwrap_err().key, "trace.low");
    }
}

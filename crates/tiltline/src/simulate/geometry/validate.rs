//! Checks of [`FoilSettings`]: everything finite, ordered and physically possible.

use super::settings::{FoilSettings, Range};

/// Why settings were refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FoilSettingsError {
    /// A range is not a range, or leaves what is possible.
    #[error("foil setting `{name}` is [{low}, {high}]; give two numbers in order between {least} and {most}")]
    Range {
        /// Key of the setting.
        name: &'static str,
        /// Given lower end.
        low: f64,
        /// Given upper end.
        high: f64,
        /// Smallest allowed value.
        least: f64,
        /// Largest allowed value.
        most: f64,
    },
    /// There is nothing to choose from.
    #[error("foil setting `{name}` {problem}")]
    Choice {
        /// Key of the setting.
        name: &'static str,
        /// What is wrong with it and what to give instead.
        problem: String,
    },
}

impl FoilSettings {
    /// Checks every number; the error names the first that is wrong.
    ///
    /// # Errors
    /// A range that is not finite, not ordered or beyond its limits; no lattice or no feature with a positive weight.
    pub fn validate(&self) -> Result<(), FoilSettingsError> {
        let share = |value: f64| Range::exactly(value);
        let ranges: [(&'static str, Range, f64, f64); 44] = [
            ("field_nm", self.field_nm, 50.0, 50_000.0),
            ("thickness_nm", self.thickness_nm, 5.0, 5_000.0),
            ("density_per_m2", self.density_per_m2, 1e9, 1e16),
            ("field_lengths", self.field_lengths, 0.01, 500.0),
            ("spacing_nm", share(self.spacing_nm), 0.1, 100.0),
            ("margin", share(self.margin), 0.0, 2.0),
            ("active_planes", self.active_planes, 1.0, 100.0),
            ("variety", share(self.variety), 0.0, 20.0),
            ("clustering", share(self.clustering), 0.0, 1.0),
            ("lamellar", share(self.lamellar), 0.0, 1.0),
            ("axis_tilt_deg", self.axis_tilt_deg.unwrap_or(share(0.0)), 0.0, 180.0),
            ("main_direction_deg", self.main_direction_deg.unwrap_or(share(0.0)), -180.0, 180.0),
            ("lamellae.width_nm", self.lamellae.width_nm, 10.0, 50_000.0),
            ("lamellae.inclination_deg", self.lamellae.inclination_deg, 5.0, 90.0),
            ("lamellae.confined", share(self.lamellae.confined), 0.0, 1.0),
            ("lamellae.at_boundary", share(self.lamellae.at_boundary), 0.0, 1.0),
            ("threading.inclination_deg", self.threading.inclination_deg, 0.0, 89.0),
            ("threading.along_axis", share(self.threading.along_axis), 0.0, 1.0),
            ("threading.scatter_deg", share(self.threading.scatter_deg), 0.0, 90.0),
            ("threading.sag", self.threading.sag, -1.0, 1.0),
            ("threading.helix_radius_nm", self.threading.helix_radius_nm, 0.5, 1000.0),
            ("threading.helix_pitch", self.threading.helix_pitch, 0.2, 100.0),
            ("glide.bow", self.glide.bow, -10.0, 10.0),
            ("glide.skew", self.glide.skew, -10.0, 10.0),
            ("glide.flatness", self.glide.flatness, 1.1, 20.0),
            ("glide.wave_amplitude_nm", self.glide.wave_amplitude_nm, 0.0, 500.0),
            ("glide.wave_length_nm", self.glide.wave_length_nm, 5.0, 50_000.0),
            ("glide.kinked", share(self.glide.kinked), 0.0, 1.0),
            ("glide.facet_nm", self.glide.facet_nm, 1.0, 5_000.0),
            ("glide.trail_nm", self.glide.trail_nm, 10.0, 50_000.0),
            ("glide.source_nm", self.glide.source_nm, 5.0, 10_000.0),
            ("glide.half_loop_nm", self.glide.half_loop_nm, 2.0, 10_000.0),
            ("glide.zigzag_nm", self.glide.zigzag_nm, 2.0, 10_000.0),
            ("glide.zigzag_deg", self.glide.zigzag_deg, 0.0, 80.0),
            ("loops.radius_nm", self.loops.radius_nm, 1.0, 10_000.0),
            ("loops.aspect", self.loops.aspect, 1.0, 50.0),
            ("loops.hexagonal", share(self.loops.hexagonal), 0.0, 1.0),
            ("loops.together", self.loops.together, 1.0, 1000.0),
            ("pairs.distance_nm", self.pairs.distance_nm, 0.5, 1000.0),
            ("pairs.height_nm", self.pairs.height_nm, 0.0, 1000.0),
            ("pairs.unevenness", self.pairs.unevenness, 0.0, 0.8),
            ("network.junction_nm", self.network.junction_nm, 2.0, 10_000.0),
            ("network.sag", self.network.sag, -1.0, 1.0),
            ("network.mesh_nm", self.network.mesh_nm, 5.0, 10_000.0),
        ];
        let more: [(&'static str, Range, f64, f64); 14] = [
            ("network.extent_nm", self.network.extent_nm, 10.0, 50_000.0),
            ("network.irregularity", self.network.irregularity, 0.0, 0.49),
            ("network.stretch", self.network.stretch, 1.0, 20.0),
            ("arrays.lines", self.arrays.lines, 1.0, 1000.0),
            ("arrays.first_gap_nm", self.arrays.first_gap_nm, 0.5, 10_000.0),
            ("arrays.band_gap_nm", self.arrays.band_gap_nm, 0.5, 10_000.0),
            ("arrays.variation", self.arrays.variation, 0.0, 5.0),
            ("arrays.misfit_gap_nm", self.arrays.misfit_gap_nm, 0.5, 10_000.0),
            ("arrays.misfit_lines", self.arrays.misfit_lines, 1.0, 1000.0),
            ("tangle.lines", self.tangle.lines, 1.0, 1000.0),
            ("tangle.radius_nm", self.tangle.radius_nm, 2.0, 10_000.0),
            ("tangle.elongation", self.tangle.elongation, 1.0, 50.0),
            ("tangle.persistence_nm", self.tangle.persistence_nm, 2.0, 5_000.0),
            ("tangle.winding", self.tangle.winding, 0.1, 100.0),
        ];
        for (name, Range { low, high }, least, most) in ranges.into_iter().chain(more) {
            // Written so that NaN fails.
            if !(least <= low && low <= high && high <= most) {
                return Err(FoilSettingsError::Range { name, low, high, least, most });
            }
        }
        let choice = |name, problem: &str| Err(FoilSettingsError::Choice { name, problem: problem.to_owned() });
        if self.lattices.is_empty() {
            return choice("lattices", "is empty; give at least one lattice");
        }
        if let Some(lattice) = self.lattices.iter().find(|lattice| !lattice.is_plausible()) {
            return choice("lattices", &format!("has {lattice:?}; lattice parameters are 0.1 to 3 nm"));
        }
        if let Some(wrong) = self.features.iter().find(|w| !(w.weight >= 0.0 && w.weight.is_finite())) {
            let (word, weight) = (wrong.feature.word(), wrong.weight);
            return choice("features", &format!("gives `{word}` the weight {weight}; weights are zero or positive"));
        }
        if self.features.iter().all(|w| w.weight == 0.0) {
            return choice("features", "has no feature with a positive weight; give at least one");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::crystal::Lattice;
    use super::super::settings::Weight;
    use super::*;

    #[test]
    fn presets_are_valid() {
        for settings in [FoilSettings::gan(), FoilSettings::tial(), FoilSettings::cantor(), FoilSettings::mixed()] {
            assert_eq!(settings.validate(), Ok(()));
        }
    }

    #[test]
    fn absurd_settings_are_refused_by_name() {
        let message = |edit: fn(&mut FoilSettings)| {
            let mut settings = FoilSettings::mixed();
            edit(&mut settings);
            settings.validate().expect_err("absurd").to_string()
        };
        assert!(message(|s| s.thickness_nm.low = f64::NAN).contains("thickness_nm"));
        assert!(message(|s| s.field_nm = Range::new(900.0, 800.0)).contains("field_nm"));
        assert!(message(|s| s.density_per_m2.high = f64::INFINITY).contains("density_per_m2"));
        assert!(message(|s| s.spacing_nm = 0.0).contains("spacing_nm"));
        assert!(message(|s| s.lattices.clear()).contains("lattices"));
        assert!(message(|s| s.lattices = vec![Lattice::Fcc { a_nm: -1.0 }]).contains("-1"));
        assert!(message(|s| s.features.clear()).contains("positive weight"));
        assert!(message(|s| s.features.iter_mut().for_each(|w: &mut Weight| w.weight = -1.0)).contains("threading"));
    }
}

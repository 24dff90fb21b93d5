//! Settings of simulated data: what foils are made of, how they look and how they are recorded. A family is a set of
//! defaults; a settings file changes what it names.

use serde::{Deserialize, Serialize};

use super::acquisition::AcquisitionSettings;
use super::alignment::AlignmentSettings;
use super::conditions::ConditionSettings;
use super::geometry::{FoilSettings, FoilSettingsError};
use super::parametric::LookSettings;

/// A kind of specimen and of microscopy, after the paper's Table 3.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Family {
    /// Gallium nitride: threading lines, few and clear.
    Gan,
    /// Lamellar titanium aluminide: bowed lines and tangles between boundaries.
    Tial,
    /// The Cantor alloy: pile-ups and networks, dense and weak.
    Cantor,
    /// Everything, in widely varying proportions.
    #[default]
    Mixed,
}

impl Family {
    /// Every family.
    pub const ALL: [Family; 4] = [Family::Gan, Family::Tial, Family::Cantor, Family::Mixed];

    /// The word used in files and flags.
    pub fn word(self) -> &'static str {
        match self {
            Family::Gan => "gan",
            Family::Tial => "tial",
            Family::Cantor => "cantor",
            Family::Mixed => "mixed",
        }
    }
}

/// How images come about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// Drawn profiles: fast and diverse.
    #[default]
    Parametric,
    /// Two-beam diffraction.
    Physics,
}

impl Mode {
    /// The word used in files and flags.
    pub fn word(self) -> &'static str {
        match self {
            Mode::Parametric => "parametric",
            Mode::Physics => "physics",
        }
    }
}

/// Everything simulated views depend on, except geometry that is given and the seed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SimulateSettings {
    /// The family whose defaults these settings started from.
    pub family: Family,
    /// Drawn or diffracted.
    pub mode: Mode,
    /// Rows and columns of an image, px.
    pub size_px: usize,
    /// Tilts of the views in degrees; two are left and right of a pair.
    pub tilts_deg: Vec<f64>,
    /// A line counts as visible where its contrast is above this multiple of noise and local texture (as seen at the scale of a line).
    pub visible_above_noise: f64,
    /// And above this share of the background.
    pub least_contrast: f64,
    /// Foils and their lines. `foil.field_nm` is the field of an image of 512 px; that of other sizes is in proportion.
    pub foil: FoilSettings,
    /// Drawn lines, and all that is not a line.
    pub look: LookSettings,
    /// Diffraction conditions of physics mode.
    pub conditions: ConditionSettings,
    /// Detector and scan.
    pub acquisition: AcquisitionSettings,
    /// How the views lie on the screen.
    pub alignment: AlignmentSettings,
}

impl Default for SimulateSettings {
    fn default() -> Self {
        Self::of_family(Family::default())
    }
}

/// Smallest and largest side of an image, px.
const SIDES_PX: [usize; 2] = [32, 8192];
/// Two-beam columns beyond this tilt say nothing.
const STEEPEST_DEG: f64 = 75.0;
/// Most views of a foil.
const MOST_VIEWS: usize = 1000;

/// Why no data can be simulated with these settings.
#[derive(Debug, thiserror::Error)]
pub enum SimulateError {
    /// A number that is not possible.
    #[error("{name} is {value}; give {expected}")]
    Value {
        /// Key of the setting.
        name: &'static str,
        /// Its value.
        value: String,
        /// What to give instead.
        expected: String,
    },
    /// Settings of foils.
    #[error(transparent)]
    Foil(#[from] FoilSettingsError),
    /// Physical parameters.
    #[error(transparent)]
    Physics(#[from] super::physics::PhysicsError),
    /// A network without a line.
    #[error("the network has no nodes: there is nothing to show")]
    EmptyNetwork,
    /// A network whose lines cover each other.
    #[error(
        "the network is too dense: a foil of {thickness_nm:.0} nm shows lines {lengths:.0} times as long as the field, which no image \
         can tell apart; in a settings file, lower foil.field_nm below {field_nm:.1} nm or foil.thickness_nm, or raise \
         foil.field_lengths"
    )]
    TooDense {
        /// Length of line over the side of the field.
        lengths: f64,
        /// Thickness of the foil.
        thickness_nm: f64,
        /// The largest field that would do.
        field_nm: f64,
    },
    /// A network that a foil cannot be cut from.
    #[error(transparent)]
    Cut(#[from] super::slab::CutError),
    /// A settings file that cannot be understood.
    #[error("settings: {0}")]
    Toml(#[from] toml::de::Error),
}

impl SimulateSettings {
    /// Settings from the text of a TOML file: what it names, over the defaults of its `family` (or the one given).
    ///
    /// # Errors
    /// Where the text is not TOML, has unknown keys or values of another type, or fails [`SimulateSettings::validate`].
    pub fn from_toml(text: &str, family: Option<Family>) -> Result<Self, SimulateError> {
        let given: toml::Table = text.parse()?;
        let named = given.get("family").map(|word| word.clone().try_into::<Family>()).transpose()?;
        let mut table = toml::Table::try_from(Self::of_family(family.or(named).unwrap_or_default()))
            .expect("settings are plain data");
        merge(&mut table, given);
        let mut settings: Self = toml::Value::Table(table).try_into()?;
        settings.family = family.unwrap_or(settings.family);
        settings.validate()?;
        Ok(settings)
    }

    /// Checks every number.
    ///
    /// # Errors
    /// The first that is not a number or not possible, by its name, with what is.
    pub fn validate(&self) -> Result<(), SimulateError> {
        let value = |name, value: String, expected: &str| {
            Err(SimulateError::Value { name, value, expected: expected.to_owned() })
        };
        if !(SIDES_PX[0]..=SIDES_PX[1]).contains(&self.size_px) {
            return value("size_px", self.size_px.to_string(), &format!("{} to {} px", SIDES_PX[0], SIDES_PX[1]));
        }
        if self.tilts_deg.len() < 2 || self.tilts_deg.len() > MOST_VIEWS {
            return value("tilts_deg", format!("a list of {}", self.tilts_deg.len()), "2 to 1000 tilts");
        }
        for tilt in &self.tilts_deg {
            // A NaN is in no range.
            if !(-STEEPEST_DEG..=STEEPEST_DEG).contains(tilt) {
                return value("tilts_deg", tilt.to_string(), &format!("angles from -{STEEPEST_DEG} to {STEEPEST_DEG}"));
            }
        }
        for (index, tilt) in self.tilts_deg.iter().enumerate() {
            if self.tilts_deg[..index].contains(tilt) {
                return value("tilts_deg", format!("{tilt} twice"), "different angles");
            }
        }
        if !(0.0..=100.0).contains(&self.visible_above_noise) {
            return value("visible_above_noise", self.visible_above_noise.to_string(), "0 to 100");
        }
        if !(0.0..=1.0).contains(&self.least_contrast) {
            return value("least_contrast", self.least_contrast.to_string(), "0 to 1");
        }
        self.foil.validate()?;
        self.look.validate()?;
        self.conditions.validate()?;
        self.acquisition.validate()?;
        self.alignment.validate()
    }
}

/// Checks that a range is finite, in order and within limits.
pub(super) fn check_range(name: &'static str, [low, high]: [f64; 2], limits: [f64; 2]) -> Result<(), SimulateError> {
    // A NaN fails every comparison.
    if low >= limits[0] && low <= high && high <= limits[1] {
        return Ok(());
    }
    let expected = format!("two numbers in order between {} and {}", limits[0], limits[1]);
    Err(SimulateError::Value { name, value: format!("[{low}, {high}]"), expected })
}

/// Checks that a number lies within limits.
pub(super) fn check_value(name: &'static str, value: f64, [low, high]: [f64; 2]) -> Result<(), SimulateError> {
    if value >= low && value <= high {
        return Ok(());
    }
    Err(SimulateError::Value { name, value: value.to_string(), expected: format!("a number between {low} and {high}") })
}

/// Puts the entries of `over` over those of `table`, tables within tables likewise.
fn merge(table: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (table.get_mut(&key), value) {
            (Some(toml::Value::Table(inner)), toml::Value::Table(value)) => merge(inner, value),
            (_, value) => {
                table.insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn families_are_valid_and_survive_toml() {
        for family in Family::ALL {
            let settings = SimulateSettings::of_family(family);
            settings.validate().unwrap();
            let text = toml::to_string(&settings).unwrap();
            assert_eq!(SimulateSettings::from_toml(&text, None).unwrap(), settings);
        }
    }

    #[test]
    fn a_file_changes_what_it_names_and_nothing_else() {
        let settings =
            SimulateSettings::from_toml("family = \"tial\"\nfoil.thickness_nm = [90.0, 95.0]", None).unwrap();
        let mut expected = SimulateSettings::of_family(Family::Tial);
        expected.foil.thickness_nm = [90.0, 95.0].into();
        assert_eq!(settings, expected);
        let other = SimulateSettings::from_toml("size_px = 256", Some(Family::Gan)).unwrap();
        assert_eq!(other, SimulateSettings { size_px: 256, ..SimulateSettings::of_family(Family::Gan) });
    }

    #[test]
    fn absurd_settings_are_named() {
        for (text, name) in [
            ("size_px = 3", "size_px"),
            ("tilts_deg = [1.0]", "tilts_deg"),
            ("tilts_deg = [4.0, 4.0]", "twice"),
            ("tilts_deg = [nan, 4.0]", "tilts_deg"),
            ("visible_above_noise = nan", "visible_above_noise"),
            ("foil.thickness_nm = [nan, 3.0]", "thickness_nm"),
            ("foil.thicknes_nm = [1.0, 3.0]", "thicknes_nm"),
            ("familly = \"gan\"", "familly"),
            ("look.line_width_px = [5.0, 1.0]", "line_width_px"),
            ("conditions.extinction_distance_nm = [-1.0, 40.0]", "extinction_distance_nm"),
            ("acquisition.dose = [nan, 40.0]", "dose"),
        ] {
            let message = SimulateSettings::from_toml(text, None).unwrap_err().to_string();
            assert!(message.contains(name), "{text}: {message}");
        }
    }
}

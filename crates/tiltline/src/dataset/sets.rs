//! The fixed sets: `val-*` for choosing between settings and weights, `bench-*` and `hard` for reporting. Each is a plan with a
//! seed that no user can take and splits that nothing is trained on, so that no foil of theirs is seen in training.
//!
//! The hash of each set as it was made for the published figures is in `sets.toml`. Another set than that one is not an error
//! of the user's (mathematical functions of another system may differ in the last digit), but its figures cannot be compared
//! to the last digit, and whoever makes it is told.

use std::collections::BTreeMap;

use super::DatasetError;
use super::manifest::{Item, Manifest, USER_SEEDS, nearest_pair};
use crate::simulate::geometry::{Feature, Range, Split};
use crate::simulate::{Family, Mode, SimulateSettings};

/// A fixed set.
#[derive(Clone, Copy, Debug)]
pub struct Set {
    /// Its name.
    pub name: &'static str,
    /// What it is for, in a sentence.
    pub purpose: &'static str,
    /// Its seed.
    seed: u64,
    plan: fn(&mut Plan),
}

/// Every fixed set.
pub const SETS: [Set; 6] = [
    Set {
        name: "val-8deg",
        purpose: "choosing: 24 pairs at 8 degrees, three families, drawn and diffracted",
        seed: USER_SEEDS + 1,
        plan: |plan| plan.families(&[Split::Val], 4, &[8.0]),
    },
    Set {
        name: "val-hard",
        purpose: "choosing: 16 pairs at 8 degrees of the four kinds of `hard`",
        seed: USER_SEEDS + 2,
        plan: |plan| plan.hard(&[Split::Val], 4),
    },
    Set {
        name: "bench-8deg",
        purpose: "reporting: 48 pairs at 8 degrees, three families, drawn and diffracted",
        seed: USER_SEEDS + 3,
        plan: |plan| plan.families(&[Split::TestA, Split::TestB], 4, &[8.0]),
    },
    Set {
        name: "bench-angles",
        purpose: "reporting: 12 foils, each at 2, 4, 6, 8, 10 and 12 degrees",
        seed: USER_SEEDS + 4,
        plan: |plan| plan.families(&[Split::TestA, Split::TestB], 1, &[2.0, 4.0, 6.0, 8.0, 10.0, 12.0]),
    },
    Set {
        name: "bench-series",
        purpose: "reporting: three series from -50 to 50 degrees by 2, one a family; pairs are the views at -4 and 4",
        seed: USER_SEEDS + 5,
        plan: Plan::series,
    },
    Set {
        name: "hard",
        purpose: "reporting: 32 pairs at 8 degrees of crossings, lines along the rows, dense tangles, weak contrast",
        seed: USER_SEEDS + 6,
        plan: |plan| plan.hard(&[Split::TestA, Split::TestB], 4),
    },
];

/// Families of the paper.
const FAMILIES: [Family; 3] = [Family::Gan, Family::Tial, Family::Cantor];
/// Both ways of making images.
const MODES: [Mode; 2] = [Mode::Parametric, Mode::Physics];

impl Set {
    /// The set of a name.
    ///
    /// # Errors
    /// [`DatasetError::UnknownSet`], which lists the names.
    pub fn named(name: &str) -> Result<Self, DatasetError> {
        SETS.into_iter()
            .find(|set| set.name == name)
            .ok_or_else(|| DatasetError::UnknownSet { name: name.into(), known: SETS.map(|set| set.name).join(", ") })
    }

    /// What the set consists of.
    pub fn manifest(&self) -> Manifest {
        let mut plan = Plan::default();
        (self.plan)(&mut plan);
        Manifest {
            name: Some(self.name.into()),
            program: Some(env!("CARGO_PKG_VERSION").into()),
            seed: Some(self.seed),
            settings: plan.settings,
            items: plan.items,
            ..Manifest::empty()
        }
    }

    /// The hash ([`Manifest::content_hash`]) of the set as it was made for the published figures.
    pub fn published_hash(&self) -> Option<String> {
        let table: BTreeMap<String, String> =
            toml::from_str(include_str!("sets.toml")).expect("the file is part of the program and tested");
        table.get(self.name).cloned()
    }
}

/// A set in the making.
#[derive(Default)]
struct Plan {
    settings: BTreeMap<String, SimulateSettings>,
    items: Vec<Item>,
}

impl Plan {
    /// Adds pairs of one kind: `count` foils from number `first` of each split, each at all the angles.
    fn pairs(
        &mut self,
        kind: &str,
        settings: &SimulateSettings,
        splits: &[Split],
        foils: std::ops::Range<u32>,
        angles: &[f64],
    ) {
        for split in splits {
            for foil in foils.clone() {
                for angle in angles {
                    let key = format!("{kind}-{angle}deg");
                    let settings = SimulateSettings { tilts_deg: vec![-0.5 * angle, 0.5 * angle], ..settings.clone() };
                    let name = format!("{key}-{}-{foil:03}", split.word());
                    self.items.push(Item::planned(name, *split, &key, foil, [0, 1]));
                    self.settings.insert(key, settings);
                }
            }
        }
    }

    /// `count` foils of each family and mode in each split, all different.
    fn families(&mut self, splits: &[Split], count: u32, angles: &[f64]) {
        let mut first = 0;
        for family in FAMILIES {
            for mode in MODES {
                let settings = SimulateSettings { mode, ..SimulateSettings::of_family(family) };
                let kind = format!("{}-{}", family.word(), mode.word());
                self.pairs(&kind, &settings, splits, first..first + count, angles);
                first += count;
            }
        }
    }

    /// `count` foils of each kind of difficulty in each split; half drawn, half diffracted.
    fn hard(&mut self, splits: &[Split], count: u32) {
        let mut first = 0;
        for (kind, settings) in hard_kinds() {
            for mode in MODES {
                let settings = SimulateSettings { mode, ..settings.clone() };
                let kind = format!("{kind}-{}", mode.word());
                self.pairs(&kind, &settings, splits, first..first + count / 2, &[8.0]);
                first += count / 2;
            }
        }
    }

    fn series(&mut self) {
        let tilts_deg: Vec<f64> = (-25..=25).map(|step| 2.0 * f64::from(step)).collect();
        for (foil, (family, mode)) in
            FAMILIES.into_iter().zip([Mode::Parametric, Mode::Physics, Mode::Parametric]).enumerate()
        {
            let key = format!("{}-{}-series", family.word(), mode.word());
            let pair = nearest_pair(&tilts_deg);
            let settings =
                SimulateSettings { mode, tilts_deg: tilts_deg.clone(), ..SimulateSettings::of_family(family) };
            self.items.push(Item::planned(key.clone(), Split::TestA, &key, foil as u32, pair));
            self.settings.insert(key, settings);
        }
    }
}

/// What makes foils difficult.
fn hard_kinds() -> [(&'static str, SimulateSettings); 4] {
    let mixed = || SimulateSettings::of_family(Family::Mixed);
    let with_features = |features: &[Feature], field_lengths: Range| {
        let mut settings = mixed();
        settings.foil.features.retain(|weight| features.contains(&weight.feature));
        settings.foil.field_lengths = field_lengths;
        // The bounds of the length decide, not the density.
        settings.foil.density_per_m2 = Range::exactly(1e14);
        settings.foil.variety = 0.0;
        settings
    };
    let mut crossings = with_features(
        &[Feature::Straight, Feature::Threading, Feature::Bowed, Feature::Zigzag],
        Range::new(12.0, 20.0),
    );
    crossings.foil.active_planes = Range::new(3.0, 4.0);
    let mut level = with_features(
        &[Feature::Straight, Feature::Trailing, Feature::Bowed, Feature::Pair, Feature::SlipBand],
        Range::new(4.0, 10.0),
    );
    level.foil.main_direction_deg = Some(Range::new(-8.0, 8.0));
    let tangles =
        with_features(&[Feature::Tangle, Feature::Net, Feature::PileUp, Feature::Junction], Range::new(20.0, 40.0));
    let mut weak = mixed();
    weak.look.line_contrast = [0.04, 0.1];
    weak.conditions.deviation = Range::new(1.0, 3.0);
    weak.acquisition.dose = [300.0, 1500.0];
    [("crossings", crossings), ("level", level), ("tangles", tangles), ("weak", weak)]
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;
    use crate::simulate::geometry::geometry_seed;

    #[test]
    fn sets_are_valid_disjoint_from_training_and_from_each_other() {
        let mut foils = HashSet::new();
        for set in SETS {
            let manifest = set.manifest();
            assert!(!manifest.items.is_empty() && set.seed >= USER_SEEDS && set.seed < 2 * USER_SEEDS);
            for settings in manifest.settings.values() {
                settings.validate().unwrap();
            }
            let mut own = HashSet::new();
            for item in &manifest.items {
                assert_ne!(item.split, Split::Train);
                assert_eq!(set.name.starts_with("val-"), item.split == Split::Val, "{}", item.name);
                own.insert(geometry_seed(item.split, (set.seed << 32) | u64::from(item.foil.unwrap())));
            }
            for seed in own {
                assert!(foils.insert(seed), "a foil of {} is in another set", set.name);
            }
        }
        assert!(matches!(Set::named("bench"), Err(DatasetError::UnknownSet { .. })));
    }

    #[test]
    fn every_set_has_a_published_hash() {
        for set in SETS {
            let hash = set.published_hash().unwrap_or_default();
            assert!(hash.len() == 64 && hash.bytes().all(|byte| byte.is_ascii_hexdigit()), "{}", set.name);
        }
    }

    /// A kind of difficulty that has no features left would be the empty choice of nothing.
    #[test]
    fn every_kind_of_difficulty_has_its_lines() {
        for (kind, settings) in hard_kinds() {
            assert!(settings.foil.features.iter().any(|weight| weight.weight > 0.0), "{kind}");
        }
    }
}

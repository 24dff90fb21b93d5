//! The families: what sets the defaults of one apart from those of another, after the samples of the paper's Table 3.
//!
//! Wider than reality on purpose: detectors that were trained on widely randomised drawings carried over to real images
//! (Govind et al. 2023), those trained on one look did not.

use super::acquisition::AcquisitionSettings;
use super::alignment::AlignmentSettings;
use super::conditions::ConditionSettings;
use super::geometry::{FoilSettings, Range};
use super::parametric::LookSettings;
use super::settings::{Family, Mode, SimulateSettings};

impl SimulateSettings {
    /// The defaults of a family: pairs of 512 px at -4 and 4 degrees.
    pub fn of_family(family: Family) -> Self {
        let (foil, look, conditions, acquisition) = match family {
            Family::Gan => (FoilSettings::gan(), gan_look(), gan_conditions(), gan_acquisition()),
            Family::Tial => (FoilSettings::tial(), tial_look(), tial_conditions(), tial_acquisition()),
            Family::Cantor => (FoilSettings::cantor(), cantor_look(), cantor_conditions(), cantor_acquisition()),
            Family::Mixed => (
                FoilSettings::mixed(),
                LookSettings::default(),
                ConditionSettings::default(),
                AcquisitionSettings::default(),
            ),
        };
        Self {
            family,
            mode: Mode::default(),
            size_px: 512,
            tilts_deg: vec![-4.0, 4.0],
            visible_above_noise: 3.0,
            least_contrast: 0.02,
            foil,
            look,
            conditions,
            acquisition,
            alignment: AlignmentSettings::default(),
        }
    }
}

/// Clear lines on an even background.
fn gan_look() -> LookSettings {
    LookSettings { line_contrast: [0.1, 0.5], boundary_families: 0.3, background: 1.1, ..LookSettings::default() }
}

fn gan_conditions() -> ConditionSettings {
    ConditionSettings { stem: 0.8, ..ConditionSettings::default() }
}

/// Little noise.
fn gan_acquisition() -> AcquisitionSettings {
    AcquisitionSettings {
        dose: [5000.0, 150_000.0],
        read_noise: [0.001, 0.008],
        correlated: 0.6,
        ..AcquisitionSettings::default()
    }
}

/// Boundaries of all kinds.
fn tial_look() -> LookSettings {
    LookSettings {
        line_width_px: [1.7, 8.0],
        line_contrast: [0.1, 0.7],
        background: 0.8,
        boundary_families: 0.6,
        lamellae: 0.7,
        hair: 0.4,
        bright: 0.08,
        ..LookSettings::default()
    }
}

fn tial_conditions() -> ConditionSettings {
    ConditionSettings {
        stem: 0.3,
        deviation: Range::new(-0.2, 1.0),
        bend_per_um: Range::new(0.0, 0.003),
        ..ConditionSettings::default()
    }
}

fn tial_acquisition() -> AcquisitionSettings {
    AcquisitionSettings { dose: [80.0, 2500.0], correlated: 0.35, ..AcquisitionSettings::default() }
}

/// Weak lines in noise.
fn cantor_look() -> LookSettings {
    LookSettings { line_contrast: [0.1, 0.5], bright: 0.1, background: 0.8, ..LookSettings::default() }
}

fn cantor_conditions() -> ConditionSettings {
    ConditionSettings { stem: 0.7, ..ConditionSettings::default() }
}

fn cantor_acquisition() -> AcquisitionSettings {
    AcquisitionSettings {
        dose: [50.0, 900.0],
        read_noise: [0.01, 0.06],
        correlated: 0.2,
        ..AcquisitionSettings::default()
    }
}

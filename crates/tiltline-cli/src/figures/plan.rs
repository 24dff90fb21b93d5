//! What is measured on what: the published figures, and a small run that shows whether everything works.

use miette::{IntoDiagnostic, Result};
use tiltline::dataset::sets::Set;
use tiltline::dataset::{Item, Manifest};
use tiltline::figures::{images, low_contrast, views};
use tiltline::simulate::geometry::Split;
use tiltline::simulate::{Family, SimulateSettings};
use tiltline_nets::figures::Budget;

/// Sets and numbers.
pub struct Plan {
    /// Series, for Figures 4 to 9.
    pub series: Manifest,
    /// Name of the series of Figures 4 to 8.
    pub shown: &'static str,
    /// Numbers of views of Figure 9.
    pub counts: Vec<usize>,
    /// Foils at several angles, for Table 1.
    pub angles: Manifest,
    /// Pairs at 8 degrees of all families, for Tables 2 and 3 and Figure 12.
    pub pairs: Manifest,
    /// A sample of the training data, for Figures 10 and 11.
    pub training: Manifest,
    /// Foils of low contrast, for Figure 12.
    pub low_contrast: Manifest,
    /// Of the trainings.
    pub budget: Budget,
}

impl Plan {
    /// The published figures.
    pub fn published() -> Result<Self> {
        let set = |name: &str| Ok::<_, miette::Report>(Set::named(name).into_diagnostic()?.manifest());
        Ok(Self {
            series: set("bench-series")?,
            shown: "cantor-parametric-series",
            counts: views::COUNTS.into(),
            angles: set("bench-angles")?,
            pairs: set("bench-8deg")?,
            training: images::training_sample(512),
            low_contrast: low_contrast::foils(512),
            budget: Budget::PUBLISHED,
        })
    }

    /// One small foil a set.
    pub fn small() -> Self {
        const SIDE_PX: usize = 192;
        let tilts: Vec<f64> = (-5..=5).map(|step| 2.0 * f64::from(step)).collect();
        let budget =
            Budget { loss_steps: 2, detector_steps: 2, loss_crop_px: 64, detector_crop_px: 64, simulated_px: 96 };
        let mut training = images::training_sample(96);
        training.items.retain(|item| item.name.ends_with("-01") || item.name.ends_with("-00"));
        let mut low_contrast = low_contrast::foils(SIDE_PX);
        low_contrast.items.truncate(2);
        Self {
            series: small_set("small-series", &[("series", tilts, [3, 7])], SIDE_PX),
            shown: "series-000",
            counts: vec![2, 3, 5],
            angles: small_set(
                "small-angles",
                &[4.0, 8.0]
                    .map(|angle| (if angle < 5.0 { "four" } else { "eight" }, vec![-0.5 * angle, 0.5 * angle], [0, 1])),
                SIDE_PX,
            ),
            pairs: small_set("small-pairs", &[("pair", vec![-4.0, 4.0], [0, 1])], SIDE_PX),
            training,
            low_contrast,
            budget,
        }
    }
}

/// One foil, seen at the tilts of each kind.
fn small_set(name: &str, kinds: &[(&str, Vec<f64>, [usize; 2])], size_px: usize) -> Manifest {
    let mut manifest = Manifest { name: Some(name.into()), seed: Some(1), ..Manifest::empty() };
    manifest.program = Some(env!("CARGO_PKG_VERSION").into());
    for (kind, tilts_deg, pair) in kinds {
        let settings =
            SimulateSettings { size_px, tilts_deg: tilts_deg.clone(), ..SimulateSettings::of_family(Family::Gan) };
        manifest.settings.insert((*kind).to_owned(), settings);
        manifest.items.push(Item::planned(format!("{kind}-000"), Split::TestA, kind, 0, *pair));
    }
    manifest
}

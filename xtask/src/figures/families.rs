//! What the families look like: the left views of four foils of each, two drawn and two diffracted.

use miette::{IntoDiagnostic, Result};
use ndarray::Array2;
use tiltline::filter::percentiles;
use tiltline::simulate::geometry::{Split, geometry_seed};
use tiltline::simulate::{Family, Lines, Mode, SimulateSettings, sample};

const SIDE_PX: usize = 256;

/// Four pictures a family, in the order of [`Family::ALL`].
pub fn pictures() -> Result<Vec<Array2<f32>>> {
    let mut pictures = Vec::new();
    for family in Family::ALL {
        for mode in [Mode::Parametric, Mode::Parametric, Mode::Physics, Mode::Physics] {
            let settings = SimulateSettings { mode, size_px: SIDE_PX, ..SimulateSettings::of_family(family) };
            let seed = geometry_seed(Split::Train, pictures.len() as u64);
            let image = sample(&settings, Lines::Random, seed).into_diagnostic()?.views.swap_remove(0).recording.image;
            let [low, high] = percentiles(&image, [0.005, 0.995]);
            pictures.push(image.mapv(|value| ((value - low) / (high - low).max(1e-6)).clamp(0.0, 1.0)));
        }
    }
    Ok(pictures)
}

//! Ratios pooled over images, with intervals over images as in [`crate::score::Summary`].

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::score::{Estimate, ScoreSettings};

/// Sum of values over sum of weights, `(value times weight, weight)` an image; the 95 percent percentile bootstrap over images.
/// `None` without weight.
pub fn pooled(parts: &[(f64, f64)]) -> Option<Estimate> {
    let ratio = |of: &mut dyn Iterator<Item = &(f64, f64)>| {
        let (sum, weight) = of.fold((0.0, 0.0), |(sum, weight), part| (sum + part.0, weight + part.1));
        (weight > 0.0).then(|| sum / weight)
    };
    let value = ratio(&mut parts.iter())?;
    let settings = ScoreSettings::default();
    let mut rng = Pcg64::seed_from_u64(settings.bootstrap_seed);
    let mut drawn: Vec<f64> = (0..settings.bootstrap_samples)
        .filter_map(|_| ratio(&mut (0..parts.len()).map(|_| &parts[rng.random_range(0..parts.len())])))
        .collect();
    drawn.sort_by(f64::total_cmp);
    let at = |share: f64| drawn[((drawn.len() - 1) as f64 * share).round() as usize];
    let interval_95 = (parts.len() > 1 && !drawn.is_empty()).then(|| [at(0.025), at(0.975)]);
    Some(Estimate { value, interval_95 })
}

/// A figure with its interval in brackets; a dash where there is none.
pub(super) fn with_interval(estimate: Option<Estimate>, decimals: usize) -> String {
    match estimate {
        None => "-".into(),
        Some(Estimate { value, interval_95: None }) => format!("{value:.decimals$}"),
        Some(Estimate { value, interval_95: Some([low, high]) }) => {
            format!("{value:.decimals$} ({low:.decimals$} to {high:.decimals$})")
        }
    }
}

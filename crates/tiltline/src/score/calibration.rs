//! Whether sigma means what it says: of the true line with a prediction, which share lies within 1 and 2 sigma of it?
//!
//! The error is that of the disparity in the paper's protocol (along the epipolar row, input px, no free offset). For
//! normal errors 68.3 and 95.4 percent are due; less means that sigma is too small. Lines matched to a wrong partner are
//! in it: they are what a user meets.

use serde::{Deserialize, Serialize};

use crate::curve::Flag;
use crate::score::paper::{Residual, ResidualError};

/// Number of groups of equal length that the error is listed for.
const GROUPS: usize = 10;

/// Calibration of sigma.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Length of true line with a prediction and a sigma, px.
    pub length_px: f64,
    /// Share of it within one sigma, 0 to 1.
    pub within_1_sigma: Option<f64>,
    /// Share of it within two sigma.
    pub within_2_sigma: Option<f64>,
    /// Median sigma in px.
    pub median_sigma_px: Option<f64>,
    /// The same shares for the points of each flag.
    pub by_flag: Vec<FlagCalibration>,
    /// Error by sigma, in ten groups of equal length from the smallest sigma to the largest (fewer where there are fewer
    /// pieces).
    pub deciles: Vec<SigmaDecile>,
}

/// Calibration of the points of one flag.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlagCalibration {
    /// The flag.
    pub flag: Flag,
    /// Length of true line, px.
    pub length_px: f64,
    /// Share within one sigma.
    pub within_1_sigma: f64,
    /// Share within two sigma.
    pub within_2_sigma: f64,
}

/// One tenth of the true line, by sigma.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SigmaDecile {
    /// Mean sigma in px.
    pub sigma_px: f64,
    /// Root mean square error in px: equal to sigma where sigma is right.
    pub rms_error_px: f64,
    /// Median absolute error in px: 0.674 sigma where errors are normal; a few wrong matches do not move it.
    pub median_error_px: f64,
}

impl ResidualError {
    /// Whether the error is within a multiple of its sigma.
    pub(crate) fn is_within(&self, multiple: f64) -> Option<bool> {
        self.sigma_px.map(|sigma| self.along_row_px.abs() <= multiple * sigma + 1e-9)
    }
}

/// Calibration of residuals, of one image or of many.
pub fn calibration<'a>(residuals: impl IntoIterator<Item = &'a Residual>) -> Calibration {
    let with_sigma = |piece: &Residual| {
        let error = piece.error?;
        Some((error.sigma_px?, error, piece.length_px))
    };
    let mut pieces: Vec<(f64, ResidualError, f64)> = residuals.into_iter().filter_map(with_sigma).collect();
    pieces.sort_by(|a, b| a.0.total_cmp(&b.0));
    let length = |pieces: &[(f64, ResidualError, f64)]| pieces.iter().map(|piece| piece.2).sum::<f64>();
    let length_px = length(&pieces);
    if length_px == 0.0 {
        return Calibration::default();
    }
    let share = |pieces: &[(f64, ResidualError, f64)], multiple| {
        let within = pieces.iter().filter(|piece| piece.1.is_within(multiple) == Some(true));
        // An empty sum is -0.
        (within.map(|piece| piece.2).sum::<f64>() / length(pieces)).max(0.0)
    };
    let of_flag = |flag: Flag| {
        let pieces: Vec<_> = pieces.iter().filter(|piece| piece.1.flag == flag).copied().collect();
        let (length_px, within_1_sigma, within_2_sigma) = (length(&pieces), share(&pieces, 1.0), share(&pieces, 2.0));
        (!pieces.is_empty()).then_some(FlagCalibration { flag, length_px, within_1_sigma, within_2_sigma })
    };
    let mut groups: Vec<Vec<(f64, ResidualError, f64)>> = vec![Vec::new(); GROUPS];
    let mut before = 0.0;
    for piece in &pieces {
        let at = (before + 0.5 * piece.2) / length_px * GROUPS as f64;
        groups[(at as usize).min(GROUPS - 1)].push(*piece);
        before += piece.2;
    }
    let decile = |group: &Vec<(f64, ResidualError, f64)>| {
        let mean = |value: &dyn Fn(&(f64, ResidualError, f64)) -> f64| {
            group.iter().map(|piece| piece.2 * value(piece)).sum::<f64>() / length(group)
        };
        let errors = group.iter().map(|piece| (piece.1.along_row_px.abs(), piece.2)).collect();
        SigmaDecile {
            sigma_px: mean(&|piece| piece.0),
            rms_error_px: mean(&|piece| piece.1.along_row_px.powi(2)).sqrt(),
            median_error_px: weighted_quantile(errors, 0.5).unwrap_or(0.0),
        }
    };
    Calibration {
        length_px,
        within_1_sigma: Some(share(&pieces, 1.0)),
        within_2_sigma: Some(share(&pieces, 2.0)),
        median_sigma_px: weighted_quantile(pieces.iter().map(|piece| (piece.0, piece.2)).collect(), 0.5),
        by_flag: [Flag::Ok, Flag::IllConditioned, Flag::Bridged].into_iter().filter_map(of_flag).collect(),
        deciles: groups.iter().filter(|group| !group.is_empty()).map(decile).collect(),
    }
}

/// The smallest value with at least `fraction` of all weight at or below it.
pub(crate) fn weighted_quantile(mut weighted: Vec<(f64, f64)>, fraction: f64) -> Option<f64> {
    weighted.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = weighted.iter().map(|(_, weight)| weight).sum();
    let mut sum = 0.0;
    for (value, weight) in &weighted {
        sum += weight;
        // Less a hair, so that ten equal weights have their median at the fifth, whatever their rounding.
        if sum >= fraction * total * (1.0 - 1e-12) {
            return Some(*value);
        }
    }
    None
}

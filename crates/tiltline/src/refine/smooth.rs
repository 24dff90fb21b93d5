//! Smoothing of a value along arc length by an integrated Wiener process: the Bayesian form of the cubic smoothing spline
//! (Wahba 1978), computed by a Kalman filter and the Rauch-Tung-Striebel smoother, with the posterior variance.
//!
//! The state is (value, slope); the slope does a random walk of spectral density `roughness` (units value^2 / px^3),
//! which is chosen per curve by its likelihood. Gaps are bridged by themselves, with the variance they deserve.

use nalgebra::{Matrix2, Vector2};

/// A measurement along a curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    /// Arc length, px, not decreasing.
    pub arc_px: f64,
    /// What was measured, and its variance; `None` where nothing was.
    pub measured: Option<(f64, f64)>,
    /// Whether the curve has a kink just before this point: its slope may change at once.
    pub kink: bool,
}

/// Value and variance at each sample.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Smoothed {
    pub values: Vec<f64>,
    pub variances: Vec<f64>,
    /// Logarithm of the likelihood of the measurements, up to a constant.
    pub log_likelihood: f64,
}

/// Smooths samples with a given roughness; the slope has a prior of `slope_sigma` at the start and at kinks.
pub(super) fn smooth(samples: &[Sample], roughness: f64, slope_sigma: f64) -> Smoothed {
    let count = samples.len();
    let measured: Vec<f64> = samples.iter().filter_map(|sample| Some(sample.measured?.0)).collect();
    let mean = measured.iter().sum::<f64>() / measured.len().max(1) as f64;
    let slope_variance = slope_sigma * slope_sigma;
    // Wide enough to leave the value free, narrow enough for f64.
    let mut state = Vector2::new(mean, 0.0);
    let mut covariance = Matrix2::new(1e6, 0.0, 0.0, slope_variance);
    let mut predicted = Vec::with_capacity(count);
    let mut filtered = Vec::with_capacity(count);
    let mut log_likelihood = 0.0;
    for (index, sample) in samples.iter().enumerate() {
        let step = index.checked_sub(1).map_or(0.0, |previous| sample.arc_px - samples[previous].arc_px);
        if index > 0 {
            let transition = transition(step);
            state = transition * state;
            covariance = transition * covariance * transition.transpose() + process_noise(step, roughness);
            if sample.kink {
                covariance[(1, 1)] += slope_variance;
            }
        }
        predicted.push((state, covariance));
        if let Some((value, variance)) = sample.measured {
            let innovation = value - state[0];
            let total = covariance[(0, 0)] + variance;
            let gain = Vector2::new(covariance[(0, 0)], covariance[(1, 0)]) / total;
            state += gain * innovation;
            // Joseph's form keeps the covariance symmetric and positive.
            let keep = Matrix2::new(1.0 - gain[0], 0.0, -gain[1], 1.0);
            covariance = keep * covariance * keep.transpose() + gain * gain.transpose() * variance;
            // The first innovation only sets the level.
            if total < 1e5 {
                log_likelihood -= 0.5 * (innovation * innovation / total + total.ln());
            }
        }
        filtered.push((state, covariance));
    }
    for index in (0..count.saturating_sub(1)).rev() {
        let transition = transition(samples[index + 1].arc_px - samples[index].arc_px);
        let (predicted_state, predicted_covariance) = predicted[index + 1];
        let (state, covariance) = filtered[index];
        let (next_state, next_covariance): (Vector2<f64>, Matrix2<f64>) = filtered[index + 1];
        let Some(inverse) = predicted_covariance.try_inverse() else { continue };
        let gain = covariance * transition.transpose() * inverse;
        filtered[index] = (
            state + gain * (next_state - predicted_state),
            covariance + gain * (next_covariance - predicted_covariance) * gain.transpose(),
        );
    }
    Smoothed {
        values: filtered.iter().map(|(state, _)| state[0]).collect(),
        variances: filtered.iter().map(|(_, covariance)| covariance[(0, 0)].max(0.0)).collect(),
        log_likelihood,
    }
}

fn transition(step: f64) -> Matrix2<f64> {
    Matrix2::new(1.0, step, 0.0, 1.0)
}

/// Covariance that the random walk of the slope adds over a step.
fn process_noise(step: f64, roughness: f64) -> Matrix2<f64> {
    let cross = roughness * step * step / 2.0;
    Matrix2::new(roughness * step.powi(3) / 3.0, cross, cross, roughness * step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn samples(values: impl Iterator<Item = Option<f64>>, variance: f64) -> Vec<Sample> {
        let sample = |(index, value): (usize, Option<f64>)| Sample {
            arc_px: index as f64,
            measured: value.map(|value| (value, variance)),
            kink: false,
        };
        values.enumerate().map(sample).collect()
    }

    #[test]
    fn a_straight_line_is_kept_and_its_error_is_that_of_a_straight_fit() {
        let line = samples((0..101).map(|i| Some(2.0 - 0.1 * i as f64)), 0.04);
        let smoothed = smooth(&line, 1e-12, 10.0);
        for (index, value) in smoothed.values.iter().enumerate() {
            assert_relative_eq!(*value, 2.0 - 0.1 * index as f64, epsilon = 1e-4);
        }
        // Least squares of a line through n points: variance at the centre is sigma^2 / n, at the ends about 4 times that.
        assert_relative_eq!(smoothed.variances[50], 0.04 / 101.0, max_relative = 0.01);
        assert_relative_eq!(smoothed.variances[0], 4.0 * 0.04 / 101.0, max_relative = 0.05);
    }

    #[test]
    fn a_gap_is_bridged_by_a_cubic_with_a_larger_variance() {
        // A natural cubic through exact data: a parabola is met to the order of the gap.
        let values = (0..41).map(|i| (!(15..26).contains(&i)).then(|| 0.002 * (i as f64 - 20.0).powi(2)));
        let smoothed = smooth(&samples(values, 1e-6), 1e-3, 10.0);
        assert_relative_eq!(smoothed.values[20], 0.0, epsilon = 0.01);
        assert!(smoothed.variances[20] > 100.0 * smoothed.variances[5]);
    }

    #[test]
    fn reversing_the_curve_changes_nothing() {
        let values: Vec<Option<f64>> = (0..50).map(|i| (i % 7 != 3).then(|| (0.2 * i as f64).sin())).collect();
        let forth = smooth(&samples(values.iter().copied(), 0.01), 1e-3, 10.0);
        let back = smooth(&samples(values.iter().rev().copied(), 0.01), 1e-3, 10.0);
        for (a, b) in forth.values.iter().zip(back.values.iter().rev()) {
            assert_relative_eq!(*a, *b, epsilon = 1e-5);
        }
    }

    #[test]
    fn a_kink_lets_the_slope_change_at_once() {
        let roof = |i: usize| 1.0 - 0.1 * (i as f64 - 20.0).abs();
        let mut bent = samples((0..41).map(|i| Some(roof(i))), 0.01);
        let plain = smooth(&bent, 1e-6, 0.3);
        bent[20].kink = true;
        let kinked = smooth(&bent, 1e-6, 0.3);
        assert!((plain.values[20] - 1.0).abs() > 0.1);
        assert!((kinked.values[20] - 1.0).abs() < 0.02);
    }
}

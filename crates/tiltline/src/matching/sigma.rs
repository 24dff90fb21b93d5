//! One-sigma error of a disparity read off two centrelines (CONVENTIONS.md, "Depth error").
//!
//! A row cuts a line at the angle psi, so that an error `e` across the line moves the crossing by `e / sin psi` along
//! the row, and an error `r` of the row moves it by `r cot psi`:
//! `sigma_d^2 = sigma_perp_L^2 / sin^2 psi_L + sigma_perp_R^2 / sin^2 psi_R + (sigma_row cot psi)^2`. All in px.

use crate::geometry::{Vector2, angle_to_row};

/// Lines within this angle of the row (10 degrees) have an ill-conditioned disparity.
pub(crate) const ILL_CONDITIONED_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;
/// Smallest angle that enters a sigma (half a degree): a traced tangent is no better than this, and sigma stays finite.
const MIN_PSI_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;

/// Whether a tangent runs within 10 degrees of the row.
pub(crate) fn ill_conditioned(tangent: &Vector2) -> bool {
    angle_to_row(tangent) < ILL_CONDITIONED_RAD
}

/// Error along the row of the crossing of a row with a line, in px, from the error across the line.
pub(crate) fn sigma_along_row_px(tangent: &Vector2, sigma_perp_px: f64) -> f64 {
    sigma_perp_px / angle_to_row(tangent).max(MIN_PSI_RAD).sin()
}

/// Error along the row of the crossing from the error of the row itself, in px. Correlated along a curve.
pub(crate) fn sigma_of_row_px(tangent: &Vector2, sigma_row_px: f64) -> f64 {
    sigma_row_px / angle_to_row(tangent).max(MIN_PSI_RAD).tan()
}

/// One sigma of `x_R - x_L` on a row, in px; each line is its tangent and its error across it. The row error shifts the
/// row that is looked up on the right line, hence that line's angle.
pub(crate) fn sigma_disparity_px(left: (&Vector2, f64), right: (&Vector2, f64), sigma_row_px: f64) -> f64 {
    let across = sigma_along_row_px(left.0, left.1).hypot(sigma_along_row_px(right.0, right.1));
    across.hypot(sigma_of_row_px(right.0, sigma_row_px))
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn a_vertical_line_has_the_sum_of_both_variances_and_no_row_error() {
        let vertical = Vector2::new(0.0, 1.0);
        // 3-4-5 triangle.
        assert_relative_eq!(sigma_disparity_px((&vertical, 0.3), (&vertical, 0.4), 9.0), 0.5, epsilon = 1e-12);
    }

    #[test]
    fn a_line_at_thirty_degrees_doubles_the_error_and_a_diagonal_passes_the_row_error_on() {
        let thirty = Vector2::new(0.75_f64.sqrt(), -0.5);
        let vertical = Vector2::new(0.0, -1.0);
        // 1 / sin 30 = 2 on the left, so (2 * 0.2)^2 + 0.3^2 = 0.5^2.
        assert_relative_eq!(sigma_disparity_px((&thirty, 0.2), (&vertical, 0.3), 7.0), 0.5, epsilon = 1e-12);
        let diagonal = Vector2::new(0.5_f64.sqrt(), 0.5_f64.sqrt());
        // cot 45 = 1.
        assert_relative_eq!(sigma_disparity_px((&vertical, 0.0), (&diagonal, 0.0), 0.7), 0.7, epsilon = 1e-12);
    }

    #[test]
    fn a_line_along_the_row_is_ill_conditioned_with_a_large_but_finite_sigma() {
        let flat = Vector2::new(-1.0, 0.0);
        assert!(ill_conditioned(&flat) && !ill_conditioned(&Vector2::new(1.0, 0.2)));
        let sigma = sigma_disparity_px((&flat, 0.1), (&flat, 0.1), 0.0);
        assert!(sigma > 10.0 && sigma.is_finite());
    }
}

//! The paper's own rectification (section "Image Rectification"), kept for comparison: a shift T of the right image by
//! RANSAC, then one rotation of it by `theta = arctan(dy / dx)` of the remaining displacements.
//!
//! Only the right image is rotated, as in the text. Where both images show the axis at the same angle that turns the
//! right image out of line with the left, and rows do not correspond: the row error says by how much.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::point_matching::PointMatch;
use super::ransac::median;
use crate::geometry::{Point2, Similarity2, Vector2};

/// The paper's maps and the matches they were fitted to.
#[derive(Clone, Debug)]
pub struct PaperFit {
    /// Right input px to left input px: the shift, then the rotation about the left image's centre.
    pub rectified_from_right: Similarity2,
    /// The rotation, radians clockwise on the screen.
    pub theta_rad: f64,
    /// One sigma of it: the displacements' scatter across their common direction over their length.
    pub theta_sigma_rad: f64,
    /// Matches within reach of the common shift.
    pub inliers: Vec<PointMatch>,
}

/// Fits the paper's model; `reach_px` is how far a match may lie from the common shift. `None` without matches.
pub fn fit_paper(matches: &[PointMatch], centre: Point2, reach_px: f64, seed: u64) -> Option<PaperFit> {
    if matches.is_empty() {
        return None;
    }
    let mut rng = Pcg64::seed_from_u64(seed);
    let offset = |pair: &PointMatch| pair.right - pair.left;
    // One match fixes the shift.
    let cost = |shift: &Vector2| -> f64 {
        matches.iter().map(|pair| (offset(pair) - shift).norm_squared().min(reach_px * reach_px)).sum()
    };
    let shifts = (0..500).map(|_| offset(&matches[rng.random_range(0..matches.len())]));
    let mut shift = shifts.min_by(|a, b| cost(a).total_cmp(&cost(b)))?;
    let mut inliers = Vec::new();
    for _ in 0..10 {
        inliers = matches.iter().filter(|pair| (offset(pair) - shift).norm() < reach_px).copied().collect();
        let axis = |component: usize| median(inliers.iter().map(|pair| offset(pair)[component]));
        shift = Vector2::new(axis(0), axis(1));
    }
    // All displacements are multiples of one direction: the principal one of their scatter about zero.
    let (mut xx_less_yy, mut xy) = (0.0, 0.0);
    for pair in &inliers {
        let displacement = shift - offset(pair);
        xx_less_yy += displacement.x * displacement.x - displacement.y * displacement.y;
        xy += displacement.x * displacement.y;
    }
    let theta_rad = 0.5 * (2.0 * xy).atan2(xx_less_yy);
    let across = Vector2::new(-theta_rad.sin(), theta_rad.cos());
    let (mut across2, mut length2) = (0.0, 0.0);
    for pair in &inliers {
        let displacement = shift - offset(pair);
        across2 += displacement.dot(&across).powi(2);
        length2 += displacement.norm_squared();
    }
    let theta_sigma_rad = (across2 / (inliers.len().max(1) as f64 * length2.max(1e-12))).sqrt();
    let shifted = Similarity2::new(-shift, 0.0, 1.0);
    let about_centre = Similarity2::new(centre.coords, 0.0, 1.0);
    let turn = about_centre * Similarity2::new(Vector2::zeros(), theta_rad, 1.0) * about_centre.inverse();
    Some(PaperFit { rectified_from_right: turn * shifted, theta_rad, theta_sigma_rad, inliers })
}

//! From disparity to depth (paper, equation for `depth`; DESIGN: `Z = d / (2 sin(phi / 2))`).

use crate::curve::{Curve3, CurvePoint, MatchedCurve};
use crate::geometry::Point3;
use crate::micrograph::StereoPair;
use crate::reconstruction::{Frame, LengthUnit};
use crate::rectify::RectifiedPair;

/// Curves in the mid-view frame, and the frame: x and y from the centre of the rectified image, z relative to its
/// length-weighted median over all curves.
///
/// `sigma_phi_rad` is the one-sigma error of the angle between the views; it scales all z alike and is kept apart from
/// each point's `sigma_z`. `flip_depth` reports -Z.
pub fn triangulate(
    matched: &[MatchedCurve],
    rectified: &RectifiedPair,
    pair: &StereoPair,
    sigma_phi_rad: f64,
    flip_depth: bool,
) -> (Vec<Curve3>, Frame) {
    let phi = pair.tilts.phi();
    let (height, width) = rectified.left.dim();
    let centre = [0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0)];
    let (unit, pixel) = match pair.pixel_size_nm() {
        Some(size) => (LengthUnit::Nm, size),
        None => (LengthUnit::Px, 1.0),
    };
    let sign = if flip_depth { -1.0 } else { 1.0 };
    let depth_gain = sign * pair.tilts.depth_gain();
    let z_of = |disparity: f64| disparity * depth_gain * pixel;
    let median_z = length_weighted_median(matched, z_of);
    let left_from_rectified = rectified.rectification.rectified_from_left.inverse();
    let right_from_rectified = rectified.rectification.rectified_from_right.inverse();
    let x_gain = 1.0 / (2.0 * (0.5 * phi).cos());
    let curves = matched
        .iter()
        .map(|curve| Curve3 {
            points: curve
                .points
                .iter()
                .map(|point| {
                    let right = point.right();
                    CurvePoint {
                        left_input: left_from_rectified * point.left,
                        right_input: right_from_rectified * right,
                        left_rectified: point.left,
                        disparity_px: point.disparity_px,
                        sigma_disparity_px: point.sigma_px,
                        position: Point3::new(
                            (point.left.x + right.x - 2.0 * centre[0]) * x_gain * pixel,
                            (point.left.y - centre[1]) * pixel,
                            z_of(point.disparity_px) - median_z,
                        ),
                        sigma_z: point.sigma_px * depth_gain.abs() * pixel,
                        flag: point.flag,
                    }
                })
                .collect(),
            closed: curve.closed,
            ends: curve.ends,
        })
        .collect();
    let frame = Frame {
        unit,
        pixel,
        centre_px: centre,
        depth_gain,
        median_z,
        depth_flipped: flip_depth,
        relative_tilt_error: (sigma_phi_rad / phi).abs(),
    };
    (curves, frame)
}

/// Median of z over all curves, each point weighted by the arc length around it; 0 without curves.
fn length_weighted_median(matched: &[MatchedCurve], z_of: impl Fn(f64) -> f64) -> f64 {
    let mut weighted: Vec<(f64, f64)> = Vec::new();
    for curve in matched {
        for pair in curve.points.windows(2) {
            let half = 0.5 * (pair[1].left - pair[0].left).norm();
            weighted.extend(pair.iter().map(|point| (z_of(point.disparity_px), half)));
        }
    }
    weighted.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = weighted.iter().map(|(_, weight)| weight).sum();
    let mut sum = 0.0;
    for (z, weight) in &weighted {
        sum += weight;
        if 2.0 * sum >= total {
            return *z;
        }
    }
    0.0
}

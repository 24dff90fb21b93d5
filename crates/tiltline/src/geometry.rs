//! Parallel projection of a tilted foil: tilts, disparity, depth (paper, equation for `depth`).
//!
//! Conventions (CONVENTIONS.md): image x right, y down; tilt axis along image y; Z points away from the viewer. At
//! tilt `a` the specimen point (X, Y, Z) lands at `x = X cos a + Z sin a`, `y = Y`.

use serde::{Deserialize, Serialize};

/// A point of an image: (x, y) in px, pixel centres at integers.
pub type Point2 = nalgebra::Point2<f64>;
/// A direction or difference in an image, in px.
pub type Vector2 = nalgebra::Vector2<f64>;
/// A point of the foil in the mid-view frame.
pub type Point3 = nalgebra::Point3<f64>;
/// A direction or difference in the foil.
pub type Vector3 = nalgebra::Vector3<f64>;
/// Rotation, isotropic scale and shift of an image; named `target_from_source`.
pub type Similarity2 = nalgebra::Similarity2<f64>;

/// The tilts of the two views of a pair, in radians.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TiltPair {
    /// Tilt of the left view.
    pub left_rad: f64,
    /// Tilt of the right view.
    pub right_rad: f64,
}

impl TiltPair {
    /// Tilts given in degrees.
    pub fn from_degrees(left_deg: f64, right_deg: f64) -> Self {
        Self { left_rad: left_deg.to_radians(), right_rad: right_deg.to_radians() }
    }

    /// Signed angle from the left view to the right one, `phi = a_R - a_L`, in radians.
    pub fn phi(&self) -> f64 {
        self.right_rad - self.left_rad
    }

    /// Tilt of the mid-view frame, in which all 3D points are given.
    pub fn mid_rad(&self) -> f64 {
        0.5 * (self.left_rad + self.right_rad)
    }

    /// Depth per disparity, `1 / (2 sin(phi / 2))`: `Z = d * depth_gain()`; negative where phi is.
    pub fn depth_gain(&self) -> f64 {
        1.0 / (2.0 * (0.5 * self.phi()).sin())
    }

    /// X and Z in the mid-view frame from the x of both rectified views, both measured from the rotation axis.
    pub fn triangulate(&self, x_left: f64, x_right: f64) -> (f64, f64) {
        let x = (x_left + x_right) / (2.0 * (0.5 * self.phi()).cos());
        (x, (x_right - x_left) * self.depth_gain())
    }

    /// The x in both rectified views, measured from the rotation axis, of (X, Z) in the mid-view frame.
    pub fn project(&self, x: f64, z: f64) -> (f64, f64) {
        let (sin, cos) = (0.5 * self.phi()).sin_cos();
        (x * cos - z * sin, x * cos + z * sin)
    }
}

/// Projects a point of the untilted specimen to x (px or nm) at tilt `tilt_rad`: `X cos a + Z sin a`.
pub fn project_at_tilt(point: &Point3, tilt_rad: f64) -> Point2 {
    let (sin, cos) = tilt_rad.sin_cos();
    Point2::new(point.x * cos + point.z * sin, point.y)
}

/// Angle of a tangent to the epipolar row, in `[0, pi/2]`.
pub fn angle_to_row(tangent: &Vector2) -> f64 {
    tangent.y.abs().atan2(tangent.x.abs())
}

/// Polyline length.
pub fn length2(points: &[Point2]) -> f64 {
    points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    /// Physical argument, not a round trip: raise the right-hand side of the foil's tilt and follow one point.
    ///
    /// A point away from the viewer (Z > 0) moves to larger x as the tilt grows (x = X cos a + Z sin a), so with
    /// a_R > a_L its disparity is positive.
    #[test]
    fn a_point_away_from_the_viewer_has_positive_disparity_when_the_tilt_grows() {
        let far = Point3::new(0.0, 0.0, 10.0);
        let tilts = TiltPair::from_degrees(-4.0, 4.0);
        let d = project_at_tilt(&far, tilts.right_rad).x - project_at_tilt(&far, tilts.left_rad).x;
        assert!(d > 0.0);
        assert_relative_eq!(d * tilts.depth_gain(), 10.0, epsilon = 1e-12);
    }

    #[test]
    fn an_asymmetric_pair_gives_the_point_in_its_mid_view_frame() {
        let point = Point3::new(30.0, 5.0, -12.0);
        let tilts = TiltPair::from_degrees(3.0, 11.0);
        let left = project_at_tilt(&point, tilts.left_rad);
        let right = project_at_tilt(&point, tilts.right_rad);
        let (x, z) = tilts.triangulate(left.x, right.x);
        // The mid-view frame is the specimen turned by the mid tilt about y.
        let (sin, cos) = tilts.mid_rad().sin_cos();
        assert_relative_eq!(x, point.x * cos + point.z * sin, epsilon = 1e-12);
        assert_relative_eq!(z, point.z * cos - point.x * sin, epsilon = 1e-12);
        let (x_left, x_right) = tilts.project(x, z);
        assert_relative_eq!(x_left, left.x, epsilon = 1e-12);
        assert_relative_eq!(x_right, right.x, epsilon = 1e-12);
    }

    #[test]
    fn swapping_the_views_negates_disparity_and_keeps_depth() {
        let tilts = TiltPair::from_degrees(-2.0, 6.0);
        let swapped = TiltPair { left_rad: tilts.right_rad, right_rad: tilts.left_rad };
        let (x, z) = tilts.triangulate(4.0, 7.5);
        let (x_swapped, z_swapped) = swapped.triangulate(7.5, 4.0);
        assert_relative_eq!(x, x_swapped, epsilon = 1e-12);
        assert_relative_eq!(z, z_swapped, epsilon = 1e-12);
    }
}

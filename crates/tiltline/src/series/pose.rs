//! How one view of a series was taken: its tilt, and where the projection lies in the image.

use nalgebra::{Rotation2, Translation2, Vector3 as Row};

use crate::geometry::{Point2, Point3, Similarity2, Vector2, project_at_tilt};

/// Pose of a view: a point of the specimen is projected along the beam at `tilt_rad` (`x = X cos a + Z sin a`, `y = Y`), and
/// turned, magnified and shifted into the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewPose {
    /// Tilt in the frame of the points, radians.
    pub tilt_rad: f64,
    /// Projected plane (tilt axis along y) to px of the input image.
    pub image_from_projection: Similarity2,
}

impl ViewPose {
    /// A pose whose projection's origin lands at `origin`; `axis_rad` is clockwise on the screen from image y.
    pub fn new(tilt_rad: f64, axis_rad: f64, scale: f64, origin: Point2) -> Self {
        let shift = Translation2::from(origin.coords);
        let map = Similarity2::from_parts(shift, Rotation2::new(axis_rad).into(), scale);
        Self { tilt_rad, image_from_projection: map }
    }

    /// Where a point of the specimen lands, in input px.
    pub fn project(&self, point: &Point3) -> Point2 {
        self.image_from_projection * project_at_tilt(point, self.tilt_rad)
    }

    /// Direction of the tilt axis in the image, radians clockwise on the screen from image y.
    pub fn axis_rad(&self) -> f64 {
        self.image_from_projection.isometry.rotation.angle()
    }

    /// Input px per unit of the specimen's lengths.
    pub fn scale(&self) -> f64 {
        self.image_from_projection.scaling()
    }

    /// Where the origin of the specimen lands, in input px.
    pub fn origin(&self) -> Point2 {
        self.image_from_projection * Point2::origin()
    }

    /// The two rows that give image x and y from (X, Y, Z), without the shift.
    pub fn rows(&self) -> [Row<f64>; 2] {
        let (sin, cos) = self.tilt_rad.sin_cos();
        let at = |x: f64, y: f64| self.image_from_projection * Vector2::new(x, y);
        let (right, down) = (at(1.0, 0.0), at(0.0, 1.0));
        [0, 1].map(|axis| Row::new(right[axis] * cos, down[axis], right[axis] * sin))
    }

    /// The pose after small changes: a tilt, a turn and a relative magnification about the image of `pivot` (projected plane), and
    /// a shift in the image.
    pub fn changed(&self, tilt_rad: f64, turn_rad: f64, log_scale: f64, shift: Vector2, pivot: &Point2) -> Self {
        let fixed = self.image_from_projection * pivot;
        let rotation = Rotation2::new(self.axis_rad() + turn_rad);
        let scale = self.scale() * log_scale.exp();
        let origin = fixed + shift - rotation * pivot.coords * scale;
        let map = Similarity2::from_parts(Translation2::from(origin.coords), rotation.into(), scale);
        Self { tilt_rad: self.tilt_rad + tilt_rad, image_from_projection: map }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;

    /// Physical argument: the stage turns the foil about a vertical axis, and what lies behind mid-foil moves to the right as the
    /// tilt grows; with the axis turned by 90 degrees (along the rows, pointing left) it moves down.
    #[test]
    fn a_far_point_moves_along_the_rows_of_the_turned_axis() {
        let far = Point3::new(0.0, 0.0, 10.0);
        let moved = |axis_deg: f64| {
            let at = |tilt_rad| ViewPose::new(tilt_rad, f64::to_radians(axis_deg), 1.0, Point2::origin()).project(&far);
            at(0.2) - at(-0.2)
        };
        assert!(moved(0.0).x > 3.0 && moved(0.0).y.abs() < 1e-12);
        assert!(moved(90.0).y > 3.0 && moved(90.0).x.abs() < 1e-12);
    }

    #[test]
    fn rows_and_changes_agree_with_the_projection() {
        let pose = ViewPose::new(0.3, 0.1, 1.2, Point2::new(40.0, -7.0));
        let point = Point3::new(3.0, -5.0, 11.0);
        let [x, y] = pose.rows().map(|row| row.dot(&point.coords));
        let landed = pose.project(&point);
        assert_abs_diff_eq!(landed.x, x + 40.0, epsilon = 1e-12);
        assert_abs_diff_eq!(landed.y, y - 7.0, epsilon = 1e-12);
        let pivot = Point2::new(8.0, 2.0);
        let changed = pose.changed(0.0, 0.2, 0.1, Vector2::new(1.0, 2.0), &pivot);
        let there = changed.image_from_projection * pivot;
        assert_abs_diff_eq!(there, pose.image_from_projection * pivot + Vector2::new(1.0, 2.0), epsilon = 1e-12);
        assert_abs_diff_eq!(changed.scale(), 1.2 * 0.1_f64.exp(), epsilon = 1e-12);
    }
}

//! Where the points of a foil land in one image, and which points of the foil a pixel sees.

use nalgebra::{Rotation2, Translation2};

use crate::geometry::{Point2, Point3, Similarity2, Vector2, project_at_tilt};

/// Parallel projection of a tilted foil on to an image. Lengths of the foil are in any unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Rows and columns of the image.
    pub shape: [usize; 2],
    /// Tilt in radians.
    pub tilt_rad: f64,
    /// Direction of the tilt axis, radians clockwise on the screen from image y.
    pub axis_rad: f64,
    /// Px per unit of the foil's lengths: the magnification where those are px, the inverse of the pixel size where they are nm.
    pub scale: f64,
    /// Shift of the image on the screen, px.
    pub shift_px: [f64; 2],
}

impl Camera {
    /// An untilted view of the foil's centre.
    pub fn new(shape: [usize; 2]) -> Self {
        Self { shape, tilt_rad: 0.0, axis_rad: 0.0, scale: 1.0, shift_px: [0.0, 0.0] }
    }

    /// Projected plane (origin at the foil's centre, tilt axis along y) to image px.
    pub fn image_from_projection(&self) -> Similarity2 {
        let centre = Vector2::new(0.5 * (self.shape[1] as f64 - 1.0), 0.5 * (self.shape[0] as f64 - 1.0));
        let shift = Translation2::from(centre + Vector2::from(self.shift_px));
        Similarity2::from_parts(shift, Rotation2::new(self.axis_rad).into(), self.scale)
    }

    /// Where a point of the foil lands in the image.
    pub fn project(&self, point: &Point3) -> Point2 {
        self.image_from_projection() * project_at_tilt(point, self.tilt_rad)
    }

    /// Projects many points.
    pub fn project_all<'a>(&self, points: impl IntoIterator<Item = &'a Point3>) -> Vec<Point2> {
        let image_from_projection = self.image_from_projection();
        points.into_iter().map(|point| image_from_projection * project_at_tilt(point, self.tilt_rad)).collect()
    }

    /// An affine map from image (column, row) to the (X, Y) of the foil at depth z: `[X, Y] = m * [column, row] + b`,
    /// returned as `[m00, m01, b0, m10, m11, b1]`; for fields that are evaluated at every pixel.
    pub fn foil_from_image(&self, z: f64) -> [f64; 6] {
        let projection_from_image = self.image_from_projection().inverse();
        let (sin, cos) = self.tilt_rad.sin_cos();
        let at = |x: f64, y: f64| {
            let point = projection_from_image * Point2::new(x, y);
            [(point.x - z * sin) / cos, point.y]
        };
        let (origin, right, down) = (at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0));
        [right[0] - origin[0], down[0] - origin[0], origin[0], right[1] - origin[1], down[1] - origin[1], origin[1]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;

    #[test]
    fn a_pixel_sees_the_point_that_lands_on_it() {
        let camera =
            Camera { tilt_rad: 0.3, axis_rad: 0.2, scale: 1.1, shift_px: [7.0, -3.0], ..Camera::new([200, 300]) };
        let point = Point3::new(31.0, -20.0, 15.0);
        let image = camera.project(&point);
        let [m00, m01, b0, m10, m11, b1] = camera.foil_from_image(point.z);
        assert_abs_diff_eq!(m00 * image.x + m01 * image.y + b0, point.x, epsilon = 1e-9);
        assert_abs_diff_eq!(m10 * image.x + m11 * image.y + b1, point.y, epsilon = 1e-9);
    }
}

//! The grid of tomograms of views as they lie: the projected plane of the frame, and as many layers as lines are deep.

use ndarray::Array2;

use super::FitView;
use super::evidence::evidence;
use crate::filter::gaussian_blur;
use crate::geometry::{Point2, Point3, Similarity2, Vector2, Vector3};
use crate::rectify::resample::{bounds, resample};
use crate::tomography::Geometry;

/// Layers beyond the range of depth, px.
const MARGIN_PX: f64 = 10.0;
/// Views are blurred by so many voxels before they are shrunk, so that no line falls between the voxels.
const SHRUNK_BLUR: f64 = 0.5;

/// Voxels of a tomogram in the frame of poses.
pub(super) struct Grid {
    /// Side of a voxel, px.
    pub px: f64,
    /// The first voxel's place in the projected plane without tilt.
    low: Point2,
    /// The depth of the middle layer, px.
    middle_z: f64,
    width: usize,
    height: usize,
    depth: usize,
}

impl Grid {
    /// The projected plane as far as a view shows it, between two depths, px; coarser than the view where there would be too many voxels.
    pub fn new(view: &FitView, [top, bottom]: [f64; 2], most_voxels: f64) -> Self {
        let (low, high) = bounds(view.lines.lines().shape, &view.pose.image_from_projection.inverse());
        let size = [high.x - low.x + 1.0, high.y - low.y + 1.0, bottom - top + 2.0 * MARGIN_PX];
        let px = (size.iter().product::<f64>() / most_voxels).cbrt().max(1.0);
        let [width, height, depth] = size.map(|length| (length / px).ceil().max(1.0) as usize);
        Self { px, low, middle_z: 0.5 * (top + bottom), width, height, depth }
    }

    /// The probabilities of lines in a view on the grid, 0 where it has none. What lies in the middle layer is where it is without tilt.
    pub fn image(&self, view: &FitView) -> Array2<f32> {
        self.placed(view, view.lines.lines().probability.mapv(|value| f32::from(value) / 255.0))
    }

    /// The evidence for lines in a view on the grid, likewise.
    pub fn evidence(&self, view: &FitView) -> Array2<f32> {
        self.placed(view, evidence(view.lines.lines()))
    }

    fn placed(&self, view: &FitView, mut image: Array2<f32>) -> Array2<f32> {
        let shift = -self.low.coords - Vector2::new(self.middle_z * view.pose.tilt_rad.sin(), 0.0);
        let mut map = view.pose.image_from_projection.inverse();
        map.isometry.translation.vector += shift;
        let map = Similarity2::from_scaling(1.0 / self.px) * map;
        if self.px > 1.0 {
            image = gaussian_blur(&image, SHRUNK_BLUR * self.px);
        }
        let moved = resample(&image.view(), &map, [self.height, self.width]);
        moved.mapv_into(|value| if value.is_finite() { value } else { 0.0 })
    }

    /// Where the middle of the grid lies in the projected plane of a view.
    pub fn middle(&self, view: &FitView) -> Point2 {
        let half = Vector2::new(0.5 * (self.width as f64 - 1.0), 0.5 * (self.height as f64 - 1.0)) * self.px;
        self.low + Vector2::new(self.middle_z * view.pose.tilt_rad.sin(), 0.0) + half
    }

    /// The width of a line on the grid, px, and its height against what they are in a view: a blurred line is wider and fainter.
    pub fn blurred(&self, sigma_px: f64) -> (f64, f64) {
        let wider = if self.px > 1.0 { sigma_px.hypot(SHRUNK_BLUR * self.px) } else { sigma_px };
        (wider, sigma_px / wider)
    }

    /// The geometry of views at these tilts.
    pub fn geometry(&self, tilts_rad: Vec<f64>) -> Geometry {
        Geometry { tilts_rad, width: self.width, depth: self.depth, axis_column: -self.low.x / self.px }
    }

    /// A point of a tomogram's curve in the frame of the poses.
    pub fn in_frame(&self, point: Point3) -> Point3 {
        Point3::from(point.coords * self.px) + Vector3::new(0.0, self.low.y, self.middle_z)
    }
}

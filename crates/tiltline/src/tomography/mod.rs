//! Tomography: a volume from the views of a tilt series, by weighted back projection ([`wbp`]) or SIRT ([`sirt`]).
//!
//! Geometry as everywhere (CONVENTIONS.md): the tilt axis lies along image y, and (X, Y, Z) lands at `x = X cos a + Z sin a`,
//! `y = Y`. Rows of y do not know of each other, so the volume is made in slabs of [`projector::LANES`] rows, one a thread: memory is that
//! of the views and of one slab a thread, whatever the volume's size, and results do not depend on the number of threads.
//!
//! Volumes are `[z, y, x]`, z growing away from the viewer. Values are the views' values per px of path.
//!
//! A tomogram assumes that views are projections of one density. Diffraction contrast is not: a dislocation's darkness depends on
//! the tilt through the deviation from the Bragg condition. [`prepare`] makes the best of it.

pub mod against_truth;
mod angles;
pub mod compare;
pub mod curves;
mod error;
pub mod prepare;
pub mod projector;
pub mod sirt;
mod slabs;
pub mod wbp;

use serde::{Deserialize, Serialize};

pub use angles::{Coverage, coverage, evenly_spaced};
pub use error::TomographyError;
pub use sirt::SirtSettings;
pub use slabs::{Slab, projections, reconstruct, volume};
pub use wbp::{Filter, WbpSettings};

/// Views and volume about one tilt axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Geometry {
    /// Tilt of each view in radians.
    pub tilts_rad: Vec<f64>,
    /// Columns of the views, and voxels of the volume along x.
    pub width: usize,
    /// Voxels of the volume along z.
    pub depth: usize,
    /// The column that the tilt axis lies on, `(width - 1) / 2` for the middle; voxel x lies at `X = x - axis_column`.
    pub axis_column: f64,
}

impl Geometry {
    /// A geometry with the tilt axis in the middle of the views.
    pub fn centred(tilts_rad: Vec<f64>, width: usize, depth: usize) -> Self {
        Self { tilts_rad, width, depth, axis_column: 0.5 * (width as f64 - 1.0) }
    }

    /// The layer at Z = 0: voxel z lies at `Z = z - middle_layer()`.
    pub fn middle_layer(&self) -> f64 {
        0.5 * (self.depth as f64 - 1.0)
    }
}

/// How a volume is made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "snake_case")]
pub enum Method {
    /// Weighted back projection.
    Wbp(WbpSettings),
    /// Simultaneous iterative reconstruction technique.
    Sirt(SirtSettings),
}

#[cfg(test)]
mod tests;

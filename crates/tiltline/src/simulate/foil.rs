//! A foil and the dislocations in it: what every mode of the simulator draws, and the 3D truth of every score.
//!
//! Lengths are nm in the untilted specimen frame: x right, y down, z away from the viewer, origin at the centre of the
//! foil, whose surfaces are at `z = -thickness_nm / 2` (entrance) and `z = +thickness_nm / 2` (exit).

use serde::{Deserialize, Serialize};

use crate::geometry::{Point3, Vector3};

/// One dislocation line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dislocation {
    /// Polyline in nm; neighbouring points are at most a few nm apart.
    pub points: Vec<Point3>,
    /// Whether the last point joins the first.
    pub closed: bool,
    /// Burgers vector in nm, if known.
    pub burgers_nm: Option<Vector3>,
    /// Unit normal of the slip plane, if it lies on one.
    pub plane_normal: Option<Vector3>,
}

/// A parallel-sided foil with dislocations.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Foil {
    /// Thickness along z in nm.
    pub thickness_nm: f64,
    /// Extent along x and y in nm.
    pub size_nm: [f64; 2],
    /// The lines in it; they end at the surfaces, at each other, or close.
    pub dislocations: Vec<Dislocation>,
}

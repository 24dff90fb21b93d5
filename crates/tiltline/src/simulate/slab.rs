//! Cuts a foil out of a dislocation network from a simulation of dislocation dynamics.

use nalgebra::UnitQuaternion;

use super::foil::{Dislocation, Foil};
use super::geometry::polyline::{HalfSpace, box_region, length};
use super::geometry::{clip, resample};
use super::paradis::Network;
use crate::geometry::{Point3, Vector3};

/// A foil holds at most this many times the volume of a periodic box (its bounds do): more would be the same lines again
/// and again.
const MOST_IMAGES: f64 = 5000.0;

/// Most points of one foil.
const MOST_POINTS: f64 = 2e7;

/// Where and how a foil is cut.
#[derive(Clone, Debug, PartialEq)]
pub struct Cut {
    /// Thickness of the foil in nm.
    pub thickness_nm: f64,
    /// Extent of the foil along x and y in nm; lines are cut at its borders.
    pub size_nm: [f64; 2],
    /// Rotation from the frame of the network to the specimen frame.
    pub specimen_from_network: UnitQuaternion<f64>,
    /// The point of the network, nm, that becomes the centre of the foil.
    pub centre: Point3,
    /// Greatest distance of neighbouring points in nm.
    pub spacing_nm: f64,
}

impl Default for Cut {
    fn default() -> Self {
        Self {
            thickness_nm: 150.0,
            size_nm: [1000.0; 2],
            specimen_from_network: UnitQuaternion::identity(),
            centre: Point3::origin(),
            spacing_nm: 2.0,
        }
    }
}

/// Why a foil could not be cut.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CutError {
    /// A size, place or spacing that is no number or not possible.
    #[error("cannot cut a foil with {name} = {value}; give a finite number{}", if *.positive { " above zero" } else { "" })]
    Value {
        /// What it is.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Whether it must be above zero.
        positive: bool,
    },
    /// The foil is far larger than the network.
    #[error(
        "a foil of {size_nm:?} nm and {thickness_nm} nm thickness is far larger than the network's box of {box_nm:?} nm and would \
         repeat it thousands of times; cut a smaller one, or check the unit of the file"
    )]
    TooLarge {
        /// Extent asked for.
        size_nm: [f64; 2],
        /// Thickness asked for.
        thickness_nm: f64,
        /// Sides of the box.
        box_nm: [f64; 3],
    },
    /// The points would lie too close for the length of line.
    #[error(
        "{length_nm} nm of line with points every {spacing_nm} nm are too many; choose a larger spacing or a smaller foil"
    )]
    TooFine {
        /// Length of line in the foil.
        length_nm: f64,
        /// Spacing asked for.
        spacing_nm: f64,
    },
}

/// A foil cut out of a network: lines end at its surfaces and borders. A periodic network goes on beyond its box.
///
/// # Errors
/// Sizes that are not finite and positive; a foil that would repeat a periodic box thousands of times.
pub fn foil_from_network(network: &Network, settings: &Cut) -> Result<Foil, CutError> {
    let Cut { thickness_nm, size_nm, centre, spacing_nm, specimen_from_network } = settings;
    let lengths =
        [("thickness", *thickness_nm), ("width", size_nm[0]), ("height", size_nm[1]), ("spacing", *spacing_nm)];
    let places = [("centre x", centre.x), ("centre y", centre.y), ("centre z", centre.z)];
    let turn = specimen_from_network.coords.norm();
    for (name, value) in lengths.into_iter().chain([("norm of the rotation", turn)]) {
        if !(value > 0.0 && value.is_finite()) {
            return Err(CutError::Value { name, value, positive: true });
        }
    }
    if let Some(&(name, value)) = places.iter().find(|(_, value)| !value.is_finite()) {
        return Err(CutError::Value { name, value, positive: false });
    }
    let corner = Point3::new(0.5 * size_nm[0], 0.5 * size_nm[1], 0.5 * thickness_nm);
    let foil_region = box_region(-corner, corner);
    // The foil's faces in the frame of the network, where the periodic images are.
    let network_from_specimen = specimen_from_network.inverse();
    let region: Vec<HalfSpace> = foil_region
        .iter()
        .map(|face| {
            let normal = network_from_specimen * face.normal;
            HalfSpace { normal, offset: face.offset + normal.dot(&centre.coords) }
        })
        .collect();
    let corners = (0..8).map(|bits| {
        let side = |bit: i32| if bits & bit == 0 { -1.0 } else { 1.0 };
        centre + network_from_specimen * Vector3::new(side(1) * corner.x, side(2) * corner.y, side(4) * corner.z)
    });
    let bounds = corners.fold([*centre, *centre], |[low, high], point| [low.inf(&point), high.sup(&point)]);
    let lines = network.lines();
    let pieces = network.pieces_in(&lines, &region, bounds, MOST_IMAGES).ok_or_else(|| CutError::TooLarge {
        size_nm: *size_nm,
        thickness_nm: *thickness_nm,
        box_nm: network.size_nm().into(),
    })?;
    let length_nm: f64 = pieces.iter().map(|(_, piece)| length(&piece.points, piece.closed)).sum();
    if length_nm > MOST_POINTS * spacing_nm {
        return Err(CutError::TooFine { length_nm, spacing_nm: *spacing_nm });
    }
    let turned: Vec<Dislocation> = pieces
        .into_iter()
        .map(|(line, piece)| Dislocation {
            points: piece.points.iter().map(|p| Point3::from(specimen_from_network * (p - centre))).collect(),
            closed: piece.closed,
            burgers_nm: lines[line].burgers_nm.map(|burgers| specimen_from_network * burgers),
            plane_normal: lines[line].plane_normal.map(|normal| specimen_from_network * normal),
        })
        .collect();
    // Cut once more in the specimen frame, which takes the rounding of the rotation back out.
    let dislocations = resample(clip(&turned, &foil_region[4..], *thickness_nm), *spacing_nm);
    Ok(Foil { thickness_nm: *thickness_nm, size_nm: *size_nm, dislocations })
}

//! The kinds of lines, by the names that settings files use.

use serde::{Deserialize, Serialize};

/// The kinds of lines that grow in a foil.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Feature {
    /// A line from surface to surface, little bowed, on no particular plane.
    Threading,
    /// A bowed line across its slip plane.
    Bowed,
    /// A line with both ends on one surface.
    HalfLoop,
    /// A gliding line that trails a long segment along its slip plane.
    Trailing,
    /// A segment bowed out between two pinning points, its arms on to the surfaces (Frank-Read source).
    Source,
    /// A long straight line in a crystallographic direction.
    Straight,
    /// A line that alternates between two directions.
    Zigzag,
    /// A screw turned into a helix by climb.
    Helix,
    /// A closed loop.
    Loop,
    /// Two lines with the same Burgers vector side by side (superdislocation).
    Pair,
    /// Two lines with opposite Burgers vectors on neighbouring planes.
    Dipole,
    /// Two lines joined along the line where their planes meet: two nodes of three arms.
    Junction,
    /// A piece of a low-angle boundary: a hexagonal net.
    Net,
    /// A row of similar lines pressed against an obstacle.
    PileUp,
    /// Similar lines on one slip plane at irregular distances.
    SlipBand,
    /// One or more sets of parallel lines in an interface nearly parallel to the foil.
    Misfit,
    /// Many irregular lines in a small volume.
    Tangle,
}

impl Feature {
    /// Every kind.
    pub const ALL: [Feature; 17] = [
        Feature::Threading,
        Feature::Bowed,
        Feature::HalfLoop,
        Feature::Trailing,
        Feature::Source,
        Feature::Straight,
        Feature::Zigzag,
        Feature::Helix,
        Feature::Loop,
        Feature::Pair,
        Feature::Dipole,
        Feature::Junction,
        Feature::Net,
        Feature::PileUp,
        Feature::SlipBand,
        Feature::Misfit,
        Feature::Tangle,
    ];

    /// The word used in settings files.
    pub fn word(self) -> &'static str {
        match self {
            Feature::Threading => "threading",
            Feature::Bowed => "bowed",
            Feature::HalfLoop => "half_loop",
            Feature::Trailing => "trailing",
            Feature::Source => "source",
            Feature::Straight => "straight",
            Feature::Zigzag => "zigzag",
            Feature::Helix => "helix",
            Feature::Loop => "loop",
            Feature::Pair => "pair",
            Feature::Dipole => "dipole",
            Feature::Junction => "junction",
            Feature::Net => "net",
            Feature::PileUp => "pile_up",
            Feature::SlipBand => "slip_band",
            Feature::Misfit => "misfit",
            Feature::Tangle => "tangle",
        }
    }
}

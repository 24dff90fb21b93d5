//! Tilt series: many views of one foil, each at its own tilt.
//!
//! [`Series`] opens one (a stack with tilts, or a folder of images); [`align`] finds how the views lie on each other;
//! [`choose_pair`] picks a pair for a reconstruction. [`SavedCurves`] reads a result back, [`register`] finds the pose of a
//! view from the curves, and [`reproject`] measures how well curves fit views that were not used (paper, Figure 7).
//!
//! Angles are radians unless a name ends in `_deg`; poses are [`ViewPose`]s (CONVENTIONS.md for signs).

mod align;
mod checks;
mod choose;
mod error;
mod evenness;
mod fit;
mod lines;
mod names;
mod phase;
mod pose;
mod read;
mod register;
mod reproject;
mod saved;

pub use align::{AlignedSeries, align};
pub use checks::{Checks, PairOrder, PairTilts};
pub use choose::{ChosenPair, choose_pair, pair_at};
pub use error::SeriesError;
pub use evenness::tilt_notes;
pub use fit::{FitSettings, FitView, FittedCurve, Grown, SeriesFit, StartCurve, grow, reconstruct_series};
pub use lines::{LineIndex, ViewLines, detect_lines, typical_view};
pub use pose::ViewPose;
pub use read::{Series, SeriesView};
pub use register::{Registration, chance_near_lines, register};
pub use reproject::{Distances, Reprojection, ViewReprojection, reproject};
pub use saved::{SavedCurve, SavedCurves};

#[cfg(test)]
mod tests;

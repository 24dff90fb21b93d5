//! The paper's Tables 1 to 3 and Figures 4 to 12 on this project's own benchmark: what is measured, the charts and pictures, and
//! the page about them (`tiltline figures` runs it all).
//!
//! A file a table or figure: [`foil`] Figures 4 to 8 on one series, [`views`] Figure 9, [`angles`] Table 1, [`losses`] Table 2,
//! [`images`] Figures 10 and 11 and Table 3, [`low_contrast`] Figure 12. Rows of numbers are plain data that a later run takes up;
//! [`chart`] and [`sheet`] draw, [`page`] writes.

pub mod angles;
pub mod chart;
mod error;
pub mod foil;
pub mod images;
pub mod losses;
pub mod low_contrast;
pub mod page;
mod pool;
pub mod sheet;
#[cfg(test)]
mod tests;
pub mod views;

pub use error::FiguresError;
pub use pool::pooled;

use crate::dataset::{Dataset, Item};
use crate::geometry::TiltPair;
use crate::io::read_micrograph;
use crate::micrograph::StereoPair;
use crate::truth::{TrueView, Truth};

/// Two views of an item as a stereo pair: what the main job is given.
///
/// # Errors
/// Where the truth has no such views or not their tilts, or an image cannot be read.
pub fn stereo_pair(
    dataset: &Dataset,
    item: &Item,
    truth: &Truth,
    [left, right]: [usize; 2],
) -> Result<StereoPair, FiguresError> {
    let pair = truth.pair(left, right)?;
    let tilts = pair.tilts.ok_or_else(|| FiguresError::NoTilts { item: item.name.clone() })?;
    // Takes the rounding of the way through radians back out, as a user would give them.
    let rounded = |rad: f64| (rad.to_degrees() * 1e6).round() / 1e6;
    let tilts = TiltPair::from_degrees(rounded(tilts.left_rad), rounded(tilts.right_rad));
    let read = |view: &TrueView| read_micrograph(&dataset.path(item, &view.name).to_string_lossy());
    let (pair, _) = StereoPair::new(read(pair.left)?, read(pair.right)?, tilts, 0.0)?;
    Ok(pair)
}

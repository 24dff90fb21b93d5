//! Physics mode: two-beam images of dislocations with exact truth (docs/simulator.md).
//!
//! Howie-Whelan equations with anomalous absorption in the column approximation (Hirsch et al. 1965; De Graef 2003),
//! isotropic elastic displacement (Hirth & Lothe 1982). The path: [`lines`] turns the foil into the view and simplifies its
//! dislocations, [`segment`] gives the strain of straight pieces along a column, [`mod@column`] carries the two beams through
//! it, [`perfect`] is the analytic solution where there is no line and the cone of convergence of STEM, [`mod@image`] puts
//! columns together, and [`truth`] measures where the contrast of every line lies. [`displacement`] is the straight line in
//! closed form, against which the strain is tested; [`beam`] holds every parameter with its unit.
//!
//! Lengths are nm, reciprocal lengths 1/nm, z along the beam (away from the viewer), the incident intensity is 1.

pub mod beam;
pub mod column;
pub mod displacement;
pub mod image;
pub mod lines;
pub mod perfect;
pub mod segment;
pub mod truth;

#[cfg(test)]
mod tests;

pub use beam::{Detector, PhysicsSettings};
pub use image::{PhysicsImage, image};
pub use truth::{Contrast, CorePoint, LineTruth, ViewTruth};

/// Why no physical image could be made.
#[derive(Debug, thiserror::Error)]
pub enum PhysicsError {
    /// A parameter is not a number or absurd.
    #[error("{name} is {value}; it must lie between {low} and {high}")]
    OutOfRange {
        /// Which.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Lowest sensible value.
        low: f64,
        /// Highest sensible value.
        high: f64,
    },
    /// A line without Burgers vector has no strain field.
    #[error("dislocation {line} has no Burgers vector; give it one, or use the parametric mode")]
    UnknownBurgers {
        /// Number of the line in the foil.
        line: usize,
    },
    /// A line needs two different points.
    #[error("dislocation {line} has {points} distinct points; a line needs at least 2")]
    TooFewPoints {
        /// Number of the line in the foil.
        line: usize,
        /// Its distinct points.
        points: usize,
    },
}

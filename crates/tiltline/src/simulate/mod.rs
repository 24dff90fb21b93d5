//! Foils with known curves, and plain images of them: dark lines and a speckled background that moves with the foil.
//!
//! Lengths are in px of an unrotated image at scale 1; the origin is the centre of the foil.

pub mod acquisition;
pub mod camera;
pub mod draw;
pub mod field;
pub mod foil;
pub mod geometry;
pub mod paradis;
pub mod parametric;
pub mod physics;
pub mod scene;
pub mod slab;
pub mod view;

pub use camera::Camera;
pub use foil::{Dislocation, Foil};
pub use scene::{Scene, SceneSettings, Speck};
pub use view::{ViewSettings, render};

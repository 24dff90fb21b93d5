//! Foils with known curves, images of them, and exact truth.
//!
//! [`sample()`] makes a specimen in its views from [`SimulateSettings`] and a seed: a random foil ([`geometry`]) or one cut out of a
//! network ([`paradis`], [`slab`]), drawn ([`parametric`]) or diffracted ([`physics`]), with what is not a line, aligned
//! ([`alignment`]) and recorded ([`acquisition`]). [`scene`] and [`view`] are plain images for tests: dark lines on a speckled
//! background that moves with the foil.

pub mod acquisition;
pub mod alignment;
pub mod camera;
pub mod conditions;
pub mod draw;
pub mod family;
pub mod field;
pub mod foil;
pub mod geometry;
pub mod paradis;
pub mod parametric;
pub mod physics;
pub mod sample;
pub mod scene;
pub mod settings;
pub mod slab;
pub mod view;
mod visibility;

pub use camera::Camera;
pub use foil::{Dislocation, Foil};
pub use sample::{Lines, Sample, SampleView, sample, view_names};
pub use scene::{Scene, SceneSettings, Speck};
pub use settings::{Family, Mode, SimulateError, SimulateSettings};
pub use view::{ViewSettings, render};

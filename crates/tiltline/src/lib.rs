//! Tiltline: from two electron micrographs of the same foil, taken at slightly different tilts, to the 3D curves of
//! the dislocations in it.
//!
//! The path through the crate is the one in [`pipeline`]: read ([`io`]), rectify ([`mod@rectify`]), detect
//! ([`ridge`]), trace ([`mod@trace`]), match ([`matching`]), refine ([`mod@refine`]), triangulate
//! ([`mod@triangulate`]), measure ([`mod@measure`]) and export ([`export`]). The nouns that travel between the stages
//! are in [`micrograph`], [`geometry`], [`curve`] and [`reconstruction`]. Signs, axes and units are fixed by
//! CONVENTIONS.md at the root of the repository.
//!
//! The library returns and never prints: progress is reported as [`progress::Event`]s, doubt as
//! [`warning::Warning`]s.

pub mod curve;
pub mod dataset;
pub mod export;
pub mod figures;
pub mod filter;
pub mod geometry;
pub mod io;
pub mod matching;
pub mod measure;
pub mod micrograph;
pub mod oracle;
pub mod pair;
pub mod pipeline;
pub mod progress;
pub mod reconstruction;
pub mod rectify;
pub mod refine;
pub mod report;
pub mod ridge;
pub mod score;
pub mod series;
pub mod settings;
pub mod simulate;
pub mod temporary;
pub mod tomography;
pub mod trace;
pub mod triangulate;
pub mod truth;
pub mod warning;

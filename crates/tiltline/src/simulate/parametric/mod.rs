//! Parametric mode: drawn profiles instead of diffraction physics. Fast, and far more varied than any one microscope:
//! the diversity a detector needs.
//!
//! A [`Specimen`] is drawn once from a seed: how each line looks, and everything that is *not* a dislocation
//! (lamella and twin boundaries, slip traces, dirt, bend contours, thickness fringes), each at a real depth or on a
//! surface, so that it moves between views as it should. [`Specimen::view`] paints it as seen by a [`Camera`]. Lengths
//! are px at scale 1; intensity is relative to a background of about 1, before the detector ([`super::acquisition`]).

pub mod background;
pub mod boundaries;
pub mod debris;
pub mod faults;
pub mod lamellae;
pub mod lines;

use ndarray::Array2;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::geometry::Point3;
use crate::simulate::camera::Camera;
use crate::simulate::geometry::polyline::HalfSpace;
use crate::simulate::settings::{SimulateError, check_range, check_value};
use background::Background;
use boundaries::{Boundary, SlipTrace};
use debris::Debris;
use faults::Fault;
use lamellae::{Hair, Lamella};
use lines::{DrawnLine, Line};

/// Sets the random numbers of faults apart from those of the rest.
const FAULTS: u64 = 0x6661_756c_7473;

/// What a random specimen may look like; ranges are `[low, high]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LookSettings {
    /// Full width at half maximum of the lines, px.
    pub line_width_px: [f64; 2],
    /// Depth of the lines relative to the background.
    pub line_contrast: [f64; 2],
    /// Chance that a line is weak or absent in one of the views.
    pub one_sided: f64,
    /// Chance that all lines are bright instead of dark.
    pub bright: f64,
    /// Mean number of families of planar boundaries.
    pub boundary_families: f64,
    /// Mean number of families of inclined planar faults with fringes.
    pub faults: f64,
    /// Mean number of stacks of lamellae.
    pub lamellae: f64,
    /// Mean number of interfaces full of strokes too dense to trace.
    pub hair: f64,
    /// Mean number of families of slip traces.
    pub slip_traces: f64,
    /// Mean number of specks of dirt for an image of 512 x 512 px.
    pub debris: f64,
    /// Strength of gradients, bend contours and fringes; 1 is lively.
    pub background: f64,
}

impl Default for LookSettings {
    fn default() -> Self {
        Self {
            line_width_px: [2.0, 9.0],
            line_contrast: [0.06, 0.6],
            one_sided: 0.12,
            bright: 0.15,
            boundary_families: 0.6,
            faults: 0.0,
            lamellae: 0.25,
            hair: 0.2,
            slip_traces: 0.5,
            debris: 12.0,
            background: 1.0,
        }
    }
}

impl LookSettings {
    /// Checks every number.
    ///
    /// # Errors
    /// [`SimulateError::Value`] with the name of the first that is not possible.
    pub fn validate(&self) -> Result<(), SimulateError> {
        check_range("look.line_width_px", self.line_width_px, [0.5, 100.0])?;
        check_range("look.line_contrast", self.line_contrast, [1e-3, 1.0])?;
        check_value("look.one_sided", self.one_sided, [0.0, 1.0])?;
        check_value("look.bright", self.bright, [0.0, 1.0])?;
        check_value("look.boundary_families", self.boundary_families, [0.0, 20.0])?;
        check_value("look.faults", self.faults, [0.0, 20.0])?;
        check_value("look.lamellae", self.lamellae, [0.0, 20.0])?;
        check_value("look.hair", self.hair, [0.0, 20.0])?;
        check_value("look.slip_traces", self.slip_traces, [0.0, 100.0])?;
        check_value("look.debris", self.debris, [0.0, 10_000.0])?;
        check_value("look.background", self.background, [0.0, 4.0])
    }
}

/// A foil with a look: everything both views share.
#[derive(Clone, Debug)]
pub struct Specimen {
    lines: Vec<Line>,
    background: Background,
    lamellae: Vec<Lamella>,
    hair: Vec<Hair>,
    boundaries: Vec<Boundary>,
    faults: Vec<Fault>,
    traces: Vec<SlipTrace>,
    debris: Vec<Debris>,
}

/// One view of a specimen.
#[derive(Clone, Debug)]
pub struct View {
    /// Intensity `[row, column]`, noise-free, about 1 on the background.
    pub image: Array2<f32>,
    /// Each line as it was drawn, in the order of the curves.
    pub lines: Vec<DrawnLine>,
}

impl Specimen {
    /// Gives curves (px at scale 1, origin at the foil's centre) in a foil of this size and thickness a look.
    ///
    /// `walls` are boundaries that are in the foil and end lines; random ones come on top.
    pub fn new(
        curves: &[Vec<Point3>],
        walls: &[HalfSpace],
        extent_px: f64,
        thickness_px: f64,
        look: &LookSettings,
        seed: u64,
    ) -> Self {
        let mut rng = Pcg64::seed_from_u64(seed);
        let rng = &mut rng;
        let area = (extent_px / 512.0).powi(2);
        let families = count(rng, look.boundary_families);
        let mut boundaries = boundaries::on_planes(rng, walls, extent_px, thickness_px);
        boundaries.extend((0..families).flat_map(|_| boundaries::family(rng, extent_px, thickness_px)));
        let lamellae =
            (0..count(rng, look.lamellae)).flat_map(|_| lamellae::stack(rng, extent_px, thickness_px)).collect();
        let hair = (0..count(rng, look.hair)).map(|_| Hair::random(rng, extent_px)).collect();
        let traces =
            (0..count(rng, look.slip_traces)).flat_map(|_| SlipTrace::family(rng, extent_px, thickness_px)).collect();
        let debris =
            (0..count(rng, look.debris * area)).map(|_| Debris::random(rng, extent_px, thickness_px)).collect();
        let background = Background::random(rng, extent_px, look.background);
        let style = lines::Style::random(rng, look);
        let lines = curves.iter().map(|curve| Line::random(rng, curve.clone(), &style, look)).collect();
        // Numbers of their own: a foil with faults is the foil without them, and they on top.
        let rng = &mut Pcg64::seed_from_u64(seed ^ FAULTS);
        let faults = (0..count(rng, look.faults)).flat_map(|_| Fault::family(rng, extent_px, thickness_px)).collect();
        Self { lines, background, lamellae, hair, boundaries, faults, traces, debris }
    }

    /// Paints the specimen as seen by a camera; `index` is the view's number (lines and background differ between
    /// views, as in a microscope).
    pub fn view(&self, camera: &Camera, index: usize) -> View {
        let mut image = self.background.paint(camera, index);
        for lamella in &self.lamellae {
            lamella.paint(camera, index, &mut image);
        }
        for boundary in &self.boundaries {
            boundary.paint(camera, index, &mut image);
        }
        for fault in &self.faults {
            fault.paint(camera, index, &mut image);
        }
        for hair in &self.hair {
            hair.paint(camera, &mut image);
        }
        for trace in &self.traces {
            trace.paint(camera, &mut image);
        }
        let lines = self.lines.iter().map(|line| line.paint(camera, index, &mut image)).collect();
        for speck in &self.debris {
            speck.paint(camera, &mut image);
        }
        image.mapv_inplace(|value| value.max(0.0));
        View { image, lines }
    }
}

/// A random count with this mean (geometric mixture: most images have few, some have many).
fn count(rng: &mut Pcg64, mean: f64) -> usize {
    let uniform: f64 = rng.random_range(0.0..1.0);
    (-(1.0 - uniform).ln() * mean).round() as usize
}

/// A number from a range, uniform in its logarithm.
fn log_uniform(rng: &mut Pcg64, [low, high]: [f64; 2]) -> f64 {
    if low < high { rng.random_range(low.ln()..high.ln()).exp() } else { low }
}

/// True with this chance.
fn chance(rng: &mut Pcg64, probability: f64) -> bool {
    rng.random_range(0.0..1.0) < probability
}

/// A different number in `[-1, 1]` for each view, the same for each call.
fn per_view(seed: u64, index: usize) -> f64 {
    Pcg64::seed_from_u64(seed ^ (index as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15)).random_range(-1.0..1.0)
}

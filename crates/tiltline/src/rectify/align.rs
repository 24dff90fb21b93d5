//! How two whole images lie on each other, roughly: the turn, magnification and shift at which their band-passed pictures
//! correlate best.
//!
//! It needs no point that could be told from others, so it finds noisy images of few lines too, where no feature repeats.

use ndarray::Array2;
use rayon::prelude::*;
use rustfft::num_complex::Complex32;

use super::correlation::{Correlator, Workspace};
use super::texture::Texture;
use crate::geometry::{Point2, Similarity2, Vector2};

/// The images are averaged down to at most so many px a side.
const LARGEST_PX: usize = 180;
/// Side of the window of the transform: shifts up to the rest are seen without wrapping around.
const WINDOW: usize = 256;
/// Turns and magnifications that are tried about each candidate, on both sides: steps and their number.
const TURN_STEP_DEG: f64 = 1.5;
const TURNS: i32 = 4;
const SCALE_STEP: f64 = 0.02;
const SCALES: i32 = 1;

/// The similarity that takes left to right input px, and how far its correlation stands out.
#[derive(Clone, Copy, Debug)]
pub struct Alignment {
    /// Right input px from left ones.
    pub right_from_left: Similarity2,
    /// Highest correlation over the root mean square of the rest.
    pub contrast: f64,
}

/// Finds the alignment of two images; besides small turns and changes of magnification, those of the `candidates` are tried.
pub fn align(images: &[Array2<f32>; 2], candidates: &[Similarity2]) -> Option<Alignment> {
    let side = images.iter().flat_map(|image| [image.nrows(), image.ncols()]).max()?;
    let step = side.div_ceil(LARGEST_PX);
    let textures = images.each_ref().map(|image| Texture::of(image, step));
    let correlator = Correlator::new(WINDOW);
    let mut poses: Vec<(f64, f64)> = Vec::new();
    for turn in -TURNS..=TURNS {
        for scale in -SCALES..=SCALES {
            poses.push((f64::from(turn) * TURN_STEP_DEG.to_radians(), 1.0 + f64::from(scale) * SCALE_STEP));
        }
    }
    poses.extend(candidates.iter().map(|candidate| (candidate.isometry.rotation.angle(), candidate.scaling())));
    let found: Vec<(f64, Similarity2)> = poses
        .par_iter()
        .map_init(|| correlator.workspace(), |workspace, pose| at_pose(&textures, *pose, &correlator, workspace))
        .collect();
    // The first of equals, so that the result does not depend on the threads.
    let best = found.into_iter().reduce(|best, next| if next.0 > best.0 { next } else { best })?;
    (best.0 > 0.0).then_some(Alignment { contrast: best.0, right_from_left: best.1 })
}

/// The best shift at a turn and magnification.
fn at_pose(
    textures: &[Texture; 2],
    (turn, scale): (f64, f64),
    correlator: &Correlator,
    workspace: &mut Workspace,
) -> (f64, Similarity2) {
    let [left, right] = textures;
    let shape = left.shape();
    let middle = |[height, width]: [usize; 2]| Point2::new(0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0));
    let pose = Similarity2::new(Vector2::zeros(), turn, scale);
    let shift = middle(right.shape()) - pose * middle(shape);
    let here_from_there = Similarity2::new(shift, turn, scale);
    let warped = right.warped(&here_from_there, shape);
    workspace.window.fill(Complex32::default());
    for ((row, column), value) in left.values.indexed_iter() {
        workspace.window[row * WINDOW + column] = Complex32::new(*value, warped.values[[row, column]]);
    }
    correlator.correlate(workspace);
    let (mut best, mut squares) = ((0.0_f32, 0), 0.0_f64);
    for (index, value) in workspace.window.iter().enumerate() {
        squares += f64::from(value.re * value.re);
        if value.re > best.0 {
            best = (value.re, index);
        }
    }
    let signed = |index: usize| {
        let index = index as f64;
        if index >= 0.5 * WINDOW as f64 { index - WINDOW as f64 } else { index }
    };
    let found = Vector2::new(signed(best.1 % WINDOW), signed(best.1 / WINDOW));
    let noise = (squares / (WINDOW * WINDOW) as f64).sqrt().max(f64::MIN_POSITIVE);
    // Texture px to input px, both of the same step.
    let at = |point: Point2| right.to_input(&(here_from_there * (left.from_input(&point) + found)));
    let origin = at(Point2::origin());
    (f64::from(best.0) / noise, Similarity2::new(origin.coords, turn, scale))
}

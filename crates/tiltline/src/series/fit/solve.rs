//! One step of the joint least squares of curves and poses (Gauss-Newton; curves are eliminated by their Schur complement).
//!
//! Observations are offsets from projected points to lines, across the projected curve. Each involves the four control points
//! about it and the five numbers of its view, so that the curves' own equations are small and independent of each other given
//! the poses: `S = H_gg - sum H_cg' H_cc^-1 H_cg` is all that couples them.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;

use super::spline::Weights;
use crate::geometry::Vector3;

/// Numbers of a view: shift in x and y (px), turn (radians), log of the magnification, tilt (radians).
pub(super) const PER_VIEW: usize = 5;
/// Keeps equations of controls that nothing observes soluble, 1/px^2.
const DAMPING: f64 = 1e-6;

/// One offset that should be zero.
#[derive(Clone, Debug)]
pub(super) struct Observation {
    /// The view, by its place among those of the fit.
    pub view: usize,
    /// The control points about the place on the curve, and their shares in it.
    pub weights: Weights,
    /// Change of the image's offset per px of the point in the foil.
    pub per_point: Vector3,
    /// Change of the offset per unit of the view's numbers.
    pub per_view: [f64; PER_VIEW],
    /// From the projected point to the line, px.
    pub offset_px: f64,
    /// 1 / variance, 1/px^2.
    pub weight: f64,
}

/// Equations of one curve.
pub(super) struct CurveProblem {
    /// Two directions in which each control point may move.
    pub normals: Vec<[Vector3; 2]>,
    /// Cost of bending over the controls.
    pub bending: DMatrix<f64>,
    /// Where the control points are.
    pub controls: Vec<Vector3>,
    /// What is seen of it.
    pub observations: Vec<Observation>,
}

/// Prior of the views' numbers: what is added to their equations.
pub(super) struct Prior {
    /// Matrix.
    pub matrix: DMatrix<f64>,
    /// Right-hand side.
    pub right: DVector<f64>,
}

/// The step, and what is known afterwards.
pub(super) struct Step {
    /// Change of each curve's control points.
    pub controls: Vec<Vec<Vector3>>,
    /// Change of the views' numbers.
    pub views: Vec<[f64; PER_VIEW]>,
    curves: Vec<Option<Eliminated>>,
    /// Inverse of the equations of the views after elimination: their covariance.
    covariance: DMatrix<f64>,
    normals: Vec<Vec<[Vector3; 2]>>,
}

/// A curve eliminated from the equations.
struct Eliminated {
    factor: Cholesky<f64, Dyn>,
    /// `H_cc^-1 H_cg`.
    gain: DMatrix<f64>,
    /// `H_cc^-1 b_c`.
    own: DVector<f64>,
    /// `H_cg' H_cc^-1 H_cg` and `H_cg' H_cc^-1 b_c`.
    reduced: (DMatrix<f64>, DVector<f64>),
    /// `H_gg` and `b_g` of this curve's observations.
    direct: (DMatrix<f64>, DVector<f64>),
}

/// Solves for the step; `None` where the equations of the views have no solution.
pub(super) fn solve(curves: Vec<CurveProblem>, prior: &Prior) -> Option<Step> {
    let size = prior.right.len();
    let eliminated: Vec<Option<Eliminated>> = curves.par_iter().map(|curve| eliminate(curve, size)).collect();
    let (mut matrix, mut right) = (prior.matrix.clone(), prior.right.clone());
    // In the order of the curves, so that the sum does not depend on the threads.
    for curve in eliminated.iter().flatten() {
        matrix += &curve.direct.0 - &curve.reduced.0;
        right += &curve.direct.1 - &curve.reduced.1;
    }
    let factor = matrix.cholesky()?;
    let views = factor.solve(&right);
    let covariance = factor.inverse();
    let controls = curves.iter().zip(&eliminated).map(|(curve, eliminated)| match eliminated {
        Some(eliminated) => moved(curve, &(&eliminated.own - &eliminated.gain * &views)),
        None => vec![Vector3::zeros(); curve.controls.len()],
    });
    Some(Step {
        controls: controls.collect(),
        views: views.as_slice().chunks_exact(PER_VIEW).map(|chunk| [0, 1, 2, 3, 4].map(|at| chunk[at])).collect(),
        covariance,
        normals: curves.iter().map(|curve| curve.normals.clone()).collect(),
        curves: eliminated,
    })
}

fn moved(curve: &CurveProblem, step: &DVector<f64>) -> Vec<Vector3> {
    curve.normals.iter().enumerate().map(|(at, [a, b])| a * step[2 * at] + b * step[2 * at + 1]).collect()
}

fn eliminate(curve: &CurveProblem, views: usize) -> Option<Eliminated> {
    let count = curve.controls.len();
    let mut own = DMatrix::<f64>::zeros(2 * count, 2 * count);
    let mut right = DVector::<f64>::zeros(2 * count);
    let mut cross = DMatrix::<f64>::zeros(2 * count, views);
    let mut direct = (DMatrix::<f64>::zeros(views, views), DVector::<f64>::zeros(views));
    for a in 0..count {
        for b in 0..count {
            let stiff = curve.bending[(a, b)];
            if stiff == 0.0 {
                continue;
            }
            for i in 0..2 {
                right[2 * a + i] -= stiff * curve.normals[a][i].dot(&curve.controls[b]);
                for j in 0..2 {
                    own[(2 * a + i, 2 * b + j)] += stiff * curve.normals[a][i].dot(&curve.normals[b][j]);
                }
            }
        }
    }
    for at in 0..2 * count {
        own[(at, at)] += DAMPING;
    }
    for seen in &curve.observations {
        let mut row = [(0, 0.0); 8];
        for k in 0..4 {
            let control = seen.weights.index[k];
            for i in 0..2 {
                let share = seen.weights.value[k] * seen.per_point.dot(&curve.normals[control][i]);
                row[2 * k + i] = (2 * control + i, share);
            }
        }
        let first = PER_VIEW * seen.view;
        for (a, x) in row {
            right[a] += seen.weight * x * seen.offset_px;
            for (b, y) in row {
                own[(a, b)] += seen.weight * x * y;
            }
            for (at, y) in seen.per_view.iter().enumerate() {
                cross[(a, first + at)] += seen.weight * x * y;
            }
        }
        for (a, x) in seen.per_view.iter().enumerate() {
            direct.1[first + a] += seen.weight * x * seen.offset_px;
            for (b, y) in seen.per_view.iter().enumerate() {
                direct.0[(first + a, first + b)] += seen.weight * x * y;
            }
        }
    }
    let factor = own.cholesky()?;
    let gain = factor.solve(&cross);
    let step = factor.solve(&right);
    let reduced = (cross.transpose() * &gain, cross.transpose() * &step);
    Some(Eliminated { factor, gain, own: step, reduced, direct })
}

impl Step {
    /// Variance of a curve's point along a direction, px^2: its own and that of the poses. `None` where nothing was solved.
    pub fn variance(&self, curve: usize, weights: &Weights, direction: &Vector3) -> Option<f64> {
        let eliminated = self.curves[curve].as_ref()?;
        let mut row = DVector::<f64>::zeros(eliminated.own.len());
        for k in 0..4 {
            let control = weights.index[k];
            for i in 0..2 {
                row[2 * control + i] += weights.value[k] * direction.dot(&self.normals[curve][control][i]);
            }
        }
        let own = row.dot(&eliminated.factor.solve(&row));
        let through = eliminated.gain.transpose() * row;
        Some(own + through.dot(&(&self.covariance * &through)))
    }

    /// Variance of a number of a view.
    pub fn view_variance(&self, view: usize, number: usize) -> f64 {
        let at = PER_VIEW * view + number;
        self.covariance[(at, at)]
    }
}

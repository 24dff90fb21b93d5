//! Curves as uniform cubic B-splines (de Boor 1978), open or closed, over arc length in px.

use nalgebra::{DMatrix, DVector};

use crate::geometry::{Point3, Vector3};

/// Distance of knots that is aimed at, px of arc length: lines bend over tens of px.
const KNOTS_PX: f64 = 6.0;
/// Length in the projection of a unit tangent up to which a curve runs along the beam: depth changes three times as fast as the place.
const ALONG_BEAM: f64 = 0.3;
/// Fewest intervals.
const LEAST_INTERVALS: usize = 2;

/// The functions of a spline.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Basis {
    intervals: usize,
    /// Length of an interval, px.
    step: f64,
    closed: bool,
}

/// The four functions that are not zero at a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Weights {
    /// Index of the control point of each.
    pub index: [usize; 4],
    /// Values.
    pub value: [f64; 4],
    /// First derivatives, 1/px.
    pub first: [f64; 4],
    /// Second derivatives, 1/px^2.
    pub second: [f64; 4],
}

impl Basis {
    /// Functions over a curve of some length; a closed one repeats itself after it.
    pub fn new(length_px: f64, closed: bool) -> Self {
        let least = if closed { 4 } else { LEAST_INTERVALS };
        let intervals = ((length_px / KNOTS_PX).round() as usize).max(least);
        Self { intervals, step: (length_px / intervals as f64).max(1e-6), closed }
    }

    /// Number of control points.
    pub fn controls(&self) -> usize {
        if self.closed { self.intervals } else { self.intervals + 3 }
    }

    /// Place at which a control point weighs most, px.
    pub fn place(&self, control: usize) -> f64 {
        let at = control as f64 - 1.0;
        if self.closed {
            return at.rem_euclid(self.intervals as f64) * self.step;
        }
        (at * self.step).clamp(0.0, self.intervals as f64 * self.step)
    }

    /// The functions at a place, px.
    pub fn at(&self, place_px: f64) -> Weights {
        let scaled = place_px / self.step;
        let scaled = if self.closed { scaled.rem_euclid(self.intervals as f64) } else { scaled };
        let interval = (scaled.floor().max(0.0) as usize).min(self.intervals - 1);
        let t = scaled - interval as f64;
        let (u, h) = (1.0 - t, self.step);
        let index = [0, 1, 2, 3].map(|k| if self.closed { (interval + k) % self.intervals } else { interval + k });
        Weights {
            index,
            value: [
                u.powi(3) / 6.0,
                (3.0 * t.powi(3) - 6.0 * t * t + 4.0) / 6.0,
                (3.0 * u.powi(3) - 6.0 * u * u + 4.0) / 6.0,
                t.powi(3) / 6.0,
            ],
            first: [-0.5 * u * u, 1.5 * t * t - 2.0 * t, -1.5 * u * u + 2.0 * u, 0.5 * t * t].map(|value| value / h),
            second: [u, 3.0 * t - 2.0, 3.0 * u - 2.0, t].map(|value| value / (h * h)),
        }
    }
}

/// A curve in the foil as a spline.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Spline {
    /// Its functions.
    pub basis: Basis,
    /// Control points.
    pub controls: Vec<Vector3>,
}

impl Spline {
    /// The smooth curve nearest to points at given places; each coordinate of a point has a weight (1/px^2), and bending a cost
    /// per px of length of `|x''|^2 / roughness`.
    pub fn through(basis: Basis, places: &[f64], points: &[Point3], weights: &[Vector3], roughness: f64) -> Self {
        let count = basis.controls();
        let mut controls = vec![Vector3::zeros(); count];
        let bending = bending(&basis, places, roughness);
        for axis in 0..3 {
            let mut matrix = bending.clone();
            let mut right = DVector::zeros(count);
            for ((place, point), weight) in places.iter().zip(points).zip(weights) {
                let at = basis.at(*place);
                for a in 0..4 {
                    right[at.index[a]] += weight[axis] * at.value[a] * point[axis];
                    for b in 0..4 {
                        matrix[(at.index[a], at.index[b])] += weight[axis] * at.value[a] * at.value[b];
                    }
                }
            }
            // Controls beyond the ends are held by bending alone; a trace of damping keeps the matrix positive.
            for at in 0..count {
                matrix[(at, at)] += 1e-9;
            }
            if let Some(factor) = matrix.cholesky() {
                let solution = factor.solve(&right);
                for (control, value) in controls.iter_mut().zip(solution.iter()) {
                    control[axis] = *value;
                }
            }
        }
        Self { basis, controls }
    }

    /// Point, derivative and second derivative at a place.
    pub fn at(&self, weights: &Weights) -> [Vector3; 3] {
        [weights.value, weights.first, weights.second]
            .map(|shares| (0..4).fold(Vector3::zeros(), |sum, k| sum + self.controls[weights.index[k]] * shares[k]))
    }

    /// The two directions in which each control point may move: across the curve as the beam shows it, and along the beam. A step across
    /// the curve in space would move points along the image wherever its depth rises, and wrong depths rise steeply: curves would shrink.
    /// Only where a curve itself runs along the beam are both across it.
    pub fn normals(&self) -> Vec<[Vector3; 2]> {
        let across = |control: usize| {
            let [_, first, _] = self.at(&self.basis.at(self.basis.place(control)));
            let tangent = first.try_normalize(1e-12).unwrap_or_else(Vector3::y);
            if tangent.xy().norm() > ALONG_BEAM {
                return [Vector3::new(-tangent.y, tangent.x, 0.0).normalize(), Vector3::z()];
            }
            let deep = (Vector3::x() - tangent * tangent.x).normalize();
            [tangent.cross(&deep), deep]
        };
        (0..self.basis.controls()).map(across).collect()
    }
}

/// The cost of bending as a matrix over the controls: the sum over the places' lengths of `|x''|^2 / roughness`.
pub(super) fn bending(basis: &Basis, places: &[f64], roughness: f64) -> DMatrix<f64> {
    let count = basis.controls();
    let mut matrix = DMatrix::zeros(count, count);
    let step = (places.last().copied().unwrap_or(0.0) - places.first().copied().unwrap_or(0.0))
        / places.len().saturating_sub(1).max(1) as f64;
    for place in places {
        let at = basis.at(*place);
        for a in 0..4 {
            for b in 0..4 {
                matrix[(at.index[a], at.index[b])] += step / roughness * at.second[a] * at.second[b];
            }
        }
    }
    matrix
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;

    #[test]
    fn functions_sum_to_one_and_their_derivatives_to_nothing() {
        for closed in [false, true] {
            let basis = Basis::new(50.0, closed);
            for place in [0.0, 7.3, 25.0, 49.9, 50.0] {
                let at = basis.at(place);
                assert_abs_diff_eq!(at.value.iter().sum::<f64>(), 1.0, epsilon = 1e-12);
                assert_abs_diff_eq!(at.first.iter().sum::<f64>(), 0.0, epsilon = 1e-12);
                assert_abs_diff_eq!(at.second.iter().sum::<f64>(), 0.0, epsilon = 1e-12);
                assert!(at.index.iter().all(|index| *index < basis.controls()));
            }
        }
    }

    /// A control point of a closed curve weighs most at its own place, the first one at the last knot.
    #[test]
    fn places_of_controls_are_where_they_weigh_most() {
        for closed in [false, true] {
            let basis = Basis::new(60.0, closed);
            for control in if closed { 0..basis.controls() } else { 1..basis.controls() - 1 } {
                let at = basis.at(basis.place(control));
                let share: f64 = (0..4).filter(|k| at.index[*k] == control).map(|k| at.value[k]).sum();
                assert_abs_diff_eq!(share, 2.0 / 3.0, epsilon = 1e-9);
            }
        }
    }

    #[test]
    fn a_smooth_curve_is_met_with_its_direction() {
        let places: Vec<f64> = (0..=80).map(f64::from).collect();
        let curve = |s: f64| Point3::new(s, 10.0 * (s / 25.0).sin(), 0.002 * s * s);
        let points: Vec<Point3> = places.iter().map(|s| curve(*s)).collect();
        let weights = vec![Vector3::new(100.0, 100.0, 100.0); points.len()];
        let spline = Spline::through(Basis::new(80.0, false), &places, &points, &weights, 1e-3);
        for s in [0.0, 11.0, 40.5, 80.0] {
            let [point, first, _] = spline.at(&spline.basis.at(s));
            assert!((point - curve(s).coords).norm() < 0.05, "{s}: {point}");
            assert_abs_diff_eq!(first.x, 1.0, epsilon = 0.02);
        }
        for (control, [across, deep]) in spline.normals().into_iter().enumerate() {
            let [_, along, _] = spline.at(&spline.basis.at(spline.basis.place(control)));
            assert_abs_diff_eq!(across.dot(&along), 0.0, epsilon = 1e-12);
            assert_abs_diff_eq!(across.norm(), 1.0, epsilon = 1e-12);
            assert_abs_diff_eq!(across.z, 0.0, epsilon = 1e-12);
            assert_abs_diff_eq!(deep.z, 1.0, epsilon = 1e-12);
        }
        // Along the beam, nearly: both across it.
        let deep: Vec<Point3> = places.iter().map(|s| Point3::new(0.1 * s, 0.05 * s, *s)).collect();
        let spline = Spline::through(Basis::new(80.0, false), &places, &deep, &weights, 1e-3);
        let along = Vector3::new(0.1, 0.05, 1.0);
        for normals in spline.normals() {
            normals.iter().for_each(|normal| assert_abs_diff_eq!(normal.dot(&along), 0.0, epsilon = 1e-6));
            assert_abs_diff_eq!(normals[0].dot(&normals[1]), 0.0, epsilon = 1e-12);
        }
    }
}

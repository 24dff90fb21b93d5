//! From a tomogram to curves: threshold, thinning, graph, sub-voxel centres, smoothing.
//!
//! What the traced micrograph is to `trace`, the volume is here. Below the missing wedge lines are drawn out along z into ribbons,
//! and their skeleton is only as good as the ribbon's middle.

mod graph;
pub mod thin;

use ndarray::Array3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Geometry;
use crate::geometry::{Point3, Vector3};
use thin::thin;

/// Settings of the way from a volume to curves; lengths in voxels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CurveSettings {
    /// Components of the mask with fewer voxels are dropped.
    pub min_voxels: usize,
    /// Shortest branch that ends freely and is no spur.
    pub spur: f64,
    /// Shortest curve.
    pub min_length: f64,
    /// Reach across a curve of the values its centre is taken from.
    pub reach: f64,
    /// Standard deviation of the smoothing along it.
    pub smoothing: f64,
}

impl Default for CurveSettings {
    fn default() -> Self {
        Self { min_voxels: 60, spur: 10.0, min_length: 15.0, reach: 3.0, smoothing: 2.0 }
    }
}

/// A curve in a volume.
#[derive(Clone, Debug, PartialEq)]
pub struct VolumeCurve {
    /// (X, Y, Z), about one voxel apart: X and Z from the tilt axis, Y the row.
    pub points: Vec<Point3>,
    /// Whether the last point joins the first.
    pub closed: bool,
}

/// Voxels of at least `threshold` in components that are large enough.
pub fn mask(volume: &Array3<f32>, threshold: f32, min_voxels: usize) -> Array3<bool> {
    let mut mask = volume.mapv(|value| value >= threshold);
    let mut seen = Array3::from_elem(mask.dim(), false);
    let starts: Vec<(usize, usize, usize)> = mask.indexed_iter().filter(|(_, set)| **set).map(|(at, _)| at).collect();
    for start in starts {
        if seen[start] {
            continue;
        }
        seen[start] = true;
        let mut members = vec![start];
        let mut next = 0;
        while next < members.len() {
            let (z, y, x) = members[next];
            next += 1;
            for place in 0..27_usize {
                let step = |from: usize, digit: usize| (from + digit).wrapping_sub(1);
                let at = (step(z, place / 9), step(y, place / 3 % 3), step(x, place % 3));
                if mask.get(at) == Some(&true) && !seen[at] {
                    seen[at] = true;
                    members.push(at);
                }
            }
        }
        if members.len() < min_voxels {
            members.into_iter().for_each(|at| mask[at] = false);
        }
    }
    mask
}

/// The curves of a volume `[z, y, x]` at a threshold.
pub fn curves(volume: &Array3<f32>, geometry: &Geometry, threshold: f32, settings: &CurveSettings) -> Vec<VolumeCurve> {
    let skeleton = thin(&mask(volume, threshold, settings.min_voxels));
    let paths = graph::join_straight(graph::prune(graph::paths(&skeleton), settings.spur));
    let origin = Vector3::new(geometry.axis_column, 0.0, geometry.middle_layer());
    paths
        .into_par_iter()
        .filter(|path| path.points.len() >= 3 && path.length() >= settings.min_length)
        .map(|path| {
            let mut points = smoothed(&path.points, path.closed, settings.smoothing);
            for _ in 0..2 {
                points = centred(volume, &points, path.closed, threshold, settings.reach);
                points = smoothed(&points, path.closed, settings.smoothing);
            }
            points = resampled(&points, path.closed);
            points.iter_mut().for_each(|point| *point -= origin);
            VolumeCurve { points, closed: path.closed }
        })
        .collect()
}

/// Unit tangent at a point, over its neighbours on both sides.
fn tangent(points: &[Point3], closed: bool, index: usize) -> Vector3 {
    let count = points.len();
    let reach = 2.min(count - 1);
    let (before, after) = if closed {
        ((index + count - reach) % count, (index + reach) % count)
    } else {
        (index.saturating_sub(reach), (index + reach).min(count - 1))
    };
    (points[after] - points[before]).try_normalize(1e-9).unwrap_or_else(Vector3::x)
}

/// Moves each point to the centre of the values above half of the threshold around it, across its curve.
fn centred(volume: &Array3<f32>, points: &[Point3], closed: bool, threshold: f32, reach: f64) -> Vec<Point3> {
    let steps = reach.ceil() as i32;
    (0..points.len())
        .map(|index| {
            let along = tangent(points, closed, index);
            let helper = if along.z.abs() < 0.8 { Vector3::z() } else { Vector3::x() };
            let u = along.cross(&helper).normalize();
            let v = along.cross(&u);
            let (mut sum, mut weight) = (Vector3::zeros(), 0.0);
            for i in -steps..=steps {
                for j in -steps..=steps {
                    let offset = u * f64::from(i) + v * f64::from(j);
                    if offset.norm() <= reach {
                        let value =
                            f64::from((interpolated(volume, &(points[index] + offset)) - 0.5 * threshold).max(0.0));
                        sum += offset * value;
                        weight += value;
                    }
                }
            }
            points[index] + sum / f64::max(weight, 1e-12)
        })
        .collect()
}

/// Trilinear interpolation at (x, y, z); 0 outside.
fn interpolated(volume: &Array3<f32>, point: &Point3) -> f32 {
    let floor = point.map(f64::floor);
    let [u, v, w] = [0, 1, 2].map(|axis| (point[axis] - floor[axis]) as f32);
    let mut value = 0.0;
    for corner in 0..8_i64 {
        let (i, j, k) = (corner & 1, corner >> 1 & 1, corner >> 2);
        let share = |fraction: f32, side: i64| if side == 1 { fraction } else { 1.0 - fraction };
        let at = [(floor.z as i64 + k), (floor.y as i64 + j), (floor.x as i64 + i)];
        if let [Ok(z), Ok(y), Ok(x)] = at.map(usize::try_from) {
            value += volume.get([z, y, x]).copied().unwrap_or(0.0) * share(u, i) * share(v, j) * share(w, k);
        }
    }
    value
}

/// Gaussian smoothing along the index; open curves are continued by their point reflection, so that ends and straight lines stay.
fn smoothed(points: &[Point3], closed: bool, sigma: f64) -> Vec<Point3> {
    let count = points.len() as isize;
    let at = |index: isize| -> Vector3 {
        if closed {
            return points[index.rem_euclid(count) as usize].coords;
        }
        let last = count - 1;
        if index < 0 {
            2.0 * points[0].coords - points[(-index).min(last) as usize].coords
        } else if index > last {
            2.0 * points[last as usize].coords - points[(2 * last - index).max(0) as usize].coords
        } else {
            points[index as usize].coords
        }
    };
    let half = crate::filter::gaussian_half_kernel(sigma);
    (0..count)
        .map(|index| {
            let mut sum = at(index) * f64::from(half[0]);
            for (offset, tap) in half.iter().enumerate().skip(1) {
                sum += (at(index - offset as isize) + at(index + offset as isize)) * f64::from(*tap);
            }
            Point3::from(sum)
        })
        .collect()
}

/// Points one voxel apart along the curve.
fn resampled(points: &[Point3], closed: bool) -> Vec<Point3> {
    let mut all = points.to_vec();
    if closed {
        all.push(points[0]);
    }
    let length: f64 = all.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    let pieces = (length.round() as usize).max(2);
    let step = length / pieces as f64;
    let mut out = vec![all[0]];
    let mut walked = 0.0;
    for pair in all.windows(2) {
        let piece = (pair[1] - pair[0]).norm();
        while out.len() < pieces && out.len() as f64 * step <= walked + piece {
            let share = (out.len() as f64 * step - walked) / piece.max(1e-12);
            out.push(pair[0] + (pair[1] - pair[0]) * share);
        }
        walked += piece;
    }
    if !closed {
        out.push(all[all.len() - 1]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A helix and a ring drawn with a Gaussian profile, away from the grid's axes.
    #[test]
    fn drawn_curves_are_found_to_a_third_of_a_voxel() {
        let helix: Vec<Point3> = (0..400)
            .map(|i| {
                let t = 0.01 * f64::from(i);
                Point3::new(20.0 + 9.0 * t.cos(), 8.3 + 12.0 * t, 20.0 + 9.0 * t.sin())
            })
            .collect();
        let ring: Vec<Point3> = (0..200)
            .map(|i| {
                let (sin, cos) = (f64::from(i) * std::f64::consts::PI / 100.0).sin_cos();
                Point3::new(52.3 + 12.0 * cos, 30.0 + 12.0 * sin, 17.6 + 4.0 * cos)
            })
            .collect();
        let drawn = [helix, ring];
        let distance = |point: &Point3, curves: &[Vec<Point3>]| {
            curves.iter().flatten().map(|other| (other - point).norm()).fold(f64::INFINITY, f64::min)
        };
        let volume = Array3::from_shape_fn((40, 64, 72), |(z, y, x)| {
            let off = distance(&Point3::new(x as f64, y as f64, z as f64), &drawn);
            (-0.5 * (off / 1.6).powi(2)).exp() as f32
        });
        let geometry = Geometry::centred(vec![0.0, 1.0], 72, 40);
        let found = curves(&volume, &geometry, 0.4, &CurveSettings::default());
        assert_eq!(found.len(), 2);
        assert_eq!(found.iter().filter(|curve| curve.closed).count(), 1);
        let origin = Vector3::new(geometry.axis_column, 0.0, geometry.middle_layer());
        let mut errors: Vec<f64> =
            found.iter().flat_map(|curve| &curve.points).map(|point| distance(&(point + origin), &drawn)).collect();
        errors.sort_by(f64::total_cmp);
        // Smoothing over 2 voxels cuts the corner of a radius of 9 by sigma^2 / (2 R) = 0.22 voxel.
        assert!(errors[errors.len() / 2] < 0.33, "{}", errors[errors.len() / 2]);
        assert!(errors[errors.len() * 9 / 10] < 0.8);
        let length: f64 = found.iter().map(|curve| curve.points.len() as f64).sum();
        let expected = 4.0 * 15.0 + 75.4 + 1.5;
        assert!((length / expected - 1.0).abs() < 0.1, "{length} {expected}");
    }

    #[test]
    fn nothing_above_the_threshold_is_no_curve() {
        let volume = Array3::zeros((4, 5, 6));
        let geometry = Geometry::centred(vec![0.0, 1.0], 6, 4);
        assert!(curves(&volume, &geometry, 0.5, &CurveSettings::default()).is_empty());
        let full = Array3::from_elem((4, 5, 6), 1.0);
        assert!(curves(&full, &geometry, 0.5, &CurveSettings::default()).len() <= 1);
    }
}

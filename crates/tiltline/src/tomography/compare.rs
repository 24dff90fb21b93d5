//! Curves of a result beside the tomogram of their series.
//!
//! Neither is the truth. The tomogram is taken at the threshold at which its own curves agree best with the result's, so what is
//! left between them is what no threshold mends. Both are in the frame of the series' alignment, which was refined on the curves: a
//! common offset in depth is taken up by the shifts of the views, and that there is none says nothing.

use ndarray::Array3;
use rstar::RTree;
use rstar::primitives::GeomWithData;
use serde::{Deserialize, Serialize};

use super::Geometry;
use super::curves::{CurveSettings, curves};
use crate::geometry::Point3;

/// Reach of a partner across the beam, px; that along it is the same times the depth that a px of disparity means.
pub const REACH_PX: f64 = 2.0;
/// Shares of the voxels above the threshold that are tried, each twice the one before, beginning with this.
const FIRST_SHARE: f64 = 0.0001;
const SHARES: i32 = 9;
/// Values that a threshold is chosen among are every so many-th voxel.
const STRIDE: usize = 7;

/// Thresholds worth trying, each with the share of the voxels at or above it, from the highest on; none that is not positive.
pub fn thresholds(volume: &Array3<f32>) -> Vec<(f64, f32)> {
    let mut sample: Vec<f32> = volume.iter().copied().step_by(STRIDE).collect();
    sample.sort_unstable_by(|a, b| b.total_cmp(a));
    let at = |step: i32| {
        let share = FIRST_SHARE * 2.0_f64.powi(step);
        Some((share, *sample.get(((sample.len() as f64 * share) as usize).min(sample.len().checked_sub(1)?))?))
    };
    (0..SHARES).filter_map(at).filter(|(_, threshold)| *threshold > 0.0).collect()
}

/// How two sets of curves agree, by length.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// The tomogram's threshold.
    pub threshold: f64,
    /// Share of its voxels at or above that.
    pub share: f64,
    /// Length of the result's curves, px, and the share of it that has a curve of the tomogram within reach.
    pub result: [f64; 2],
    /// Length of the tomogram's curves, px, and the share of it that has a curve of the result within reach.
    pub tomogram: [f64; 2],
    /// Reach across the beam and along it, px.
    pub reach_px: [f64; 2],
    /// Median of z of the tomogram less that of the result, and median distance from it, over what is within reach across the beam, px.
    pub depth_px: Option<[f64; 2]>,
}

impl Comparison {
    /// Harmonic mean of both shares.
    pub fn f_score(&self) -> f64 {
        let [a, b] = [self.result[1], self.tomogram[1]];
        if a + b > 0.0 { 2.0 * a * b / (a + b) } else { 0.0 }
    }
}

/// Compares the curves of a result (px, in the frame of the volume's geometry) with a volume `[z, y, x]`; `along_px` is the reach
/// along the beam. `None` where the volume has nothing bright. Points of the result outside the volume do not count.
pub fn compare(volume: &Array3<f32>, geometry: &Geometry, result: &[Vec<Point3>], along_px: f64) -> Option<Comparison> {
    let (layers, rows, columns) = volume.dim();
    let inside = |point: &Point3| {
        let (x, z) = (point.x + geometry.axis_column, point.z + geometry.middle_layer());
        let within = |value: f64, count: usize| value >= -0.5 && value <= count as f64 - 0.5;
        within(x, columns) && within(point.y, rows) && within(z, layers)
    };
    let runs: Vec<Vec<Point3>> = result
        .iter()
        .flat_map(|curve| curve.split(|point| !inside(point)).filter(|run| run.len() > 1).map(<[Point3]>::to_vec))
        .collect();
    let reach = [REACH_PX, along_px];
    let mut best: Option<Comparison> = None;
    for (share, threshold) in thresholds(volume) {
        let found = curves(volume, geometry, threshold, &CurveSettings::default());
        let lines: Vec<Vec<Point3>> = found.into_iter().map(|curve| curve.points).collect();
        let comparison = Comparison {
            threshold: f64::from(threshold),
            share,
            result: near(&runs, &lines, reach),
            tomogram: near(&lines, &runs, reach),
            reach_px: reach,
            depth_px: depth(&runs, &lines),
        };
        // Where nothing agrees, one at which there is something to look at.
        let worth = |comparison: &Comparison| (comparison.f_score(), comparison.depth_px.is_some());
        if best.as_ref().is_none_or(|best| worth(&comparison) > worth(best)) {
            best = Some(comparison);
        }
    }
    best
}

type Tree = RTree<GeomWithData<[f64; 2], f64>>;

/// Points by (x, y), with their z.
fn tree(curves: &[Vec<Point3>]) -> Tree {
    RTree::bulk_load(curves.iter().flatten().map(|point| GeomWithData::new([point.x, point.y], point.z)).collect())
}

/// Length of curves, and the share of it within reach of others.
fn near(curves: &[Vec<Point3>], others: &[Vec<Point3>], [across, along]: [f64; 2]) -> [f64; 2] {
    let tree = tree(others);
    let has = |point: &Point3| {
        let mut within = tree.locate_within_distance([point.x, point.y], across * across);
        within.any(|other| (other.data - point.z).abs() <= along)
    };
    let (mut length, mut found) = (0.0, 0.0);
    for pair in curves.iter().flat_map(|curve| curve.windows(2)) {
        let step = (pair[1] - pair[0]).norm();
        length += step;
        found += step * pair.iter().filter(|point| has(point)).count() as f64 / 2.0;
    }
    [length, if length > 0.0 { found / length } else { 0.0 }]
}

/// Median of the differences of z, and median distance from it.
fn depth(result: &[Vec<Point3>], tomogram: &[Vec<Point3>]) -> Option<[f64; 2]> {
    let tree = tree(tomogram);
    let off = |point: &Point3| {
        // The nearest in the image, not in depth: that would draw differences towards nothing.
        let nearest = tree.nearest_neighbor([point.x, point.y])?;
        let [x, y] = *nearest.geom();
        ((x - point.x).hypot(y - point.y) <= REACH_PX).then_some(nearest.data - point.z)
    };
    let median = |values: &mut Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
    };
    let mut differences: Vec<f64> = result.iter().flatten().filter_map(off).collect();
    let middle = median(&mut differences)?;
    let spread = median(&mut differences.iter().map(|value| (value - middle).abs()).collect())?;
    Some([middle, spread])
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;

    /// A bright tube along y that rises; a curve in it is found with the right offset, one beside it is not.
    #[test]
    fn a_curve_in_the_bright_tube_agrees_and_one_above_it_does_not() {
        let geometry = Geometry::centred(vec![0.0, 0.1], 64, 40);
        let z = |y: f64| 0.2 * (y - 32.0);
        let volume = Array3::from_shape_fn((40, 64, 64), |(layer, row, column)| {
            let across = column as f64 - geometry.axis_column;
            let along = layer as f64 - geometry.middle_layer() - z(row as f64);
            (-0.5 * (across * across + along * along) / 2.0).exp() as f32
        });
        let line = |off: f64| (4..60).map(|row| Point3::new(0.0, f64::from(row), z(f64::from(row)) + off)).collect();
        let agrees = compare(&volume, &geometry, &[line(0.0)], 3.0).unwrap();
        assert!(agrees.result[1] > 0.95 && agrees.tomogram[1] > 0.8, "{agrees:?}");
        let [off, spread] = agrees.depth_px.unwrap();
        assert!(off.abs() < 0.2 && spread < 0.3, "{agrees:?}");
        let above = compare(&volume, &geometry, &[line(-6.0)], 3.0).unwrap();
        assert_abs_diff_eq!(above.result[1], 0.0);
        // The tomogram's line lies further from the viewer.
        assert!((above.depth_px.unwrap()[0] - 6.0).abs() < 0.3, "{above:?}");
        assert!(compare(&Array3::zeros((4, 4, 4)), &Geometry::centred(vec![0.0, 0.1], 4, 4), &[], 1.0).is_none());
    }
}

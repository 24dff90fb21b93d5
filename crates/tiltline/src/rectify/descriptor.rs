//! Orientation and 128-value descriptor of a keypoint (Lowe 2004, sections 5 and 6), as RootSIFT (Arandjelovic and
//! Zisserman, CVPR 2012): scaled to unit sum and square-rooted, so that dot products compare histograms by Hellinger's
//! kernel.

use std::f32::consts::{PI, TAU};

use super::keypoints::Keypoint;
use super::scale_space::Plane;

/// Values of a descriptor: 4x4 places, 8 directions.
pub const LENGTH: usize = 128;
/// Cells each way.
const CELLS: usize = 4;
/// Directions of a cell's histogram.
const DIRECTIONS: usize = 8;
/// Side of a cell in units of the keypoint's blur.
const CELL_SIGMAS: f32 = 3.0;
/// Directions of the histogram that gives the orientation.
const ORIENTATION_BINS: usize = 36;
/// A second peak this high, relative to the highest, gives a second feature.
const SECOND_PEAK: f32 = 0.8;
/// No value of the normalised descriptor may exceed this: it keeps single strong edges from ruling.
const CLIP: f32 = 0.2;

/// Angle of (x, y) in `[-pi, pi]` without branches, so that loops over it vectorise; within 2e-5 rad.
///
/// The polynomial is the odd minimax approximation of the arctangent on `[0, 1]`.
fn fast_atan2(y: f32, x: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let ratio = ax.min(ay) / ax.max(ay).max(f32::MIN_POSITIVE);
    let r2 = ratio * ratio;
    let poly = 0.052_653_32_f32 - r2 * 0.011_721_2;
    let poly = 0.193_543_46 + r2 * (-0.116_432_87 + r2 * poly);
    let angle = ratio * (0.999_977_26 + r2 * (-0.332_623_47 + r2 * poly));
    let angle = if ay > ax { 0.5 * PI - angle } else { angle };
    let angle = if x < 0.0 { PI - angle } else { angle };
    if y < 0.0 { -angle } else { angle }
}

/// Gradients of one row of a window; kept between rows so that nothing is allocated in the loop.
#[derive(Default)]
struct GradientRow {
    /// Length of the gradient times the weight of its pixel.
    magnitude: Vec<f32>,
    /// Direction in radians clockwise on the screen from image x.
    direction: Vec<f32>,
}

/// A window of pixels about a keypoint, cut at the image's border (gradients need one more pixel), with Gaussian
/// weights about the keypoint.
struct Window<'a> {
    plane: &'a Plane,
    /// First column and row; may lie outside the image.
    left: isize,
    top: isize,
    /// The keypoint less the first column and row.
    x: f32,
    y: f32,
    /// Weights by column and by row: a Gaussian is the product of the two.
    weight_x: Vec<f32>,
    weight_y: Vec<f32>,
}

impl<'a> Window<'a> {
    fn new(plane: &'a Plane, keypoint: &Keypoint, reach: f32, sigma: f32) -> Self {
        let radius = reach.ceil() as isize + 1;
        let (left, top) = (keypoint.column.round() as isize - radius, keypoint.row.round() as isize - radius);
        let (x, y) = (keypoint.column - left as f32, keypoint.row - top as f32);
        let weights =
            |centre: f32| (0..=2 * radius).map(|i| (-0.5 * ((i as f32 - centre) / sigma).powi(2)).exp()).collect();
        Self { plane, left, top, x, y, weight_x: weights(x), weight_y: weights(y) }
    }

    /// Rows of the window inside the image: index in the image and distance to the keypoint.
    fn rows(&self) -> impl Iterator<Item = (usize, f32)> {
        let end = (self.top + self.weight_y.len() as isize).min(self.plane.height as isize - 1);
        (self.top.max(1)..end).map(|row| (row as usize, (row - self.top) as f32 - self.y))
    }

    /// Columns of the image at `low..=high` px from the keypoint.
    fn columns(&self, low: f32, high: f32) -> std::ops::Range<usize> {
        let first = self.left + (low + self.x).ceil().max(0.0) as isize;
        let end = self.left + (high + self.x + 1.0).floor().clamp(0.0, self.weight_x.len() as f32) as isize;
        let (first, end) = (first.max(1), end.min(self.plane.width as isize - 1));
        if first < end { first as usize..end as usize } else { 0..0 }
    }

    /// Distance of a column to the keypoint.
    fn dx(&self, column: usize) -> f32 {
        (column as isize - self.left) as f32 - self.x
    }

    fn gradients(&self, row: usize, columns: &std::ops::Range<usize>, out: &mut GradientRow) {
        let count = columns.len();
        out.magnitude.resize(count, 0.0);
        out.direction.resize(count, 0.0);
        if count == 0 {
            return;
        }
        let (above, here, below) = (self.plane.row(row - 1), self.plane.row(row), self.plane.row(row + 1));
        let (above, below) = (&above[columns.clone()], &below[columns.clone()]);
        let (before, after) = (&here[columns.start - 1..][..count], &here[columns.start + 1..][..count]);
        let weight = self.weight_y[(row as isize - self.top) as usize];
        let weights = &self.weight_x[(columns.start as isize - self.left) as usize..][..count];
        let (magnitude, direction) = (&mut out.magnitude[..count], &mut out.direction[..count]);
        for i in 0..count {
            let (dx, dy) = (after[i] - before[i], below[i] - above[i]);
            magnitude[i] = weight * weights[i] * (dx * dx + dy * dy).sqrt();
            direction[i] = fast_atan2(dy, dx);
        }
    }
}

/// Orientations of a keypoint (Lowe, section 5): the highest peak of its histogram of gradient directions and all
/// peaks of at least 0.8 of it; radians clockwise on the screen from image x.
pub fn orientations(plane: &Plane, keypoint: &Keypoint) -> Vec<f32> {
    let sigma = 1.5 * keypoint.sigma;
    let reach = 3.0 * sigma;
    let window = Window::new(plane, keypoint, reach, sigma);
    let mut gradients = GradientRow::default();
    let mut histogram = [0.0_f32; ORIENTATION_BINS];
    for (row, dy) in window.rows() {
        let half = (reach * reach - dy * dy).max(0.0).sqrt();
        window.gradients(row, &window.columns(-half, half), &mut gradients);
        for (magnitude, direction) in gradients.magnitude.iter().zip(&gradients.direction) {
            let bin = (direction + PI) * (ORIENTATION_BINS as f32 / TAU);
            histogram[(bin + 0.5) as usize % ORIENTATION_BINS] += magnitude;
        }
    }
    peaks(&smoothed(&smoothed(&histogram)))
}

/// The descriptor of a keypoint at one of its orientations: non-negative, squares sum to one.
pub fn root_sift(plane: &Plane, keypoint: &Keypoint, orientation_rad: f32) -> [f32; LENGTH] {
    let cell = CELL_SIGMAS * keypoint.sigma;
    let (sin, cos) = orientation_rad.sin_cos();
    // Pixels up to half a cell outside the 4x4 cells still share in them by interpolation.
    let reach = 0.5 * (CELLS + 1) as f32 * cell;
    let sigma = 0.5 * CELLS as f32 * cell;
    let window = Window::new(plane, keypoint, reach * (sin.abs() + cos.abs()), sigma);
    // One more cell all round, and one more direction, take what falls outside, so that the loop has no branches.
    let mut histogram = [[[0.0_f32; DIRECTIONS + 2]; CELLS + 2]; CELLS + 2];
    let mut gradients = GradientRow::default();
    let turn = DIRECTIONS as f32 / TAU;
    for (row, dy) in window.rows() {
        // u and v run along and across the orientation: |u|, |v| < reach bounds dx.
        let (mut low, mut high) = (-1e6_f32, 1e6_f32);
        for (along, offset) in [(cos, sin * dy), (-sin, cos * dy)] {
            if along.abs() > 1e-6 {
                let (a, b) = ((-reach - offset) / along, (reach - offset) / along);
                (low, high) = (low.max(a.min(b)), high.min(a.max(b)));
            } else if offset.abs() >= reach {
                (low, high) = (1.0, -1.0);
            }
        }
        let columns = window.columns(low, high);
        if columns.is_empty() {
            continue;
        }
        window.gradients(row, &columns, &mut gradients);
        let first = window.dx(columns.start);
        // Cells are counted from the extra one, whose centre is -2.5 cells from the keypoint.
        let u0 = (cos * first + sin * dy) / cell + 2.5;
        let v0 = (cos * dy - sin * first) / cell + 2.5;
        let (step_u, step_v) = (cos / cell, -sin / cell);
        for (i, (magnitude, direction)) in gradients.magnitude.iter().zip(&gradients.direction).enumerate() {
            let u = (u0 + i as f32 * step_u).clamp(0.0, 4.999);
            let v = (v0 + i as f32 * step_v).clamp(0.0, 4.999);
            let mut angle = (direction - orientation_rad) * turn;
            if angle < 0.0 {
                angle += DIRECTIONS as f32;
            }
            if angle < 0.0 {
                angle += DIRECTIONS as f32;
            }
            let (iu, iv, ia) = (u as usize, v as usize, (angle as usize).min(DIRECTIONS));
            let (fu, fv, fa) = (u - iu as f32, v - iv as f32, angle - ia as f32);
            for (dv, weight_v) in [(0, 1.0 - fv), (1, fv)] {
                for (du, weight_u) in [(0, 1.0 - fu), (1, fu)] {
                    let cell = &mut histogram[(iv + dv).min(CELLS + 1)][(iu + du).min(CELLS + 1)];
                    let share = magnitude * weight_u * weight_v;
                    cell[ia] += share * (1.0 - fa);
                    cell[ia + 1] += share * fa;
                }
            }
        }
    }
    let mut descriptor = [0.0_f32; LENGTH];
    for (index, cell) in descriptor.chunks_exact_mut(DIRECTIONS).enumerate() {
        let directions = &histogram[1 + index / CELLS][1 + index % CELLS];
        cell.copy_from_slice(&directions[..DIRECTIONS]);
        cell[0] += directions[DIRECTIONS];
        cell[1] += directions[DIRECTIONS + 1];
    }
    normalise(&mut descriptor);
    descriptor
}

/// Unit length, clipped at 0.2 against single strong edges (Lowe, section 6.1), then RootSIFT.
fn normalise(descriptor: &mut [f32; LENGTH]) {
    let length = descriptor.iter().map(|value| value * value).sum::<f32>().sqrt().max(f32::MIN_POSITIVE);
    for value in descriptor.iter_mut() {
        *value = (*value / length).min(CLIP);
    }
    let sum = descriptor.iter().sum::<f32>().max(f32::MIN_POSITIVE);
    for value in descriptor.iter_mut() {
        *value = (*value / sum).sqrt();
    }
}

fn smoothed(histogram: &[f32; ORIENTATION_BINS]) -> [f32; ORIENTATION_BINS] {
    std::array::from_fn(|i| {
        let before = histogram[(i + ORIENTATION_BINS - 1) % ORIENTATION_BINS];
        0.25 * (before + histogram[(i + 1) % ORIENTATION_BINS]) + 0.5 * histogram[i]
    })
}

fn peaks(histogram: &[f32; ORIENTATION_BINS]) -> Vec<f32> {
    let highest = histogram.iter().copied().fold(0.0, f32::max);
    let mut angles = Vec::with_capacity(2);
    for i in 0..ORIENTATION_BINS {
        let before = histogram[(i + ORIENTATION_BINS - 1) % ORIENTATION_BINS];
        let (here, after) = (histogram[i], histogram[(i + 1) % ORIENTATION_BINS]);
        if here > before && here >= after && here >= SECOND_PEAK * highest {
            let offset = 0.5 * (before - after) / (before - 2.0 * here + after);
            angles.push((i as f32 + offset) * (TAU / ORIENTATION_BINS as f32) - PI);
        }
    }
    angles
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fast_atan2_is_the_arctangent_in_every_octant() {
        for i in 0..1000 {
            let angle = (i as f32 + 0.5) * TAU / 1000.0 - PI;
            let (y, x) = (3.0 * angle.sin(), 3.0 * angle.cos());
            assert!((fast_atan2(y, x) - angle).abs() < 2e-5, "{angle}");
        }
        assert_eq!(fast_atan2(0.0, 0.0), 0.0);
    }

    /// A pattern without symmetry about (40, 40), turned clockwise on the screen by `angle`.
    fn turned(angle: f32) -> Plane {
        let (sin, cos) = angle.sin_cos();
        let value = |i: usize| {
            let (dx, dy) = ((i % 81) as f32 - 40.0, (i / 81) as f32 - 40.0);
            let (u, v) = (cos * dx + sin * dy, cos * dy - sin * dx);
            0.5 + 0.2 * (u / 7.0).sin() + 0.1 * ((v + 0.3 * u) / 5.0).cos() + 0.01 * u
        };
        Plane { values: (0..81 * 81).map(value).collect(), width: 81, height: 81 }
    }

    const CENTRE: Keypoint = Keypoint { column: 40.0, row: 40.0, octave: 0, level: 1, sigma: 2.0, contrast: 0.1 };

    #[test]
    fn turning_the_image_turns_the_orientation_and_keeps_the_descriptor() {
        let straight = turned(0.0);
        let first = orientations(&straight, &CENTRE)[0];
        let descriptor = root_sift(&straight, &CENTRE, first);
        for angle in [0.4_f32, 1.3, -2.0, 3.0] {
            let plane = turned(angle);
            let wanted = first + angle;
            let off = |found: f32| (found - wanted).sin().abs().max(1.0 - (found - wanted).cos());
            let nearest = orientations(&plane, &CENTRE).into_iter().min_by(|a, b| off(*a).total_cmp(&off(*b))).unwrap();
            // Bins are 10 degrees wide; interpolated peaks of a smooth pattern are good to a degree or two.
            assert!(off(nearest) < 0.05, "{nearest} {wanted}");
            let product: f32 = root_sift(&plane, &CENTRE, nearest).iter().zip(&descriptor).map(|(a, b)| a * b).sum();
            assert!(product > 0.98, "{product}");
        }
    }

    #[test]
    fn a_ramp_points_along_its_gradient_and_fills_one_direction() {
        let ramp = Plane { values: (0..81 * 81).map(|i| (i / 81) as f32 * 0.01).collect(), width: 81, height: 81 };
        let found = orientations(&ramp, &CENTRE);
        assert_eq!(found.len(), 1);
        // Brighter downwards: clockwise from x by a right angle.
        assert!((found[0] - 0.5 * PI).abs() < 1e-3, "{found:?}");
        let descriptor = root_sift(&ramp, &CENTRE, found[0]);
        let along: f32 = descriptor.iter().step_by(DIRECTIONS).map(|value| value * value).sum();
        assert!(along > 0.999, "{along}");
    }

    #[test]
    fn keypoints_at_the_border_have_descriptors_too() {
        let corner = Keypoint { column: 5.2, row: 75.4, ..CENTRE };
        let plane = turned(0.2);
        for angle in orientations(&plane, &corner) {
            let squares: f32 = root_sift(&plane, &corner, angle).iter().map(|value| value * value).sum();
            assert!((squares - 1.0).abs() < 1e-5);
        }
    }
}

//! How an image lies on what is expected: shifted, turned and magnified so that the two are most alike.
//!
//! A shift is looked for first, over all of a range; then shift, turn and magnification together by Gauss-Newton steps on the
//! correlation coefficient (Lucas & Kanade 1981; Evangelidis & Psarakis 2008).

use nalgebra::{Matrix4, Vector4};
use ndarray::{Array2, ArrayView2, s};

use crate::geometry::{Point2, Similarity2, Vector2};
use crate::rectify::resample::resample;

/// Gauss-Newton steps.
const STEPS: usize = 6;
/// A step is cut to this, px, at a quarter of the width from the middle.
const MOST_STEP_PX: f64 = 1.0;

/// By how much an image is displaced against what is expected: a shift, and a turn and a magnification about the middle of the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Displaced {
    /// Columns, rows; px.
    pub shift: Vector2,
    /// Radians, clockwise on the screen.
    pub turn_rad: f64,
    /// Logarithm of the magnification.
    pub log_scale: f64,
}

impl Displaced {
    /// Not at all.
    pub const NONE: Self = Self { shift: Vector2::new(0.0, 0.0), turn_rad: 0.0, log_scale: 0.0 };

    /// From where something is expected to where it is, about `middle`.
    pub fn map(&self, middle: &Point2) -> Similarity2 {
        let turned = Similarity2::new(Vector2::zeros(), self.turn_rad, self.log_scale.exp());
        let shift = middle.coords + self.shift - turned * middle.coords;
        Similarity2::new(shift, self.turn_rad, self.log_scale.exp())
    }
}

/// What is known of a displacement beforehand: turn and magnification, and one sigma of each.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expected {
    /// Radians.
    pub turn_rad: f64,
    pub turn_sigma: f64,
    pub log_scale: f64,
    pub scale_sigma: f64,
}

/// The displacement of an image, its shift at first within `reach`; lines in the image are `blur` px wide (sigma).
pub(super) fn displaced(
    image: &Array2<f32>,
    expected: ArrayView2<'_, f32>,
    reach: usize,
    blur: f64,
    prior: &Expected,
) -> Displaced {
    let mut now = Displaced { shift: best_shift(image, expected, reach), ..Displaced::NONE };
    let (height, width) = image.dim();
    let middle = Point2::new(0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0));
    // The likeliest so far, and the noise at first.
    let mut best = (f64::NEG_INFINITY, now);
    let mut noise = None;
    for _ in 0..=STEPS {
        let moved = resample(&image.view(), &now.map(&middle).inverse(), [height, width]);
        let Some(alike) = Alike::new(&moved, expected) else { break };
        let noise = *noise.get_or_insert(alike.noise());
        let likelihood = prior.log_likelihood(&now) - 0.5 * alike.unexplained / (noise * independent(blur));
        if likelihood <= best.0 || now.shift.norm() > reach as f64 + 1.0 {
            break;
        }
        best = (likelihood, now);
        let Some(step) = alike.step(&moved, expected, &middle, noise * independent(blur), prior, &now) else { break };
        // No further than an image is known to go on as its slopes say.
        let longest = Vector2::new(step[0], step[1]).norm().max((step[2].abs() + step[3].abs()) * 0.25 * width as f64);
        let step = step * (MOST_STEP_PX / longest.max(MOST_STEP_PX));
        now.shift += Vector2::new(step[0], step[1]);
        now.turn_rad += step[2];
        now.log_scale += step[3];
    }
    best.1
}

/// Pixels of a blurred image that tell as much as one of independent noise.
fn independent(blur: f64) -> f64 {
    (4.0 * std::f64::consts::PI * blur * blur).max(1.0)
}

impl Expected {
    fn log_likelihood(&self, at: &Displaced) -> f64 {
        let off = [(at.turn_rad - self.turn_rad) / self.turn_sigma, (at.log_scale - self.log_scale) / self.scale_sigma];
        -0.5 * off.iter().map(|off| off * off).sum::<f64>()
    }
}

/// The correlation coefficient of an image with what is expected; 0 where one of them is the same everywhere.
pub(super) fn correlation(image: &Array2<f32>, expected: ArrayView2<'_, f32>) -> f64 {
    let mut sums = [0.0_f64; 5];
    for (a, b) in image.iter().zip(expected.iter()) {
        let (a, b) = (f64::from(*a), f64::from(*b));
        for (sum, value) in sums.iter_mut().zip([a, b, a * a, b * b, a * b]) {
            *sum += value;
        }
    }
    let count = image.len().max(1) as f64;
    let [a, b, aa, bb, ab] = sums.map(|sum| sum / count);
    let spread = ((aa - a * a) * (bb - b * b)).sqrt();
    if spread > 0.0 { (ab - a * b) / spread } else { 0.0 }
}

/// An image as what is expected, times a gain, and other things.
struct Alike {
    means: [f64; 2],
    gain: f64,
    /// The sum of the squares of the other things.
    unexplained: f64,
    count: f64,
}

/// Whether a pixel of a moved image and its neighbours lie in the image.
fn is_known(moved: &Array2<f32>, row: usize, column: usize) -> bool {
    let near = [(row, column), (row, column - 1), (row, column + 1), (row - 1, column), (row + 1, column)];
    near.iter().all(|at| moved[*at].is_finite())
}

/// Pixels that [`is_known`] may be asked of.
fn inner((height, width): (usize, usize)) -> impl Iterator<Item = (usize, usize)> {
    (1..height.saturating_sub(1)).flat_map(move |row| (1..width.saturating_sub(1)).map(move |column| (row, column)))
}

impl Alike {
    /// `None` where the two have nothing in common.
    fn new(moved: &Array2<f32>, expected: ArrayView2<'_, f32>) -> Option<Self> {
        let (mut count, mut sums) = (0.0, [0.0; 5]);
        for (row, column) in inner(moved.dim()).filter(|(row, column)| is_known(moved, *row, *column)) {
            let (a, b) = (f64::from(moved[[row, column]]), f64::from(expected[[row, column]]));
            count += 1.0;
            for (sum, value) in sums.iter_mut().zip([a, b, a * a, b * b, a * b]) {
                *sum += value;
            }
        }
        let [a, b] = [sums[0] / count, sums[1] / count];
        let [aa, bb, ab] = [sums[2] - count * a * a, sums[3] - count * b * b, sums[4] - count * a * b];
        (aa > 0.0 && bb > 0.0 && ab > 0.0).then(|| Self {
            means: [a, b],
            gain: ab / bb,
            unexplained: (aa - ab * ab / bb).max(0.0),
            count,
        })
    }

    /// Variance of a pixel's other things.
    fn noise(&self) -> f64 {
        (self.unexplained / self.count).max(1e-12)
    }

    /// The Gauss-Newton step of shift, turn and magnification at which the moved image is most like what is expected; `variance` is that
    /// of independent noise in a pixel.
    fn step(
        &self,
        moved: &Array2<f32>,
        expected: ArrayView2<'_, f32>,
        middle: &Point2,
        variance: f64,
        prior: &Expected,
        now: &Displaced,
    ) -> Option<Vector4<f64>> {
        let mut matrix = Matrix4::zeros();
        let mut right = Vector4::zeros();
        for (row, column) in inner(moved.dim()).filter(|(row, column)| is_known(moved, *row, *column)) {
            let right_of = 0.5 * f64::from(moved[[row, column + 1]] - moved[[row, column - 1]]);
            let below = 0.5 * f64::from(moved[[row + 1, column]] - moved[[row - 1, column]]);
            let (x, y) = (column as f64 - middle.x, row as f64 - middle.y);
            let change = Vector4::new(right_of, below, x * below - y * right_of, x * right_of + y * below);
            let off = self.gain * (f64::from(expected[[row, column]]) - self.means[1])
                - (f64::from(moved[[row, column]]) - self.means[0]);
            matrix += change * change.transpose();
            right += change * off;
        }
        matrix /= variance;
        right /= variance;
        for (place, off, sigma) in [
            (2, prior.turn_rad - now.turn_rad, prior.turn_sigma),
            (3, prior.log_scale - now.log_scale, prior.scale_sigma),
        ] {
            matrix[(place, place)] += 1.0 / (sigma * sigma);
            right[place] += off / (sigma * sigma);
        }
        matrix.cholesky().map(|factors| factors.solve(&right))
    }
}

/// By how much (columns, rows; pixels) an image is displaced against what is expected: where their correlation is largest
/// within `reach`, between pixels by a parabola; 0 where it is largest at the edge of that.
fn best_shift(image: &Array2<f32>, expected: ArrayView2<'_, f32>, reach: usize) -> Vector2 {
    let (height, width) = image.dim();
    let side = 2 * reach + 1;
    if height <= side || width <= side {
        return Vector2::zeros();
    }
    let inside = expected.slice(s![reach..height - reach, reach..width - reach]);
    let mean = inside.mean().unwrap_or(0.0);
    let correlation = Array2::from_shape_fn((side, side), |(down, right)| {
        let part = image.slice(s![down..height - 2 * reach + down, right..width - 2 * reach + right]);
        let mut sum = 0.0_f64;
        for (row, expected) in part.rows().into_iter().zip(inside.rows()) {
            let products = row.iter().zip(expected).map(|(value, expected)| value * (expected - mean));
            sum += f64::from(products.sum::<f32>());
        }
        sum
    });
    let ((row, column), _) =
        correlation.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).expect("it has at least one place");
    if row == 0 || column == 0 || row + 1 == side || column + 1 == side {
        return Vector2::zeros();
    }
    let peak = |before: f64, at: f64, after: f64| {
        let curvature = before - 2.0 * at + after;
        if curvature < 0.0 { 0.5 * (before - after) / curvature } else { 0.0 }
    };
    let at = |row: usize, column: usize| correlation[[row, column]];
    let between = Vector2::new(
        peak(at(row, column - 1), at(row, column), at(row, column + 1)),
        peak(at(row - 1, column), at(row, column), at(row + 1, column)),
    );
    Vector2::new(column as f64, row as f64) + between - Vector2::from_element(reach as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::draw::union_of_profiles;

    /// What lies 3.4 px to the right and 1.7 px up of where it is expected is found there; what is further away than the reach is not.
    #[test]
    fn a_shift_is_found_with_its_signs() {
        let drawn = |x: f64, y: f64| {
            let at = |a: f64, b: f64| Point2::new(a + x, b + y);
            union_of_profiles(
                [80, 90],
                &[vec![at(30.0, 20.0), at(60.0, 55.0)], vec![at(60.0, 25.0), at(35.0, 60.0)]],
                2.0,
            )
        };
        let found = best_shift(&drawn(3.4, -1.7), drawn(0.0, 0.0).view(), 6);
        assert!((found - Vector2::new(3.4, -1.7)).norm() < 0.1, "{found}");
        let far = best_shift(&drawn(12.0, 0.0), drawn(0.0, 0.0).view(), 4);
        assert!(far.norm() < 4.0);
        assert_eq!(best_shift(&drawn(0.0, 0.0), drawn(0.0, 0.0).view(), 40), Vector2::zeros());
    }

    /// An image that is shifted, turned and magnified is found so, with the signs; what is known of turn and magnification beforehand
    /// holds them as far as it goes.
    #[test]
    fn a_turned_and_magnified_image_is_found_with_its_signs() {
        let middle = Point2::new(74.5, 69.5);
        let drawn = |by: &Displaced| {
            let map = by.map(&middle);
            let line = |a: [f64; 2], b: [f64; 2]| {
                let at = |share: f64| map * Point2::new(a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share);
                (0..=20).map(|step| at(0.05 * f64::from(step))).collect::<Vec<_>>()
            };
            let lines = [
                line([20.0, 20.0], [120.0, 60.0]),
                line([110.0, 15.0], [40.0, 120.0]),
                line([60.0, 30.0], [90.0, 110.0]),
            ];
            union_of_profiles([140, 150], &lines, 2.0)
        };
        let known = |sigma: f64| Expected { turn_rad: 0.0, turn_sigma: sigma, log_scale: 0.0, scale_sigma: sigma };
        let truth = Displaced { shift: Vector2::new(2.3, -1.6), turn_rad: 0.015, log_scale: -0.008 };
        let found = displaced(&drawn(&truth), drawn(&Displaced::NONE).view(), 6, 2.0, &known(0.05));
        assert!((found.shift - truth.shift).norm() < 0.1, "{found:?}");
        assert!(
            (found.turn_rad - truth.turn_rad).abs() < 1e-3 && (found.log_scale - truth.log_scale).abs() < 1e-3,
            "{found:?}"
        );
        let held = displaced(&drawn(&truth), drawn(&Displaced::NONE).view(), 6, 2.0, &known(1e-6));
        assert!(
            held.turn_rad.abs() < 1e-4 && held.log_scale.abs() < 1e-4 && (held.shift - truth.shift).norm() < 0.5,
            "{held:?}"
        );
        // What is further away than the reach is not followed there.
        let far = Displaced { shift: Vector2::new(5.0, 0.0), ..Displaced::NONE };
        let followed = displaced(&drawn(&far), drawn(&Displaced::NONE).view(), 2, 2.0, &known(0.05));
        assert!(followed.shift.norm() <= 3.0, "{followed:?}");
        // Nothing to be seen moves nothing.
        let empty = Array2::zeros([140, 150]);
        assert_eq!(displaced(&empty, drawn(&truth).view(), 6, 2.0, &known(0.05)).turn_rad, 0.0);
        assert_eq!(correlation(&empty, drawn(&truth).view()), 0.0);
        assert!((correlation(&drawn(&truth), drawn(&truth).view()) - 1.0).abs() < 1e-6);
    }
}

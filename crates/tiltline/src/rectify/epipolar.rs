//! The two-view geometry of parallel projection: the affine epipolar constraint
//! `a x_L + b y_L + c x_R + e y_R + f = 0` (Koenderink and van Doorn 1991; Shapiro, Zisserman and Brady 1995) and its
//! total least squares fit with a prior on the axis.
//!
//! The constraint says that two row coordinates agree. `(a, b)` is the left image's row normal: its direction is that
//! of the tilt axis. `(c, e)` is the right's: its direction and length give the images' relative rotation and scale.

use std::f64::consts::PI;

use nalgebra::{Matrix2, Matrix3, Matrix4, Matrix4x3, SymmetricEigen, Vector4};

use super::point_matching::PointMatch;
use crate::geometry::{Point2, Similarity2, Vector2};

/// Beyond so many sigmas the prior falls off exponentially, not like a Gaussian: a user may give the axis of another
/// microscope, and then clear points must be able to win without being dragged along.
const PRIOR_CORE: f64 = 3.0;
/// Neighbouring features overlap and err together: so many of them count as one.
const CROWDING: f64 = 3.0;
/// The same for the error of the rows: blocks overlap, and all matches along one line share its error. Chosen so that two
/// thirds of the pairs of the sets `val-8deg` and `val-hard` have a smaller true error than stated.
const ROW_CROWDING: f64 = 14.0;
/// Errors of points differ by direction (they slide along lines) by about this share of their variance.
const ANISOTROPY: f64 = 1.0;

/// Two images whose epipolar lines are made rows. All lengths are in left px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Epipolar {
    /// Direction of the tilt axis in the left image, radians clockwise on the screen from image y.
    pub axis_left_rad: f64,
    /// The same in the right image.
    pub axis_right_rad: f64,
    /// Size of things in the right image relative to the left.
    pub scale: f64,
    /// Added to right rows.
    pub row_offset: f64,
}

impl Epipolar {
    /// From the constraint's coefficients `[a, b, c, e]` and `f`; of the two opposite axis directions the one nearer
    /// `axis_rad`. `None` where one image has no row normal.
    pub fn from_constraint(normal: &Vector4<f64>, f: f64, axis_rad: f64) -> Option<Self> {
        let (left, right) = (normal.xy(), -Vector2::new(normal.z, normal.w));
        let (left_length, right_length) = (left.norm(), right.norm());
        if !(left_length > 1e-9 && right_length > 1e-9) {
            return None;
        }
        // Row normals are (-sin, cos) of the axis angle. An axis turned by a half turn negates both.
        let angle = |normal: &Vector2| (-normal.x).atan2(normal.y);
        let axis = angle(&left);
        let flip = (axis - axis_rad).cos() < 0.0;
        let sign = if flip { -1.0 } else { 1.0 };
        let axis_left_rad = axis_rad + wrapped(angle(&(left * sign)) - axis_rad, 2.0 * PI);
        let axis_right_rad = axis_left_rad + wrapped(angle(&(right * sign)) - axis_left_rad, 2.0 * PI);
        Some(Self {
            axis_left_rad,
            axis_right_rad,
            scale: left_length / right_length,
            row_offset: -sign * f / left_length,
        })
    }

    /// Right axis less left axis: how far things are turned in the right image, clockwise on the screen.
    pub fn relative_rotation_rad(&self) -> f64 {
        self.axis_right_rad - self.axis_left_rad
    }

    /// Left input px to rectified px, up to the shift of the grid.
    pub fn rectified_from_left(&self) -> Similarity2 {
        Similarity2::new(Vector2::zeros(), -self.axis_left_rad, 1.0)
    }

    /// Right input px to rectified px, up to the shift of the grid and a shift along the rows.
    pub fn rectified_from_right(&self) -> Similarity2 {
        Similarity2::new(Vector2::new(0.0, self.row_offset), -self.axis_right_rad, 1.0 / self.scale)
    }

    /// Difference of a match after rectification: x is the disparity (up to a constant), y the row error.
    pub fn differences(&self, matches: &[PointMatch]) -> Vec<Vector2> {
        let (left, right) = (self.rectified_from_left(), self.rectified_from_right());
        matches.iter().map(|pair| right * pair.right - left * pair.left).collect()
    }

    /// Standard deviation of a row difference for an error of one px in each coordinate of each image.
    pub fn row_noise_gain(&self) -> f64 {
        (1.0 + 1.0 / (self.scale * self.scale)).sqrt()
    }
}

/// Angle brought into `[-period/2, period/2)`.
pub fn wrapped(angle: f64, period: f64) -> f64 {
    (angle + 0.5 * period).rem_euclid(period) - 0.5 * period
}

/// Weighted mean and covariance of matches as points `(x_L, y_L, x_R, y_R)`.
#[derive(Clone, Debug)]
pub struct Moments {
    /// Sum of the weights.
    pub weight: f64,
    mean: Vector4<f64>,
    covariance: Matrix4<f64>,
}

impl Moments {
    /// Of matches with weights from 0 to 1.
    pub fn of<'a>(matches: impl Iterator<Item = (&'a PointMatch, f64)> + Clone) -> Self {
        let point = |pair: &PointMatch| Vector4::new(pair.left.x, pair.left.y, pair.right.x, pair.right.y);
        let weight: f64 = matches.clone().map(|(_, weight)| weight).sum();
        let each = 1.0 / weight.max(1e-300);
        let mean = matches.clone().map(|(pair, weight)| point(pair) * weight).sum::<Vector4<f64>>() * each;
        let scatter = matches.map(|(pair, weight)| (point(pair) - mean, weight));
        let covariance = scatter.map(|(p, weight)| p * p.transpose() * weight).sum::<Matrix4<f64>>() * each;
        Self { weight, mean, covariance }
    }

    /// Eigenvalues, descending, in px^2, and the eigenvector of the smallest.
    pub fn principal(&self) -> ([f64; 4], Vector4<f64>) {
        let eigen = SymmetricEigen::new(self.covariance);
        let mut order = [0, 1, 2, 3];
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        // Rounding may leave the smallest a little below zero.
        (order.map(|i| eigen.eigenvalues[i].max(0.0)), eigen.eigenvectors.column(order[3]).into_owned())
    }

    /// Total least squares geometry without a prior.
    pub fn fit(&self, axis_rad: f64) -> Option<Epipolar> {
        let (_, normal) = self.principal();
        Epipolar::from_constraint(&normal, -normal.dot(&self.mean), axis_rad)
    }

    /// The best normal whose left axis is given, and its mean squared residual in px^2: the smallest eigenvector of the
    /// covariance in the three dimensions that the axis leaves.
    fn given_axis(&self, axis_rad: f64) -> (Vector4<f64>, f64) {
        let (sin, cos) = axis_rad.sin_cos();
        let basis = Matrix4x3::new(-sin, 0.0, 0.0, cos, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
        let reduced: Matrix3<f64> = basis.transpose() * self.covariance * basis;
        let eigen = SymmetricEigen::new(reduced);
        let index = eigen.eigenvalues.imin();
        (basis * eigen.eigenvectors.column(index), eigen.eigenvalues[index])
    }

    /// Covariance of the matches' right points.
    fn right_covariance(&self) -> Matrix2<f64> {
        self.covariance.fixed_view::<2, 2>(2, 2).into_owned()
    }
}

/// What is known of the axis before the points are looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisPrior {
    /// The given axis, radians clockwise on the screen from image y.
    pub axis_rad: f64,
    /// One sigma of it.
    pub sigma_rad: f64,
}

impl AxisPrior {
    /// Negative logarithm of the prior's density, less its least value.
    pub fn negative_log(&self, axis_rad: f64) -> f64 {
        let offset = (wrapped(axis_rad - self.axis_rad, PI) / self.sigma_rad).abs();
        if offset < PRIOR_CORE { 0.5 * offset * offset } else { PRIOR_CORE * (offset - 0.5 * PRIOR_CORE) }
    }
}

/// A fit with what the points and the prior say about the axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Posterior {
    /// The geometry at the most probable axis.
    pub geometry: Epipolar,
    /// One sigma of the axis, points and prior together.
    pub axis_sigma_rad: f64,
    /// The axis that the points alone prefer.
    pub points_axis_rad: f64,
    /// One sigma of it; up to a quarter turn, which is no knowledge at all.
    pub points_sigma_rad: f64,
    /// Estimated error of one coordinate of one point, px.
    pub noise_px: f64,
    /// Third eigenvalue of the covariance over the fourth: near 1 the points lie in one plane.
    pub eigenvalue_ratio: f64,
}

/// Fits the geometry to points with a prior on the axis.
///
/// For each axis the best remaining parameters leave a mean squared residual `r(axis)`; its excess over the overall
/// minimum would be the points' log likelihood, `-N (r - r_min) / (2 l4)`, for known point places with equal errors. Its
/// width is `l4 / (N (l3 - l4))`, l3 and l4 being the smallest eigenvalues of the covariance. But the places are measured
/// themselves: first-order perturbation of eigenvectors gives `l3 l4 / (N (l3 - l4)^2)`. And errors that differ by
/// direction turn the eigenvector by about `ANISOTROPY l4 / (l3 - l4)`, however many points there are. The likelihood is
/// widened to the sum of both: it fades out by itself as the points approach one plane.
pub fn fit_with_prior(moments: &Moments, prior: &AxisPrior) -> Option<Posterior> {
    if moments.weight < 4.5 {
        return None;
    }
    let ([_, _, third, fourth], normal) = moments.principal();
    let points = Epipolar::from_constraint(&normal, 0.0, prior.axis_rad)?;
    let count = moments.weight;
    // Four parameters are fitted. Points computed exactly have no errors; a ten-thousandth of a px keeps sigmas finite.
    let noise2 = (fourth * count / (count - 4.0)).max(1e-8);
    let excess = third - fourth;
    let random2 = CROWDING * third * noise2 / (count * excess * excess);
    let bias2 = (ANISOTROPY * noise2 / excess).powi(2);
    // Turning the axis by t raises r by about excess * t^2.
    let wide = 0.5 / ((random2 + bias2) * excess);
    let gain = if excess > 0.0 && wide.is_finite() { wide } else { 0.0 };
    let data = |axis: f64| gain * (moments.given_axis(axis).1 - fourth);
    let both = |axis: f64| data(axis) + prior.negative_log(axis);

    // Both the points' and the prior's preference are tried, and a coarse sweep for what lies between.
    let step = PI / 360.0;
    let sweep = (-180..180).map(|i| prior.axis_rad + f64::from(i) * step);
    let start = sweep.chain([points.axis_left_rad]).min_by(|a, b| both(*a).total_cmp(&both(*b)))?;
    // A peak narrower than the sweep is the points' own, whose place is known; search about it on its own scale.
    let points_sigma_rad = half_width(&data, points.axis_left_rad);
    let reach = if start == points.axis_left_rad { step.min(8.0 * points_sigma_rad) } else { step };
    let axis = golden_section(&both, start - reach, start + reach);
    let (normal, _) = moments.given_axis(axis);
    let geometry = Epipolar::from_constraint(&normal, -normal.dot(&moments.mean), prior.axis_rad)?;
    Some(Posterior {
        geometry,
        axis_sigma_rad: half_width(&both, axis),
        points_axis_rad: points.axis_left_rad,
        points_sigma_rad,
        noise_px: noise2.sqrt(),
        eigenvalue_ratio: third / fourth.max(1e-8),
    })
}

/// One sigma of a peak at `centre`: half the width at which the negative log has risen by 1/2; at most a quarter turn.
fn half_width(negative_log: &impl Fn(f64) -> f64, centre: f64) -> f64 {
    let level = negative_log(centre) + 0.5;
    let side = |sign: f64| {
        let (mut inside, mut outside) = (0.0, 1e-7);
        while negative_log(centre + sign * outside) < level {
            if outside >= 0.5 * PI {
                return 0.5 * PI;
            }
            (inside, outside) = (outside, (2.0 * outside).min(0.5 * PI));
        }
        for _ in 0..40 {
            let middle = 0.5 * (inside + outside);
            if negative_log(centre + sign * middle) < level { inside = middle } else { outside = middle }
        }
        outside
    };
    0.5 * (side(1.0) + side(-1.0))
}

/// Minimum of a function with one minimum in `[low, high]`.
fn golden_section(function: &impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    let ratio = 0.5 * (5.0_f64.sqrt() - 1.0);
    let (mut a, mut b) = (high - ratio * (high - low), low + ratio * (high - low));
    let (mut at_a, mut at_b) = (function(a), function(b));
    for _ in 0..60 {
        if at_a < at_b {
            (high, b, at_b) = (b, a, at_a);
            a = high - ratio * (high - low);
            at_a = function(a);
        } else {
            (low, a, at_a) = (a, b, at_b);
            b = low + ratio * (high - low);
            at_b = function(b);
        }
    }
    0.5 * (low + high)
}

/// One-sigma systematic error of a row correspondence, in left px: root mean square over an image of `shape`.
///
/// Three parts: the fit's own uncertainty (of the right row normal and the offset); the axis's, which moves points off
/// the points' common plane by disparity times its sine; and what the model cannot follow (drift, distortion), seen as
/// mean residuals of the cells of a 4x4 grid beyond what their noise explains.
pub fn systematic_row_error_px(
    posterior: &Posterior,
    inliers: &[PointMatch],
    disparity_spread_px: f64,
    shape: [usize; 2],
) -> f64 {
    let moments = Moments::of(inliers.iter().map(|pair| (pair, 1.0)));
    let count = moments.weight.max(1.0);
    let row_noise2 = (posterior.noise_px * posterior.geometry.row_noise_gain()).powi(2) * ROW_CROWDING;
    let [height, width] = shape.map(|side| side as f64);
    let offset = Vector2::new(0.5 * width, 0.5 * height) - moments.mean.xy();
    let field = Matrix2::new(width * width / 12.0, 0.0, 0.0, height * height / 12.0) + offset * offset.transpose();
    let spread = moments.right_covariance().try_inverse().map_or(0.0, |inverse| (inverse * field).trace());
    let fit2 = row_noise2 / count * (1.0 + spread);
    let axis2 = (posterior.axis_sigma_rad * disparity_spread_px).powi(2);

    /// Cells each way.
    const CELLS: usize = 4;
    let mut cells = [(0.0, 0.0); CELLS * CELLS];
    for (pair, difference) in inliers.iter().zip(posterior.geometry.differences(inliers)) {
        let index = |at: f64, side: f64| ((at / side * CELLS as f64).max(0.0) as usize).min(CELLS - 1);
        let cell = &mut cells[index(pair.left.y, height) * CELLS + index(pair.left.x, width)];
        *cell = (cell.0 + difference.y, cell.1 + 1.0);
    }
    let filled: Vec<_> = cells.iter().filter(|cell| cell.1 >= 3.0).collect();
    let excess: f64 = filled.iter().map(|(sum, count)| (sum / count).powi(2) - row_noise2 / count).sum();
    let unmodelled2 = (excess / filled.len().max(1) as f64).max(0.0);
    (fit2 + axis2 + unmodelled2).sqrt()
}

/// Least squares similarity that takes left points to right points.
pub fn fit_similarity<'a>(matches: impl Iterator<Item = (&'a PointMatch, f64)> + Clone) -> Option<Similarity2> {
    let weight: f64 = matches.clone().map(|(_, weight)| weight).sum();
    let mean = |point: fn(&PointMatch) -> Vector2| {
        matches.clone().map(|(pair, weight)| point(pair) * weight).sum::<Vector2>() / weight
    };
    let (left, right) = (mean(|pair| pair.left.coords), mean(|pair| pair.right.coords));
    let (mut dot, mut cross, mut norm) = (0.0, 0.0, 0.0);
    for (pair, weight) in matches {
        let (p, q) = (pair.left.coords - left, pair.right.coords - right);
        dot += weight * p.dot(&q);
        cross += weight * p.perp(&q);
        norm += weight * p.norm_squared();
    }
    let scale = dot.hypot(cross) / norm;
    if !(scale.is_finite() && scale > 1e-6) {
        return None;
    }
    let turn = Similarity2::new(Vector2::zeros(), cross.atan2(dot), scale);
    let shift = right - (turn * Point2::from(left)).coords;
    Some(Similarity2::new(shift, cross.atan2(dot), scale))
}

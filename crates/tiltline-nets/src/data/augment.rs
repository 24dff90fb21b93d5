//! Random crops: one resampling of each map, so that nothing is blurred twice, and then what microscopes do to grey values.
//!
//! With `c` the centre of a crop, `A` the common change (scale, turn, flips) and `M`, `e` the misalignment of the right image,
//! crop pixel `q` shows left pixel `A (q - c) + m` and right pixel `A (M (q - c) + e) + m + (o, 0)`. So the match of `q`, at left
//! pixel `p + (d, 0)` in the right image, is `q' - c = M^-1 (A^-1 (A (q - c) + (d - o, 0)) - e)`, and the new disparity is
//! `(q' - q).x`.

use ndarray::Array2;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use tiltline::filter::{gaussian_blur, sample_cubic};

use super::{DataError, Example, Task};
use crate::flatten::flattened;

/// Crops with too little in them are drawn again this many times.
const TRIES: usize = 6;
/// Line pixels that a crop should have at least.
const ENOUGH_LINE: usize = 150;
/// Share of crops that are taken as they come, so that images without lines are seen too.
const AS_THEY_COME: f64 = 0.2;

/// Ranges of the changes; each is drawn anew for every crop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AugmentSettings {
    /// Smallest and largest enlargement (paper: 0.7 to 1.2).
    pub scale: [f64; 2],
    /// Largest turn either way, for the detector only (paper: 60), degrees.
    pub turn_deg: f64,
    /// Whether images are mirrored.
    pub flip: bool,
    /// Smallest and largest brightness (paper: 0.8 to 1.2).
    pub brightness: [f64; 2],
    /// Largest change of gamma either way, as a factor.
    pub gamma: f64,
    /// Largest change of contrast between left and right, as a share.
    pub contrast: f64,
    /// Share of crops with inverted contrast.
    pub inverted: f64,
    /// Largest standard deviation of added noise (the image's range is 1): white, and smooth.
    pub noise: [f64; 2],
    /// Largest blur, px.
    pub blur_px: f64,
    /// Share of crops with a black border.
    pub border: f64,
    /// Largest vertical shift of the right image, px.
    pub row_px: f64,
    /// Largest turn of the right image, degrees.
    pub right_turn_deg: f64,
    /// Largest shift of the right image along the row beyond the median disparity, px.
    pub shift_px: f64,
}

impl Default for AugmentSettings {
    fn default() -> Self {
        Self {
            scale: [0.7, 1.2],
            turn_deg: 60.0,
            flip: true,
            brightness: [0.8, 1.2],
            gamma: 1.4,
            contrast: 0.2,
            inverted: 0.15,
            noise: [0.02, 0.02],
            blur_px: 0.8,
            border: 0.2,
            row_px: 0.8,
            right_turn_deg: 0.2,
            shift_px: 4.0,
        }
    }
}

impl AugmentSettings {
    /// No change.
    pub fn none() -> Self {
        Self {
            scale: [1.0; 2],
            turn_deg: 0.0,
            flip: false,
            brightness: [1.0; 2],
            gamma: 1.0,
            contrast: 0.0,
            inverted: 0.0,
            noise: [0.0; 2],
            blur_px: 0.0,
            border: 0.0,
            row_px: 0.0,
            right_turn_deg: 0.0,
            shift_px: 0.0,
        }
    }

    /// Checks every number.
    ///
    /// # Errors
    /// The first that is not possible.
    pub fn validate(&self) -> Result<(), DataError> {
        let checks = [
            ("augment.scale", self.scale[0], 0.1, 10.0),
            ("augment.scale", self.scale[1], self.scale[0], 10.0),
            ("augment.brightness", self.brightness[0], 0.1, 10.0),
            ("augment.brightness", self.brightness[1], self.brightness[0], 10.0),
            ("augment.gamma", self.gamma, 1.0, 10.0),
            ("augment.contrast", self.contrast, 0.0, 0.9),
            ("augment.inverted", self.inverted, 0.0, 1.0),
            ("augment.border", self.border, 0.0, 1.0),
            ("augment.blur_px", self.blur_px, 0.0, 10.0),
            ("augment.noise", self.noise[0], 0.0, 1.0),
            ("augment.noise", self.noise[1], 0.0, 1.0),
        ];
        for (name, value, low, high) in checks {
            if !(low..=high).contains(&value) {
                return Err(DataError::Setting { name, value: value.to_string(), wanted: "inside its range" });
            }
        }
        Ok(())
    }
}

/// A crop of an example.
#[derive(Clone, Debug, PartialEq)]
pub struct Crop {
    /// Left and right.
    pub images: [Array2<f32>; 2],
    /// Lines: 1, 0, or NaN.
    pub lines: [Array2<f32>; 2],
    /// Disparity on the left grid, NaN where it is not known.
    pub disparity: Array2<f32>,
}

/// A 2x2 matrix, row by row.
type Matrix = [[f64; 2]; 2];

fn apply(m: &Matrix, v: [f64; 2]) -> [f64; 2] {
    [m[0][0] * v[0] + m[0][1] * v[1], m[1][0] * v[0] + m[1][1] * v[1]]
}

fn inverse(m: &Matrix) -> Matrix {
    let det = m[0][0] * m[1][1] - m[0][1] * m[1][0];
    [[m[1][1] / det, -m[0][1] / det], [-m[1][0] / det, m[0][0] / det]]
}

fn product(a: &Matrix, b: &Matrix) -> Matrix {
    let column = |j: usize| apply(a, [b[0][j], b[1][j]]);
    let (x, y) = (column(0), column(1));
    [[x[0], y[0]], [x[1], y[1]]]
}

fn turn(angle_deg: f64) -> Matrix {
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    [[cos, -sin], [sin, cos]]
}

/// The geometry of a crop (see the top of this file).
#[derive(Clone, Debug)]
pub(super) struct Window {
    pub side: usize,
    /// `A`: source px a crop px.
    pub common: Matrix,
    /// `m`: the source pixel at the crop's centre.
    pub middle: [f64; 2],
    /// `M` and `e` of the right image.
    pub right: (Matrix, [f64; 2]),
    /// `o`: what is taken off the disparity, source px.
    pub offset: f64,
}

impl Window {
    fn centre(&self) -> f64 {
        0.5 * (self.side as f64 - 1.0)
    }

    /// The left source pixel of crop pixel `(x, y)`.
    pub fn left(&self, q: [f64; 2]) -> [f64; 2] {
        let c = self.centre();
        let p = apply(&self.common, [q[0] - c, q[1] - c]);
        [p[0] + self.middle[0], p[1] + self.middle[1]]
    }

    /// The right source pixel of crop pixel `(x, y)`.
    pub fn right(&self, q: [f64; 2]) -> [f64; 2] {
        let c = self.centre();
        let (m, e) = &self.right;
        let moved = apply(m, [q[0] - c, q[1] - c]);
        let p = apply(&self.common, [moved[0] + e[0], moved[1] + e[1]]);
        [p[0] + self.middle[0] + self.offset, p[1] + self.middle[1]]
    }

    /// The disparity in the crop at pixel `q` of one of `d` in the source.
    pub fn disparity(&self, q: [f64; 2], d: f64) -> f64 {
        let c = self.centre();
        let along = apply(&inverse(&self.common), [d - self.offset, 0.0]);
        let (m, e) = &self.right;
        let found = apply(&inverse(m), [q[0] - c + along[0] - e[0], q[1] - c + along[1] - e[1]]);
        found[0] + c - q[0]
    }

    #[cfg(test)]
    pub fn random_for_tests(example: &Example, side: usize, settings: &AugmentSettings, rng: &mut Pcg64) -> Self {
        Self::random(example, Task::Matcher, side, settings, rng)
    }

    fn random(example: &Example, task: Task, side: usize, settings: &AugmentSettings, rng: &mut Pcg64) -> Self {
        let mut within = |most: f64| most * rng.random_range(-1.0..1.0);
        let angle_deg = if task == Task::Detector { within(settings.turn_deg) } else { 0.0 };
        let (row_px, shift_px) = (within(settings.row_px), within(settings.shift_px));
        let misaligned = turn(within(settings.right_turn_deg));
        let [low, high] = settings.scale;
        let scale = low * (high / low).powf(rng.random_range(0.0..1.0));
        let mut sign = || if settings.flip && rng.random_range(0..2) == 1 { -1.0 } else { 1.0 };
        let flips = [[sign() / scale, 0.0], [0.0, sign() / scale]];
        let (height, width) = example.images[0].dim();
        // Crops lie inside the image where they fit.
        let reach = 0.5 * side as f64 / scale;
        let mut place = |length: usize| {
            let (low, high) = (reach - 0.5, length as f64 - 0.5 - reach);
            if high > low { low + (high - low) * rng.random_range(0.0..1.0) } else { 0.5 * (length as f64 - 1.0) }
        };
        let middle = [place(width), place(height)];
        let offset = f64::from(example.median_px) + shift_px;
        let right = if task == Task::Matcher { (misaligned, [0.0, row_px]) } else { (turn(0.0), [0.0; 2]) };
        Self { side, common: product(&turn(angle_deg), &flips), middle, right, offset }
    }
}

impl Crop {
    /// A random crop, its images as networks see them.
    pub fn random(example: &Example, task: Task, side: usize, settings: &AugmentSettings, rng: &mut Pcg64) -> Self {
        // Both views are images with lines.
        let view = if task == Task::Detector { rng.random_range(0..2) } else { 0 };
        let as_it_comes = rng.random_range(0.0..1.0) < AS_THEY_COME;
        let mut crop = Self::cut(example, &Window::random(example, task, side, settings, rng), task, view);
        for _ in 0..TRIES {
            let enough = if task == Task::Detector {
                as_it_comes || crop.lines[0].iter().filter(|line| **line == 1.0).count() >= ENOUGH_LINE
            } else {
                let known = crop.disparity.iter().filter(|d| !d.is_nan()).count();
                known >= if as_it_comes { 1 } else { ENOUGH_LINE }
            };
            if enough {
                break;
            }
            crop = Self::cut(example, &Window::random(example, task, side, settings, rng), task, view);
        }
        crop.change(settings, rng);
        crop.images = crop.images.map(|image| if image.is_empty() { image } else { flattened(&image) });
        crop
    }

    /// The largest square in the middle whose sides are multiples of 64 px, which suit every network; nothing is changed.
    pub(super) fn middle(example: &Example) -> Self {
        let (height, width) = example.images[0].dim();
        let side = (height.min(width) / 64 * 64).max(64);
        let middle = [width, height].map(|length| 0.5 * (length as f64 - 1.0));
        let window = Window { side, common: turn(0.0), middle, right: (turn(0.0), [0.0; 2]), offset: 0.0 };
        let mut crop = Self::cut(example, &window, Task::Matcher, 0);
        crop.images = crop.images.map(|image| flattened(&image));
        crop
    }

    /// The maps in a window, grey values as they are; of one view for the detector.
    pub(super) fn cut(example: &Example, window: &Window, task: Task, view: usize) -> Self {
        let side = window.side;
        let shape = (side, side);
        let image = |view: usize, place: &dyn Fn([f64; 2]) -> [f64; 2]| {
            let source = example.images[view].view();
            Array2::from_shape_fn(shape, |(row, column)| {
                let [x, y] = place([column as f64, row as f64]);
                sample_cubic(&source, x, y).unwrap_or(0.0)
            })
        };
        let nearest = |map: &Array2<f32>, [x, y]: [f64; 2]| {
            let (x, y) = (x.round(), y.round());
            let inside = x >= 0.0 && y >= 0.0 && x < map.ncols() as f64 && y < map.nrows() as f64;
            if inside { map[[y as usize, x as usize]] } else { f32::NAN }
        };
        let lines = |view: usize, place: &dyn Fn([f64; 2]) -> [f64; 2]| {
            Array2::from_shape_fn(shape, |(row, column)| match &example.lines[view] {
                Some(map) => nearest(map, place([column as f64, row as f64])),
                None => f32::NAN,
            })
        };
        let (left, right) = (|q| window.left(q), |q| window.right(q));
        let nothing = || Array2::from_elem((0, 0), 0.0);
        if task == Task::Detector {
            // Single images: `images[1]` stays empty.
            return Self {
                images: [image(view, &left), nothing()],
                lines: [lines(view, &left), nothing()],
                disparity: nothing(),
            };
        }
        let disparity = Array2::from_shape_fn(shape, |(row, column)| {
            let q = [column as f64, row as f64];
            let source = example.disparity.as_ref().map_or(f32::NAN, |map| nearest(map, window.left(q)));
            let found = if source.is_nan() { source } else { window.disparity(q, f64::from(source)) as f32 };
            // A match outside the crop cannot be found.
            let right = column as f32 + found;
            if (0.0..=(side - 1) as f32).contains(&right) { found } else { f32::NAN }
        });
        Self { images: [image(0, &left), image(1, &right)], lines: [lines(0, &left), lines(1, &right)], disparity }
    }

    /// Grey values as another microscope, another exposure or another border would have made them.
    fn change(&mut self, settings: &AugmentSettings, rng: &mut Pcg64) {
        let mut chance = |share: f64| rng.random_range(0.0..1.0) < share;
        let (inverted, border, blurred, noisy) =
            (chance(settings.inverted), chance(settings.border), chance(0.4), chance(0.7));
        let gamma = settings.gamma.powf(rng.random_range(-1.0..1.0));
        let [low, high] = settings.brightness;
        let brightness = low + (high - low) * rng.random_range(0.0..1.0);
        let blur = settings.blur_px * rng.random_range(0.0..1.0);
        let levels = settings.noise.map(|most| most * rng.random_range(0.0_f64..1.0).powi(2));
        let correlation = rng.random_range(0.8..3.0);
        let half_plane = HalfPlane::random(self.images[0].nrows(), rng);
        for view in 0..2 {
            if self.images[view].is_empty() {
                continue;
            }
            let contrast = 1.0 + settings.contrast * rng.random_range(-1.0..1.0);
            let image = &mut self.images[view];
            if blurred && blur > 0.3 {
                *image = gaussian_blur(image, blur);
            }
            if noisy {
                add_noise(image, levels, correlation, rng);
            }
            image.mapv_inplace(|value| {
                let value = if inverted { 1.0 - value } else { value };
                let bent = f64::from(value.clamp(0.0, 2.0)).powf(gamma) + f64::from(value.min(0.0));
                ((0.5 + contrast * (bent - 0.5)) * brightness).clamp(-0.5, 1.5) as f32
            });
            if border {
                let lines = &mut self.lines[view];
                // An image of which nothing is known stays one.
                let known = lines.iter().any(|line| !line.is_nan());
                for ((row, column), value) in image.indexed_iter_mut() {
                    if half_plane.contains(row, column) {
                        *value = 0.0;
                        if known {
                            lines[[row, column]] = 0.0;
                        }
                    }
                }
            }
        }
        if border && !self.disparity.is_empty() {
            for ((row, column), value) in self.disparity.indexed_iter_mut() {
                let right = (column as f32 + *value).max(0.0) as usize;
                if half_plane.contains(row, column) || half_plane.contains(row, right) {
                    *value = f32::NAN;
                }
            }
        }
    }
}

/// A black border along one side, nearly straight.
struct HalfPlane {
    normal: [f64; 2],
    offset: f64,
}

impl HalfPlane {
    fn random(side: usize, rng: &mut Pcg64) -> Self {
        let quarter = f64::from(rng.random_range(0..4)) * 90.0 + rng.random_range(-3.0..3.0);
        let (sin, cos) = quarter.to_radians().sin_cos();
        let half = 0.5 * side as f64;
        let depth = rng.random_range(0.02..0.3) * side as f64;
        // Beyond this distance from the centre, along the normal.
        Self { normal: [cos, sin], offset: (cos + sin) * half + half - depth }
    }

    fn contains(&self, row: usize, column: usize) -> bool {
        self.normal[0] * column as f64 + self.normal[1] * row as f64 > self.offset
    }
}

fn add_noise(image: &mut Array2<f32>, [white, smooth]: [f64; 2], correlation_px: f64, rng: &mut Pcg64) {
    let mut field = |level: f64| {
        Array2::from_shape_simple_fn(image.dim(), || {
            let value: f32 = StandardNormal.sample(rng);
            level as f32 * value
        })
    };
    let fine = field(white);
    // A Gaussian blur of white noise divides its deviation by 2 sqrt(pi) times its width.
    let coarse = gaussian_blur(&field(smooth * 2.0 * std::f64::consts::PI.sqrt() * correlation_px), correlation_px);
    *image += &fine;
    *image += &coarse;
}

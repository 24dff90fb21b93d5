//! How a dislocation is drawn: profile across the line, modulation along it, image shift, and what each view sees.

use ndarray::Array2;
use rand::RngExt;
use rand_pcg::Pcg64;

use crate::geometry::{Point2, Point3, Vector2};
use crate::simulate::camera::Camera;
use crate::simulate::draw::stroke;
use crate::simulate::field::SmoothField;
use crate::simulate::parametric::{LookSettings, chance, log_uniform, per_view};

/// Full width at half maximum of a Gaussian per standard deviation.
const FWHM_PER_SIGMA: f64 = 2.354_820_045;

/// Shape of the profile across a line.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Profile {
    /// One dark trough.
    Single,
    /// A trough with a weaker bright ridge on one side (black-white contrast): relative height and side.
    BlackWhite { height: f32, side: f32 },
    /// Two troughs this many sigma apart: superdislocations, g.b = 2.
    Double { separation: f32 },
    /// A trough with a long tail on one side.
    Skewed { tail: f32, side: f32 },
}

impl Profile {
    /// Value at `u` sigma across the line; the deepest point is about 1.
    fn at(self, u: f32) -> f32 {
        let trough = |u: f32| (-0.5 * u * u).exp();
        match self {
            Profile::Single => trough(u),
            Profile::BlackWhite { height, side } => trough(u) - height * trough(u - 2.4 * side),
            Profile::Double { separation } => trough(u - 0.5 * separation) + trough(u + 0.5 * separation),
            Profile::Skewed { tail, side } => {
                if u * side > 0.0 {
                    trough(u / tail)
                } else {
                    trough(u)
                }
            }
        }
    }

    /// Where the profile's centre of contrast lies, in sigma: the midpoint at half its depth.
    fn centre(self) -> f32 {
        match self {
            Profile::Single | Profile::Double { .. } => 0.0,
            // The bright ridge steepens its side of the trough a little.
            Profile::BlackWhite { height, side } => -0.15 * height * side,
            Profile::Skewed { tail, side } => 0.5 * (tail - 1.0) * 1.177 * side,
        }
    }

    /// How far from the core the profile reaches, in sigma.
    fn reach(self) -> f64 {
        match self {
            Profile::Single => 3.5,
            Profile::BlackWhite { .. } => 6.0,
            Profile::Double { separation } => 3.5 + 0.5 * f64::from(separation),
            Profile::Skewed { tail, .. } => 3.5 * f64::from(tail),
        }
    }
}

/// Contrast along a line.
#[derive(Clone, Debug)]
enum Modulation {
    /// Constant.
    None,
    /// Oscillates with depth, as inclined dislocations do: period in px of depth, strength 0 to 1, phase.
    Depth { period_px: f64, strength: f64, phase: f64 },
    /// Varies irregularly along the line.
    Irregular { length_px: f64, strength: f64, row: f64 },
    /// Broken into beads: period and filled share along the line.
    Beads { period_px: f64, filled: f64, phase: f64 },
}

/// What the lines of one specimen have in common: one foil, one g, one microscope.
#[derive(Clone, Debug)]
pub struct Style {
    sigma_px: f64,
    contrast: f64,
    sign: f64,
    oscillating: bool,
    beaded: bool,
    profile_seed: f64,
    irregular: SmoothField,
}

impl Style {
    /// A random style.
    pub fn random(rng: &mut Pcg64, look: &LookSettings) -> Self {
        Self {
            sigma_px: log_uniform(rng, look.line_width_px) / FWHM_PER_SIGMA,
            contrast: log_uniform(rng, look.line_contrast),
            sign: if chance(rng, look.bright) { -1.0 } else { 1.0 },
            oscillating: chance(rng, 0.3),
            beaded: chance(rng, 0.12),
            profile_seed: rng.random_range(0.0..1.0),
            irregular: SmoothField::new(rng, 4000.0, 20.0),
        }
    }
}

/// A dislocation and its look.
#[derive(Clone, Debug)]
pub struct Line {
    points: Vec<Point3>,
    sigma_px: f64,
    contrast: f64,
    profile: Profile,
    modulation: Modulation,
    /// Contrast centre relative to the core, in px across the line (image shift of diffraction contrast).
    shift_px: f64,
    /// Length over which the ends fade, px.
    fade_px: f64,
    /// Change of strength between views; the weak view's factor, if there is one.
    view_seed: u64,
    weak_view: Option<(usize, f64)>,
    irregular: SmoothField,
}

/// A line as it was drawn in one view.
#[derive(Clone, Debug, PartialEq)]
pub struct DrawnLine {
    /// Projected core in image px, one point for each point of the curve.
    pub core: Vec<Point2>,
    /// Noise-free centre of contrast, aligned with `core`.
    pub contrast_centre: Vec<Point2>,
    /// Contrast at each point relative to the background (the depth of the trough, without sign).
    pub contrast: Vec<f32>,
    /// Full width at half maximum in image px.
    pub width_px: f64,
}

impl Line {
    /// A random look in a style.
    pub fn random(rng: &mut Pcg64, points: Vec<Point3>, style: &Style, look: &LookSettings) -> Self {
        let sigma_px = style.sigma_px * rng.random_range(0.8..1.25);
        let strength = log_uniform(rng, [0.35, 1.3]);
        let side = if chance(rng, 0.5) { 1.0 } else { -1.0 };
        // Lines of one foil mostly share one kind of profile.
        let kind = if chance(rng, 0.7) { style.profile_seed } else { rng.random_range(0.0..1.0) };
        let profile = match kind {
            k if k < 0.55 => Profile::Single,
            k if k < 0.75 => Profile::BlackWhite { height: rng.random_range(0.2..0.8), side },
            k if k < 0.85 => Profile::Double { separation: rng.random_range(2.5..5.0) },
            _ => Profile::Skewed { tail: rng.random_range(1.3..2.5), side },
        };
        let modulation = match rng.random_range(0.0..1.0) {
            _ if style.beaded && chance(rng, 0.7) => Modulation::Beads {
                period_px: sigma_px * rng.random_range(4.0..12.0),
                filled: rng.random_range(0.35..0.8),
                phase: rng.random_range(0.0..1.0),
            },
            _ if style.oscillating && chance(rng, 0.8) => Modulation::Depth {
                period_px: rng.random_range(8.0..50.0),
                strength: rng.random_range(0.2..0.9),
                phase: rng.random_range(0.0..std::f64::consts::TAU),
            },
            u if u < 0.5 => Modulation::Irregular {
                length_px: log_uniform(rng, [6.0, 80.0]),
                strength: rng.random_range(0.1..0.7),
                row: rng.random_range(-1500.0..1500.0),
            },
            _ => Modulation::None,
        };
        Self {
            points,
            sigma_px,
            contrast: style.sign * (style.contrast * strength).min(0.85),
            profile,
            modulation,
            shift_px: if chance(rng, 0.5) { sigma_px * rng.random_range(-1.2..1.2) } else { 0.0 },
            fade_px: if chance(rng, 0.4) { rng.random_range(3.0..40.0) } else { 1.0 },
            view_seed: rng.random_range(0..u64::MAX),
            weak_view: chance(rng, look.one_sided).then(|| {
                (usize::from(chance(rng, 0.5)), if chance(rng, 0.5) { 0.0 } else { rng.random_range(0.1..0.5) })
            }),
            irregular: style.irregular.clone(),
        }
    }

    /// Draws the line into an image and says what was drawn.
    pub fn paint(&self, camera: &Camera, index: usize, image: &mut Array2<f32>) -> DrawnLine {
        let core = camera.project_all(&self.points);
        let strength = self.strength_in(index);
        let contrast: Vec<f32> =
            self.along(&core).into_iter().map(|factor| (self.contrast * strength * factor) as f32).collect();
        let sigma = (self.sigma_px * camera.scale) as f32;
        let shift = (self.shift_px * camera.scale) as f32;
        let (profile, last) = (self.profile, contrast.len().saturating_sub(1));
        let reach = f64::from(sigma) * profile.reach() + f64::from(shift.abs());
        stroke(camera.shape, &core, reach, |row, column, near| {
            let (i, t) = (near.place as usize, near.place.fract());
            let local = contrast[i.min(last)] * (1.0 - t) + contrast[(i + 1).min(last)] * t;
            // Beyond the ends the line is a half-disc of its own profile.
            let across = if near.across.abs() < 0.999 * near.distance {
                near.distance.copysign(near.across)
            } else {
                near.across
            };
            image[[row, column]] *= 1.0 - local * profile.at((across - shift) / sigma);
        });
        let centre = shift + profile.centre() * sigma;
        let contrast_centre = offset_polyline(&core, f64::from(centre));
        let contrast = contrast.into_iter().map(f32::abs).collect();
        DrawnLine { core, contrast_centre, contrast, width_px: f64::from(sigma) * FWHM_PER_SIGMA }
    }

    fn strength_in(&self, index: usize) -> f64 {
        let change = 1.0 + 0.3 * per_view(self.view_seed, index);
        match self.weak_view {
            Some((weak, factor)) if weak == index % 2 => change * factor,
            _ => change,
        }
    }

    /// Factor of the contrast at each point: modulation and faded ends.
    fn along(&self, core: &[Point2]) -> Vec<f64> {
        let mut arc = Vec::with_capacity(core.len());
        let mut length = 0.0;
        for (index, point) in core.iter().enumerate() {
            length += index.checked_sub(1).map_or(0.0, |before| (point - core[before]).norm());
            arc.push(length);
        }
        let factor = |index: usize| {
            let s = arc[index];
            let fade = |distance: f64| (distance / self.fade_px).min(1.0);
            let ends = fade(s + 0.5).min(fade(length - s + 0.5));
            let modulation = match &self.modulation {
                Modulation::None => 1.0,
                Modulation::Depth { period_px, strength, phase } => {
                    let angle = std::f64::consts::TAU * self.points[index].z / period_px + phase;
                    1.0 - strength * (0.5 + 0.5 * angle.cos())
                }
                Modulation::Irregular { length_px, strength, row } => {
                    let value = f64::from(self.irregular.at(s * 20.0 / length_px, *row));
                    (1.0 + strength * value).clamp(0.0, 1.6)
                }
                Modulation::Beads { period_px, filled, phase } => {
                    let wave = (std::f64::consts::TAU * (s / period_px + phase)).cos();
                    let threshold = (std::f64::consts::PI * filled).cos();
                    (0.5 + 4.0 * (wave - threshold)).clamp(0.05, 1.0)
                }
            };
            ends * modulation
        };
        (0..core.len()).map(factor).collect()
    }
}

/// A polyline moved sideways: positive to the right-hand side of its direction on the screen (y down).
pub fn offset_polyline(points: &[Point2], offset_px: f64) -> Vec<Point2> {
    let last = points.len().saturating_sub(1);
    (0..points.len())
        .map(|index| {
            let along = points[(index + 1).min(last)] - points[index.saturating_sub(1)];
            let side = Vector2::new(-along.y, along.x).try_normalize(1e-9).unwrap_or_default();
            points[index] + side * offset_px
        })
        .collect()
}

//! Where the contrast of every line lies in a noise-free image, and how strong it is.
//!
//! Across each point of a line the profile of `(image - background) / background` is sampled perpendicular to the projected
//! line, background being the perfect crystal. Offsets are px, positive on the right of someone walking along the line on
//! the screen (x right, y down), i.e. along `z^ x u`.

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use crate::filter::sample_linear;
use crate::geometry::{Point2, Vector2};
use crate::simulate::{Camera, Foil};

use super::{PhysicsSettings, perfect};

/// Spacing of the samples of a profile, px.
const SAMPLE_PX: f64 = 0.5;

/// What is seen of the lines of a foil in one view; lines in the order of the foil.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ViewTruth {
    /// One entry a dislocation.
    pub lines: Vec<LineTruth>,
}

/// One dislocation in one view; points as in [`crate::simulate::Dislocation::points`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LineTruth {
    /// One entry a point of the dislocation.
    pub points: Vec<CorePoint>,
    /// Whether the last point joins the first.
    pub closed: bool,
}

/// One point of a line in one view.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CorePoint {
    /// The projected core, (x, y) in px.
    pub core_px: Point2,
    /// Unit vector across the projected line, to the right of its direction on the screen.
    pub across: Vector2,
    /// The contrast here; none outside the image or the foil, or where the background is dark (a hole).
    pub contrast: Option<Contrast>,
}

/// Noise-free contrast across a line.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Contrast {
    /// Centre of the strongest contrast from the core, px along [`CorePoint::across`].
    pub offset_px: f64,
    /// Its contrast relative to the local background: negative is dark.
    pub amplitude: f64,
    /// Highest minus lowest relative contrast across the line: above |amplitude| where it is black-white.
    pub peak_to_peak: f64,
    /// Full width at half of the amplitude, px.
    pub width_px: f64,
}

impl CorePoint {
    /// Where the centre of contrast lies, px; the core where there is no contrast.
    pub fn centre_px(&self) -> Point2 {
        self.core_px + self.across * self.contrast.map_or(0.0, |contrast| contrast.offset_px)
    }
}

/// Half-width of the profiles in nm: 0.4 of the effective extinction distance (images are about a third of it wide) and
/// twice the blur.
pub fn profile_half_width_nm(settings: &PhysicsSettings) -> f64 {
    0.4 * perfect::effective_extinction_distance_nm(settings) + 2.0 * settings.blur_nm
}

/// Truth of a view from its noise-free background and the change by the lines, both `[row, column]`.
pub fn measure(
    foil: &Foil,
    settings: &PhysicsSettings,
    view: &Camera,
    background: &Array2<f32>,
    change: &Array2<f32>,
) -> ViewTruth {
    let half_width_px = (profile_half_width_nm(settings) * view.scale).max(3.0);
    let lines = foil.dislocations.iter().map(|dislocation| {
        let projected: Vec<Point2> = dislocation.points.iter().map(|point| view.project(point)).collect();
        let across = normals(&projected, dislocation.closed);
        let points = dislocation.points.iter().zip(&projected).zip(across).map(|((point, &core_px), across)| {
            let thickness = foil.thickness_nm + settings.wedge[0] * point.x + settings.wedge[1] * point.y;
            let inside = point.z.abs() <= 0.5 * thickness + 1e-6;
            let contrast = if inside { profile(core_px, across, half_width_px, background, change) } else { None };
            CorePoint { core_px, across, contrast }
        });
        LineTruth { points: points.collect(), closed: dislocation.closed }
    });
    ViewTruth { lines: lines.collect() }
}

/// Unit normals of a projected polyline; where it is seen end-on, the last known one (x if there is none).
fn normals(points: &[Point2], closed: bool) -> Vec<Vector2> {
    let count = points.len();
    let mut last = Vector2::x();
    (0..count)
        .map(|i| {
            let before = if i > 0 {
                i - 1
            } else if closed {
                count - 1
            } else {
                0
            };
            let after = if i + 1 < count {
                i + 1
            } else if closed {
                0
            } else {
                i
            };
            let along = points[after] - points[before];
            if along.norm() > 1e-6 {
                last = Vector2::new(-along.y, along.x) / along.norm();
            }
            last
        })
        .collect()
}

fn profile(
    core: Point2,
    across: Vector2,
    half_width_px: f64,
    background: &Array2<f32>,
    change: &Array2<f32>,
) -> Option<Contrast> {
    let count = (half_width_px / SAMPLE_PX).ceil() as isize;
    let local = f64::from(sample_linear(&background.view(), core.x, core.y)?);
    if local < 1e-6 {
        return None;
    }
    // Samples beyond the rim of the image are unknown and count as no contrast.
    let at = |step: isize| {
        let place = core + across * (step as f64 * SAMPLE_PX);
        f64::from(sample_linear(&change.view(), place.x, place.y).unwrap_or(0.0)) / local
    };
    let mut values: Vec<f64> = (-count..=count).map(at).collect();
    // What is left at both ends is the long-range strain and the neighbours: a straight line taken off.
    let (first, last) = (values[0], values[values.len() - 1]);
    let steps = (values.len() - 1) as f64;
    for (i, value) in values.iter_mut().enumerate() {
        *value -= first + (last - first) * i as f64 / steps;
    }
    let peak = (0..values.len()).fold(0, |best, i| if values[i].abs() > values[best].abs() { i } else { best });
    let amplitude = values[peak];
    let above_half = |i: &usize| values[*i] * amplitude > 0.5 * amplitude * amplitude;
    let left = (0..=peak).rev().take_while(above_half).last().unwrap_or(peak);
    let right = (peak..values.len()).take_while(above_half).last().unwrap_or(peak);
    let (mut weight, mut moment) = (0.0, 0.0);
    for (i, value) in values.iter().enumerate().take(right + 1).skip(left) {
        weight += value.abs();
        moment += value.abs() * (i as f64 - count as f64) * SAMPLE_PX;
    }
    let offset_px = if weight > 0.0 { moment / weight } else { 0.0 };
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    Some(Contrast { offset_px, amplitude, peak_to_peak: high - low, width_px: (right - left + 1) as f64 * SAMPLE_PX })
}

#[cfg(test)]
mod unit_tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn the_profile_finds_the_centre_depth_and_side_of_a_drawn_line() {
        let background = Array2::from_elem((60, 60), 0.8_f32);
        // Dark, 3 px right of a core at x = 30 that runs up the screen (towards -y): its right is +x.
        let change = Array2::from_shape_fn((60, 60), |(_, x)| -0.4 * (-(x as f32 - 33.0).powi(2) / 8.0).exp());
        let points = [Point2::new(30.0, 40.0), Point2::new(30.0, 30.0), Point2::new(30.0, 20.0)];
        let across = normals(&points, false)[1];
        assert_relative_eq!(across, Vector2::x(), epsilon = 1e-12);
        let contrast = profile(points[1], across, 12.0, &background, &change).unwrap();
        assert_relative_eq!(contrast.offset_px, 3.0, epsilon = 0.05);
        assert_relative_eq!(contrast.amplitude, -0.5, epsilon = 1e-3);
        assert_relative_eq!(contrast.peak_to_peak, 0.5, epsilon = 1e-3);
        // 2.355 sigma, sampled every half pixel.
        assert_relative_eq!(contrast.width_px, 4.71, epsilon = 0.5);
        assert!(profile(Point2::new(-5.0, 3.0), across, 12.0, &background, &change).is_none());
    }
}

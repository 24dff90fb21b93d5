//! More than two views: each curve a smooth spline in the foil, fitted to the lines of all views at once, together with shifts,
//! turns, magnifications and small errors of the tilts.
//!
//! Robust, sparse least squares: project the splines, measure the offset to the line across them in every view ([`observe`]), solve
//! for curves and poses ([`solve`]), repeat. Priors hold each tilt to 0.1 degree and their mean altogether (a common change only
//! turns the foil), and the pair's views to the rows that its rectification gave them; the shift and magnification of the first
//! view, and the shift of the second along the rows, are the frame.
//! [`grow`] starts from a pair and takes in views by and by; [`volume`] adds the lines that only all views together show,
//! [`faint`] those of which the detector knows next to nothing, and [`settle`] finds poses without the pair's curves where these are wrong.

mod consensus;
mod evidence;
mod faint;
mod frame;
mod grid;
mod grow;
mod likeness;
mod observe;
mod settle;
mod solve;
mod spline;
#[cfg(test)]
mod tests;
mod tomogram;
mod volume;

pub use frame::{SeriesFit, reconstruct_series};
pub use grow::{Grown, grow};

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::{LineIndex, ViewPose};
use crate::geometry::{Point3, Vector3};
use observe::{Noise, Sampled, observe};
use solve::{CurveProblem, Observation, PER_VIEW, Prior, Step};
use spline::{Basis, Spline};

/// Settings of the fit to all views.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FitSettings {
    /// One-sigma prior of the error of a tilt, degrees.
    pub tilt_sigma_deg: f64,
    /// One-sigma prior of the turn of a view against that of the pair, beyond what all views share, degrees.
    pub turn_sigma_deg: f64,
    /// One-sigma prior of the direction of the tilt axis, which all views share, degrees.
    pub axis_sigma_deg: f64,
    /// One-sigma prior of the relative magnification of a view.
    pub scale_sigma: f64,
    /// One-sigma prior of the rows of the pair's views against each other, px, in the middle of an image and at a quarter of its longer
    /// side from there: what their rectification leaves, at least (where it says that more is left, that counts).
    pub pair_row_sigma_px: f64,
    /// How readily curves bend: spectral density of the random walk of their slope, px^2 / px^3.
    pub roughness: f64,
    /// Largest offset between a projected curve and a line of a view, px.
    pub reach_px: f64,
    /// Rounds of the last fit.
    pub rounds: usize,
}

impl Default for FitSettings {
    fn default() -> Self {
        Self {
            tilt_sigma_deg: 0.1,
            turn_sigma_deg: 0.6,
            axis_sigma_deg: 1.0,
            scale_sigma: 0.003,
            pair_row_sigma_px: 0.3,
            roughness: 1e-3,
            reach_px: 3.0,
            rounds: 10,
        }
    }
}

/// What holds the frame is fixed to this, px and relative.
const FIXED: f64 = 1e-5;
/// The mean of the tilts is held to this, degrees.
const MEAN_TILT_SIGMA_DEG: f64 = 1e-3;
/// A step of a round is cut to this, px.
const MOST_STEP_PX: f64 = 6.0;

/// Depths from the pair are held with so many times their sigma.
const HELD_SIGMAS: f64 = 2.0;

/// Errors of the pair's depths are alike over so many px.
const HELD_CORRELATION_PX: f64 = 20.0;

/// A curve that the fit starts from.
#[derive(Clone, Debug, PartialEq)]
pub struct StartCurve {
    /// Points in the frame of the poses, px, at least two.
    pub points: Vec<Point3>,
    /// One sigma of z at each, px.
    pub sigma_z: Vec<f64>,
    /// Whether the last point joins the first.
    pub closed: bool,
}

impl StartCurve {
    /// Length from the first point to the last, px.
    fn length_px(&self) -> f64 {
        self.points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum()
    }
}

/// A view in the fit.
#[derive(Clone, Debug)]
pub struct FitView {
    /// Its place in [`super::Series::views`].
    pub view: usize,
    /// Its pose; the tilt is the nominal one plus what the fit found.
    pub pose: ViewPose,
    /// Its tilt before the fit, radians.
    pub nominal_rad: f64,
    /// Its lines.
    pub lines: LineIndex,
}

impl FitView {
    /// A view as it is before the fit.
    pub fn new(view: usize, pose: ViewPose, lines: LineIndex) -> Self {
        Self { view, pose, nominal_rad: pose.tilt_rad, lines }
    }
}

/// A fitted curve.
#[derive(Clone, Debug, PartialEq)]
pub struct FittedCurve {
    /// Points in the frame of the poses, px, as many as the curve had.
    pub points: Vec<Point3>,
    /// One sigma of z at each, px: curve and poses together; of a faint curve, that of the tomogram's voxels.
    pub sigma_z: Vec<f64>,
    /// In how many views each point lies on a line.
    pub seen: Vec<usize>,
    /// Whether the last point joins the first.
    pub closed: bool,
    /// Share of the places in the images of views at which a line is found, over the views that are not of the pair; 0 without.
    pub support: f64,
}

impl FittedCurve {
    /// The curve as the start of another fit.
    fn as_start(&self) -> StartCurve {
        let sigma_z = self.sigma_z.iter().map(|sigma| sigma.min(100.0)).collect();
        StartCurve { points: self.points.clone(), sigma_z, closed: self.closed }
    }
}

/// A depth that is known from elsewhere than the lines.
struct KnownDepth {
    place: spline::Weights,
    z: f64,
    sigma: f64,
    /// Share of it that is independent of its neighbours.
    share: f64,
}

/// How well the poses are known that a fit starts from.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Hold {
    /// One sigma of the place of a view, px.
    shift_px: f64,
    /// Share of the sigmas of turn and magnification in the settings.
    share: f64,
}

impl Hold {
    /// Hardly: places are wide open, but a view without observations stays soluble.
    const LOOSE: Self = Self { shift_px: 50.0, share: 1.0 };
    /// As well as views agree on them by all that they show: most are good to half a px, of the far ones some are not.
    const AGREED: Self = Self { shift_px: 1.0, share: 0.5 };
    /// Curves are fitted to views as they are.
    const FIRM: Self = Self { shift_px: 0.1, share: 0.1 };
}

/// Curves and poses while they are fitted.
struct Problem {
    splines: Vec<Sampled>,
    views: Vec<FitView>,
    /// The poses that the priors are about, and how well they hold.
    start: Vec<ViewPose>,
    hold: Hold,
    noise: Vec<Noise>,
    /// Depths that are known beforehand, for each curve.
    depths: Vec<Vec<KnownDepth>>,
    /// Equations of the last round.
    step: Option<Step>,
}

impl Problem {
    fn new(curves: &[StartCurve], views: Vec<FitView>, settings: &FitSettings) -> Self {
        let splines = curves.iter().map(|curve| sampled(curve, settings.roughness)).collect();
        let noise = vec![Noise::default(); views.len()];
        let start = views.iter().map(|view| view.pose).collect();
        Self { splines, start, hold: Hold::LOOSE, views, noise, depths: Vec::new(), step: None }
    }

    /// Holds curves to the depths that they start with, as far as these are known. What they are known from are the lines of the pair,
    /// which are seen by the fit as well: sigma is taken for larger than it is.
    fn hold_depths(&mut self, curves: &[StartCurve]) {
        let of_curve = |(sampled, curve): (&Sampled, &StartCurve)| {
            let last = sampled.points.len() - 1;
            let spacing = sampled.points[last] / last.max(1) as f64;
            let known = |((place, point), sigma): ((&f64, &Point3), &f64)| KnownDepth {
                place: sampled.spline.basis.at(*place),
                z: point.z,
                sigma: HELD_SIGMAS * sigma.max(0.1),
                share: (spacing / HELD_CORRELATION_PX).min(1.0),
            };
            sampled.points.iter().zip(&curve.points).zip(&curve.sigma_z).map(known).collect()
        };
        self.depths = self.splines.iter().zip(curves).map(of_curve).collect();
    }

    /// What is known of the depths of a curve, as observations; depths that are far off count for less.
    fn depths_of(&self, index: usize) -> Vec<Observation> {
        let spline = &self.splines[index].spline;
        let observation = |known: &KnownDepth| {
            let offset_px = known.z - spline.at(&known.place)[0].z;
            let far = (observe::HUBER * known.sigma / offset_px.abs().max(1e-9)).min(1.0);
            Observation {
                view: 0,
                weights: known.place,
                per_point: Vector3::z(),
                per_view: [0.0; PER_VIEW],
                offset_px,
                weight: known.share * far / known.sigma.powi(2),
            }
        };
        self.depths.get(index).map_or(Vec::new(), |depths| depths.iter().map(observation).collect())
    }

    /// Takes in another view. Its turn and magnification are held to the pair's, not to those it was registered with: errors would
    /// go on from view to view.
    fn add(&mut self, view: FitView) {
        let ViewPose { tilt_rad, .. } = view.pose;
        let start = ViewPose::new(tilt_rad, self.start[0].axis_rad(), self.start[0].scale(), view.pose.origin());
        self.add_held(view, start);
    }

    /// Takes in another view that is held to a pose.
    fn add_held(&mut self, view: FitView, to: ViewPose) {
        self.start.push(to);
        self.noise.push(Noise::default());
        self.views.push(view);
    }

    /// Rounds of the fit, with lines looked for within a reach that goes from the first to the second.
    fn run(&mut self, rounds: usize, reach_px: [f64; 2], settings: &FitSettings) {
        for round in 0..rounds {
            let share = round as f64 / rounds.saturating_sub(1).max(1) as f64;
            let reach = reach_px[0] + (reach_px[1] - reach_px[0]) * share;
            let observed = observe(&self.splines, &self.views, &mut self.noise, reach);
            let curves: Vec<CurveProblem> = self
                .splines
                .iter()
                .zip(observed)
                .enumerate()
                .map(|(index, (sampled, mut observations))| {
                    observations.extend(self.depths_of(index));
                    CurveProblem {
                        normals: sampled.spline.normals(),
                        bending: spline::bending(&sampled.spline.basis, &sampled.places, settings.roughness),
                        controls: sampled.spline.controls.clone(),
                        observations,
                    }
                })
                .collect();
            let Some(step) = solve::solve(curves, &self.prior(settings)) else { return };
            for (sampled, moves) in self.splines.iter_mut().zip(&step.controls) {
                for (control, by) in sampled.spline.controls.iter_mut().zip(moves) {
                    *control += by * (MOST_STEP_PX / by.norm().max(MOST_STEP_PX));
                }
            }
            for (view, [x, y, turn, grown, tilt]) in self.views.iter_mut().zip(&step.views) {
                let shift = crate::geometry::Vector2::new(*x, *y);
                view.pose = view.pose.changed(*tilt, *turn, *grown, shift, &crate::geometry::Point2::origin());
            }
            self.step = Some(step);
        }
    }

    /// Priors of the views' numbers about their starts, and the frame.
    fn prior(&self, settings: &FitSettings) -> Prior {
        let count = self.views.len();
        let mut matrix = DMatrix::<f64>::zeros(PER_VIEW * count, PER_VIEW * count);
        let mut right = DVector::<f64>::zeros(PER_VIEW * count);
        // A weighted sum of numbers that should be zero: their places and weights, how far off it is, its sigma.
        let mut hold = |numbers: &[(usize, f64)], off: f64, sigma: f64| {
            for &(a, of_a) in numbers {
                right[a] -= of_a * off / (sigma * sigma);
                for &(b, of_b) in numbers {
                    matrix[(a, b)] += of_a * of_b / (sigma * sigma);
                }
            }
        };
        let tilt_sigma = settings.tilt_sigma_deg.max(1e-6).to_radians();
        let turn_sigma = self.hold.share * settings.turn_sigma_deg.max(1e-6).to_radians();
        let scale_sigma = self.hold.share * settings.scale_sigma.max(1e-9);
        let off = |index: usize| {
            let (pose, start) = (&self.views[index].pose, &self.start[index]);
            let turned = pose.axis_rad() - start.axis_rad();
            (pose.origin() - start.origin(), turned.sin().atan2(turned.cos()), (pose.scale() / start.scale()).ln())
        };
        let rows = settings.pair_row_sigma_px.max(FIXED);
        let longer_side = self.views.first().map_or(1, |view| view.lines.lines().shape.into_iter().max().unwrap_or(1));
        // Of the turn and the magnification of the pair's views against each other.
        let pair_sigma = rows / (0.25 * longer_side as f64);
        for (index, view) in self.views.iter().enumerate() {
            let first = PER_VIEW * index;
            let (moved, turned, grown) = off(index);
            // The views of the pair are the frame: the place of one, and of the other along the rows.
            let (sin, cos) = self.start[index].axis_rad().sin_cos();
            let [along, across] =
                [[FIXED, FIXED], [FIXED, rows]].get(index).copied().unwrap_or([self.hold.shift_px; 2]);
            hold(&[(first, cos), (first + 1, sin)], cos * moved.x + sin * moved.y, along);
            hold(&[(first, -sin), (first + 1, cos)], cos * moved.y - sin * moved.x, across);
            hold(&[(first + 2, 1.0)], turned, turn_sigma);
            hold(
                &[(first + 3, 1.0)],
                grown,
                [FIXED, pair_sigma.min(scale_sigma)].get(index).copied().unwrap_or(scale_sigma),
            );
            hold(&[(first + 4, 1.0)], view.pose.tilt_rad - view.nominal_rad, tilt_sigma);
        }
        if count > 1 {
            // Lines that run along the tilt axis hardly show a turn of the pair's views against each other: it looks like depth. The
            // rectification knows it from the rows of points that are no lines.
            hold(&[(2, -1.0), (PER_VIEW + 2, 1.0)], off(1).1 - off(0).1, pair_sigma);
        }
        // Turns of views are independent of each other but for the error of the axis, which they share: their covariance is
        // turn^2 I + axis^2 (1 1'), and this is what its inverse has less than I / turn^2.
        let axis_sigma = settings.axis_sigma_deg.max(0.0).to_radians();
        let shared =
            axis_sigma.powi(2) / (turn_sigma.powi(2) * (turn_sigma.powi(2) + count as f64 * axis_sigma.powi(2)));
        let turned: f64 = (0..count).map(|index| off(index).1).sum();
        for a in 0..count {
            right[PER_VIEW * a + 2] += shared * turned;
            for b in 0..count {
                matrix[(PER_VIEW * a + 2, PER_VIEW * b + 2)] -= shared;
            }
        }
        // The mean of the errors of tilt: sum(delta) / n = 0.
        let sigma = MEAN_TILT_SIGMA_DEG.to_radians() * count as f64;
        let sum: f64 = self.views.iter().map(|view| view.pose.tilt_rad - view.nominal_rad).sum();
        for a in 0..count {
            right[PER_VIEW * a + 4] -= sum / (sigma * sigma);
            for b in 0..count {
                matrix[(PER_VIEW * a + 4, PER_VIEW * b + 4)] += 1.0 / (sigma * sigma);
            }
        }
        Prior { matrix, right }
    }

    /// The curves as points again, at the places that those of the start had.
    fn fitted(&mut self, reach_px: f64) -> Vec<FittedCurve> {
        let seen = observe::seen(&self.splines, &self.views, reach_px);
        let curve = |(index, sampled): (usize, &Sampled)| {
            let at = |place: &f64| sampled.spline.basis.at(*place);
            let points = sampled.points.iter().map(|place| Point3::from(sampled.spline.at(&at(place))[0])).collect();
            let variance = |place: &f64| {
                let step = self.step.as_ref()?;
                step.variance(index, &at(place), &Vector3::z())
            };
            let sigma_z = sampled.points.iter().map(|place| variance(place).map_or(f64::INFINITY, f64::sqrt)).collect();
            FittedCurve { points, sigma_z, seen: seen[index].0.clone(), closed: sampled.closed, support: seen[index].1 }
        };
        self.splines.iter().enumerate().map(curve).collect()
    }

    /// The lines that the curves have at present, for the search of further views.
    fn points_with_tangents(&self) -> Vec<(Point3, Vector3)> {
        let of_curve = |sampled: &Sampled| {
            let at = |place: &f64| {
                let [point, first, _] = sampled.spline.at(&sampled.spline.basis.at(*place));
                (Point3::from(point), first)
            };
            sampled.points.iter().map(at).collect::<Vec<_>>()
        };
        self.splines.iter().flat_map(of_curve).collect()
    }
}

/// The spline through a curve's points; places are arc lengths of the projection, in which points are known well.
fn sampled(curve: &StartCurve, roughness: f64) -> Sampled {
    let mut points = vec![0.0];
    for pair in curve.points.windows(2) {
        let last = points[points.len() - 1];
        points.push(last + (pair[1].xy() - pair[0].xy()).norm().max(1e-3));
    }
    let mut length = points[points.len() - 1];
    if curve.closed {
        length += (curve.points[0].xy() - curve.points[curve.points.len() - 1].xy()).norm();
    }
    let weights: Vec<Vector3> = curve
        .sigma_z
        .iter()
        .map(|sigma| Vector3::new(4.0, 4.0, 1.0 / (observe::CORRELATION_PX * sigma.max(0.1).powi(2))))
        .collect();
    let spline = Spline::through(Basis::new(length, curve.closed), &points, &curve.points, &weights, roughness);
    Sampled::new(spline, points, length, curve.closed)
}

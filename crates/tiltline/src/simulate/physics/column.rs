//! Two beams through one column of a strained crystal (column approximation).
//!
//! The strain enters the equations of [`super::perfect`] only as a local deviation `sigma(z) = s + beta(z)`, with
//! `beta = d(g . R)/dz` (Hirsch et al. 1965, chapter 10). The column is cut into slices, halved until each is short
//! against its distance to every core; over a slice the exponential of the fourth-order Magnus expansion with two Gauss
//! points is taken in closed form (Iserles & Norsett 1999): with `eta = sqrt(3)/6 pi h (sigma_1 - sigma_2)`,
//!
//! `M = [[-sigma, q (1 + i eta)], [q (1 - i eta), sigma]]`, `k^2 = sigma^2 + q^2 (1 + eta^2)`,
//! `exp(i pi h M) = cos(pi k h) + i pi h M sin(pi k h) / (pi k h)`.
//!
//! Turning the column upside down transposes the product of the slices exactly, as it does in the equations. nm and 1/nm.

use std::f64::consts::PI;

use nalgebra::Complex;

use crate::geometry::Point3;
use crate::simulate::Foil;

use super::lines::Line;
use super::perfect::{self, Cone};
use super::segment::add_chain;
use super::{PhysicsError, PhysicsSettings, beam};

/// A slice is no longer than this share of its distance to the nearest core: intensities are right to 2e-3 (tested), below
/// the tolerance of the interpolation between pixels.
const SLICE_SHARE: f64 = 0.6;
/// And turns the phases by no more than this, rad, so that short series give sine and cosine to 1e-8.
const SLICE_PHASE_RAD: f64 = 1.8;
/// There are at least this many, for the slow strain of far lines.
const FEWEST_SLICES: f64 = 6.0;
/// The strain of lines further from the column than this share of its length is smooth along it: it is computed at
/// [`NODES`] Chebyshev points and interpolated. It is analytic up to 0.6 half-lengths off the axis there, so that the
/// error is below 1.77^-8 of a strain that is itself small.
const FAR_SHARE: f64 = 0.3;
const NODES: usize = 8;

/// All columns of a foil in one view.
#[derive(Clone, Debug)]
pub struct Columns {
    settings: PhysicsSettings,
    tilt_rad: f64,
    thickness_nm: f64,
    lines: Vec<Line>,
    cone: Cone,
    largest_deviation: f64,
}

/// A column through the foil: its place along the beam, its length and its deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Column {
    /// Depth of the entrance surface along the beam, nm.
    pub top_nm: f64,
    /// Length in the foil along the beam, nm; 0 where the wedge has come to an end.
    pub length_nm: f64,
    /// s_g of the perfect crystal here, 1/nm.
    pub deviation_per_nm: f64,
}

/// Buffers of one thread.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    vertices: Vec<Point3>,
    chains: Vec<Chain>,
    cores: Vec<Core>,
    slices: Vec<[f64; 2]>,
    depths: Vec<f64>,
    beta: Vec<f64>,
    node_depths: Vec<f64>,
    node_beta: Vec<f64>,
    inverse: [Vec<f64>; 2],
    waves: [Vec<f64>; 4],
}

/// Some neighbouring segments of a line in reach of the column.
#[derive(Clone, Debug)]
struct Chain {
    line: usize,
    vertices: std::ops::Range<usize>,
    /// Where the column is for this line: see [`outside_core`].
    at: [f64; 2],
    weight: f64,
    /// Whether all of them are far.
    far: bool,
}

/// Where a piece of line comes closest to the column.
#[derive(Clone, Copy, Debug)]
struct Core {
    depth: f64,
    lateral2: f64,
    /// Sine of the angle between line and beam.
    steepness: f64,
}

impl Columns {
    /// The columns of `foil` at `tilt_rad`.
    ///
    /// # Errors
    /// [`PhysicsError`] for a foil or settings that make no sense, with the value.
    pub fn new(foil: &Foil, settings: &PhysicsSettings, tilt_rad: f64) -> Result<Self, PhysicsError> {
        settings.validate()?;
        beam::validate_foil(foil)?;
        let lines: Vec<Line> = (0..foil.dislocations.len())
            .map(|line| Line::new(foil, line, settings, tilt_rad))
            .collect::<Result<_, _>>()?;
        // The cone must resolve the thickest column; the wedge may double the thickness within the field at most.
        let slope = settings.wedge.map(f64::abs);
        let thickest = foil.thickness_nm + 0.5 * (slope[0] * foil.size_nm[0] + slope[1] * foil.size_nm[1]);
        let cone = Cone::new(settings, thickest / tilt_rad.cos());
        let largest_deviation = settings.deviation_spread_per_nm();
        Ok(Self {
            settings: settings.clone(),
            tilt_rad,
            thickness_nm: foil.thickness_nm,
            lines,
            cone,
            largest_deviation,
        })
    }

    /// The column at (x, y) nm of the projected plane.
    pub fn column(&self, [x, y]: [f64; 2]) -> Column {
        let cos = self.tilt_rad.cos();
        let specimen_x = x / cos;
        let [slope_x, slope_y] = self.settings.wedge;
        let thickness = self.thickness_nm + slope_x * specimen_x + slope_y * y;
        let length_nm = (thickness / cos).max(0.0);
        Column {
            top_nm: -x * self.tilt_rad.tan() - 0.5 * length_nm,
            length_nm,
            deviation_per_nm: self.settings.deviation_at(specimen_x, y, self.tilt_rad),
        }
    }

    /// Recorded intensity of the perfect crystal at (x, y).
    pub fn background(&self, at: [f64; 2]) -> f64 {
        let column = self.column(at);
        perfect::recorded_intensity(&self.settings, &self.cone, column.length_nm, column.deviation_per_nm)
    }

    /// Lateral distance in nm from (x, y) to the nearest line, looked for up to `limit`.
    pub fn distance_to_lines(&self, at: [f64; 2], limit: f64, scratch: &mut Scratch) -> f64 {
        let mut nearest = limit;
        for line in &self.lines {
            if line.distance_to_box(at) < nearest {
                scratch.vertices.clear();
                let [dx, dy] = line.seen_from(at, &mut scratch.vertices);
                nearest = nearest.min((dx * dx + dy * dy).sqrt());
            }
        }
        nearest
    }

    /// What the lines change of the recorded intensity at (x, y): that of the strained column less the perfect one's.
    pub fn change(&self, at: [f64; 2], scratch: &mut Scratch) -> f64 {
        let column = self.column(at);
        if column.length_nm == 0.0 || !self.gather(at, &column, scratch) {
            return 0.0;
        }
        let Scratch { vertices, chains, cores, slices, depths, beta, node_depths, node_beta, inverse, waves } = scratch;
        let s_max = column.deviation_per_nm.abs() + self.largest_deviation;
        let longest = SLICE_PHASE_RAD / (PI * s_max.hypot(1.0 / self.settings.extinction_distance_nm));
        let count = (column.length_nm / longest).max(FEWEST_SLICES).ceil();
        let step = column.length_nm / count;
        slices.clear();
        for index in 0..count as usize {
            let top = column.top_nm + index as f64 * step;
            cut([top, top + step], cores, slices);
        }
        depths.clear();
        for [top, bottom] in slices.iter() {
            let (middle, offset) = (0.5 * (top + bottom), (bottom - top) / 12.0_f64.sqrt());
            depths.extend([middle - offset, middle + offset]);
        }
        beta.clear();
        beta.resize(depths.len(), 0.0);
        let centre = column.top_nm + 0.5 * column.length_nm;
        node_depths.clear();
        node_depths.extend(chebyshev_points().map(|point| centre + 0.5 * column.length_nm * point));
        node_beta.clear();
        node_beta.resize(NODES, 0.0);
        let [inverse, inverse_next] = inverse;
        for chain in chains.iter() {
            let contrast = &self.lines[chain.line].contrast;
            let (z, beta) = if chain.far { (&*node_depths, &mut *node_beta) } else { (&*depths, &mut *beta) };
            let vertices = &vertices[chain.vertices.clone()];
            add_chain(contrast, vertices, chain.at, z, chain.weight, beta, [inverse, inverse_next]);
        }
        if chains.iter().any(|chain| chain.far) {
            let coefficients = chebyshev_coefficients(node_beta);
            for (beta, depth) in beta.iter_mut().zip(depths.iter()) {
                *beta += chebyshev_sum(&coefficients, (depth - centre) / (0.5 * column.length_nm));
            }
        }
        self.propagate(&column, slices, beta, waves)
            - perfect::recorded_intensity(&self.settings, &self.cone, column.length_nm, column.deviation_per_nm)
    }

    /// Recorded intensity at (x, y).
    pub fn intensity(&self, at: [f64; 2], scratch: &mut Scratch) -> f64 {
        self.background(at) + self.change(at, scratch)
    }

    /// Collects the chains of vertices in reach, their weights and their cores; false if there are none.
    fn gather(&self, at: [f64; 2], column: &Column, scratch: &mut Scratch) -> bool {
        let Scratch { vertices, chains, cores, .. } = scratch;
        vertices.clear();
        chains.clear();
        cores.clear();
        let reach = self.settings.reach_nm;
        for (index, line) in self.lines.iter().enumerate() {
            if line.distance_to_box(at) >= reach {
                continue;
            }
            let start = vertices.len();
            let [dx, dy] = line.seen_from(at, vertices);
            let nearest = (dx * dx + dy * dy).sqrt();
            if nearest >= reach {
                vertices.truncate(start);
                continue;
            }
            let weight = fade(nearest / reach);
            let at = outside_core(at, [dx, dy], self.settings.core_radius_nm, line);
            let far_nm = FAR_SHARE * column.length_nm;
            // Runs of near and of far segments; a run starts with the last vertex of the one before.
            let mut run = Chain { line: index, vertices: start..start + 1, at, weight, far: false };
            for (offset, ends) in vertices[start..].windows(2).enumerate() {
                let core = closest_approach(&ends[0], &ends[1], at);
                let far = core.lateral2 > far_nm * far_nm;
                if far != run.far && run.vertices.len() > 1 {
                    chains.push(run.clone());
                    run.vertices = start + offset..start + offset + 1;
                }
                run.far = far;
                run.vertices.end += 1;
                if !far {
                    cores.push(core);
                }
            }
            chains.push(run);
        }
        !chains.is_empty()
    }

    /// Both waves through all slices, for all directions of the cone; the recorded intensity.
    fn propagate(&self, column: &Column, slices: &[[f64; 2]], beta: &[f64], waves: &mut [Vec<f64>; 4]) -> f64 {
        let q = perfect::coupling(&self.settings);
        let q2 = q * q;
        let count = self.cone.len();
        for wave in waves.iter_mut() {
            wave.clear();
            wave.resize(count, 0.0);
        }
        waves[0].fill(1.0);
        for (slice, beta) in slices.iter().zip(beta.chunks_exact(2)) {
            let length = slice[1] - slice[0];
            let mean = column.deviation_per_nm + 0.5 * (beta[0] + beta[1]);
            let eta = 3.0_f64.sqrt() / 6.0 * PI * length * (beta[0] - beta[1]);
            let step = Slice { phase_per_k: PI * length, mean, eta, q, k2: q2 * (1.0 + eta * eta) };
            let largest = step.phase_per_k.powi(2) * ((mean.abs() + self.largest_deviation).powi(2) + step.k2.norm());
            // As many terms as leave 1e-8.
            let offsets = &self.cone.offset_per_nm;
            match largest {
                0.0..0.1 => step.apply(offsets, waves, series::<3>),
                0.1..1.0 => step.apply(offsets, waves, series::<5>),
                1.0..4.0 => step.apply(offsets, waves, series::<7>),
                4.0..9.0 => step.apply(offsets, waves, series::<9>),
                _ => step.apply(offsets, waves, cosine_and_sine),
            }
        }
        let absorbed = perfect::normal_absorption(&self.settings, column.length_nm);
        let [direct_re, direct_im, diffracted_re, diffracted_im] = waves;
        let mut sum = 0.0;
        for (direction, weight) in self.cone.weight.iter().enumerate() {
            let direct = direct_re[direction].powi(2) + direct_im[direction].powi(2);
            let diffracted = diffracted_re[direction].powi(2) + diffracted_im[direction].powi(2);
            sum += weight * perfect::recorded(self.settings.detector, direct * absorbed, diffracted * absorbed);
        }
        sum
    }
}

/// One slice of the crystal.
struct Slice {
    /// pi h.
    phase_per_k: f64,
    /// s + mean beta.
    mean: f64,
    eta: f64,
    q: Complex<f64>,
    /// q^2 (1 + eta^2).
    k2: Complex<f64>,
}

impl Slice {
    /// Carries the waves (direct re, im, diffracted re, im; one entry a direction) through the slice.
    fn apply(&self, offsets: &[f64], waves: &mut [Vec<f64>; 4], functions: impl Fn(f64, f64) -> [f64; 4]) {
        let [d_re, d_im, g_re, g_im] = waves;
        let phase2 = self.phase_per_k * self.phase_per_k;
        let w_im = phase2 * self.k2.im;
        // i pi h q, to be multiplied by sin(x)/x.
        let (iq_re, iq_im) = (-self.phase_per_k * self.q.im, self.phase_per_k * self.q.re);
        let waves = d_re.iter_mut().zip(d_im).zip(g_re.iter_mut().zip(g_im));
        for (((d_re, d_im), (g_re, g_im)), offset) in waves.zip(offsets) {
            let sigma = self.mean + offset;
            let [c_re, c_im, s_re, s_im] = functions(phase2 * (sigma * sigma + self.k2.re), w_im);
            // i pi h sigma sin(x)/x.
            let (p_re, p_im) = (-self.phase_per_k * sigma * s_im, self.phase_per_k * sigma * s_re);
            let (f_re, f_im) = (iq_re * s_re - iq_im * s_im, iq_re * s_im + iq_im * s_re);
            // Off-diagonal elements f (1 +- i eta).
            let (up_re, up_im) = (f_re - self.eta * f_im, f_im + self.eta * f_re);
            let (down_re, down_im) = (f_re + self.eta * f_im, f_im - self.eta * f_re);
            let (a_re, a_im) = (c_re - p_re, c_im - p_im);
            let (b_re, b_im) = (c_re + p_re, c_im + p_im);
            let direct = (*d_re, *d_im);
            let diffracted = (*g_re, *g_im);
            *d_re = a_re * direct.0 - a_im * direct.1 + up_re * diffracted.0 - up_im * diffracted.1;
            *d_im = a_re * direct.1 + a_im * direct.0 + up_re * diffracted.1 + up_im * diffracted.0;
            *g_re = down_re * direct.0 - down_im * direct.1 + b_re * diffracted.0 - b_im * diffracted.1;
            *g_im = down_re * direct.1 + down_im * direct.0 + b_re * diffracted.1 + b_im * diffracted.0;
        }
    }
}

/// `cos(sqrt w)` and `sin(sqrt w) / sqrt w` (re, im, re, im) by TERMS terms of their power series after the first: the
/// error is `|w|^(TERMS + 1) / (2 TERMS + 2)!`.
#[inline(always)]
fn series<const TERMS: usize>(re: f64, im: f64) -> [f64; 4] {
    let horner = |first: f64| {
        // Coefficients 1, -1/(a b), ... with a b running over 1*2, 3*4, ... (cosine) or 2*3, 4*5, ... (sine).
        let (mut x, mut y) = (1.0, 0.0);
        for term in (0..TERMS).rev() {
            let a = first + 2.0 * term as f64;
            let factor = -1.0 / (a * (a + 1.0));
            (x, y) = (1.0 + factor * (x * re - y * im), factor * (x * im + y * re));
        }
        [x, y]
    };
    let ([c_re, c_im], [s_re, s_im]) = (horner(1.0), horner(2.0));
    [c_re, c_im, s_re, s_im]
}

/// The same in closed form, for any w (not near 0).
fn cosine_and_sine(re: f64, im: f64) -> [f64; 4] {
    let root = Complex::new(re, im).sqrt();
    let (cosine, sine) = (root.cos(), root.sin() / root);
    [cosine.re, cosine.im, sine.re, sine.im]
}

/// Halves a slice until it is short enough; appends the pieces in order of depth.
fn cut([top, bottom]: [f64; 2], cores: &[Core], out: &mut Vec<[f64; 2]>) {
    let length = bottom - top;
    let too_long = cores.iter().any(|core| {
        let gap = (top - core.depth).max(core.depth - bottom).max(0.0) * core.steepness;
        let distance2 = core.lateral2 + gap * gap;
        (length * core.steepness).powi(2) > SLICE_SHARE * SLICE_SHARE * distance2
    });
    if too_long && length > 1e-3 {
        let middle = 0.5 * (top + bottom);
        cut([top, middle], cores, out);
        cut([middle, bottom], cores, out);
    } else {
        out.push([top, bottom]);
    }
}

/// The column, moved sideways out of the core of a line that lies (dx, dy) from it. The linear strain is meaningless in
/// there, but its phase is not: it tends to the same column from both sides where g . b is an integer.
fn outside_core([x, y]: [f64; 2], [dx, dy]: [f64; 2], core_radius: f64, line: &Line) -> [f64; 2] {
    let distance = (dx * dx + dy * dy).sqrt();
    if distance >= core_radius {
        return [x, y];
    }
    if distance < 1e-9 {
        // On the line: the side is chosen so that -g takes the other one.
        let side = if line.contrast.g_per_nm.dot(&line.contrast.burgers_nm) < 0.0 { -1.0 } else { 1.0 };
        let [across_x, across_y] = line.across_near([x, y]);
        return [x + side * core_radius * across_x, y + side * core_radius * across_y];
    }
    let scale = core_radius / distance;
    [x + dx - dx * scale, y + dy - dy * scale]
}

fn closest_approach(start: &Point3, end: &Point3, [x, y]: [f64; 2]) -> Core {
    let along = end - start;
    let lateral2 = along.x * along.x + along.y * along.y;
    let (px, py) = (x - start.x, y - start.y);
    let foot = ((px * along.x + py * along.y) / lateral2.max(1e-30)).clamp(0.0, 1.0);
    let (dx, dy) = (px - foot * along.x, py - foot * along.y);
    Core {
        depth: start.z + foot * along.z,
        lateral2: dx * dx + dy * dy,
        steepness: (lateral2 / along.norm_squared().max(1e-30)).sqrt(),
    }
}

/// The points of the Chebyshev polynomial T_n, n = [`NODES`], from -1 to 1.
fn chebyshev_points() -> impl Iterator<Item = f64> {
    (0..NODES).map(|node| -(PI * (node as f64 + 0.5) / NODES as f64).cos())
}

/// Coefficients of the polynomial through `values` at [`chebyshev_points`].
fn chebyshev_coefficients(values: &[f64]) -> [f64; NODES] {
    let mut coefficients = [0.0; NODES];
    // T_k of the points in turn, by its recurrence.
    for (point, value) in chebyshev_points().zip(values) {
        let (mut this, mut next) = (1.0, point);
        for coefficient in &mut coefficients {
            *coefficient += 2.0 / NODES as f64 * this * value;
            (this, next) = (next, 2.0 * point * next - this);
        }
    }
    coefficients[0] *= 0.5;
    coefficients
}

/// Clenshaw's sum of Chebyshev polynomials at `x`.
fn chebyshev_sum(coefficients: &[f64; NODES], x: f64) -> f64 {
    let (mut this, mut next) = (0.0, 0.0);
    for coefficient in coefficients.iter().skip(1).rev() {
        (this, next) = (2.0 * x * this - next + coefficient, this);
    }
    x * this - next + coefficients[0]
}

/// 1 up to half the reach, then smoothly (two continuous derivatives) to 0.
fn fade(share: f64) -> f64 {
    let t = (2.0 - 2.0 * share).clamp(0.0, 1.0);
    t * t * t * (10.0 - 15.0 * t + 6.0 * t * t)
}

#[cfg(test)]
mod unit_tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn the_series_is_the_closed_form_over_its_range() {
        let same = |found: [f64; 4], [re, im]: [f64; 2]| {
            for (a, b) in found.iter().zip(cosine_and_sine(re, im)) {
                assert_relative_eq!(*a, b, epsilon = 1e-8);
            }
        };
        same(series::<3>(0.09, 0.03), [0.09, 0.03]);
        same(series::<5>(0.9, -0.3), [0.9, -0.3]);
        same(series::<7>(3.9, 0.5), [3.9, 0.5]);
        same(series::<9>(8.9, -1.0), [8.9, -1.0]);
    }

    #[test]
    fn chebyshev_interpolation_reproduces_a_polynomial() {
        let function = |x: f64| 1.0 - 2.0 * x + 0.5 * x.powi(3) + x.powi(7);
        let values: Vec<f64> = chebyshev_points().map(function).collect();
        let coefficients = chebyshev_coefficients(&values);
        for x in [-1.0, -0.33, 0.0, 0.8] {
            assert_relative_eq!(chebyshev_sum(&coefficients, x), function(x), epsilon = 1e-13);
        }
    }

    #[test]
    fn slices_cover_the_column_without_gaps_and_turn_over_with_it() {
        let core = |depth| [Core { depth, lateral2: 0.3, steepness: 0.8 }];
        let (mut down, mut up) = (Vec::new(), Vec::new());
        cut([0.0, 128.0], &core(37.0), &mut down);
        cut([0.0, 128.0], &core(128.0 - 37.0), &mut up);
        assert_eq!((down[0][0], down[down.len() - 1][1]), (0.0, 128.0));
        assert!(down.windows(2).all(|pair| pair[0][1] == pair[1][0]));
        let turned: Vec<[f64; 2]> = up.iter().rev().map(|[top, bottom]| [128.0 - bottom, 128.0 - top]).collect();
        assert_eq!(down, turned);
    }
}

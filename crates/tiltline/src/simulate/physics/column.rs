//! Two beams through one column of a strained crystal (column approximation).
//!
//! The strain enters the equations of [`super::perfect`] only as a local deviation `sigma(z) = s + beta(z)`, with
//! `beta = d(g . R)/dz` (Hirsch et al. 1965, equation 10.7). The column is cut into slices, halved until each is short
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

/// A slice is no longer than this share of its distance to the nearest core. Halving it changes no intensity by 1e-3.
const SLICE_SHARE: f64 = 1.0;
/// And turns the phases by no more than this, rad, so that short series give sine and cosine to 1e-8.
const SLICE_PHASE_RAD: f64 = 1.7;

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
    chains: Vec<(usize, std::ops::Range<usize>, f64)>,
    cores: Vec<Core>,
    slices: Vec<[f64; 2]>,
    depths: Vec<f64>,
    beta: Vec<f64>,
    inverse: [Vec<f64>; 2],
    waves: [Vec<f64>; 4],
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
                nearest = nearest.min(line.seen_from(at, &mut scratch.vertices));
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
        let Scratch { vertices, chains, cores, slices, depths, beta, inverse, waves } = scratch;
        let s_max = column.deviation_per_nm.abs() + self.largest_deviation;
        let longest = SLICE_PHASE_RAD / (PI * s_max.hypot(1.0 / self.settings.extinction_distance_nm));
        slices.clear();
        let all = [column.top_nm, column.top_nm + column.length_nm];
        cut(all, cores, longest, self.settings.core_radius_nm, slices);
        depths.clear();
        for [top, bottom] in slices.iter() {
            let (middle, offset) = (0.5 * (top + bottom), (bottom - top) / 12.0_f64.sqrt());
            depths.extend([middle - offset, middle + offset]);
        }
        beta.clear();
        beta.resize(depths.len(), 0.0);
        let [inverse, inverse_next] = inverse;
        for (line, range, weight) in chains.iter() {
            let contrast = &self.lines[*line].contrast;
            add_chain(contrast, &vertices[range.clone()], at, depths, *weight, beta, [inverse, inverse_next]);
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
            let nearest = line.seen_from(at, vertices);
            if nearest >= reach {
                vertices.truncate(start);
                continue;
            }
            chains.push((index, start..vertices.len(), fade(nearest / reach)));
            for ends in vertices[start..].windows(2) {
                let core = closest_approach(&ends[0], &ends[1], at);
                // Further away than the column is long, no slice is too long.
                if core.lateral2 < column.length_nm * column.length_nm {
                    cores.push(core);
                }
            }
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
            if largest <= 4.0 {
                step.apply(&self.cone.offset_per_nm, waves, series);
            } else {
                step.apply(&self.cone.offset_per_nm, waves, cosine_and_sine);
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

/// `cos(sqrt w)` and `sin(sqrt w) / sqrt w` (re, im, re, im) by their power series, for |w| <= 4 (error 4^8 / 16!).
#[inline(always)]
fn series(re: f64, im: f64) -> [f64; 4] {
    let horner = |first: f64| {
        // Coefficients 1, -1/(a b), ... with a b running over 1*2, 3*4, ... (cosine) or 2*3, 4*5, ... (sine).
        let (mut x, mut y) = (1.0, 0.0);
        for term in (0..7).rev() {
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
fn cut([top, bottom]: [f64; 2], cores: &[Core], longest: f64, core_radius: f64, out: &mut Vec<[f64; 2]>) {
    let length = bottom - top;
    let too_long = length > longest
        || cores.iter().any(|core| {
            let gap = (top - core.depth).max(core.depth - bottom).max(0.0) * core.steepness;
            let distance2 = core.lateral2 + gap * gap + core_radius * core_radius;
            (length * core.steepness).powi(2) > SLICE_SHARE * SLICE_SHARE * distance2
        });
    if too_long && length > 1e-3 {
        let middle = 0.5 * (top + bottom);
        cut([top, middle], cores, longest, core_radius, out);
        cut([middle, bottom], cores, longest, core_radius, out);
    } else {
        out.push([top, bottom]);
    }
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
        for (re, im) in [(0.5, 0.1), (3.9, 0.5), (2.0, -1.0)] {
            for (a, b) in series(re, im).iter().zip(cosine_and_sine(re, im)) {
                assert_relative_eq!(*a, b, epsilon = 1e-8);
            }
        }
    }

    #[test]
    fn slices_cover_the_column_without_gaps_and_turn_over_with_it() {
        let core = |depth| [Core { depth, lateral2: 0.3, steepness: 0.8 }];
        let (mut down, mut up) = (Vec::new(), Vec::new());
        cut([0.0, 128.0], &core(37.0), 20.0, 0.2, &mut down);
        cut([0.0, 128.0], &core(128.0 - 37.0), 20.0, 0.2, &mut up);
        assert_eq!((down[0][0], down[down.len() - 1][1]), (0.0, 128.0));
        assert!(down.windows(2).all(|pair| pair[0][1] == pair[1][0]));
        let turned: Vec<[f64; 2]> = up.iter().rev().map(|[top, bottom]| [128.0 - bottom, 128.0 - top]).collect();
        assert_eq!(down, turned);
    }
}

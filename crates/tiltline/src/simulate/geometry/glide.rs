//! Single lines on slip planes: bowed, half-loops, trailing, pinned, straight and zig-zag.
//!
//! Shapes are made in the plane (`[s, q]` of [`PlaneFrame`], nm), a little longer than the foil is thick, and cut by the
//! surfaces later.

use rand::RngExt;
use rand_pcg::Pcg64;

use super::polyline::{round_corners, spline};
use super::settings::GlideSettings;
use super::site::{PlaneFrame, Site, Wave, chance, facetted, open_line, sign};
use crate::geometry::{Point3, Vector3};
use crate::simulate::foil::Dislocation;

/// How far shapes go beyond the surfaces, as a share of half the width of the plane.
const OVERSHOOT: f64 = 1.03;

/// The shape of a line that crosses its plane from one surface to the other.
#[derive(Clone, Copy, Debug)]
pub struct Bow {
    /// Sag at the middle, nm.
    pub sag_nm: f64,
    /// Slope of the chord: s over q.
    pub skew: f64,
    /// Exponent of the front.
    pub flatness: f64,
    /// Where the apex lies, -0.4 to 0.4 of the half width.
    pub apex: f64,
    /// Waviness.
    pub wave: Wave,
}

impl Bow {
    /// A random bow on a plane of this half width.
    pub fn random(settings: &GlideSettings, half_width_nm: f64, rng: &mut Pcg64) -> Self {
        // A plane nearly parallel to the foil is very wide; the line tension does not know that.
        let width = half_width_nm.min(600.0);
        Self {
            sag_nm: settings.bow.sample(rng) * width,
            skew: settings.skew.sample(rng),
            flatness: settings.flatness.sample(rng),
            apex: rng.random_range(-0.4..0.4),
            wave: random_wave(settings, rng),
        }
    }

    /// A similar bow: every number off by about this share.
    pub fn varied(&self, share: f64, rng: &mut Pcg64) -> Self {
        let mut factor = || 1.0 + share * rng.random_range(-1.0..1.0);
        let (sag, flatness) = (factor(), factor());
        Self {
            sag_nm: self.sag_nm * sag,
            skew: self.skew + 0.3 * (factor() - 1.0),
            flatness: (self.flatness * flatness).max(1.2),
            apex: (self.apex + 0.5 * (factor() - 1.0)).clamp(-0.45, 0.45),
            ..*self
        }
    }

    /// Points `[s, q]` of the line whose chord crosses the middle of the plane at `s_nm`, about `spacing_nm` apart.
    pub fn curve(&self, s_nm: f64, half_width_nm: f64, spacing_nm: f64) -> Vec<[f64; 2]> {
        let chord = half_width_nm * (1.0 + self.skew.abs()) + self.sag_nm.abs() * self.flatness;
        let steps = ((2.2 * chord / spacing_nm).ceil() as usize).clamp(16, 20_000);
        (0..=steps)
            .map(|step| {
                let across = OVERSHOOT * (2.0 * step as f64 / steps as f64 - 1.0);
                let q = half_width_nm * across;
                // Moves the apex without moving the ends.
                let shifted = across - self.apex * (1.0 - across * across);
                let bow = self.sag_nm * (1.0 - shifted.abs().powf(self.flatness));
                [s_nm + self.skew * q + bow + self.wave.at(q), q]
            })
            .collect()
    }
}

fn random_wave(settings: &GlideSettings, rng: &mut Pcg64) -> Wave {
    Wave::new(settings.wave_amplitude_nm.sample(rng), settings.wave_length_nm.sample_log(rng), rng)
}

/// Makes a smooth in-plane line facetted now and then.
pub fn finish(points: Vec<Point3>, settings: &GlideSettings, frame: &PlaneFrame, rng: &mut Pcg64) -> Vec<Point3> {
    if chance(settings.kinked, rng) {
        facetted(&points, false, settings.facet_nm.sample(rng), &[frame.along, frame.down], rng)
    } else {
        points
    }
}

/// A bowed line from surface to surface.
pub fn bowed(settings: &GlideSettings, site: &Site, rng: &mut Pcg64) -> Vec<Dislocation> {
    let (frame, system) = site.slip_plane(rng);
    let bow = Bow::random(settings, frame.half_width_nm, rng);
    let [s, _] = frame.coordinates(&site.centre);
    let points = frame.points(&bow.curve(s, frame.half_width_nm, site.spacing_nm));
    vec![open_line(finish(points, settings, &frame, rng), system.burgers_nm, Some(frame.normal))]
}

/// A line with both ends on the same surface.
pub fn half_loop(settings: &GlideSettings, site: &Site, rng: &mut Pcg64) -> Vec<Dislocation> {
    let (frame, system) = site.slip_plane(rng);
    let [s, _] = frame.coordinates(&site.centre);
    let (radius, side) = (settings.half_loop_nm.sample_log(rng), sign(rng));
    // Deeper than the foil and it would be two lines; that happens too.
    let depth = (radius * rng.random_range(0.5..2.0)).min(2.1 * frame.half_width_nm);
    let (lean, wave) = (rng.random_range(-0.5..0.5), random_wave(settings, rng));
    let steps = ((4.0 * (radius + depth) / site.spacing_nm).ceil() as usize).clamp(16, 20_000);
    let curve: Vec<[f64; 2]> = (0..=steps)
        .map(|step| {
            let angle = std::f64::consts::PI * (1.1 * step as f64 / steps as f64 - 0.05);
            let below = depth * angle.sin();
            [s - radius * angle.cos() + lean * below + wave.at(radius * angle), side * (frame.half_width_nm - below)]
        })
        .collect();
    vec![open_line(finish(frame.points(&curve), settings, &frame, rng), system.burgers_nm, Some(frame.normal))]
}

/// A line that has glided along its plane: one end steep to a surface, a long wavy segment, and a rounded head.
pub fn trailing(settings: &GlideSettings, site: &Site, rng: &mut Pcg64) -> Vec<Dislocation> {
    let (frame, system) = site.slip_plane(rng);
    let points = frame.points(&trailing_curve(settings, site, &frame, rng));
    vec![open_line(finish(points, settings, &frame, rng), system.burgers_nm, Some(frame.normal))]
}

/// In-plane points of a trailing line with its middle at the site.
pub fn trailing_curve(settings: &GlideSettings, site: &Site, frame: &PlaneFrame, rng: &mut Pcg64) -> Vec<[f64; 2]> {
    let [centre_s, centre_q] = frame.coordinates(&site.centre);
    let (way, side) = (sign(rng), sign(rng));
    let trail = settings.trail_nm.sample_log(rng);
    let half = frame.half_width_nm;
    let band = half.min(0.5 * trail);
    // On a plane nearly parallel to the foil the surfaces are far away: stay around the site.
    let middle = if band < half { centre_q.clamp(-half + band, half - band) } else { 0.0 };
    let stretch = settings.wave_length_nm.sample_log(rng).min(0.5 * trail);
    let start = -0.5 * trail;
    let tail = side * rng.random_range(0.1..0.8);
    let end_side = if chance(0.75, rng) { -side } else { side };
    let mut knots = vec![[start - 0.05 * trail, side * OVERSHOOT], [start, 0.5 * (side + tail)]];
    let (mut s, mut level) = (start + 0.4 * stretch, tail);
    while s < 0.5 * trail {
        knots.push([s, level]);
        s += stretch * rng.random_range(0.5..1.5);
        level = (level + rng.random_range(-0.25..0.25) - 0.1 * (level + end_side * 0.3)).clamp(-0.85, 0.85);
    }
    // The head: a bow from the trail to the surface, forward and then a little back.
    let head = band * rng.random_range(0.2..0.9);
    knots.push([0.5 * trail + head * 0.8, 0.6 * level + 0.4 * end_side]);
    knots.push([0.5 * trail + head * rng.random_range(0.5..1.0), 0.15 * level + 0.85 * end_side]);
    knots.push([0.5 * trail + head * rng.random_range(0.2..0.9), end_side * OVERSHOOT]);
    let reach = if band < half { half / band } else { 1.0 };
    let last = knots.len() - 1;
    let flat: Vec<Point3> = knots
        .iter()
        .enumerate()
        .map(|(index, &[s, level])| {
            // The ends reach the surfaces, however far they are.
            let q = if index == 0 || index == last { level * band * reach } else { middle + level * band };
            Point3::new(centre_s + way * s, q, 0.0)
        })
        .collect();
    let wave = Wave::new(0.5 * settings.wave_amplitude_nm.sample(rng), stretch, rng);
    spline(&flat, false, site.spacing_nm).iter().map(|point| [point.x, point.y + wave.at(point.x)]).collect()
}

/// A segment bowed out between two pinning points; its arms leave its plane for the surfaces.
pub fn source(settings: &GlideSettings, site: &Site, rng: &mut Pcg64) -> Vec<Dislocation> {
    let (frame, system) = site.slip_plane(rng);
    let half_span = 0.5 * settings.source_nm.sample_log(rng);
    let bow = half_span * rng.random_range(0.1..1.1) * sign(rng);
    let angle = rng.random_range(-0.6..0.6f64);
    let along = frame.along * angle.cos() + frame.down * angle.sin();
    let out = along.cross(&frame.normal);
    // Pins and bow stay within the foil, so that the arms go on from where the bow ends.
    let limit = 0.42 * site.thickness_nm;
    let mut middle = site.centre;
    middle.z = middle.z.clamp(-0.5 * limit, 0.5 * limit);
    let shrink = (0.5 * limit / (half_span * along.z.abs()).max(bow.abs() * out.z.abs()).max(1e-9)).min(1.0);
    let steps = ((4.0 * half_span / site.spacing_nm).ceil() as usize).clamp(12, 10_000);
    let arc = (0..=steps).map(|step| {
        let across = 2.0 * step as f64 / steps as f64 - 1.0;
        middle + (along * (half_span * across) + out * (bow * (1.0 - across * across))) * shrink
    });
    let arc: Vec<Point3> = arc.collect();
    let arm = |from: &Point3, to_lower: bool, rng: &mut Pcg64| {
        let lean = super::site::azimuth(rng) * rng.random_range(0.1..2.0);
        let side = if to_lower { -1.0 } else { 1.0 };
        let way = 0.51 * site.thickness_nm - side * from.z;
        let end = from + Vector3::new(lean.x, lean.y, side) * way;
        let bend = super::site::direction(rng) * (0.12 * (end - from).norm());
        [end, Point3::from((from.coords + end.coords) * 0.5 + bend)]
    };
    let lower_first = chance(0.5, rng);
    let first = arm(&arc[0], lower_first, rng);
    let opposite = if chance(0.7, rng) { !lower_first } else { lower_first };
    let last = arm(&arc[arc.len() - 1], opposite, rng);
    let mut points = spline(&[first[0], first[1], arc[0]], false, site.spacing_nm);
    points.extend(&arc[1..]);
    points.extend(&spline(&[arc[arc.len() - 1], last[1], last[0]], false, site.spacing_nm)[1..]);
    // Its arms lie on other planes, so no single plane is right.
    vec![open_line(points, system.burgers_nm, None)]
}

/// A direction in a slip plane that lines like to follow: screw, 60 degrees or edge.
pub fn line_direction(normal: &Vector3, burgers_nm: &Vector3, rng: &mut Pcg64) -> Vector3 {
    let screw = burgers_nm.normalize();
    let edge = normal.cross(&screw);
    let angle_deg = [0.0, 0.0, 60.0, -60.0, 90.0, 30.0, -30.0][rng.random_range(0..7)];
    let (sin, cos) = f64::to_radians(angle_deg).sin_cos();
    screw * cos + edge * sin
}

/// A straight line through the whole foil.
pub fn straight(settings: &GlideSettings, site: &Site, rng: &mut Pcg64) -> Vec<Dislocation> {
    let (frame, system) = site.slip_plane(rng);
    let along = line_direction(&frame.normal, &system.burgers_nm, rng);
    let across = frame.normal.cross(&along);
    let reach = site.reach_nm();
    let wave =
        Wave::new(0.6 * settings.wave_amplitude_nm.sample(rng), 2.0 * settings.wave_length_nm.sample_log(rng), rng);
    let steps = ((2.0 * reach / 20.0).ceil() as usize).max(2);
    let knots: Vec<Point3> = (0..=steps)
        .map(|step| {
            let way = reach * (2.0 * step as f64 / steps as f64 - 1.0);
            site.centre + along * way + across * wave.at(way)
        })
        .collect();
    vec![open_line(knots, system.burgers_nm, Some(frame.normal))]
}

/// A line of straight parts, alternating between two directions in its plane.
pub fn zigzag(settings: &GlideSettings, site: &Site, rng: &mut Pcg64) -> Vec<Dislocation> {
    let (frame, system) = site.slip_plane(rng);
    let along = line_direction(&frame.normal, &system.burgers_nm, rng);
    let across = frame.normal.cross(&along);
    let part = settings.zigzag_nm.sample_log(rng);
    let (sin, cos) = settings.zigzag_deg.sample(rng).to_radians().sin_cos();
    let mut corners = vec![site.centre];
    for way in [-1.0, 1.0] {
        let mut side = way;
        let (mut at, mut travelled) = (site.centre, 0.0);
        corners.reverse();
        while travelled < 0.5 * site.reach_nm() {
            let step = part * rng.random_range(0.4..1.6);
            at += (along * cos + across * (sin * side)) * (step * way);
            side = -side;
            travelled += step * cos;
            corners.push(at);
            if at.z.abs() > 0.5 * site.thickness_nm {
                break;
            }
        }
    }
    // The last part may stop short of a surface that is far away, but then it is beyond the window.
    vec![open_line(round_corners(&corners, false, 3), system.burgers_nm, Some(frame.normal))]
}

//! Lines that meet: binary junctions and nets of low-angle boundaries. Burgers vectors sum to zero at every node.
//!
//! Junctions after Hirth and Lothe, *Theory of Dislocations*, chapter 22: two lines on crossing planes attract where
//! `b1 . b2 < 0` and zip together along the line where the planes meet, with `b3 = b1 + b2`. Nets after chapter 19: a twist
//! boundary on a close-packed plane is a honeycomb of three Burgers vectors that sum to zero.

use rand::RngExt;
use rand_pcg::Pcg64;

use super::crystal::SlipSystem;
use super::polyline::spline;
use super::settings::NetworkSettings;
use super::site::{PlaneFrame, Site, Wave, azimuth, chance, direction, open_line, sign};
use crate::geometry::{Point3, Vector3};
use crate::simulate::foil::Dislocation;

/// Two lines joined over a stretch; where no two active planes cross suitably, nothing grows.
pub fn junction(settings: &NetworkSettings, site: &Site, rng: &mut Pcg64) -> Vec<Dislocation> {
    let Some([one, two]) = attracting_pair(site, rng, |one, two| one.normal.cross(&two.normal).norm() > 0.2) else {
        return Vec::new();
    };
    let along = one.normal.cross(&two.normal).normalize();
    // Both nodes stay inside the foil.
    let room = 0.35 * site.thickness_nm;
    let mut middle = site.centre;
    middle.z = middle.z.clamp(-0.4 * room, 0.4 * room);
    let half = (0.5 * settings.junction_nm.sample_log(rng)).min(0.6 * room / along.z.abs().max(1e-9));
    let nodes = [middle - along * half, middle + along * half];
    let joint_burgers = one.burgers_nm + two.burgers_nm;
    let sag = settings.sag.sample(rng) * 0.3;
    let bend = along.cross(&direction(rng)).normalize() * (sag * 2.0 * half);
    let joint = spline(&[nodes[0], middle + bend, nodes[1]], false, site.spacing_nm);
    let mut lines = vec![open_line(joint, joint_burgers, None)];
    for (system, side) in [(one, 1.0), (two, -1.0)] {
        // Into the first node, out of the second: the line sense runs through, so that each node balances.
        let mut into = arm(settings, site, &nodes[0], &-along, &system.normal, side, rng);
        into.reverse();
        let out_of = arm(settings, site, &nodes[1], &along, &system.normal, side, rng);
        lines.extend([into, out_of].map(|points| open_line(points, system.burgers_nm, Some(system.normal))));
    }
    lines
}

/// An arm in a plane, turned away from a direction, on until it has left the foil or the window.
fn arm(
    settings: &NetworkSettings,
    site: &Site,
    from: &Point3,
    straight_on: &Vector3,
    normal: &Vector3,
    side: f64,
    rng: &mut Pcg64,
) -> Vec<Point3> {
    let turn = side * rng.random_range(20.0..75.0f64).to_radians();
    let along = straight_on * turn.cos() + normal.cross(straight_on) * turn.sin();
    let level = along.z.abs().max(1e-6);
    let reach = (0.75 * site.thickness_nm / level + 30.0).min(site.reach_nm());
    let bend = normal.cross(&along) * settings.sag.sample(rng);
    // Sag on the scale of the foil, not of a line that runs level for micrometres.
    let scale = reach.min(2.0 * site.thickness_nm);
    let across = normal.cross(&along);
    let wave = Wave::new(0.03 * scale, 1.5 * scale, rng);
    let steps = ((reach / (0.15 * scale)).ceil() as usize).max(4);
    let knots: Vec<Point3> = (0..=steps)
        .map(|step| {
            let way = reach * step as f64 / steps as f64;
            let profile = (way / scale).min(1.0);
            let aside = wave.at(way) * profile;
            from + along * way + bend * (2.0 * scale * profile * (1.0 - 0.5 * profile)) + across * aside
        })
        .collect();
    let mut points = spline(&knots, false, site.spacing_nm);
    // A bend may have turned it level: the last word has the surface.
    let end = points[points.len() - 1];
    if end.z.abs() < 0.5 * site.thickness_nm {
        points.push(end + (end - points[points.len() - 2]).normalize() * site.reach_nm());
    }
    points
}

/// Two active systems that attract and meet a condition.
fn attracting_pair(
    site: &Site,
    rng: &mut Pcg64,
    suits: impl Fn(&SlipSystem, &SlipSystem) -> bool,
) -> Option<[SlipSystem; 2]> {
    let all = site.crystal.slip_systems();
    for attempt in 0..40 {
        let one = site.slip_system(rng);
        // Where only one plane is active, forest lines on the others are what there is to react with.
        let mut two = if attempt < 10 { site.slip_system(rng) } else { all[rng.random_range(0..all.len())] };
        let product = one.burgers_nm.dot(&two.burgers_nm);
        if product > 0.0 {
            two.burgers_nm = -two.burgers_nm;
        }
        let sum = (one.burgers_nm + two.burgers_nm).norm();
        let shortest = one.burgers_nm.norm().min(two.burgers_nm.norm());
        // Parallel Burgers vectors annihilate instead of joining.
        if product.abs() > 1e-9 && sum > 0.3 * shortest && suits(&one, &two) {
            return Some([one, two]);
        }
    }
    None
}

/// A piece of a hexagonal net; its loose edges go on to the nearer surface.
pub fn net(settings: &NetworkSettings, site: &Site, rng: &mut Pcg64) -> Vec<Dislocation> {
    let Some([one, two]) = attracting_pair(site, rng, |_, _| true) else { return Vec::new() };
    let burgers = [one.burgers_nm, two.burgers_nm, -(one.burgers_nm + two.burgers_nm)];
    // Not steeper than 60 degrees: seen nearer to edge on, a net is a row of dashes.
    let mut normal = if chance(0.5, rng) { one.normal } else { direction(rng) };
    while normal.z.abs() < 0.5 {
        normal = direction(rng);
    }
    let frame = PlaneFrame::new(&normal, &site.centre, site.thickness_nm);
    // At least two meshes from surface to surface.
    let mesh = settings.mesh_nm.sample_log(rng).min(0.6 * frame.half_width_nm);
    // More than 80 meshes across are no longer seen as a net.
    let half_extent = (0.5 * settings.extent_nm.sample_log(rng)).min(40.0 * mesh);
    let half_height = frame.half_width_nm.min(half_extent);
    // Length of edge per area of a honeycomb of edge a is 2 / (sqrt(3) a).
    let full = 4.0 * half_extent * half_height * 2.0 / (3f64.sqrt() * mesh);
    let shrink = (site.budget_nm / full.max(1.0)).sqrt().clamp((1.2 * mesh / half_extent).min(1.0), 1.0);
    let (half_extent, half_height) = (half_extent * shrink, half_height * shrink.max(0.5));
    let [centre_s, centre_q] = frame.coordinates(&site.centre);
    let centre_q = if half_height < frame.half_width_nm { centre_q } else { 0.0 };
    let grid = Honeycomb::new(settings, mesh, rng);
    let inside = |at: [f64; 2]| at[0].abs() <= half_extent && at[1].abs() <= 1.2 * half_height;
    let place = |at: [f64; 2]| frame.point([centre_s + at[0], centre_q + at[1]]);
    let in_foil = |point: &Point3| point.z.abs() < 0.5 * site.thickness_nm;

    // The grid covers the patch: |row| is at most 0.91 radius / mesh in a regular honeycomb.
    let radius = half_extent.hypot(1.2 * half_height);
    let cells = (radius * grid.stretch / mesh).ceil() as i32 + 2;
    let sag = settings.sag.sample(rng);
    let lean = azimuth(rng) * rng.random_range(0.2..1.5);
    let mut lines = Vec::new();
    for row in -cells..=cells {
        for column in -cells..=cells {
            for (kind, neighbour) in [[0, 0], [-1, 0], [0, -1]].into_iter().enumerate() {
                let ends = [grid.node(0, row, column), grid.node(1, row + neighbour[0], column + neighbour[1])];
                let kept = ends.map(inside);
                let points = ends.map(place);
                let edge = points[1] - points[0];
                let bow = frame.normal.cross(&edge) * (sag * 0.5 * ends[0][0].sin());
                let middle = Point3::from((points[0].coords + points[1].coords) * 0.5) + bow;
                let knots = match kept {
                    [true, true] => vec![points[0], middle, points[1]],
                    // A loose edge ends at the nearer surface; from the kept node, in the sense of the edge.
                    [true, false] if in_foil(&points[0]) => {
                        vec![points[0], points[0] + edge * 0.4, site.beyond_surface(&(points[0] + edge * 0.8), lean)]
                    }
                    [false, true] if in_foil(&points[1]) => {
                        vec![site.beyond_surface(&(points[1] - edge * 0.8), -lean), points[1] - edge * 0.4, points[1]]
                    }
                    _ => continue,
                };
                let on_plane = (kept == [true, true]).then_some(frame.normal);
                lines.push(open_line(spline(&knots, false, site.spacing_nm), burgers[kind], on_plane));
            }
        }
    }
    lines
}

/// The nodes of an irregular honeycomb.
struct Honeycomb {
    steps: [[f64; 2]; 2],
    second: [f64; 2],
    irregularity: f64,
    mesh: f64,
    turn: [f64; 2],
    stretch: f64,
    salt: u64,
}

impl Honeycomb {
    fn new(settings: &NetworkSettings, mesh: f64, rng: &mut Pcg64) -> Self {
        let half = 3f64.sqrt() / 2.0 * mesh;
        let (sin, cos) = rng.random_range(0.0..std::f64::consts::PI).sin_cos();
        Self {
            steps: [[half, 1.5 * mesh], [-half, 1.5 * mesh]],
            second: [0.0, mesh],
            irregularity: settings.irregularity.sample(rng),
            mesh,
            turn: [cos, sin * sign(rng)],
            stretch: settings.stretch.sample(rng).sqrt(),
            salt: rng.random(),
        }
    }

    /// In-plane position of a node of one of the two sublattices; the displacement is a hash of its place in the grid.
    fn node(&self, sublattice: u8, row: i32, column: i32) -> [f64; 2] {
        let (r, c) = (f64::from(row), f64::from(column));
        let mut at = [r * self.steps[0][0] + c * self.steps[1][0], r * self.steps[0][1] + c * self.steps[1][1]];
        if sublattice == 1 {
            at = [at[0] + self.second[0], at[1] + self.second[1]];
        }
        let mut hash = self.salt ^ ((row as u32 as u64) << 33) ^ ((column as u32 as u64) << 1) ^ u64::from(sublattice);
        let mut noise = || {
            // splitmix64 (Steele, Lea, Flood 2014).
            hash = hash.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut mixed = (hash ^ (hash >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((mixed ^ (mixed >> 31)) >> 11) as f64 / (1u64 << 53) as f64 * 2.0 - 1.0
        };
        let reach = self.irregularity * self.mesh;
        at = [(at[0] + reach * noise()) * self.stretch, (at[1] + reach * noise()) / self.stretch];
        let [cos, sin] = self.turn;
        [at[0] * cos - at[1] * sin, at[0] * sin + at[1] * cos]
    }
}

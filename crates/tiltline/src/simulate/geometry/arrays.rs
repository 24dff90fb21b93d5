//! Rows of similar lines: pile-ups, slip bands and misfit arrays.

use rand::RngExt;
use rand_pcg::Pcg64;

use super::glide::{Bow, finish};
use super::polyline::spline;
use super::settings::{ArraySettings, FoilSettings, GlideSettings};
use super::site::{PlaneFrame, Site, Wave, azimuth, chance, open_line, sign};
use crate::geometry::{Point3, Vector3};
use crate::simulate::foil::Dislocation;

/// A single-ended pile-up: line i of n lies at about `first_gap i^2`, i = 0 at the obstacle.
///
/// Eshelby, Frank, Nabarro, Phil. Mag. 42 (1951) 351: the positions are zeros of a Laguerre polynomial, which near the
/// obstacle grow as the square of the index.
pub fn pile_up(settings: &FoilSettings, site: &Site, rng: &mut Pcg64) -> Vec<Dislocation> {
    let first_gap = settings.arrays.first_gap_nm.sample_log(rng);
    row(settings, site, rng, |index, rng| {
        let exact = first_gap * (index as f64).powi(2);
        // Solute and forest hold lines back: positions scatter by a part of the gap.
        exact + 0.15 * first_gap * (1.0 + 2.0 * index as f64) * rng.random_range(-1.0..1.0)
    })
}

/// Lines on one slip plane at irregular distances.
pub fn slip_band(settings: &FoilSettings, site: &Site, rng: &mut Pcg64) -> Vec<Dislocation> {
    let gap = settings.arrays.band_gap_nm.sample_log(rng);
    let disorder = rng.random_range(0.0..0.5);
    row(settings, site, rng, |index, rng| gap * (index as f64 + disorder * rng.random_range(-1.0..1.0)))
}

/// Similar bowed lines on one plane, at the positions along it that `position_nm` gives.
fn row(
    settings: &FoilSettings,
    site: &Site,
    rng: &mut Pcg64,
    mut position_nm: impl FnMut(usize, &mut Pcg64) -> f64,
) -> Vec<Dislocation> {
    let (frame, system) = site.slip_plane(rng);
    let ArraySettings { lines, variation, .. } = settings.arrays;
    let count = site.count(lines, 2.3 * frame.half_width_nm, rng);
    let variation = variation.sample(rng);
    let bow = Bow::random(&settings.glide, frame.half_width_nm, rng);
    let glide =
        GlideSettings { kinked: if chance(settings.glide.kinked, rng) { 1.0 } else { 0.0 }, ..settings.glide.clone() };
    let (way, [s, _]) = (sign(rng), frame.coordinates(&site.centre));
    // The row is laid around the site, at whichever of its lines.
    let anchor = rng.random_range(0..count);
    let positions: Vec<f64> = (0..count).map(|index| position_nm(index, rng)).collect();
    positions
        .iter()
        .map(|position| {
            let own = bow.varied(variation, rng);
            let at = s + way * (position - positions[anchor]);
            let points = frame.points(&own.curve(at, frame.half_width_nm, site.spacing_nm));
            open_line(finish(points, &glide, &frame, rng), system.burgers_nm, Some(frame.normal))
        })
        .collect()
}

/// Sets of parallel lines in an interface a few degrees from the foil plane; some turn up to a surface.
pub fn misfit(settings: &ArraySettings, site: &Site, rng: &mut Pcg64) -> Vec<Dislocation> {
    let tilt = azimuth(rng) * rng.random_range(0.0..0.08);
    let frame = PlaneFrame::new(&(Vector3::z() + tilt), &site.centre, site.thickness_nm);
    let base = azimuth(rng);
    let sets = [1, 1, 2, 3][rng.random_range(0..4)];
    let mut lines = Vec::new();
    for set in 0..sets {
        // Two sets cross at right angles, three at 60 degrees, as on (001) and on {111} or (0001).
        let turn = std::f64::consts::PI * f64::from(set) / f64::from(sets);
        let level =
            Vector3::new(base.x * turn.cos() - base.y * turn.sin(), base.x * turn.sin() + base.y * turn.cos(), 0.0);
        let along = (level - frame.normal * level.dot(&frame.normal)).normalize();
        let across = frame.normal.cross(&along);
        let gap = settings.misfit_gap_nm.sample_log(rng);
        let burgers_nm = site.slip_system(rng).burgers_nm;
        let count = site.count(settings.misfit_lines, site.window_nm * f64::from(sets), rng);
        for index in 0..count {
            let aside = gap * (index as f64 - 0.5 * count as f64 + 0.2 * rng.random_range(-1.0..1.0));
            let wave = Wave::new(rng.random_range(0.0..4.0), rng.random_range(150.0..800.0), rng);
            let origin: Point3 = site.centre + across * aside;
            let mut end = |way: f64| {
                let threads = chance(0.35, rng);
                let reach = if threads { site.window_nm * rng.random_range(0.05..0.7) } else { site.reach_nm() };
                (way * reach, threads)
            };
            let (left, right) = (end(-1.0), end(1.0));
            let steps = (((right.0 - left.0) / 15.0).ceil() as usize).max(4);
            let mut knots: Vec<Point3> = (0..=steps)
                .map(|step| {
                    let way = left.0 + (right.0 - left.0) * step as f64 / steps as f64;
                    origin + along * way + across * wave.at(way)
                })
                .collect();
            // A threading arm: out of the interface and up to the nearer surface.
            if right.1 {
                let from = knots[knots.len() - 1];
                let up = site.beyond_surface(&from, along * rng.random_range(0.1..1.0));
                knots.extend([Point3::from(from.coords * 0.6 + up.coords * 0.4) + along * 10.0, up]);
            }
            if left.1 {
                let from = knots[0];
                let up = site.beyond_surface(&from, along * -rng.random_range(0.1..1.0));
                knots.splice(0..0, [up, Point3::from(from.coords * 0.6 + up.coords * 0.4) - along * 10.0]);
            }
            lines.push(open_line(spline(&knots, false, 2.0 * site.spacing_nm), burgers_nm, None));
        }
    }
    lines
}

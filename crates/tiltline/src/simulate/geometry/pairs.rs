//! Two lines side by side: superdislocations (equal Burgers vectors) and dipoles (opposite ones, two planes).

use rand::RngExt;
use rand_pcg::Pcg64;

use super::glide::{Bow, finish, line_direction, trailing_curve};
use super::polyline::{length, resample};
use super::settings::{FoilSettings, PairSettings};
use super::site::{PlaneFrame, Site, Wave, chance, open_line, sign};
use crate::geometry::{Point3, Vector3};
use crate::simulate::foil::Dislocation;

/// A line and its companion at a nearly constant distance in the same plane.
pub fn pair(settings: &FoilSettings, site: &Site, rng: &mut Pcg64) -> Vec<Dislocation> {
    let (frame, system) = site.slip_plane(rng);
    let leader = leading_line(settings, site, &frame, &system.burgers_nm, rng);
    let companion = beside(&leader, &frame.normal, 0.0, &settings.pairs, rng);
    [leader, companion].map(|points| open_line(points, system.burgers_nm, Some(frame.normal))).to_vec()
}

/// A line and one of opposite Burgers vector on a neighbouring plane.
pub fn dipole(settings: &FoilSettings, site: &Site, rng: &mut Pcg64) -> Vec<Dislocation> {
    let (frame, system) = site.slip_plane(rng);
    let leader = leading_line(settings, site, &frame, &system.burgers_nm, rng);
    let height = settings.pairs.height_nm.sample(rng) * sign(rng);
    let companion = beside(&leader, &frame.normal, height, &settings.pairs, rng);
    vec![
        open_line(leader, system.burgers_nm, Some(frame.normal)),
        open_line(companion, -system.burgers_nm, Some(frame.normal)),
    ]
}

/// A bowed, trailing or straight line.
fn leading_line(
    settings: &FoilSettings,
    site: &Site,
    frame: &PlaneFrame,
    burgers_nm: &Vector3,
    rng: &mut Pcg64,
) -> Vec<Point3> {
    if chance(0.25, rng) {
        let along = line_direction(&frame.normal, burgers_nm, rng) * (0.5 * site.reach_nm());
        return vec![site.centre - along, site.centre + along];
    }
    let curve = if chance(0.5, rng) {
        let [s, _] = frame.coordinates(&site.centre);
        Bow::random(&settings.glide, frame.half_width_nm, rng).curve(s, frame.half_width_nm, site.spacing_nm)
    } else {
        trailing_curve(&settings.glide, site, frame, rng)
    };
    finish(frame.points(&curve), &settings.glide, frame, rng)
}

/// The offset curve in the plane, at a slowly varying distance, and `height` off the plane.
fn beside(line: &[Point3], normal: &Vector3, height: f64, settings: &PairSettings, rng: &mut Pcg64) -> Vec<Point3> {
    let distance = settings.distance_nm.sample_log(rng) * sign(rng);
    let unevenness = settings.unevenness.sample(rng);
    // Steps of the size of the distance smooth the tangent, so that the offset has no cusps at small bends.
    let step = (0.5 * distance.abs()).max(4.0).min(0.25 * length(line, false).max(1e-6));
    let coarse = resample(line, false, step);
    let slow = Wave::new(0.5 * unevenness, rng.random_range(8.0..40.0) * distance.abs(), rng);
    let last = coarse.len() - 1;
    let knots: Vec<Point3> = (0..=last)
        .map(|index| {
            let tangent = coarse[(index + 2).min(last)] - coarse[index.saturating_sub(2)];
            let across = normal.cross(&tangent).try_normalize(1e-9).unwrap_or_else(Vector3::zeros);
            let own = distance * (1.0 + slow.at(index as f64 * step)).max(0.3);
            coarse[index] + across * own + normal * height
        })
        .collect();
    super::polyline::spline(&knots, false, step.min(4.0))
}

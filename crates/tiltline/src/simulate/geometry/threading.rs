//! Lines from one surface to the other on no particular plane: threading lines and helices.

use rand::RngExt;
use rand_pcg::Pcg64;

use super::polyline::spline;
use super::settings::ThreadingSettings;
use super::site::{Site, Wave, azimuth, chance, direction, open_line, sign};
use crate::geometry::{Point3, Vector3};
use crate::simulate::foil::Dislocation;

/// A threading line: nearly straight, slightly bowed and wavy.
pub fn threading(settings: &ThreadingSettings, site: &Site, rng: &mut Pcg64) -> Vec<Dislocation> {
    let system = site.slip_system(rng);
    let axis = site.crystal.axis();
    let scatter = settings.scatter_deg.to_radians().tan();
    let along = if chance(settings.along_axis, rng) && axis.z.abs() > 0.02 {
        (axis + direction(rng) * (scatter * rng.random::<f64>())).normalize()
    } else {
        let (sin, cos) = settings.inclination_deg.sample(rng).to_radians().sin_cos();
        azimuth(rng) * sin + Vector3::z() * cos
    };
    // A line along a level direction leaves by the window, not by the surfaces.
    let half_length = (0.52 * site.thickness_nm / along.z.abs().max(1e-3)).min(0.5 * site.reach_nm());
    let across = along.cross(&direction(rng)).normalize();
    let sag = settings.sag.sample(rng) * 2.0 * half_length;
    let wave = Wave::new(0.01 * half_length, 0.5 * half_length, rng);
    let middle = site.centre - along * (site.centre.z / if along.z.abs() < 1e-3 { f64::INFINITY } else { along.z });
    let steps = ((2.5 * half_length / site.spacing_nm).ceil() as usize).clamp(8, 20_000);
    let points = (0..=steps).map(|step| {
        let way = 2.0 * step as f64 / steps as f64 - 1.0;
        let aside = sag * (1.0 - way * way) + wave.at(way * half_length);
        // Lengthened by the overshoot, so that a sag in z cannot leave an end inside.
        middle + along * (1.3 * half_length * way) + across * aside
    });
    vec![open_line(points.collect(), system.burgers_nm, None)]
}

/// A helix about the direction of its Burgers vector, straight where it nears the surfaces.
pub fn helix(settings: &ThreadingSettings, site: &Site, rng: &mut Pcg64) -> Vec<Dislocation> {
    let system = site.slip_system(rng);
    let axis = system.burgers_nm.normalize();
    let first = axis.cross(&direction(rng)).normalize();
    let second = axis.cross(&first);
    let radius = settings.helix_radius_nm.sample_log(rng).min(0.3 * site.thickness_nm);
    let pitch = radius * settings.helix_pitch.sample(rng);
    let half_coil = pitch * rng.random_range(1.5..8.0);
    let (hand, wobble) = (sign(rng), Wave::new(0.15, 1.5 * pitch, rng));
    // The coil, then the axis on to the surfaces or out of the window.
    let per_turn = std::f64::consts::TAU * radius + pitch;
    let steps = ((2.5 * half_coil / pitch * per_turn / site.spacing_nm).ceil() as usize).clamp(40, 20_000);
    let mut points: Vec<Point3> = (0..=steps)
        .map(|step| {
            let way = half_coil * (2.0 * step as f64 / steps as f64 - 1.0);
            let (sin, cos) = (hand * std::f64::consts::TAU * way / pitch).sin_cos();
            // The radius grows from the ends of the coil within a turn.
            let opening = ((half_coil - way.abs()) / pitch).min(1.0);
            let width = radius * (0.15 + 0.85 * opening) * (1.0 + wobble.at(way)).max(0.3);
            site.centre + axis * way + (first * cos + second * sin) * width
        })
        .collect();
    let on = |from: &Point3, way: f64| {
        let far = from + axis * (way * site.reach_nm());
        spline(&[*from, from + axis * (way * pitch), far], false, 40.0)
    };
    let mut line = on(&points[0], -1.0);
    line.reverse();
    line.pop();
    let tail = on(&points[points.len() - 1], 1.0);
    line.append(&mut points);
    line.extend(&tail[1..]);
    vec![open_line(line, system.burgers_nm, None)]
}

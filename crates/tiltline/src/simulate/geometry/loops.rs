//! Closed loops: circular, elliptic, elongated, hexagonal; on slip planes or prismatic.

use rand::RngExt;
use rand_pcg::Pcg64;

use super::polyline::round_corners;
use super::settings::LoopSettings;
use super::site::{Site, Wave, chance, direction};
use crate::geometry::Point3;
use crate::simulate::foil::Dislocation;

/// One loop, or a few that lie together. A surface cuts them into arcs.
pub fn loops(settings: &LoopSettings, site: &Site, rng: &mut Pcg64) -> Vec<Dislocation> {
    let radius = settings.radius_nm.sample_log(rng);
    let count = site.count(settings.together, std::f64::consts::TAU * radius, rng);
    let hexagonal = chance(settings.hexagonal, rng);
    // Loops of one kind: half of them shear loops in their slip plane, half prismatic, across their Burgers vector.
    let prismatic = chance(0.5, rng);
    (0..count)
        .map(|index| {
            let system = site.slip_system(rng);
            let normal = if prismatic { system.burgers_nm.normalize() } else { system.normal };
            let own_radius = radius * rng.random_range(0.5..1.3);
            let mut centre = site.centre;
            if index > 0 {
                centre += direction(rng) * (radius * rng.random_range(1.0..6.0));
                centre.z = centre.z.clamp(-0.5 * site.thickness_nm, 0.5 * site.thickness_nm);
            }
            let long = normal.cross(&direction(rng)).normalize();
            let short = normal.cross(&long);
            let aspect = settings.aspect.sample(rng).sqrt();
            let wobble = Wave::new(0.03, 2.5, rng);
            let corners = if hexagonal { 6 } else { 360 };
            let outline: Vec<Point3> = (0..corners)
                .map(|corner| {
                    let angle = std::f64::consts::TAU * f64::from(corner) / f64::from(corners);
                    // Fades towards angle 0, so that the outline joins itself.
                    let reach = own_radius * (1.0 + wobble.at(angle) * (0.5 * angle).sin());
                    centre + (long * (angle.cos() * aspect) + short * (angle.sin() / aspect)) * reach
                })
                .collect();
            let points = if hexagonal { round_corners(&outline, true, 3) } else { outline };
            Dislocation { points, closed: true, burgers_nm: Some(system.burgers_nm), plane_normal: Some(normal) }
        })
        .collect()
}

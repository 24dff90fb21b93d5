//! Tangles: many irregular lines in a small volume, each on to the surfaces in the end.

use rand::RngExt;
use rand_pcg::Pcg64;

use super::polyline::spline;
use super::settings::{Range, TangleSettings};
use super::site::{Site, azimuth, chance, direction, facetted, open_line, sign};
use crate::geometry::{Point3, Vector3};
use crate::simulate::foil::Dislocation;

/// Lines that wander within an ellipsoid, along the boundary where there is one.
pub fn tangle(settings: &TangleSettings, site: &Site, rng: &mut Pcg64) -> Vec<Dislocation> {
    let radius = settings.radius_nm.sample_log(rng);
    let elongation = settings.elongation.sample(rng);
    let long = site.boundary.unwrap_or_else(|| azimuth(rng));
    let wide = Vector3::new(-long.y, long.x, 0.0);
    let volume = Volume { centre: site.centre, long: long * (radius * elongation), wide: wide * radius };
    let persistence = settings.persistence_nm.sample_log(rng);
    let winding = settings.winding.sample(rng) * radius * elongation;
    // A small tangle of many lines would be a ball of wool.
    let room = (2.0 + radius * elongation / 20.0).clamp(settings.lines.low, settings.lines.high);
    let count = site.count(Range::new(settings.lines.low, room), winding + site.thickness_nm, rng);
    (0..count)
        .map(|_| {
            let system = site.slip_system(rng);
            let start = volume.random_point(site, rng);
            // Lines run along a long tangle rather than across it.
            let along = (direction(rng) + long * (sign(rng) * 0.6 * (elongation - 1.0).min(2.5))).normalize();
            let upper = sign(rng);
            let lower = if chance(0.7, rng) { -upper } else { upper };
            let one = volume.walk(start, along, 0.5 * winding, persistence, upper, site, rng);
            let other = volume.walk(start, -along, 0.5 * winding, persistence, lower, site, rng);
            let knots: Vec<Point3> = other.into_iter().rev().chain([start]).chain(one).collect();
            let smooth = spline(&knots, false, site.spacing_nm);
            let points = if chance(0.3, rng) {
                facetted(&smooth, false, 1.2 * persistence, &[long, wide, Vector3::z()], rng)
            } else {
                smooth
            };
            open_line(points, system.burgers_nm, None)
        })
        .collect()
}

/// The ellipsoid that the lines prefer.
struct Volume {
    centre: Point3,
    long: Vector3,
    wide: Vector3,
}

impl Volume {
    fn random_point(&self, site: &Site, rng: &mut Pcg64) -> Point3 {
        let mut point = self.centre + self.long * rng.random_range(-1.0..1.0) + self.wide * rng.random_range(-1.0..1.0);
        point.z = rng.random_range(-0.45..0.45) * site.thickness_nm;
        point
    }

    /// Knots of a persistent random walk that is drawn back to the volume; it then leaves for the surface `side`.
    #[allow(clippy::too_many_arguments)]
    fn walk(
        &self,
        start: Point3,
        along: Vector3,
        length_nm: f64,
        persistence_nm: f64,
        side: f64,
        site: &Site,
        rng: &mut Pcg64,
    ) -> Vec<Point3> {
        let half = 0.5 * site.thickness_nm;
        let step = 0.6 * persistence_nm;
        let drift = 0.15 * (self.long.norm() / self.wide.norm() - 1.0).clamp(0.0, 2.0);
        let (mut at, mut heading, mut travelled) = (start, along, 0.0);
        let mut knots = Vec::new();
        while travelled < length_nm {
            let offset = at - self.centre;
            let (long, wide) = (self.long.norm(), self.wide.norm());
            let out = self.long * (offset.dot(&self.long) / long.powi(3))
                + self.wide * (offset.dot(&self.wide) / wide.powi(3));
            let back = -out - Vector3::z() * (0.4 * at.z / half);
            heading =
                (heading + along * drift + direction(rng) * 0.9 + back * 0.5).try_normalize(1e-6).unwrap_or(along);
            let next = at + heading * (step * rng.random_range(0.5..1.5));
            if next.z.abs() > 0.9 * half {
                // Reflected: a surface ends the line only where it is meant to.
                heading.z = -heading.z;
                travelled += step;
                continue;
            }
            at = next;
            travelled += step;
            knots.push(at);
        }
        // Steers for the surface within a few steps.
        for _ in 0..60 {
            heading = (heading * 0.8 + direction(rng) * 0.5 + Vector3::z() * (0.45 * side))
                .try_normalize(1e-6)
                .unwrap_or(along);
            at += heading * step;
            knots.push(at);
            if at.z.abs() > 1.02 * half {
                return knots;
            }
        }
        at.z = 1.05 * half * side;
        knots.push(at);
        knots
    }
}

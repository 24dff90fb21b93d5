//! Turns a foil about the beam, so that its lines mainly run in a given direction.

use nalgebra::{Rotation3, UnitQuaternion};

use super::FoilSample;
use crate::geometry::Vector3;

/// Turns everything in the foil so that the main direction of its lines, in projection, makes `angle_rad` with x (clockwise on
/// the screen).
pub(super) fn turn_to(sample: &mut FoilSample, angle_rad: f64) {
    let turn = angle_rad - main_direction_rad(sample);
    let rotation = Rotation3::from_axis_angle(&Vector3::z_axis(), turn);
    for line in &mut sample.foil.dislocations {
        line.points.iter_mut().for_each(|point| *point = rotation * *point);
        for vector in [&mut line.burgers_nm, &mut line.plane_normal].into_iter().flatten() {
            *vector = rotation * *vector;
        }
    }
    for boundary in &mut sample.boundaries {
        boundary.normal = rotation * boundary.normal;
    }
    for crystal in &mut sample.crystals {
        crystal.specimen_from_crystal = UnitQuaternion::from(rotation) * crystal.specimen_from_crystal;
    }
}

/// The direction most of the projected length runs in, radians clockwise on the screen from x; opposite directions are one.
fn main_direction_rad(sample: &FoilSample) -> f64 {
    let (mut cos, mut sin) = (0.0, 0.0);
    for ends in sample.foil.dislocations.iter().flat_map(|line| line.points.windows(2)) {
        let along = ends[1] - ends[0];
        let length = along.xy().norm();
        // Doubled angles make opposite directions agree.
        let (double_sin, double_cos) = (2.0 * along.y.atan2(along.x)).sin_cos();
        cos += length * double_cos;
        sin += length * double_sin;
    }
    0.5 * sin.atan2(cos)
}

#[cfg(test)]
mod tests {
    use super::super::{FoilSettings, Range, Split, geometry_rng, sample_foil};
    use super::*;

    #[test]
    fn lines_mainly_run_in_the_direction_asked_for_and_burgers_vectors_turn_with_them() {
        let settings = FoilSettings { main_direction_deg: Some(Range::exactly(30.0)), ..FoilSettings::gan() };
        let mut glide = 0;
        for index in 0..5 {
            let sample = sample_foil(&settings, &mut geometry_rng(Split::Train, index));
            assert!((main_direction_rad(&sample).to_degrees() - 30.0).abs() < 1e-6);
            // Lines on slip systems of the crystal: true of a turned foil only if lines, planes and crystal were turned alike.
            let systems: Vec<_> = sample.crystals.iter().flat_map(|crystal| crystal.slip_systems()).collect();
            let on_system = sample.foil.dislocations.iter().filter(|line| {
                let (Some(burgers), Some(normal)) = (line.burgers_nm, line.plane_normal) else { return false };
                systems.iter().any(|system| {
                    let same_burgers =
                        (system.burgers_nm.norm() - system.burgers_nm.dot(&burgers).abs() / burgers.norm()).abs();
                    same_burgers < 1e-9 && system.normal.dot(&normal).abs() > 1.0 - 1e-9
                })
            });
            glide += on_system.count();
            let reflections = sample.crystals[0].reflections();
            let line = sample.foil.dislocations.iter().find(|line| line.burgers_nm.is_some()).unwrap();
            // g.b of a lattice vector and a reciprocal lattice vector is a multiple of one half: true only if both were turned.
            let product = 2.0 * reflections[0].dot(&line.burgers_nm.unwrap());
            assert!((product - product.round()).abs() < 1e-6, "{product}");
        }
        // Threading lines have no plane, but these foils have glide lines too.
        assert!(glide > 5, "{glide}");
    }
}

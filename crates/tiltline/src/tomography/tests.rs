use std::f64::consts::PI;

use approx::assert_relative_eq;
use ndarray::{Array2, Array3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::projector::{LANES, Lanes, Projector};
use super::*;
use crate::geometry::{Point3, project_at_tilt};

fn random(count: usize, seed: u64) -> Vec<Lanes> {
    let mut rng = Pcg64::seed_from_u64(seed);
    (0..count).map(|_| std::array::from_fn(|_| rng.random_range(0.0..1.0))).collect()
}

fn dot(a: &[Lanes], b: &[Lanes]) -> f64 {
    a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
}

/// Uneven tilts on both sides of 45 and 90 degrees, an axis off the middle, a flat and a deep volume.
fn geometries() -> Vec<Geometry> {
    let tilts = [-170.0, -90.0, -76.0, -45.0, -44.9, -8.3, 0.0, 0.0, 12.0, 45.0, 60.1, 89.0, 135.0];
    let tilts_rad: Vec<f64> = tilts.iter().map(|tilt: &f64| tilt.to_radians()).collect();
    [(37, 37, 18.0), (64, 9, 29.3), (12, 50, 2.25), (1, 1, 0.0), (2, 3, 0.5)]
        .map(|(width, depth, axis_column)| Geometry { tilts_rad: tilts_rad.clone(), width, depth, axis_column })
        .to_vec()
}

#[test]
fn the_projections_are_adjoint() {
    for (seed, geometry) in geometries().iter().enumerate() {
        let projector = Projector::new(geometry);
        let (x, y) = (random(projector.volume_len(), seed as u64), random(projector.views_len(), 100 + seed as u64));
        let mut projected = vec![[0.0; LANES]; projector.views_len()];
        projector.project(&x, &mut projected);
        let mut back = vec![[0.0; LANES]; projector.volume_len()];
        projector.back_project(&y, |index, sum| back[index] = *sum);
        // Single precision, and positive numbers only: what is lost is rounding.
        assert_relative_eq!(dot(&projected, &y), dot(&x, &back), max_relative = 1e-6);
    }
}

/// Against the definition, written out in double precision: the share of each voxel's shadow that lies over a bin.
#[test]
fn weights_are_overlaps_of_shadows_and_bins() {
    for geometry in geometries() {
        let projector = Projector::new(&geometry);
        let mut rng = Pcg64::seed_from_u64(7);
        for _ in 0..20 {
            let (x, z) = (rng.random_range(0..geometry.width), rng.random_range(0..geometry.depth));
            let mut volume = vec![[0.0; LANES]; projector.volume_len()];
            volume[z * geometry.width + x] = [1.0; LANES];
            let mut views = vec![[0.0; LANES]; projector.views_len()];
            projector.project(&volume, &mut views);
            for (tilt, bins) in geometry.tilts_rad.iter().zip(views.chunks_exact(geometry.width)) {
                let (sin, cos) = tilt.sin_cos();
                let m = cos.abs().max(sin.abs());
                let place = Point3::new(x as f64 - geometry.axis_column, 0.0, z as f64 - geometry.middle_layer());
                let centre = project_at_tilt(&place, *tilt).x + geometry.axis_column;
                for (u, bin) in bins.iter().enumerate() {
                    let low = (centre - 0.5 * m).max(u as f64 - 0.5);
                    let overlap = ((centre + 0.5 * m).min(u as f64 + 0.5) - low).max(0.0);
                    assert!((f64::from(bin[3]) - overlap / m).abs() < 1e-6, "{x} {z} {u} {tilt}");
                }
            }
        }
    }
}

/// Physics, not a round trip: what lies away from the viewer (Z > 0) moves to larger x as the tilt grows.
#[test]
fn a_far_point_moves_right_as_the_tilt_grows() {
    let geometry = Geometry::centred(vec![-0.3, 0.0, 0.3], 41, 41);
    let projector = Projector::new(&geometry);
    let mut volume = vec![[0.0; LANES]; projector.volume_len()];
    volume[35 * 41 + 20] = [1.0; LANES];
    let mut views = vec![[0.0; LANES]; projector.views_len()];
    projector.project(&volume, &mut views);
    let centre =
        |view: usize| -> f64 { (0..41).map(|u| u as f64 * f64::from(views[view * 41 + u][0])).sum::<f64>() - 20.0 };
    assert!(centre(0) < -3.0 && centre(1).abs() < 1e-5 && centre(2) > 3.0);
    // A shadow that is shared out to bins may lose a hundredth of a px of its place.
    assert_relative_eq!(centre(2), 15.0 * 0.3_f64.sin(), epsilon = 0.02);
}

const SIDE: usize = 65;

/// Exact projections of a ball of density 1 about (3, y 16, -5), and of one of density 0.5, by chord lengths.
fn balls(tilts_rad: &[f64]) -> Vec<Array2<f32>> {
    let balls = [(Point3::new(3.0, 16.0, -5.0), 12.0, 1.0), (Point3::new(-14.0, 20.0, 9.0), 6.0, 0.5)];
    let middle = 0.5 * (SIDE as f64 - 1.0);
    let view = |tilt: &f64| {
        Array2::from_shape_fn((40, SIDE), |(row, column)| {
            let chord = |(centre, radius, density): &(Point3, f64, f64)| {
                let place = project_at_tilt(centre, *tilt);
                let average = (0..8).map(|sub| {
                    let across = column as f64 - middle + (f64::from(sub) - 3.5) / 8.0 - place.x;
                    let off2 = across.powi(2) + (row as f64 - place.y).powi(2);
                    2.0 * density * (radius * radius - off2).max(0.0).sqrt()
                });
                average.sum::<f64>() / 8.0
            };
            balls.iter().map(chord).sum::<f64>() as f32
        })
    };
    tilts_rad.iter().map(view).collect()
}

fn half_turn(count: usize) -> Vec<f64> {
    (0..count).map(|step| PI * step as f64 / count as f64).collect()
}

/// Mean value in a ball of 3 px about a specimen point.
fn mean_about(volume: &Array3<f32>, point: [f64; 3]) -> f64 {
    let middle = 0.5 * (SIDE as f64 - 1.0);
    let (mut sum, mut count) = (0.0, 0.0);
    for ((z, y, x), value) in volume.indexed_iter() {
        let off = [x as f64 - middle - point[0], y as f64 - point[1], z as f64 - middle - point[2]];
        if off.iter().map(|value| value * value).sum::<f64>() <= 9.0 {
            sum += f64::from(*value);
            count += 1.0;
        }
    }
    sum / count
}

#[test]
fn balls_come_back_where_they_are_with_their_density() {
    let geometry = Geometry::centred(half_turn(90), SIDE, SIDE);
    let views = balls(&geometry.tilts_rad);
    let methods = [
        Method::Wbp(WbpSettings { filter: Filter::Ramp }),
        Method::Wbp(WbpSettings { filter: Filter::Hamming }),
        Method::Sirt(SirtSettings { iterations: 60, ..SirtSettings::default() }),
    ];
    for method in methods {
        let volume = volume(&views, &geometry, &method).unwrap();
        assert_eq!(volume.dim(), (SIDE, 40, SIDE));
        for (point, density) in [
            ([3.0, 16.0, -5.0], 1.0),
            ([-14.0, 20.0, 9.0], 0.5),
            ([20.0, 16.0, 18.0], 0.0),
            // Mirror images, should z be upside down, or x.
            ([3.0, 16.0, 22.0], 0.0),
            ([-14.0, 20.0, -20.0], 0.0),
        ] {
            let found = mean_about(&volume, point);
            // The Hamming window keeps the mean of a ball of this size to a few percent.
            assert!((found - density).abs() < 0.03, "{method:?} {point:?} {found}");
        }
    }
}

#[test]
fn sirt_comes_closer_to_the_views_at_each_step_and_stays_positive() {
    let tilts: Vec<f64> = (-15..=15).map(|step| (4.0 * f64::from(step)).to_radians()).collect();
    let geometry = Geometry::centred(tilts, SIDE, 41);
    let views = balls(&geometry.tilts_rad);
    let lanes: Vec<Lanes> =
        views.iter().flat_map(|view| (0..SIDE).map(|u| std::array::from_fn(|lane| view[[lane, u]]))).collect();
    for relaxation in [0.5, 1.0, 1.8] {
        let settings = SirtSettings { iterations: 12, relaxation, non_negative: true };
        let (volume, misfit) = sirt::Sirt::new(&geometry, &settings).unwrap().reconstruct(&lanes);
        assert!(misfit.windows(2).all(|pair| pair[1] < pair[0]), "{misfit:?}");
        assert!(misfit[11] < 0.2 * misfit[0], "{misfit:?}");
        assert!(volume.iter().flatten().all(|value| *value >= 0.0));
    }
    for relaxation in [0.0, 2.0, f32::NAN] {
        assert!(SirtSettings { relaxation, ..SirtSettings::default() }.validate().is_err());
    }
}

/// Rows do not know of each other, nor of the number of threads, nor of where slabs begin.
#[test]
fn rows_are_independent_of_slabs_and_threads() {
    let geometry = Geometry::centred(half_turn(20), SIDE, 17);
    let views = balls(&geometry.tilts_rad);
    let method = Method::Sirt(SirtSettings { iterations: 3, ..SirtSettings::default() });
    let with = |threads: usize, views: &[Array2<f32>]| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| volume(views, &geometry, &method).unwrap())
    };
    let whole = with(1, &views);
    assert_eq!(whole, with(3, &views));
    let below: Vec<Array2<f32>> = views.iter().map(|view| view.slice(ndarray::s![5.., ..]).to_owned()).collect();
    assert_eq!(whole.slice(ndarray::s![.., 5.., ..]), with(2, &below));
}

#[test]
fn what_is_wrong_is_named() {
    let geometry = Geometry::centred(half_turn(3), 8, 4);
    let method = Method::Wbp(WbpSettings::default());
    let blank = || vec![Array2::<f32>::zeros((6, 8)); 3];
    assert!(volume(&blank(), &geometry, &method).is_ok());
    let mut views = blank();
    views.pop();
    let message = volume(&views, &geometry, &method).unwrap_err().to_string();
    assert!(message.contains("2 views have 3 tilts"), "{message}");
    let mut views = blank();
    views[1] = Array2::zeros((5, 8));
    assert!(matches!(volume(&views, &geometry, &method), Err(TomographyError::Shape { view: 1, rows: 5, .. })));
    let mut views = blank();
    views[2][[0, 0]] = f32::NAN;
    assert!(matches!(volume(&views, &geometry, &method), Err(TomographyError::NotFinite { view: 2, count: 1 })));
    let one = Geometry::centred(vec![0.1; 3], 8, 4);
    assert!(matches!(volume(&blank(), &one, &method), Err(TomographyError::TooFewViews { views: 3, distinct: 1 })));
}

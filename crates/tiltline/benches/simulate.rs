//! `cargo bench --bench simulate`: whole pairs of 512x512 px with their truth, as `tiltline simulate` makes them (eight foils of each
//! family and mode in one measurement: divide by eight), and one physical view (1 nm px) of a 120 nm foil with 15 bowed lines.
#![allow(missing_docs)]

use criterion::{Criterion, criterion_group, criterion_main};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;
use tiltline::geometry::{Point3, Vector3};
use tiltline::simulate::geometry::{Split, geometry_seed};
use tiltline::simulate::physics::{Detector, PhysicsSettings, image};
use tiltline::simulate::{Camera, Dislocation, Family, Foil, Lines, Mode, SimulateSettings, sample};

fn foil() -> Foil {
    let (size, thickness) = (512.0, 120.0);
    let mut rng = Pcg64::seed_from_u64(1);
    let lines = (0..15).map(|i| {
        let middle = [rng.random_range(-0.45..0.45) * size, rng.random_range(-0.45..0.45) * size];
        let (angle, length) = (rng.random_range(0.0..6.3_f64), rng.random_range(0.2..0.7) * size);
        let bow = rng.random_range(-0.25..0.25) * length;
        let points = (0..=80).map(|step| {
            let q = f64::from(step) / 80.0 - 0.5;
            let (along, across) = (q * length, bow * (1.0 - 4.0 * q * q));
            let x = middle[0] + along * angle.cos() - across * angle.sin();
            Point3::new(x, middle[1] + along * angle.sin() + across * angle.cos(), q * thickness)
        });
        let burgers =
            [Vector3::new(0.0, 0.18, 0.18), Vector3::new(0.18, 0.18, 0.0), Vector3::new(0.18, 0.0, 0.18)][i % 3];
        Dislocation { points: points.collect(), closed: false, burgers_nm: Some(burgers), plane_normal: None }
    });
    Foil { thickness_nm: thickness, size_nm: [1.2 * size; 2], dislocations: lines.collect() }
}

fn views(criterion: &mut Criterion) {
    let foil = foil();
    let bright_field = PhysicsSettings { g_per_nm: Vector3::new(0.0, 1.0 / 0.18, 0.0), ..PhysicsSettings::default() };
    let weak_beam = PhysicsSettings { deviation_per_nm: 0.2, detector: Detector::DarkField, ..bright_field.clone() };
    let detector = Detector::AnnularBrightField { inner_fraction: 0.5 };
    let annular = PhysicsSettings { convergence_mrad: 12.4, detector, ..bright_field.clone() };
    let view = Camera { tilt_rad: 0.07, ..Camera::new([512, 512]) };
    let mut group = criterion.benchmark_group("physics, one 512x512 view");
    group.sample_size(10);
    for (name, settings) in [("bright field", bright_field), ("weak beam", weak_beam), ("STEM ABF", annular)] {
        group.bench_function(name, |bencher| bencher.iter(|| image(&foil, &settings, &view)));
    }
    group.finish();
}

/// Pairs in one measurement: foils differ several times in cost.
const FOILS: u32 = 8;

fn pairs(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("eight 512x512 pairs");
    group.sample_size(10);
    for mode in [Mode::Parametric, Mode::Physics] {
        for family in [Family::Gan, Family::Tial, Family::Cantor] {
            let settings = SimulateSettings { mode, ..SimulateSettings::of_family(family) };
            let make = || {
                let foils = (0..FOILS).into_par_iter().with_max_len(1);
                foils
                    .map(|foil| {
                        sample(&settings, Lines::Random, geometry_seed(Split::Train, u64::from(foil)))
                            .map(|s| s.truth.curves.len())
                    })
                    .collect::<Vec<_>>()
            };
            group.bench_function(format!("{} {}", family.word(), mode.word()), |bencher| bencher.iter(make));
        }
    }
    group.finish();
}

criterion_group!(benches, pairs, views);
criterion_main!(benches);

//! Textbook cases of diffraction contrast, for a microscopist to recognise.

use std::f64::consts::PI;

use miette::{IntoDiagnostic, Result};
use ndarray::Array2;
use tiltline::filter::percentiles;
use tiltline::geometry::{Point3, Vector3};
use tiltline::simulate::physics::{Detector, PhysicsSettings, image};
use tiltline::simulate::{Camera, Dislocation, Foil};

const SIDE_PX: usize = 200;
const PIXEL_NM: f64 = 1.8;
/// A perfect dislocation of an fcc metal is about this long.
const B_NM: f64 = 0.25;

struct Case {
    foil: Foil,
    settings: PhysicsSettings,
    tilt_rad: f64,
}

/// All cases as pictures, in the order of docs/simulator.md.
pub fn pictures() -> Result<Vec<Array2<f32>>> {
    let picture = |case: Case| {
        let view = Camera { scale: 1.0 / PIXEL_NM, tilt_rad: case.tilt_rad, ..Camera::new([SIDE_PX, SIDE_PX]) };
        let intensity = image(&case.foil, &case.settings, &view).into_diagnostic()?.intensity;
        let [low, high] = percentiles(&intensity, [0.002, 0.998]);
        // At least 2 percent of contrast from black to white: what is invisible stays grey.
        let (middle, range) = (0.5 * (low + high), (high - low).max(0.01 * (low + high)));
        Ok(intensity.mapv(|value| (0.5 + (value - middle) / range).clamp(0.0, 1.0)))
    };
    cases().into_iter().map(picture).collect()
}

/// g along x with |g.b| = 1 for b along x; slightly positive deviation; parallel bright field.
fn usual() -> PhysicsSettings {
    PhysicsSettings {
        g_per_nm: Vector3::new(1.0 / B_NM, 0.0, 0.0),
        extinction_distance_nm: 45.0,
        deviation_per_nm: 0.004,
        ..PhysicsSettings::default()
    }
}

fn cases() -> Vec<Case> {
    let x = Vector3::x() * B_NM;
    let along = Vector3::new(0.0, 0.85, 0.5).normalize();
    let thick = 180.0;
    let case = |foil, settings| Case { foil, settings, tilt_rad: 0.0 };
    let oscillating = PhysicsSettings { deviation_per_nm: 0.0, ..usual() };
    let weak = PhysicsSettings {
        g_per_nm: Vector3::new(2.0 / B_NM, 0.0, 0.0),
        deviation_per_nm: 0.2,
        detector: Detector::DarkField,
        ..usual()
    };
    let stem = PhysicsSettings { convergence_mrad: 12.4, ..usual() };
    let ring = Detector::AnnularBrightField { inner_fraction: 0.5 };
    let diffuse = Detector::AnnularDarkField { diffracted_fraction: 0.6, diffuse_fraction: 0.6 };
    let annular = PhysicsSettings { detector: ring, ..stem.clone() };
    let bent = PhysicsSettings { bend_per_um: [0.12, 0.0, 0.02], deviation_per_nm: 0.01, ..usual() };
    let wedge = PhysicsSettings { wedge: [0.0, 0.7], deviation_per_nm: 0.002, ..usual() };
    let mut cases = vec![
        // Screws inclined.
        case(screws(120.0), PhysicsSettings { g_per_nm: Vector3::new(0.0, 1.0 / B_NM, 0.0), ..usual() }),
        // Screws invisible.
        case(screws(120.0), usual()),
        // Edge inclined.
        case(three_inclined(120.0, x), usual()),
        // Mixed inclined.
        case(three_inclined(120.0, (Vector3::x() + along) * B_NM), usual()),
        // Dotted thick foil s 0.
        case(three_inclined(thick, x), oscillating),
        // Horizontal edges at three depths.
        case(horizontal(120.0, x), usual()),
        // Dipoles.
        case(dipoles(120.0, x), usual()),
        // Loops in plane.
        case(loops(120.0, Vector3::new(0.0, 0.0, B_NM)), usual()),
        // Loops b in plane.
        case(loops(120.0, x), usual()),
        // Double image g b 2.
        case(three_inclined(120.0, x * 2.0), usual()),
        // Bowed bright field.
        case(bowed(120.0), usual()),
        // Bowed dark field.
        case(bowed(120.0), PhysicsSettings { detector: Detector::DarkField, ..usual() }),
        // Bowed weak beam.
        case(bowed(120.0), weak),
        // Bowed stem abf.
        case(bowed(120.0), annular.clone()),
        // Bowed stem adf.
        case(bowed(120.0), PhysicsSettings { detector: diffuse, ..stem }),
        // Bent foil.
        case(bowed(120.0), bent),
        // Wedge.
        case(bowed(140.0), wedge),
        // Thick foil stem abf.
        case(three_inclined(thick, x), PhysicsSettings { deviation_per_nm: 0.0, ..annular }),
    ];
    // A stereo pair: everything else alike, 20 degrees apart.
    for tilt_deg in [-10.0_f64, 10.0] {
        cases.push(Case { foil: bowed(120.0), settings: usual(), tilt_rad: tilt_deg.to_radians() });
    }
    cases
}

fn foil(thickness_nm: f64, dislocations: Vec<Dislocation>) -> Foil {
    Foil { thickness_nm, size_nm: [SIDE_PX as f64 * PIXEL_NM * 1.2; 2], dislocations }
}

fn line(points: Vec<Point3>, burgers: Vector3) -> Dislocation {
    Dislocation { points, closed: false, burgers_nm: Some(burgers), plane_normal: None }
}

/// Straight lines from surface to surface, projected along y with three lengths.
fn three_inclined(thickness: f64, burgers: Vector3) -> Foil {
    let lines = [(-100.0, 300.0), (0.0, 200.0), (100.0, 120.0)].map(|(x, length): (f64, f64)| {
        let points = (0..=60).map(|i| f64::from(i) / 60.0 - 0.5);
        line(points.map(|q| Point3::new(x + 20.0 * q, q * length, q * thickness)).collect(), burgers)
    });
    foil(thickness, lines.into())
}

/// The same with b along each line, as long as makes b_y = B_NM; none leans towards x.
fn screws(thickness: f64) -> Foil {
    let mut foil = three_inclined(thickness, Vector3::zeros());
    for dislocation in &mut foil.dislocations {
        let x = dislocation.points[30].x;
        for point in &mut dislocation.points {
            point.x = x;
        }
        let along = dislocation.points[60] - dislocation.points[0];
        dislocation.burgers_nm = Some(along * (B_NM / along.y));
    }
    foil
}

fn horizontal(thickness: f64, burgers: Vector3) -> Foil {
    let lines = [(-100.0, -0.3), (0.0, 0.0), (100.0, 0.3)].map(|(x, depth): (f64, f64)| {
        let points = (-40..=40).map(|i| Point3::new(x, f64::from(i) * 6.0, depth * thickness));
        line(points.collect(), burgers)
    });
    foil(thickness, lines.into())
}

/// Pairs of opposite sign, 8, 16 and 32 nm apart, on planes 6 nm above each other.
fn dipoles(thickness: f64, burgers: Vector3) -> Foil {
    let mut lines = Vec::new();
    for (x, gap) in [(-100.0, 8.0), (0.0, 16.0), (100.0, 32.0)] {
        for side in [-0.5, 0.5] {
            let points = (-40..=40).map(|i| {
                let q = f64::from(i) / 80.0;
                Point3::new(x + side * gap, q * 280.0, q * thickness + side * 6.0)
            });
            lines.push(line(points.collect(), burgers * (2.0 * side)));
        }
    }
    foil(thickness, lines)
}

/// Circular loops of radius 10 to 40 nm in planes parallel to the surface, at several depths.
fn loops(thickness: f64, burgers: Vector3) -> Foil {
    let places =
        [(-95.0, -95.0, 40.0, -0.25), (70.0, -80.0, 28.0, 0.0), (-80.0, 70.0, 20.0, 0.2), (60.0, 70.0, 10.0, 0.3)];
    let loops = places.map(|(x, y, radius, depth): (f64, f64, f64, f64)| {
        let angles = (0..72).map(|i| 2.0 * PI * f64::from(i) / 72.0);
        let points = angles.map(|a| Point3::new(x + radius * a.cos(), y + radius * a.sin(), depth * thickness));
        Dislocation { closed: true, ..line(points.collect(), burgers) }
    });
    foil(thickness, loops.into())
}

/// Lines of three Burgers vectors bowed on inclined slip planes, from surface to surface.
fn bowed(thickness: f64) -> Foil {
    let vectors = [Vector3::new(1.0, 0.0, 0.0), Vector3::new(1.0, 1.0, 0.0), Vector3::new(-1.0, 0.0, 1.0)];
    let ends = [
        ([-160.0, -140.0], [-60.0, 40.0], 30.0),
        ([-110.0, -150.0], [0.0, 20.0], 35.0),
        ([-60.0, -160.0], [70.0, 10.0], 45.0),
        ([-150.0, 40.0], [-40.0, 150.0], -25.0),
        ([-20.0, 150.0], [150.0, 60.0], 40.0),
        ([60.0, -150.0], [150.0, -20.0], -30.0),
        ([10.0, 60.0], [90.0, 110.0], 10.0),
        ([110.0, 90.0], [160.0, 160.0], 0.0),
    ];
    let lines = ends.iter().enumerate().map(|(i, (start, end, bow))| {
        let across = Vector3::new(start[1] - end[1], end[0] - start[0], 0.0).normalize();
        let points = (0..=80).map(|step| {
            let q = f64::from(step) / 80.0;
            let middle = 4.0 * q * (1.0 - q);
            let x = start[0] + q * (end[0] - start[0]) + across.x * bow * middle;
            let y = start[1] + q * (end[1] - start[1]) + across.y * bow * middle;
            Point3::new(x, y, (q - 0.5) * thickness)
        });
        line(points.collect(), vectors[i % 3] * B_NM)
    });
    foil(thickness, lines.collect())
}

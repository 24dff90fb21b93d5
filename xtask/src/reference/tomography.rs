//! Tomography against scikit-image (`iradon`), ASTRA (SIRT) and NumPy (the projector as a matrix) on phantoms, the volume's file
//! against mrcfile, and the speed of SIRT against ASTRA, scikit-image and SciPy's sparse matrices.

use std::f64::consts::PI;
use std::path::Path;
use std::time::Instant;

use miette::{IntoDiagnostic, Result, miette};
use ndarray::{Array2, s};
use serde_json::Value;
use tiltline::export::mrc_volume::VolumeWriter;
use tiltline::tomography::{Filter, Geometry, Method, SirtSettings, WbpSettings, volume};

use crate::npy;
use crate::venv::Venv;

/// Odd, so that the middle of every program's image is a pixel.
const SIDE: usize = 129;
const SMALL: usize = 33;
/// Rounds in which all are timed in turn.
const ROUNDS: usize = 3;
const PEERS: [(&str, &str); 4] = [
    ("astra-linear", "ASTRA SIRT, linear (Joseph) kernel"),
    ("astra-strip", "ASTRA SIRT, strip kernel"),
    ("scipy", "SciPy CSR with ASTRA's linear matrix, 32 rows at once"),
    ("skimage", "scikit-image iradon_sart"),
];

/// An ellipse: centre, half axes (px), turn (radians), density.
type Ellipse = ([f64; 2], [f64; 2], f64, f64);

/// A body with inclusions, a rod, and points, that fills most of the side.
fn ellipses(side: usize) -> Vec<Ellipse> {
    let unit = side as f64 / 129.0;
    [
        ([0.0, 0.0], [50.0, 40.0], 0.3, 1.0),
        ([12.0, -8.0], [14.0, 9.0], -0.5, -0.6),
        ([-20.0, 10.0], [6.0, 16.0], 0.9, 0.8),
        ([5.0, 25.0], [3.0, 3.0], 0.0, 1.5),
        ([25.0, 14.0], [2.0, 12.0], 1.2, 0.7),
    ]
    .map(|(centre, half, turn, density)| (centre.map(|at| at * unit), half.map(|at| at * unit), turn, density))
    .to_vec()
}

/// Exact line integrals, averaged over each bin.
fn views(side: usize, tilts_rad: &[f64]) -> Array2<f32> {
    let middle = 0.5 * (side as f64 - 1.0);
    Array2::from_shape_fn((tilts_rad.len(), side), |(view, column)| {
        let (sin, cos) = tilts_rad[view].sin_cos();
        let integral = |t: f64| -> f64 {
            let one = |([x, z], [a, b], turn, density): &Ellipse| {
                // Along the normal (cos, sin) in the ellipse's own axes.
                let (own_sin, own_cos) = (tilts_rad[view] - turn).sin_cos();
                let reach2 = (a * own_cos).powi(2) + (b * own_sin).powi(2);
                let off = t - (x * cos + z * sin);
                2.0 * density * a * b * (reach2 - off * off).max(0.0).sqrt() / reach2
            };
            ellipses(side).iter().map(one).sum()
        };
        let samples = 16;
        let sum: f64 =
            (0..samples).map(|i| integral(column as f64 - middle - 0.5 + (i as f64 + 0.5) / samples as f64)).sum();
        (sum / samples as f64) as f32
    })
}

/// Mean density of each voxel, `[z][x]`.
fn truth(side: usize) -> Array2<f32> {
    let middle = 0.5 * (side as f64 - 1.0);
    Array2::from_shape_fn((side, side), |(row, column)| {
        let mut sum = 0.0;
        for sub in 0..25 {
            let place = |index: usize, step: usize| index as f64 - middle + (step as f64 - 2.0) / 5.0;
            let (x, z) = (place(column, sub % 5), place(row, sub / 5));
            for ([cx, cz], [a, b], turn, density) in ellipses(side) {
                let (sin, cos) = turn.sin_cos();
                let (u, v) = ((x - cx) * cos + (z - cz) * sin, (z - cz) * cos - (x - cx) * sin);
                sum += if (u / a).powi(2) + (v / b).powi(2) <= 1.0 { density } else { 0.0 };
            }
        }
        (sum / 25.0) as f32
    })
}

/// One slice: views `[view][column]` to `[z][x]`.
fn slice(views: &Array2<f32>, tilts_rad: &[f64], depth: usize, method: &Method) -> Result<Array2<f32>> {
    let images: Vec<Array2<f32>> =
        views.rows().into_iter().map(|row| row.to_owned().insert_axis(ndarray::Axis(0))).collect();
    let geometry = Geometry::centred(tilts_rad.to_vec(), views.ncols(), depth);
    Ok(volume(&images, &geometry, method).into_diagnostic()?.slice(s![.., 0, ..]).to_owned())
}

fn sirt(iterations: usize) -> Method {
    Method::Sirt(SirtSettings { iterations, ..SirtSettings::default() })
}

/// Runs the comparisons and prints their tables.
pub fn run(venv: &Venv) -> Result<()> {
    let folder = venv.work.join("tomography");
    std::fs::create_dir_all(&folder).into_diagnostic()?;
    write_inputs(&folder)?;
    let results: Value =
        serde_json::from_str(&venv.run("tomography.py", &[std::ffi::OsStr::new("phantom"), folder.as_os_str()])?)
            .into_diagnostic()?;
    println!("{:34} {:>12} {:>12} {:>12}", "relative rms, inside the circle", "difference", "ours, truth", "theirs");
    let mut faults = Vec::new();
    for name in ["half-turn", "wedge"] {
        let entries = results[name].as_object().ok_or_else(|| miette!("no results for {name}"))?;
        for (method, found) in entries {
            let number = |key: &str| found[key].as_f64().unwrap_or(f64::NAN);
            let [difference, ours, theirs] = ["difference", "ours_from_truth", "theirs_from_truth"].map(number);
            println!("{:34} {difference:12.4} {ours:12.4} {theirs:12.4}", format!("{name}, {method}"));
            // ASTRA's strips are our shadows but for their shape, its linear kernel blurs a little less: 0.002 to 0.009.
            if !(difference < 0.02 && ours < 1.05 * theirs) {
                faults.push(format!("{name}, {method}: {found}"));
            }
        }
    }
    println!("against NumPy's matrix: {}", results["numpy"]);
    println!("volume read by mrcfile: {}", results["mrc"]);
    let numpy = |key: &str| results["numpy"][key].as_f64().unwrap_or(f64::NAN);
    if !(numpy("projector") < 1e-4 && numpy("sirt") < 1e-4) {
        faults.push(format!("the projector or SIRT differs from its definition: {}", results["numpy"]));
    }
    let mrc = &results["mrc"];
    if mrc["valid"] != true || mrc["volume"] != true || mrc["same"] != true {
        faults.push(format!("the volume's file is not as it should be: {mrc}"));
    }
    if !faults.is_empty() {
        return Err(miette!("{}", faults.join("\n")));
    }
    speed(venv)
}

fn write_inputs(folder: &Path) -> Result<()> {
    let save = |name: &str, array: &Array2<f32>| npy::write_f32(&folder.join(format!("{name}.npy")), array);
    let half_turn: Vec<f64> = (0..120).map(|step| -0.5 * PI + PI * f64::from(step) / 120.0).collect();
    let wedge: Vec<f64> = (-35..=35).map(|step| (2.0 * f64::from(step)).to_radians()).collect();
    save("truth", &truth(SIDE))?;
    for (name, tilts) in [("half-turn", &half_turn), ("wedge", &wedge)] {
        let views = views(SIDE, tilts);
        save(&format!("{name}-views"), &views)?;
        save_tilts(folder, name, tilts)?;
        for (filter, word) in [(Filter::Ramp, "ramp"), (Filter::Hamming, "hamming")] {
            let method = Method::Wbp(WbpSettings { filter });
            save(&format!("{name}-{word}"), &slice(&views, tilts, SIDE, &method)?)?;
        }
        save(&format!("{name}-sirt"), &slice(&views, tilts, SIDE, &sirt(60))?)?;
    }
    // Small enough for a dense matrix; uneven tilts.
    let tilts: Vec<f64> =
        (0..17).map(|step| (-70.0 + 8.3 * f64::from(step) + f64::from(step % 3)).to_radians()).collect();
    let small = views(SMALL, &tilts);
    let body = truth(SMALL);
    let geometry = Geometry::centred(tilts.clone(), SMALL, SMALL);
    let projector = tiltline::tomography::projector::Projector::new(&geometry);
    let lanes: Vec<_> = body.iter().map(|value| [*value; tiltline::tomography::projector::LANES]).collect();
    let mut projected = vec![[0.0; tiltline::tomography::projector::LANES]; projector.views_len()];
    projector.project(&lanes, &mut projected);
    save("small-views", &small)?;
    save_tilts(folder, "small", &tilts)?;
    save("small-volume", &body)?;
    save("small-projected", &Array2::from_shape_fn((tilts.len(), SMALL), |(view, u)| projected[view * SMALL + u][0]))?;
    save("small-sirt", &slice(&small, &tilts, SMALL, &sirt(20))?)?;
    // A volume whose every voxel is another.
    let voxels = ndarray::Array3::from_shape_fn((5, 41, 7), |(z, y, x)| (z * 1000 + y * 10 + x) as f32 - 2000.5);
    save("volume", &voxels.to_shape((5 * 41, 7)).into_diagnostic()?.to_owned())?;
    let file = std::fs::File::create(folder.join("volume.mrc")).into_diagnostic()?;
    let mut writer = VolumeWriter::begin(file, [5, 41, 7], Some(3.36)).into_diagnostic()?;
    writer.write_rows(32, voxels.slice(s![.., 32.., ..])).into_diagnostic()?;
    writer.write_rows(0, voxels.slice(s![.., ..32, ..])).into_diagnostic()?;
    writer.finish().map(drop).into_diagnostic()
}

fn save_tilts(folder: &Path, name: &str, tilts_rad: &[f64]) -> Result<()> {
    let degrees = Array2::from_shape_fn((1, tilts_rad.len()), |(_, view)| tilts_rad[view].to_degrees());
    npy::write_f64(&folder.join(format!("{name}-tilts.npy")), &degrees)
}

/// Seconds of our SIRT for one iteration, voxel and view, all cores.
fn own_seconds(width: usize, count: usize) -> Result<f64> {
    let tilts: Vec<f64> =
        (0..count).map(|view| (-76.0 + 152.0 * view as f64 / (count - 1) as f64).to_radians()).collect();
    let rows = 128;
    let images: Vec<Array2<f32>> = (0..count)
        .map(|view| {
            Array2::from_shape_fn((rows, width), |(row, column)| ((row * 7 + column * 13 + view * 29) % 31) as f32)
        })
        .collect();
    let geometry = Geometry::centred(tilts, width, width);
    let time = |iterations: usize| -> Result<f64> {
        let start = Instant::now();
        volume(&images, &geometry, &sirt(iterations)).into_diagnostic()?;
        Ok(start.elapsed().as_secs_f64())
    };
    // The difference leaves out sums and copies, as it does for the peers.
    let (few, many) = (time(1)?, time(4)?);
    Ok((many - few) / (3 * rows * width * width * count) as f64)
}

fn speed(venv: &Venv) -> Result<()> {
    println!("\nSIRT, seconds of one iteration, voxel and view, all cores in use; median of {ROUNDS} rounds in turn");
    println!("{:56} {:>6} {:>6} {:>12} {:>8}", "", "width", "views", "seconds", "ratio");
    for (width, views) in [(128, 60), (256, 30), (256, 60), (256, 120)] {
        let mut ours = Vec::new();
        let mut theirs = vec![Vec::new(); PEERS.len()];
        for _ in 0..ROUNDS {
            ours.push(own_seconds(width, views)?);
            for ((peer, _), seconds) in PEERS.iter().zip(&mut theirs) {
                let arguments = ["speed".to_owned(), (*peer).to_owned(), width.to_string(), views.to_string()];
                let found: Value = serde_json::from_str(&venv.run("tomography.py", &arguments)?).into_diagnostic()?;
                seconds.push(found["seconds"].as_f64().unwrap_or(f64::NAN));
            }
        }
        let middle = |seconds: &mut Vec<f64>| {
            seconds.sort_by(f64::total_cmp);
            seconds[seconds.len() / 2]
        };
        let own = middle(&mut ours);
        println!("{:56} {width:6} {views:6} {own:12.3e}", "ours");
        for ((_, name), seconds) in PEERS.iter().zip(&mut theirs) {
            let peer = middle(seconds);
            println!("{name:56} {width:6} {views:6} {peer:12.3e} {:8.3}", own / peer);
        }
    }
    Ok(())
}

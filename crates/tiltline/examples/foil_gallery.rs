//! Draws simulated foils, to be looked at beside real micrographs: `cargo run --release -p tiltline --example foil_gallery --
//! FOLDER [SEED] [NETWORK.data]`.
//!
//! FOLDER gets `family_<name>.png` (twelve foils of each family) and `features.png` (two foils of each kind of line, in the order of
//! `Feature::ALL`). Dark lines are near the entrance surface, light ones near the exit surface; boundaries of lamellae are
//! dotted. With a ParaDiS file, `network.png` shows foils cut out of it. Prints what a foil costs in time.
#![allow(clippy::print_stdout)]

use std::path::Path;
use std::time::Instant;

use ndarray::Array2;
use tiltline::geometry::Point3;
use tiltline::simulate::geometry::{Feature, FoilSample, FoilSettings, Range, geometry_rng, sample_foil};
use tiltline::simulate::geometry::{Split, length_in_field_nm};
use tiltline::simulate::paradis::{Network, ReadOptions};
use tiltline::simulate::slab::{Cut, foil_from_network};

const TILE: usize = 340;
const COLUMNS: usize = 4;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().ok_or("usage: foil_gallery FOLDER [SEED] [NETWORK.data]")?;
    let seed: u64 = arguments.next().map_or(Ok(0), |text| text.parse())?;
    std::fs::create_dir_all(&folder)?;
    let families = [
        ("gan", FoilSettings::gan()),
        ("tial", FoilSettings::tial()),
        ("cantor", FoilSettings::cantor()),
        ("mixed", FoilSettings::mixed()),
    ];
    for (name, settings) in &families {
        let start = Instant::now();
        let foils: Vec<FoilSample> = (0..12).map(|index| grow(settings, 1000 * seed + index)).collect();
        let each_ms = start.elapsed().as_secs_f64() * 1e3 / foils.len() as f64;
        let lines: usize = foils.iter().map(|sample| sample.foil.dislocations.len()).sum();
        println!("{name}: {each_ms:.2} ms a foil, {:.0} lines a foil", lines as f64 / foils.len() as f64);
        save(&Path::new(&folder).join(format!("family_{name}.png")), &foils)?;
    }
    let slowest = (0..400).map(|index| {
        // The fastest of three, for machines that do other things too.
        let times = [0; 3].map(|_| {
            let start = Instant::now();
            let foil = grow(&FoilSettings::mixed(), 1_000_000 + index).foil;
            (start.elapsed().as_secs_f64() * 1e3, foil)
        });
        let [first, second, third] = times;
        let (ms, foil) = (first.0.min(second.0).min(third.0), first.1);
        let length: f64 = foil.dislocations.iter().map(|line| length_in_field_nm(line, foil.size_nm)).sum();
        (ms, length / foil.size_nm[0])
    });
    let slowest = slowest.max_by(|one, two| one.0.total_cmp(&two.0)).ok_or("no foil")?;
    println!("slowest of 400 mixed foils: {:.1} ms ({:.0} field lengths of line)", slowest.0, slowest.1);
    let plain = FoilSettings { field_lengths: Range::new(4.0, 9.0), clustering: 0.0, ..FoilSettings::mixed() };
    let features: Vec<FoilSample> = Feature::ALL
        .iter()
        .flat_map(|&feature| [0, 1].map(|index| grow(&plain.clone().only(feature), 100 * seed + index)))
        .collect();
    save(&Path::new(&folder).join("features.png"), &features)?;
    if let Some(path) = arguments.next() {
        let network = Network::read(Path::new(&path), &ReadOptions { nm_per_unit: 0.256, ..ReadOptions::default() })?;
        let cuts = (0..8).map(|index| {
            let centre = Point3::from(network.size_nm() * (0.1 * f64::from(index)));
            let size_nm = [0.8 * network.size_nm().x; 2];
            let cut = Cut { thickness_nm: 0.12 * network.size_nm().z, size_nm, centre, ..Cut::default() };
            foil_from_network(&network, &cut).map(|foil| FoilSample {
                foil,
                boundaries: Vec::new(),
                crystals: Vec::new(),
            })
        });
        save(&Path::new(&folder).join("network.png"), &cuts.collect::<Result<Vec<_>, _>>()?)?;
    }
    Ok(())
}

fn grow(settings: &FoilSettings, index: u64) -> FoilSample {
    sample_foil(settings, &mut geometry_rng(Split::Train, index))
}

/// A contact sheet of foils, each seen along the beam.
fn save(path: &Path, foils: &[FoilSample]) -> Result<(), Box<dyn std::error::Error>> {
    let rows = foils.len().div_ceil(COLUMNS);
    let mut sheet = Array2::<u8>::from_elem([rows * TILE, COLUMNS * TILE], 90);
    for (index, sample) in foils.iter().enumerate() {
        let (top, left) = (index / COLUMNS * TILE, index % COLUMNS * TILE);
        for ((row, column), grey) in draw(sample, TILE - 4).indexed_iter() {
            sheet[[top + 2 + row, left + 2 + column]] = *grey;
        }
    }
    let mut encoder = png::Encoder::new(
        std::io::BufWriter::new(std::fs::File::create(path)?),
        u32::try_from(sheet.ncols())?,
        u32::try_from(sheet.nrows())?,
    );
    encoder.set_color(png::ColorType::Grayscale);
    let pixels: Vec<u8> = sheet.iter().copied().collect();
    encoder.write_header()?.write_image_data(&pixels)?;
    Ok(())
}

/// Lines about two pixels wide on a light ground, grey by depth, with a mark at each end.
fn draw(sample: &FoilSample, size: usize) -> Array2<u8> {
    let mut image = Array2::<f64>::from_elem([size, size], 235.0);
    let FoilSample { foil, boundaries, .. } = sample;
    let scale = size as f64 / foil.size_nm[0];
    let place = |point: &Point3| [(point.x * scale + 0.5 * size as f64), (point.y * scale + 0.5 * size as f64)];
    for wall in boundaries {
        // The trace on the mid-plane.
        let level = wall.normal.xy().norm();
        let across = wall.normal.xy() / level;
        for step in -(size as i64)..size as i64 {
            let along = f64::from(i32::try_from(step).unwrap_or(0)) / scale * 1.5;
            let foot = across * (wall.offset / level) + nalgebra::Vector2::new(-across.y, across.x) * along;
            stamp(&mut image, place(&Point3::new(foot.x, foot.y, 0.0)), 190.0, 0.8);
        }
    }
    for line in &foil.dislocations {
        let closing = if line.closed { line.points.first() } else { None };
        let mut previous: Option<[f64; 2]> = None;
        for point in line.points.iter().chain(closing) {
            let grey = 20.0 + 140.0 * (point.z / foil.thickness_nm + 0.5);
            let at = place(point);
            let from = previous.unwrap_or(at);
            let steps = ((at[0] - from[0]).hypot(at[1] - from[1]) / 0.5).ceil().max(1.0);
            for step in 1..=steps as usize {
                let share = step as f64 / steps;
                stamp(&mut image, [0, 1].map(|axis| from[axis] + (at[axis] - from[axis]) * share), grey, 0.9);
            }
            previous = Some(at);
        }
    }
    image.mapv(|value| value.clamp(0.0, 255.0) as u8)
}

fn stamp(image: &mut Array2<f64>, [x, y]: [f64; 2], grey: f64, radius: f64) {
    let size = image.nrows() as f64;
    if !(x > 2.0 && y > 2.0 && x < size - 3.0 && y < size - 3.0) {
        return;
    }
    let (column, row) = (x.round() as usize, y.round() as usize);
    for r in row - 1..=row + 1 {
        for c in column - 1..=column + 1 {
            let cover = (radius + 0.5 - (c as f64 - x).hypot(r as f64 - y)).clamp(0.0, 1.0);
            let pixel = &mut image[[r, c]];
            *pixel = pixel.min(235.0 + (grey - 235.0) * cover);
        }
    }
}

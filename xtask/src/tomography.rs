//! How well tomograms of N views show the curves of a simulated series: `cargo xtask tomography [SERIES]`.
//!
//! The series are those of `bench-series`; SERIES is how many of the three (1 by default). Everything a user must estimate is given
//! to the tomogram from the truth (`tiltline::tomography::against_truth`), the threshold included. Prints a table, and leaves
//! pictures in `target/tomography`: per method and number of views the largest value along y of a slab, and one layer.

use std::path::Path;

use miette::{IntoDiagnostic, Result, miette};
use ndarray::{Array2, Array3, s};
use tiltline::dataset::sets::Set;
use tiltline::export::png::write_grey;
use tiltline::filter::percentiles;
use tiltline::simulate::geometry::geometry_seed;
use tiltline::simulate::{Lines, sample};
use tiltline::tomography::against_truth::KnownSeries;
use tiltline::tomography::prepare::PrepareSettings;
use tiltline::tomography::{Method, SirtSettings, WbpSettings};

use crate::venv::root;

const COUNTS: [usize; 7] = [2, 3, 5, 9, 15, 25, 45];
/// Numbers of views that are drawn.
const DRAWN: [usize; 2] = [9, 45];

/// Prints the table.
pub fn measure(arguments: &[String]) -> Result<()> {
    let series: usize = match arguments {
        [] => 1,
        [count] => count.parse().map_err(|_| miette!("{count} is not a number of series"))?,
        _ => return Err(miette!("tomography takes one number")),
    };
    let manifest = Set::named("bench-series").into_diagnostic()?.manifest();
    let seed = manifest.seed.ok_or_else(|| miette!("bench-series has a seed"))?;
    let folder = root().join("target/tomography");
    std::fs::create_dir_all(&folder).into_diagnostic()?;
    println!("| series | method | views | threshold, share | completeness | correctness | F | mean distance, nm |");
    println!("|---|---|---|---|---|---|---|---|");
    for item in manifest.items.iter().take(series) {
        let key = item.settings.as_ref().ok_or_else(|| miette!("{} has no settings", item.name))?;
        let settings = &manifest.settings[key];
        let foil = u64::from(item.foil.unwrap_or(0));
        let sample =
            sample(settings, Lines::Random, geometry_seed(item.split, (seed << 32) | foil)).into_diagnostic()?;
        let images: Vec<Array2<f32>> = sample.views.iter().map(|view| view.recording.image.clone()).collect();
        let known = KnownSeries::new(&sample.truth, &images, &PrepareSettings::dark_lines()).into_diagnostic()?;
        let methods = [("wbp", Method::Wbp(WbpSettings::default())), ("sirt", Method::Sirt(SirtSettings::default()))];
        for (word, method) in methods {
            for count in COUNTS {
                let judged = known.judge(count, &method, item.pair).into_diagnostic()?;
                let score = &judged.score.end_to_end;
                let distance = score.distance.map_or("-".into(), |distance| format!("{:.1}", distance.mean));
                println!(
                    "| {} | {word} | {count} | {:.4} | {:.3} | {:.3} | {:.3} | {distance} |",
                    item.name,
                    judged.share,
                    score.completeness,
                    score.correctness.unwrap_or(0.0),
                    score.f_score,
                );
                if DRAWN.contains(&count) {
                    let (volume, _, _) = known.tomogram(count, &method).into_diagnostic()?;
                    draw(&volume, &folder.join(format!("{}-{word}-{count}", item.name)))?;
                }
            }
        }
    }
    Ok(())
}

/// The largest value along z (from above), and a cut at the middle row, to PNG.
fn draw(volume: &Array3<f32>, stem: &Path) -> Result<()> {
    let (layers, rows, columns) = volume.dim();
    let above = volume.fold_axis(ndarray::Axis(0), f32::NEG_INFINITY, |most, value| most.max(*value));
    let mut picture = Array2::zeros((rows + layers + 4, columns));
    picture.slice_mut(s![..rows, ..]).assign(&above);
    picture.slice_mut(s![rows + 4.., ..]).assign(&volume.slice(s![.., rows / 2, ..]));
    let [low, high] = percentiles(&picture, [0.02, 0.998]);
    let grey = picture.mapv(|value: f32| (255.0 * (value - low) / (high - low).max(1e-9)).clamp(0.0, 255.0) as u8);
    let mut file = std::fs::File::create(stem.with_extension("png")).into_diagnostic()?;
    write_grey(&grey, &mut file).into_diagnostic()
}

//! Thinning and the graph of the skeleton against scikit-image's `skeletonize` and skan on the same masks.
//!
//! "skan on ours" counts the graph of our skeleton by their code; "our graph" is our own graph of our skeleton.

use miette::{IntoDiagnostic, Result, miette};
use ndarray::Array2;
use serde_json::Value;
use tiltline::filter::gaussian_blur;
use tiltline::simulate::draw::union_of_profiles;
use tiltline::simulate::{Scene, SceneSettings, ViewSettings};
use tiltline::trace::graph::{SkeletonGraph, skeleton_graph};
use tiltline::trace::thin::{fill_small_holes, thin};

use crate::npy;
use crate::venv::Venv;

/// Masks with a name: lines as the tracer meets them, of two widths, and blobs that are no lines at all.
fn masks() -> Vec<(String, Array2<bool>)> {
    let mut masks = Vec::new();
    for (seed, sigma) in [(1, 1.5), (2, 1.5), (3, 3.0)] {
        let scene = Scene::random(&SceneSettings { seed, ..SceneSettings::default() });
        let curves = ViewSettings::default().project_curves(&scene);
        let mut mask = union_of_profiles([512, 512], &curves, sigma).mapv(|value| value > 0.25);
        fill_small_holes(&mut mask, 6);
        masks.push((format!("lines, sigma {sigma}, seed {seed}"), mask));
    }
    // Blobs from a hash of the pixel, smoothed: the same on every machine.
    let noise = Array2::from_shape_fn((256, 256), |(row, column)| {
        let mut bits = (row * 256 + column) as u32;
        bits = (bits ^ (bits >> 16)).wrapping_mul(0x7feb_352d);
        bits = (bits ^ (bits >> 15)).wrapping_mul(0x846c_a68b);
        ((bits ^ (bits >> 16)) as f32) / (u32::MAX as f32) - 0.5
    });
    masks.push(("random blobs".into(), gaussian_blur(&noise, 3.0).mapv(|value| value > 0.0)));
    masks
}

/// Length as skan counts it: pixel steps of 1 and sqrt 2.
fn pixel_length(graph: &SkeletonGraph) -> f64 {
    let step = |a: &[usize; 2], b: &[usize; 2]| (a[0].abs_diff(b[0]) as f64).hypot(a[1].abs_diff(b[1]) as f64);
    let path = |pixels: &[[usize; 2]]| pixels.windows(2).map(|pair| step(&pair[0], &pair[1])).sum::<f64>();
    graph
        .branches
        .iter()
        .map(|branch| {
            let ends = [branch.pixels.first(), branch.pixels.last()];
            // To the nearest pixel of the junction at either end.
            let joints: f64 = (0..2)
                .filter_map(|end| {
                    let junction = &graph.junctions[branch.ends[end]?];
                    let at = ends[end]?;
                    junction.iter().map(|pixel| step(pixel, at)).min_by(f64::total_cmp)
                })
                .sum();
            let closing =
                if branch.closed { step(&branch.pixels[0], &branch.pixels[branch.pixels.len() - 1]) } else { 0.0 };
            path(&branch.pixels) + joints + closing
        })
        .sum()
}

/// Runs the comparison and prints its table.
pub fn run(venv: &Venv) -> Result<()> {
    let masks = masks();
    let mut files = Vec::new();
    let mut graphs = Vec::new();
    for (index, (_, mask)) in masks.iter().enumerate() {
        let skeleton = thin(mask);
        for (name, array) in [("mask", mask), ("skeleton", &skeleton)] {
            let path = venv.work.join(format!("trace-{name}-{index}.npy"));
            npy::write_f32(&path, &array.mapv(|set| if set { 1.0 } else { 0.0 }))?;
            files.push(path);
        }
        graphs.push(skeleton_graph(&skeleton));
    }
    let results: Vec<Value> = serde_json::from_str(&venv.run("trace.py", &files)?).into_diagnostic()?;
    println!(
        "{:26} {:>7} {:>7} {:>7} {:>9} {:>9} {:>8}",
        "", "pixels", "parts", "holes", "junctions", "branches", "length"
    );
    for ((name, _), (graph, result)) in masks.iter().zip(graphs.iter().zip(&results)) {
        let number = |group: &str, key: &str| result[group][key].as_f64().unwrap_or(f64::NAN);
        println!(
            "{name}: ours within 1 px of theirs {:.4}, theirs within 1 px of ours {:.4}",
            result["ours_near_theirs"].as_f64().unwrap_or(f64::NAN),
            result["theirs_near_ours"].as_f64().unwrap_or(f64::NAN),
        );
        for (label, group) in [("  scikit-image + skan", "theirs"), ("  our thinning + skan", "ours")] {
            println!(
                "{label:26} {:7} {:7} {:7} {:9} {:9} {:8.1}",
                number(group, "pixels"),
                number(group, "components"),
                number(group, "holes"),
                number(group, "junctions"),
                number(group, "branches"),
                number(group, "length"),
            );
        }
        println!(
            "{:26} {:7} {:7} {:7} {:9} {:9} {:8.1}",
            "  our thinning + graph",
            graph.branches.iter().map(|b| b.pixels.len()).sum::<usize>()
                + graph.junctions.iter().map(Vec::len).sum::<usize>(),
            "",
            "",
            graph.junctions.len(),
            graph.branches.len(),
            pixel_length(graph),
        );
        for key in ["components", "holes"] {
            let mask = result[&format!("mask_{key}")].as_f64();
            if mask != result["ours"][key].as_f64() {
                return Err(miette!("{name}: thinning changed the number of {key} from {mask:?}"));
            }
        }
    }
    Ok(())
}

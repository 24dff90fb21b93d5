//! OpenCV's StereoSGBM on the fixed sets that `cargo xtask accuracy` left in `target/accuracy`, with its rectification known and with
//! several sizes of block: figures beside those of docs/accuracy.md.

use std::path::PathBuf;

use miette::{IntoDiagnostic, Result, miette};
use serde::Deserialize;
use tiltline::dataset::sets::SETS;

use crate::venv::{Venv, root};

/// What the script prints.
#[derive(Deserialize)]
struct Output {
    version: String,
    scores: Vec<Score>,
}

#[derive(Deserialize)]
struct Score {
    set: String,
    block: usize,
    coverage: f64,
    /// Mean error where there is a value.
    epe: Option<f64>,
    /// Percent with an error above 1, 3 and 5 px, or without a value.
    bad: [f64; 3],
}

/// Prints the table.
pub fn run(venv: &Venv) -> Result<()> {
    let data = |name: &str| root().join("target/accuracy").join(name).join("data");
    let folders: Vec<PathBuf> = SETS.iter().map(|set| data(set.name)).filter(|folder| folder.is_dir()).collect();
    if folders.is_empty() {
        return Err(miette!("there are no sets in target/accuracy; run cargo xtask accuracy first"));
    }
    let output = venv.run("sgbm_sets.py", &folders)?;
    let Output { version, scores } = serde_json::from_str(&output).into_diagnostic()?;
    println!("OpenCV {version}, known rectification, -63 to 64 px");
    println!("| set | block | coverage | EPE, px | bad-1, % | bad-3, % | bad-5, % |\n|---|---|---|---|---|---|---|");
    for Score { set, block, coverage, epe, bad: [one, three, five] } in scores {
        let epe = epe.map_or_else(|| "-".to_owned(), |epe| format!("{epe:.2}"));
        println!("| `{set}` | {block} | {coverage:.3} | {epe} | {one:.1} | {three:.1} | {five:.1} |");
    }
    Ok(())
}

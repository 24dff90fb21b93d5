//! Trained weights as they are shipped: `pack RUN OUT [COMMIT]` writes the last weights of a training run in half precision, with the
//! run's curve in their record.

use std::error::Error;
use std::path::Path;

use tiltline_nets::weights::{Precision, Weights};

/// Lines of the curve that are kept.
const KEPT: usize = 40;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [run, out, rest @ ..] = &arguments[..] else { return Err("pack RUN OUT [COMMIT]".into()) };
    let run = Path::new(run);
    let mut weights = Weights::read(&run.join("last.safetensors"))?;
    let metrics = std::fs::read_to_string(run.join("metrics.jsonl"))?;
    let all: Vec<&str> = metrics.lines().collect();
    // The first lines whole: a training that is done again must begin with them.
    let every = all.len().div_ceil(KEPT).max(1);
    let curve: Vec<&str> =
        all.iter().enumerate().filter(|(at, _)| *at < 4 || at % every == 0).map(|(_, line)| *line).collect();
    weights.record.insert("curve".into(), curve.join("\n"));
    if let Some(commit) = rest.first() {
        weights.record.insert("commit".into(), commit.clone());
    }
    weights.write(Path::new(out), Precision::Half)?;
    Ok(())
}

//! docs/accuracy.md: every fixed set, reconstructed and scored by the command itself, and the hashes of the sets.

use std::fmt::Write;
use std::path::Path;
use std::process::Command;

use miette::{IntoDiagnostic, Result, miette};
use tiltline::dataset::Dataset;
use tiltline::dataset::sets::SETS;

use crate::venv::root;

const INTRODUCTION: &str = "# Accuracy

How well `tiltline reconstruct` finds lines and depths in the fixed simulated sets (docs/simulator.md), by the scores of docs/truth.md.
Made by `cargo xtask accuracy`, which runs `tiltline bench SET` and `tiltline score` for each set; the settings are the defaults. The
sets' SHA-256 are in `crates/tiltline/src/dataset/sets.toml`. In brackets: 95 percent intervals over pairs. The same sets as the
paper's tables and figures: [figures](figures/README.md).

These are the networks that are part of the program; the classical methods on the same sets (`tiltline bench SET --detector ridge --matcher classical`)
are beside them in docs/networks.md. `val-*` sets are for choosing between settings and weights, the others for reporting. Nothing is trained on any of them. Simulated images are meant to be harder and more varied than real ones
of good quality; a pair that cannot be reconstructed counts as nothing found.

";

/// What the figures show; written by hand, to be checked whenever they change.
const FINDINGS: &str = include_str!("accuracy_findings.md");

/// Runs all sets in `target/accuracy` (a set that is there and unchanged is taken up) and writes the page.
pub fn measure() -> Result<()> {
    let folder = root().join("target/accuracy");
    std::fs::create_dir_all(&folder).into_diagnostic()?;
    let mut page = INTRODUCTION.to_owned() + FINDINGS;
    let mut hashes =
        "# SHA-256 over the content of each fixed set, as made for the published figures (docs/accuracy.md).\n"
            .to_owned();
    for set in SETS {
        let results = folder.join(set.name);
        tiltline(&["bench", set.name, "--quiet", "-o"], &results)?;
        let scores = folder.join(format!("{}-scores", set.name));
        if scores.exists() {
            std::fs::remove_dir_all(&scores).into_diagnostic()?;
        }
        tiltline(&["score", &results.to_string_lossy(), "-o"], &scores)?;
        let report = std::fs::read_to_string(scores.join("scores.md")).into_diagnostic()?;
        let dataset = Dataset::open(results.join("data")).into_diagnostic()?;
        writeln!(hashes, "{} = \"{}\"", set.name, dataset.manifest.content_hash()).into_diagnostic()?;
        let failed = dataset
            .manifest
            .items
            .iter()
            .filter(|item| results.join("results").join(&item.name).join("failed.txt").exists());
        write!(
            page,
            "\n## {}\n\n{}. Pairs that could not be reconstructed: {}.\n\n",
            set.name,
            capital(set.purpose),
            failed.count()
        )
        .into_diagnostic()?;
        page += &section(&report);
    }
    std::fs::write(root().join("docs/accuracy.md"), page).into_diagnostic()?;
    std::fs::write(root().join("crates/tiltline/src/dataset/sets.toml"), hashes).into_diagnostic()
}

/// A report without its title and its list of pairs, one level down.
fn section(report: &str) -> String {
    let body = report.split_once("\n\n").map_or(report, |(_, body)| body);
    let body = body.split_once("\n## Pairs").map_or(body, |(body, _)| body);
    body.replace("\n## ", "\n### ").trim_end().to_owned() + "\n"
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().collect::<String>() + letters.as_str())
}

/// Runs the project's own command, as a user would.
pub fn tiltline(arguments: &[&str], last: &Path) -> Result<()> {
    let status = Command::new(env!("CARGO"))
        .args(["run", "--quiet", "--release", "--bin", "tiltline", "--"])
        .args(arguments)
        .arg(last)
        .current_dir(root())
        .stdout(std::process::Stdio::null())
        .status()
        .into_diagnostic()?;
    if status.success() { Ok(()) } else { Err(miette!("tiltline {} failed", arguments.join(" "))) }
}

//! docs/ablation.md: which stage loses how much, told by putting the truth in its place; and what refinement buys.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use miette::{IntoDiagnostic, Result, WrapErr, miette};
use serde_json::Value;

use crate::accuracy::tiltline;
use crate::venv::root;

const INTRODUCTION: &str = "# Where accuracy is lost

Made by `cargo xtask ablation` on the fixed sets (docs/simulator.md) with the scores of docs/truth.md; each row is `tiltline bench SET` with other
flags, everything else as it is by default. A stage that is \"truth\" loses nothing: lines are drawn where the truth's centres of contrast are visible in both views,
disparities are those of the nearest true line, and the rectification is the known one. *core* and *contrast* are what completeness, correctness and F-score
are judged on: the cores of the dislocations, or the centres of contrast, which are what an image shows.

";

/// What the figures show; written by hand, to be checked whenever they change.
const FINDINGS: &str = include_str!("ablation_findings.md");

/// The sets that choices are made on.
const SETS: [&str; 2] = ["val-8deg", "val-hard"];
/// Words for the table, and flags.
const STAGES: [(&str, &[&str]); 8] = [
    ("truth, truth, truth", &["--known-rectification", "--detector", "truth", "--matcher", "truth"]),
    ("estimated, truth, truth", &["--detector", "truth", "--matcher", "truth"]),
    ("estimated, truth, network", &["--detector", "truth", "--matcher", "net"]),
    ("estimated, truth, classical", &["--detector", "truth", "--matcher", "classical"]),
    ("estimated, network, truth", &["--detector", "net", "--matcher", "truth"]),
    ("estimated, ridge, truth", &["--detector", "ridge", "--matcher", "truth"]),
    ("truth, network, network", &["--known-rectification"]),
    ("estimated, network, network (the default)", &[]),
];
/// Methods of refinement, by their name in the settings.
const REFINEMENTS: [&str; 3] = ["none", "nearest", "curve"];
/// The set with many angles.
const ANGLES: &str = "bench-angles";

/// Runs everything in `target/ablation` (what is there and unchanged is taken up) and writes the page.
pub fn measure() -> Result<()> {
    let mut page = INTRODUCTION.to_owned() + FINDINGS;
    for set in SETS {
        write!(page, "\n## Stages, {set}\n\n{}", titles("rectification, detector, matcher")).into_diagnostic()?;
        for (words, flags) in STAGES {
            let name = words.split(" (").next().unwrap_or(words).replace(", ", "-");
            row(&mut page, words, &scores(&name, set, flags)?)?;
        }
    }
    let mut refined = Vec::new();
    for method in REFINEMENTS {
        let config = folder()?.join(format!("{method}.toml"));
        std::fs::write(&config, format!("[refine]\nmethod = \"{method}\"\n")).into_diagnostic()?;
        refined.push((method, config.to_string_lossy().into_owned()));
    }
    for set in SETS {
        write!(page, "\n## Refinement, {set}\n\n{}", titles("refinement")).into_diagnostic()?;
        for (method, config) in &refined {
            row(&mut page, method, &scores(method, set, &["--config", config])?)?;
        }
    }
    let mut by_method = Vec::new();
    for (method, config) in &refined {
        by_method.push(by_angle(&scores(method, ANGLES, &["--config", config])?)?);
    }
    page += &angles(&by_method)?;
    std::fs::write(root().join("docs/ablation.md"), page).into_diagnostic()
}

/// The head of a table of scores.
pub fn titles(first: &str) -> String {
    format!(
        "| {first} | coverage | EPE, px | bad-1, % | completeness, core | correctness, core | F, core | F, contrast |\n|---|---|---|---|---|---|---|---|\n"
    )
}

fn folder() -> Result<PathBuf> {
    let folder = root().join("target/ablation");
    std::fs::create_dir_all(&folder).into_diagnostic()?;
    Ok(folder)
}

/// The scores of a set with some flags.
fn scores(name: &str, set: &str, flags: &[&str]) -> Result<Value> {
    let results = folder()?.join(format!("{set}-{name}"));
    // The data that `cargo xtask accuracy` uses, or would.
    let data = root().join("target/accuracy").join(set).join("data").to_string_lossy().into_owned();
    let arguments = [&["bench", set, "--quiet", "--data", &data], flags, &["-o"]].concat();
    tiltline(&arguments, &results)?;
    let scores = folder()?.join(format!("{set}-{name}-scores"));
    if scores.exists() {
        std::fs::remove_dir_all(&scores).into_diagnostic()?;
    }
    tiltline(&["score", &results.to_string_lossy(), "-o"], &scores)?;
    read(&scores.join("scores.json"))
}

/// The scores of a folder that `tiltline score` wrote.
pub fn read(path: &Path) -> Result<Value> {
    let text = std::fs::read_to_string(path).into_diagnostic()?;
    serde_json::from_str(&text).into_diagnostic().wrap_err_with(|| format!("in {}", path.display()))
}

fn number(value: &Value, pointer: &str) -> Result<f64> {
    value.pointer(pointer).and_then(Value::as_f64).ok_or_else(|| miette!("scores.json has no {pointer}"))
}

/// A row of such a table.
pub fn row(page: &mut String, words: &str, scores: &Value) -> Result<()> {
    let figure = |name: &str| number(scores, &format!("/summary/all/figures/{name}/value"));
    writeln!(
        page,
        "| {words} | {:.3} | {:.2} | {:.1} | {:.3} | {:.3} | {:.3} | {:.3} |",
        figure("coverage")?,
        figure("epe_px")?,
        figure("bad_1_percent")?,
        figure("completeness")?,
        figure("correctness")?,
        figure("f_score")?,
        f_on_contrast(scores)?,
    )
    .into_diagnostic()
}

/// F-score on centres of contrast, pooled by length as that on cores is; pairs whose basis is the contrast have but one.
fn f_on_contrast(scores: &Value) -> Result<f64> {
    let pairs = scores["pairs"].as_array().ok_or_else(|| miette!("scores.json has no pairs"))?;
    let (mut found, mut truth, mut right, mut result) = (0.0, 0.0, 0.0, 0.0);
    for pair in pairs {
        let all = &pair["end_to_end"];
        let judged = if all["on_contrast"].is_null() { all } else { &all["on_contrast"] };
        let (truth_px, result_px) = (number(all, "/truth_length_px")?, number(all, "/result_length_px")?);
        truth += truth_px;
        found += truth_px * number(judged, "/completeness")?;
        result += result_px;
        // No result, no correctness.
        right += result_px * judged["correctness"].as_f64().unwrap_or(0.0);
    }
    Ok(if found + right > 0.0 { 2.0 / (truth / found + result / right) } else { 0.0 })
}

/// Angle in degrees, EPE and depth error in px.
fn by_angle(scores: &Value) -> Result<Vec<[f64; 3]>> {
    let groups = scores
        .pointer("/summary/by_angle")
        .and_then(Value::as_array)
        .ok_or_else(|| miette!("scores have no angles"))?;
    let figures = |group: &Value| -> Result<[f64; 3]> {
        Ok([
            number(group, "/group/phi_deg")?,
            number(group, "/figures/epe_px/value")?,
            number(group, "/figures/depth_error_px/value")?,
        ])
    };
    groups.iter().map(figures).collect()
}

fn angles(by_method: &[Vec<[f64; 3]>]) -> Result<String> {
    let mut page = format!(
        "\n## Angles, raw and refined, {ANGLES}\n\nEPE / depth error, px (the paper's Table 1).\n\n| angle, degrees |"
    );
    for method in REFINEMENTS {
        write!(page, " {method} |").into_diagnostic()?;
    }
    page += "\n|---|---|---|---|\n";
    for (index, [angle_deg, ..]) in by_method[0].iter().enumerate() {
        write!(page, "| {angle_deg:.0} |").into_diagnostic()?;
        for of_method in by_method {
            let [_, epe, depth] = of_method[index];
            write!(page, " {epe:.2} / {depth:.1} |").into_diagnostic()?;
        }
        page += "\n";
    }
    Ok(page)
}

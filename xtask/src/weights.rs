//! `cargo xtask weights`: trains the shipped detector and matcher again from nothing, and puts them where the program embeds them.
//!
//! Runs are in `target/weights` and go on where they were stopped. Settings are in `xtask/weights`, one file a stage (the detector has
//! four, of other data and rates); data and first weights follow from their seeds, so the first steps of the stage that begins from
//! nothing must give the losses of the committed curve beside its settings, and that is checked.

use std::fs;
use std::path::Path;
use std::process::Command;

use miette::{Context, IntoDiagnostic, Result, miette};
use serde_json::Value;

use crate::venv::root;

/// Steps whose losses must be those of the record.
const CHECKED_STEPS: u64 = 200;
/// Losses may differ by this share: other processors add in other orders, and a training amplifies that.
const TOLERANCE: f64 = 0.05;

/// Trains both networks.
pub fn train() -> Result<()> {
    stage("detector", "detector", None)?;
    stage("detector", "detector-further", Some("target/weights/detector/last.safetensors"))?;
    stage("detector", "detector-faults", Some("target/weights/detector-further/last.safetensors"))?;
    stage("detector", "detector-last", Some("target/weights/detector-faults/last.safetensors"))?;
    ship("detector", "detector-last")?;
    stage("matcher", "matcher", Some("target/weights/detector-last/last.safetensors"))?;
    ship("matcher", "matcher")
}

/// The run `name` of a network, and the check of its beginning where it begins from nothing but seeds.
fn stage(kind: &str, name: &str, from: Option<&str>) -> Result<()> {
    let run = format!("target/weights/{name}");
    let curve = format!("xtask/weights/{name}.jsonl");
    let expected = match from {
        Some(_) => Vec::new(),
        None => losses(&fs::read_to_string(root().join(&curve)).into_diagnostic().wrap_err_with(|| curve.clone())?)?,
    };
    let mut arguments = vec!["run", "--release", "--quiet", "--bin", "tiltline", "--", "train"];
    let settings = format!("xtask/weights/{name}.toml");
    if root().join(&run).join("train.toml").exists() {
        arguments.extend(["--resume", &run]);
    } else {
        arguments.extend([kind, "--config", &settings, "-o", &run]);
        arguments.extend(from.iter().flat_map(|from| ["--from", from]));
    }
    if !done(&root().join(&run))? {
        cargo(&arguments)?;
    }
    let metrics = losses(&fs::read_to_string(root().join(&run).join("metrics.jsonl")).into_diagnostic()?)?;
    for (step, before) in expected.into_iter().filter(|(step, _)| *step <= CHECKED_STEPS) {
        let loss = metrics.iter().find(|(known, _)| *known == step).map(|(_, loss)| *loss);
        let loss = loss.ok_or_else(|| miette!("{run} has no loss at step {step}, and {curve} has one"))?;
        if (loss / before - 1.0).abs() > TOLERANCE {
            return Err(miette!("the loss at step {step} of {run} is {loss}, and {before} in {curve}"));
        }
    }
    Ok(())
}

/// Puts the last weights of a run where the program embeds them.
fn ship(kind: &str, name: &str) -> Result<()> {
    let run = format!("target/weights/{name}");
    let shipped = format!("crates/tiltline-nets/weights/{kind}.safetensors");
    let commit =
        Command::new("git").args(["rev-parse", "--short", "HEAD"]).current_dir(root()).output().into_diagnostic()?;
    let commit = String::from_utf8_lossy(&commit.stdout).trim().to_owned();
    cargo(&["run", "--release", "--quiet", "-p", "tiltline-nets", "--example", "pack", "--", &run, &shipped, &commit])
}

/// Whether a run has reached its last step.
pub fn done(run: &Path) -> Result<bool> {
    let Ok(text) = fs::read_to_string(run.join("train.toml")) else { return Ok(false) };
    let settings: toml::Table = text.parse().into_diagnostic()?;
    let steps = settings.get("steps").and_then(toml::Value::as_integer).unwrap_or(i64::MAX);
    let metrics = fs::read_to_string(run.join("metrics.jsonl")).unwrap_or_default();
    Ok(losses(&metrics)?.last().is_some_and(|(step, _)| *step as i64 >= steps))
}

/// Steps and losses of the training lines of a curve.
fn losses(metrics: &str) -> Result<Vec<(u64, f64)>> {
    let lines: Vec<Value> = metrics.lines().map(serde_json::from_str).collect::<Result<_, _>>().into_diagnostic()?;
    let train = lines.iter().filter(|line| line["kind"] == "train");
    Ok(train.filter_map(|line| Some((line["step"].as_u64()?, line["values"]["loss"].as_f64()?))).collect())
}

fn cargo(arguments: &[&str]) -> Result<()> {
    let status = Command::new(env!("CARGO")).args(arguments).current_dir(root()).status().into_diagnostic()?;
    if status.success() { Ok(()) } else { Err(miette!("cargo {} failed", arguments.join(" "))) }
}

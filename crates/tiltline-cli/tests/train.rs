//! `tiltline train`, and networks in `tiltline reconstruct`, as a user types them.
#![allow(clippy::unwrap_used)] // a failed unwrap is a failed test

use std::fs;
use std::path::{Path, PathBuf};

use assert_cmd::Command;

const SMALL: &str = "
report_every = 1
checkpoint_every = 2
validate_every = 1000
validation_count = 1
[detector]
channels = 3
depth = 2
[matcher]
features = 8
concatenated = 4
groups = 4
channels = 4
hourglasses = 1
levels = 8
[data]
families = ['gan']
physics = 0.0
simulated_px = 96
crop_px = 64
batch = 2
";

fn tiltline() -> Command {
    Command::cargo_bin("tiltline").unwrap()
}

fn words(bytes: &[u8]) -> String {
    // miette wraps long messages and draws a margin: compare words, not lines.
    let text = String::from_utf8_lossy(bytes).replace(['│', '×', '╰', '─', '▶'], " ");
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn train(folder: &Path, arguments: &[&str]) -> Command {
    let config = folder.join("small.toml");
    fs::write(&config, SMALL).unwrap();
    let mut command = tiltline();
    command.current_dir(folder).args(["train", "--config", "small.toml"]).args(arguments);
    command
}

fn example(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples").join(name)
}

#[test]
fn a_detector_and_a_matcher_are_trained_resumed_and_used() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    train(here, &["detector", "--steps", "4", "-o", "detector"]).assert().success();
    for file in ["train.toml", "best.safetensors", "last.safetensors", "metrics.jsonl", "curves.svg", "validation.png"]
    {
        assert!(here.join("detector").join(file).is_file(), "{file}");
    }
    let again = train(here, &["detector", "-o", "detector"]).assert().code(1).get_output().clone();
    assert!(words(&again.stderr).contains("--resume"), "{}", words(&again.stderr));
    let mut resume = tiltline();
    resume.current_dir(here).args(["train", "--resume", "detector", "--steps", "6"]).assert().success();
    let lines = fs::read_to_string(here.join("detector/metrics.jsonl")).unwrap();
    assert_eq!(lines.lines().filter(|line| line.contains("\"train\"")).count(), 6);

    let without = train(here, &["matcher", "--steps", "2", "-o", "matcher"]).assert().code(1).get_output().clone();
    assert!(words(&without.stderr).contains("--from"), "{}", words(&without.stderr));
    train(here, &["matcher", "--steps", "2", "--from", "detector/last.safetensors", "-o", "matcher"])
        .assert()
        .success();
    let mut reconstruct = tiltline();
    reconstruct
        .current_dir(here)
        .arg("reconstruct")
        .arg(example("rendered_-4deg.png"))
        .arg(example("rendered_+4deg.png"));
    reconstruct.args(["--tilts=-4,4", "--detector", "ridge", "--weights", "matcher/last.safetensors", "-o", "out"]);
    reconstruct.assert().success();
    let record = fs::read_to_string(here.join("out/run.toml")).unwrap();
    assert!(record.contains("matcher = \"net ") && record.contains("detector = \"ridge\""), "{record}");
}

/// `shipped` is what no file gives: all that the task needs, or the matcher beside a detector of one's own.
#[test]
fn training_goes_on_from_the_weights_of_the_program() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let settings = |run: &str| fs::read_to_string(here.join(run).join("train.toml")).unwrap();
    train(here, &["detector", "--steps", "1", "--from", "shipped", "-o", "shipped"]).assert().success();
    assert!(settings("shipped").contains("[detector]\nchannels = 10\ndepth = 5\n"), "{}", settings("shipped"));
    train(here, &["detector", "--steps", "1", "-o", "own"]).assert().success();
    let both = ["matcher", "--steps", "1", "--from", "shipped", "--from", "own/last.safetensors", "-o", "both"];
    train(here, &both).assert().success();
    assert!(settings("both").contains("[detector]\nchannels = 3\ndepth = 2\n"), "{}", settings("both"));
    assert!(settings("both").contains("features = 32\n"), "{}", settings("both"));
}

#[test]
fn wrong_weights_and_devices_get_a_clear_error() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let device = train(here, &["detector", "-o", "run", "--device", "cuda"]).assert().code(1).get_output().clone();
    assert!(words(&device.stderr).contains("built without cuda"), "{}", words(&device.stderr));
    assert!(!here.join("run").exists());
    fs::write(here.join("pickle.pt"), b"PK\x03\x04 a pickle in a zip file").unwrap();
    let mut reconstruct = tiltline();
    reconstruct.arg("reconstruct").arg(example("rendered_-4deg.png")).arg(example("rendered_+4deg.png"));
    reconstruct
        .args(["--tilts=-4,4", "--detector", "net", "--weights"])
        .arg(here.join("pickle.pt"))
        .arg("-o")
        .arg(here.join("out"));
    let output = reconstruct.assert().code(1).get_output().clone();
    assert!(words(&output.stderr).contains("is no weight file"), "{}", words(&output.stderr));
    assert!(!here.join("out").exists());
}

/// The weights that are part of the program do the main job on the example.
#[test]
fn the_built_in_networks_reconstruct_the_example() {
    let folder = tempfile::tempdir().unwrap();
    let mut reconstruct = tiltline();
    reconstruct.arg("reconstruct").arg(example("rendered_-4deg.png")).arg(example("rendered_+4deg.png"));
    reconstruct.args(["--tilts=-4,4", "--detector", "net", "--matcher", "net", "-o"]).arg(folder.path().join("out"));
    reconstruct.assert().success();
    let csv = fs::read_to_string(folder.path().join("out/curves.csv")).unwrap();
    // Five curves of some 300 px each.
    assert!(csv.lines().count() > 500, "only {} points", csv.lines().count());
}

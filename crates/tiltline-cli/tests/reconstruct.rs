//! The command as a user types it.
#![allow(clippy::unwrap_used, clippy::print_stderr)] // a failed unwrap is a failed test

use std::fs;
use std::path::{Path, PathBuf};

use assert_cmd::Command;

fn tiltline() -> Command {
    Command::cargo_bin("tiltline").unwrap()
}

fn example(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples").join(name)
}

/// The example pair reconstructed into `out` with more flags.
fn reconstruct(out: &Path, more: &[&str]) -> Command {
    let mut command = tiltline();
    command.arg("reconstruct").arg(example("rendered_-4deg.png")).arg(example("rendered_+4deg.png"));
    command.arg("-o").arg(out).args(more);
    command
}

fn stderr(command: &mut Command, code: i32) -> String {
    let output = command.assert().code(code).get_output().clone();
    // miette wraps long messages and draws a margin: compare words, not lines.
    let text = String::from_utf8(output.stderr).unwrap().replace(['│', '×', '╰', '─', '▶'], " ");
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

const OUTPUTS: [&str; 17] = [
    "curves.csv",
    "curves.data",
    "curves.json",
    "curves.obj",
    "curves.ply",
    "curves.swc",
    "curves.vtp",
    "disparity.tif",
    "lines.csv",
    "lines_left.png",
    "lines_right.png",
    "overlay.png",
    "rectified_left.tif",
    "rectified_right.tif",
    "report.html",
    "run.toml",
    "sigma.tif",
];

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn the_example_pair_gives_every_output_and_a_repeated_run_the_same_curves() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let summary = reconstruct(&out, &["--tilts", "-4,4", "--pixel-size", "1.2nm", "--json", "-q"]).assert().success();
    let summary: serde_json::Value = serde_json::from_slice(&summary.get_output().stdout).unwrap();
    assert_eq!(summary["unit"], "nm");
    assert!(summary["curves"].as_u64().unwrap() > 8, "{summary}");
    assert_eq!(names(&out), OUTPUTS);
    let csv = fs::read_to_string(out.join("curves.csv")).unwrap();
    assert!(csv.starts_with(
        "curve,point,x_left_px,y_left_px,x_right_px,y_right_px,disparity_px,sigma_disparity_px,\
         x_nm,y_nm,z_nm,sigma_z_nm,flag\n"
    ));
    // The record of a run, given as settings, repeats it: same curves to the last digit, on one thread too.
    let again = folder.path().join("again");
    let record = out.join("run.toml");
    reconstruct(&again, &["--config", record.to_str().unwrap(), "-q"]).env("RAYON_NUM_THREADS", "1").assert().success();
    assert_eq!(csv, fs::read_to_string(again.join("curves.csv")).unwrap());
}

#[test]
fn turning_the_depth_negates_z_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let column = |more: &[&str], name: &str| -> Vec<f64> {
        let out = folder.path().join("out");
        reconstruct(&out, &[&["--tilts=-4,4", "-q", "--force"], more].concat()).assert().success();
        let csv = fs::read_to_string(out.join("curves.csv")).unwrap();
        let index = csv.lines().next().unwrap().split(',').position(|word| word == name).unwrap();
        csv.lines().skip(1).map(|line| line.split(',').nth(index).unwrap().parse().unwrap()).collect()
    };
    let (z, flipped) = (column(&[], "z_px"), column(&["--flip-depth"], "z_px"));
    assert!(z.len() > 500 && z.len() == flipped.len());
    // The median that is subtracted may be the neighbouring one of two middle values: a constant is left over.
    let constant = z[0] + flipped[0];
    assert!(z.iter().zip(&flipped).all(|(a, b)| (a + b - constant).abs() < 0.01));
    assert!(constant.abs() < 1.0);
    assert_eq!(column(&[], "disparity_px"), column(&["--flip-depth"], "disparity_px"));
}

#[test]
fn an_output_folder_with_other_content_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("thesis.tex"), "years of work").unwrap();
    let message = stderr(&mut reconstruct(folder.path(), &["--tilts", "-4,4"]), 1);
    assert!(message.contains("--force"), "{message}");
    assert_eq!(names(folder.path()), ["thesis.tex"]);
    reconstruct(folder.path(), &["--tilts", "-4,4", "--force", "-q"]).assert().success();
    assert_eq!(fs::read_to_string(folder.path().join("thesis.tex")).unwrap(), "years of work");
    assert!(names(folder.path()).contains(&"curves.csv".to_string()));
}

#[test]
fn bad_input_is_named_with_the_way_out_and_writes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let cases: [(&[&str], &str, i32); 7] = [
        (&[], "--tilts", 1),
        (&["--tilts", "4,4"], "tilt", 1),
        (&["--tilts", "NaN,4"], "NaN", 2),
        (&["--tilts", "-4,0,4"], "3 tilts", 2),
        (&["--tilts", "-4,4", "--tilt-axis", "NaN"], "NaN", 2),
        (&["--tilts", "-4,4", "--config", "/no/such/file.toml"], "file.toml", 1),
        (&["--tilts", "-4,4", "--max-disparity", "0"], "--max-disparity", 2),
    ];
    for (flags, words, code) in cases {
        let message = stderr(&mut reconstruct(&out, flags), code);
        assert!(message.contains(words), "{flags:?}: {message}");
        assert!(!out.exists(), "{flags:?}");
    }
}

#[test]
fn bad_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    };
    let png = fs::read(example("rendered_-4deg.png")).unwrap();
    let cases = [
        (folder.path().join("missing.png"), "missing.png"),
        (path("empty.png", b""), "empty"),
        (path("truncated.png", &png[..png.len() / 2]), "truncated.png"),
        (path("text.tif", b"not an image at all, but long enough to look at"), "text.tif"),
        (folder.path().to_path_buf(), "folder"),
    ];
    for (left, words) in cases {
        let mut command = tiltline();
        command.arg("reconstruct").arg(&left).arg(example("rendered_+4deg.png")).args(["--tilts", "-4,4", "-o"]);
        let message = stderr(command.arg(folder.path().join("out")), 1);
        assert!(message.contains(words), "{}: {message}", left.display());
        assert!(!folder.path().join("out").exists());
    }
}

#[test]
fn a_pair_with_nothing_in_it_says_so() {
    // Noise has features that match nowhere: an error with counts, or a result without lines, but never a panic.
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let left = example("rendered_-4deg.png");
    // The same image twice: a valid pair without parallax.
    let assert = tiltline()
        .arg("reconstruct")
        .arg(&left)
        .arg(&left)
        .args(["--tilts", "-4,4", "-q", "--json", "-o"])
        .arg(&out)
        .assert();
    let summary: serde_json::Value = serde_json::from_slice(&assert.success().get_output().stdout).unwrap();
    let range = &summary["disparity_range_px"];
    assert!(range[0].as_f64().unwrap().abs() < 0.3 && range[1].as_f64().unwrap().abs() < 0.3, "{summary}");
}

#[test]
fn wrong_usage_exits_with_two() {
    tiltline().arg("reconstruct").assert().code(2);
    tiltline().args(["reconstruct", "a", "b", "-o", "c", "--pixel-size", "3"]).assert().code(2);
    tiltline().arg("no-such-command").assert().code(2);
}

#[test]
fn info_and_completions_print() {
    let output = tiltline().arg("info").arg(example("rendered_-4deg.png")).assert().success();
    let text = String::from_utf8(output.get_output().stdout.clone()).unwrap();
    assert!(text.contains("512") && text.contains("unknown"), "{text}");
    let output = tiltline().args(["completions", "bash"]).assert().success();
    assert!(String::from_utf8_lossy(&output.get_output().stdout).contains("reconstruct"));
}

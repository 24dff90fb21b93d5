//! Simulating, benchmarking and scoring as a user types it.
#![allow(clippy::unwrap_used, clippy::print_stderr)] // a failed unwrap is a failed test

use std::fs;
use std::path::Path;

use assert_cmd::Command;

fn tiltline() -> Command {
    Command::cargo_bin("tiltline").unwrap()
}

fn simulate(out: &Path, more: &[&str]) -> Command {
    let mut command = tiltline();
    command.args(["simulate", "--family", "gan", "--size", "256", "-o"]).arg(out).args(more);
    command
}

fn stdout(command: &mut Command) -> String {
    String::from_utf8(command.assert().success().get_output().stdout.clone()).unwrap()
}

fn stderr(command: &mut Command, code: i32) -> String {
    let output = command.assert().code(code).get_output().clone();
    // miette wraps long messages and draws a margin: compare words, not lines.
    let text = String::from_utf8(output.stderr).unwrap().replace(['│', '×', '╰', '─', '▶'], " ");
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn a_simulated_pair_is_reconstructed_and_scored_without_a_word_about_tilts() {
    let folder = tempfile::tempdir().unwrap();
    let (data, out) = (folder.path().join("data"), folder.path().join("out"));
    assert!(stdout(&mut simulate(&data, &["--count", "2"])).contains("2 made, 0 kept"));
    let item = data.join("00001");
    let mut reconstruct = tiltline();
    // Tilts and pixel size are in the files.
    reconstruct.arg("reconstruct").arg(item.join("left.tif")).arg(item.join("right.tif")).arg("-o").arg(&out);
    let summary = stdout(&mut reconstruct);
    assert!(summary.contains("nm"), "{summary}");
    let report = stdout(tiltline().arg("score").arg(&out).arg(&item));
    assert!(report.contains("completeness") && report.contains("EPE"), "{report}");
    let paper = stdout(tiltline().arg("score").arg(&out).arg(&item).args(["--protocol", "paper"]));
    assert!(!paper.contains("End to end") && paper.contains("coverage"), "{paper}");
    let json = stdout(tiltline().arg("score").arg(&out).arg(item.join("truth.json")).arg("--json"));
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let completeness = json["summary"]["all"]["figures"]["completeness"]["value"].as_f64().unwrap();
    assert!((0.0..=1.0).contains(&completeness));
    // Running the same again keeps everything; other settings are refused.
    assert!(stdout(&mut simulate(&data, &["--count", "2"])).contains("0 made, 2 kept"));
    let refused = stderr(&mut simulate(&data, &["--count", "2", "--seed", "2"]), 1);
    assert!(refused.contains("another data set") && refused.contains("seed"), "{refused}");
}

#[test]
fn a_benchmark_counts_pairs_that_fail_and_goes_on_where_it_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let (data, out) = (folder.path().join("data"), folder.path().join("bench"));
    stdout(&mut simulate(&data, &["--count", "2", "--seed", "5"]));
    let bench = || {
        let mut command = tiltline();
        command.arg("bench").arg(&data).arg("-o").arg(&out);
        command
    };
    stdout(&mut bench());
    let score = |more: &[&str]| {
        let json = stdout(tiltline().arg("score").arg(&out).arg("--json").args(more));
        serde_json::from_str::<serde_json::Value>(&json).unwrap()
    };
    let before = score(&[]);
    assert_eq!(before["pairs"].as_array().unwrap().len(), 2);
    // One result is lost, and made again by the same command.
    let first = out.join("results/00000");
    fs::remove_dir_all(&first).unwrap();
    assert!(stderr(tiltline().arg("score").arg(&out), 1).contains("bench"));
    stdout(&mut bench());
    assert_eq!(score(&[]), before);
    // A pair that could not be reconstructed is not left out: it scores as nothing found.
    fs::remove_dir_all(&first).unwrap();
    fs::create_dir(&first).unwrap();
    fs::write(first.join("failed.txt"), "no lines").unwrap();
    let after = score(&[]);
    assert_eq!(after["pairs"][0]["end_to_end"]["completeness"].as_f64().unwrap(), 0.0);
    assert_eq!(after["pairs"][0]["paper"]["coverage"].as_f64().unwrap(), 0.0);
    // Other settings do not mix with these results, and changed data are noticed.
    assert!(stderr(bench().args(["--refine", "none"]), 1).contains("another benchmark"));
    let reports = folder.path().join("reports");
    score(&["-o", &reports.to_string_lossy()]);
    assert!(fs::read_to_string(reports.join("scores.md")).unwrap().contains("detector, net "));
    fs::write(data.join("00001/left.tif"), "not an image").unwrap();
    assert!(stderr(tiltline().arg("score").arg(&out), 1).contains("left.tif"));
}

/// Lines, disparities and rows that are true leave the errors of tracing only: a wrong sign or a shift in any of the three would show.
#[test]
fn truth_in_place_of_all_stages_is_found_nearly_without_error() {
    let folder = tempfile::tempdir().unwrap();
    let (data, out) = (folder.path().join("data"), folder.path().join("bench"));
    stdout(&mut simulate(&data, &["--count", "2", "--seed", "5"]));
    let truth = ["--detector", "truth", "--matcher", "truth"];
    stdout(tiltline().arg("bench").arg(&data).arg("-o").arg(&out).args(truth).arg("--known-rectification"));
    let json = stdout(tiltline().arg("score").arg(&out).arg("--json"));
    let scores: serde_json::Value = serde_json::from_str(&json).unwrap();
    let figure = |name: &str| scores["summary"]["all"]["figures"][name]["value"].as_f64().unwrap();
    // Crossing lines, which tracing may mix up, keep these from 1 and 0.
    assert!(figure("coverage") > 0.9 && figure("epe_px") < 0.3, "{} {}", figure("coverage"), figure("epe_px"));
    let result = folder.path().join("result");
    let images = ["left.tif", "right.tif"].map(|name| data.join("00000").join(name));
    let refused = stderr(tiltline().arg("reconstruct").args(images).args(truth).arg("-o").arg(&result), 1);
    assert!(refused.contains("tiltline bench") && !result.exists(), "{refused}");
}

#[test]
fn bad_input_is_named_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("data");
    let config = folder.path().join("foil.toml");
    for (text, word) in [
        ("foil.thickness_nm = [nan, 100.0]", "thickness_nm"),
        ("conditions.wedge = [0.0, 9.0]", "wedge"),
        ("foyl = 1", "foyl"),
    ] {
        fs::write(&config, text).unwrap();
        let message = stderr(&mut simulate(&out, &["--config", &config.to_string_lossy()]), 1);
        assert!(message.contains(word) && message.contains("foil.toml"), "{message}");
    }
    let network = folder.path().join("net.data");
    fs::write(&network, "dataFileVersion = 4\nnodeCount = 3\n").unwrap();
    assert!(stderr(&mut simulate(&out, &["--geometry", &network.to_string_lossy()]), 1).contains("net.data"));
    assert!(stderr(&mut simulate(&out, &["--tilts", "4"]), 1).contains("tilts_deg"));
    assert!(stderr(&mut simulate(&out, &["--tilts", "a,b"]), 2).contains("--tilts"));
    assert!(stderr(&mut simulate(&out, &["--seed", "600000000"]), 1).contains("fixed sets"));
    assert!(!out.exists());
    let unknown = stderr(tiltline().args(["bench", "bench-9deg", "-o"]).arg(&out), 1);
    assert!(unknown.contains("bench-8deg") && !out.exists(), "{unknown}");
    assert!(stderr(tiltline().arg("score").arg(folder.path()), 1).contains("truth"));
    // A result for images of another size.
    let (small, result) = (folder.path().join("small"), folder.path().join("result"));
    stdout(tiltline().args(["simulate", "--size", "64", "--count", "1", "-o"]).arg(&small));
    fs::create_dir(&result).unwrap();
    let columns = "curve,point,x_left_px,y_left_px,x_right_px,y_right_px,disparity_px,sigma_disparity_px,x_px,y_px,z_px,sigma_z_px,flag";
    fs::write(result.join("curves.csv"), format!("{columns}\n0,0,400.0,9.0,400.0,9.0,0.0,0.1,0.0,0.0,0.0,1.0,ok\n"))
        .unwrap();
    let message = stderr(tiltline().arg("score").arg(&result).arg(small.join("00000")), 1);
    assert!(message.contains("64"), "{message}");
}

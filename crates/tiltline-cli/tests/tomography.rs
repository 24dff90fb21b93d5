//! Tomograms as a user types them.
#![allow(clippy::unwrap_used, clippy::print_stderr)] // a failed unwrap is a failed test

use std::fs;
use std::path::Path;

use assert_cmd::Command;

fn tiltline() -> Command {
    Command::cargo_bin("tiltline").unwrap()
}

fn tomography(method: &str, series: &Path, out: &Path, more: &[&str]) -> Command {
    let mut command = tiltline();
    command.args(["tomography", method]).arg(series).arg("-o").arg(out).args(["--depth", "24"]).args(more);
    command
}

fn stderr(command: &mut Command, code: i32) -> String {
    let output = command.assert().code(code).get_output().clone();
    let text = String::from_utf8(output.stderr).unwrap().replace(['│', '×', '╰', '─', '▶'], " ");
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn a_series_becomes_a_volume_and_what_is_wrong_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    tiltline()
        .args(["simulate", "--family", "gan", "--size", "128", "--tilts=-40:40:10", "--count", "1", "-o"])
        .arg(&data)
        .assert()
        .success();
    let series = data.join("00000/series.mrc");
    let out = folder.path().join("tomogram.mrc");
    for (method, more) in
        [("wbp", &["--use", "5", "--filter", "ramp"][..]), ("sirt", &["--iterations", "3", "--force"])]
    {
        let mut command = tomography(method, &series, &out, &[&["--flatten", "--invert"], more].concat());
        let said = String::from_utf8(command.assert().success().get_output().stdout.clone()).unwrap();
        assert!(said.contains("from -40 to 40 degrees") && said.contains("missing wedge of 100.0 degrees"), "{said}");
        assert!(said.contains("128 x 128 x 24 voxels") && said.contains("nm a voxel"), "{said}");
        let info = tiltline::io::info(out.to_str().unwrap()).unwrap();
        assert_eq!((info.columns, info.rows, info.pages), (128, 128, 24));
        let range = info.intensities.unwrap();
        assert!(range.max > 0.0 && (method == "wbp" || range.min >= 0.0));
    }

    let other = folder.path().join("other.mrc");
    assert!(stderr(&mut tomography("wbp", &series, &out, &[]), 1).contains("is there already"));
    let message = stderr(&mut tomography("wbp", &series, &other, &["--tilts", "-4,4"]), 1);
    assert!(message.contains("9 views") && message.contains("2 tilts"), "{message}");
    assert!(stderr(&mut tomography("wbp", &series, &other, &["--use", "1"]), 1).contains("at least two"));
    assert!(stderr(&mut tomography("wbp", &series, &other, &["--use", "10"]), 1).contains("the series has 9"));
    assert!(stderr(&mut tomography("sirt", &series, &other, &["--relaxation", "2"]), 2).contains("relaxation is 2"));
    let bytes = fs::read(&series).unwrap();
    let cut = data.join("00000/cut.mrc");
    fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    assert!(stderr(&mut tomography("wbp", &cut, &other, &["--tilts=-40:40:10"]), 1).contains("are complete"));
    assert!(!other.exists());
    let hidden = fs::read_dir(folder.path())
        .unwrap()
        .filter(|entry| entry.as_ref().unwrap().file_name().to_string_lossy().starts_with(".tiltline-"));
    assert_eq!(hidden.count(), 0, "no temporary file stays");
}

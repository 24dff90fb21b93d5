//! Tilt series as a user gives them to the command.
#![allow(clippy::unwrap_used)] // a failed unwrap is a failed test

use std::fs;
use std::path::Path;

use assert_cmd::Command;
use tiltline::report::page;

fn tiltline(arguments: &[&str]) -> Command {
    let mut command = Command::cargo_bin("tiltline").unwrap();
    command.args(arguments);
    command
}

fn stdout(command: &mut Command) -> String {
    String::from_utf8(command.assert().success().get_output().stdout.clone()).unwrap()
}

fn stderr(command: &mut Command, code: i32) -> String {
    let output = command.assert().code(code).get_output().clone();
    let text = String::from_utf8(output.stderr).unwrap().replace(['│', '×', '╰', '─', '▶'], " ");
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The methods that need no weights: the same on every machine, and fast.
const CLASSICAL: [&str; 5] = ["--detector", "ridge", "--matcher", "classical", "-q"];

fn simulate(folder: &Path) -> String {
    let data = folder.join("data");
    let data = data.to_str().unwrap();
    let flags = ["simulate", "--family", "tial", "--size", "256", "--tilts=-16:16:4", "--count", "1", "--seed", "5"];
    tiltline(&flags).args(["-o", data, "-q"]).assert().success();
    format!("{data}/00000/series.mrc")
}

#[test]
fn a_series_gives_curves_of_all_views_and_these_are_reprojected() {
    let folder = tempfile::tempdir().unwrap();
    let series = simulate(folder.path());
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let out = at("out");
    let text = stdout(tiltline(&["reconstruct", &series, "-o", &out]).args(CLASSICAL));
    assert!(text.contains("degrees apart"), "{text}");
    let read = |name: &str| fs::read_to_string(Path::new(&out).join(name)).unwrap();
    assert_eq!(read("series.xf").lines().count(), 9);
    assert_eq!(read("series.tlt").lines().count(), 9);
    assert!(read("views.csv").lines().count() > 3, "{}", read("views.csv"));
    let record: toml::Table = read("run.toml").parse().unwrap();
    assert_eq!(record["run"]["series"]["views"].as_integer(), Some(9));
    // Eight degrees where both views show enough lines, and never far from it.
    let pair = record["run"]["series"]["pair_deg"].as_array().unwrap();
    let apart = pair[1].as_float().unwrap() - pair[0].as_float().unwrap();
    assert!((3.0..=16.0).contains(&apart), "{apart}");

    let report = page::read(&read("report.html")).unwrap().series.unwrap();
    assert!(report.fitted && report.views.len() + 1 == read("views.csv").lines().count());
    assert!(report.pictures.len() >= 3 && report.views.iter().all(|view| view.tilt_error_deg.is_some()));

    let again = at("reprojection");
    let text = stdout(&mut tiltline(&["reproject", &out, &series, "--views=-12,5", "-o", &again, "-q"]));
    assert!(text.contains("-12.0\u{b0}") && text.contains("+4.0\u{b0}"), "{text}");
    assert!(text.contains("absolute sign of depth cannot be known"));
    let rows = fs::read_to_string(Path::new(&again).join("reprojection.csv")).unwrap();
    assert_eq!(rows.lines().count(), 3, "{rows}");
    for name in ["view_-12.0deg.png", "view_+4.0deg.png", "reprojection.json", "points.csv", "series.xf"] {
        assert!(Path::new(&again).join(name).is_file(), "{name}");
    }
    // The alignment that was written is read back.
    let flags = ["reproject", &out, &series, "--views", "0", "-o", &at("aligned"), "-q", "--align"];
    tiltline(&flags).arg(Path::new(&again).join("series.xf")).assert().success();
    // The report shows the re-projection; then the tomogram beside the curves too.
    let shown = |name: &str| {
        let text = fs::read_to_string(Path::new(&at(name)).join("report.html")).unwrap();
        page::read(&text).unwrap().series.unwrap()
    };
    let section = shown("out");
    // The curves were fitted to these views: drawn into them again, they are no test.
    assert!(section.fitted && section.tomogram.is_none());
    assert_eq!(section.views.len(), 1);
    let tomogram = at("tomogram.mrc");
    let flags = ["tomography", "sirt", &series, "--flatten", "--invert", "--compare", &out, "-o", &tomogram, "-q"];
    let text = stdout(&mut tiltline(&flags));
    assert!(text.contains("compared") && text.contains("report.html"), "{text}");
    let wrong = [&flags[..], &["--force", "--align", "auto"]].concat();
    assert!(stderr(&mut tiltline(&wrong), 2).contains("refined on the curves"));
    let section = shown("out");
    assert_eq!(section.views.len(), 1, "what was shown stays");
    let size = section.tomogram.unwrap().size;
    assert_eq!([size[0], size[1]], [256, 256]);
    // An angle that no view has.
    let flags = ["reproject", &out, &series, "--views", "30", "-o", &at("far"), "-q"];
    assert!(stderr(&mut tiltline(&flags), 1).contains("nearest is at 16"));
}

#[test]
fn a_named_pair_is_reconstructed_alone_and_wrong_series_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let series = simulate(folder.path());
    let out = folder.path().join("out");
    let out = out.to_str().unwrap();
    let flags = ["reconstruct", &series, "--pair=-5,4", "-o", out];
    let text = stdout(tiltline(&flags).args(CLASSICAL));
    assert!(text.contains("tilts -4 and 4"), "{text}");
    assert!(!Path::new(out).join("views.csv").exists());
    let other = folder.path().join("other");
    let other = other.to_str().unwrap();
    let error =
        |more: &[&str], code| stderr(tiltline(&["reconstruct", &series, "-o", other]).args(more).args(CLASSICAL), code);
    assert!(error(&["--pair", "4"], 2).contains("--pair -4,4"));
    assert!(error(&["--pair=-4,60"], 1).contains("no view at 60"));
    let message = error(&["--tilts=-4,0,4"], 1);
    assert!(message.contains("9 views") && message.contains("3 tilts"), "{message}");
    let flags = ["reconstruct", &series, &series, "--pair=-4,4", "-o", other];
    assert!(stderr(&mut tiltline(&flags), 2).contains("cannot be used with"));
    assert!(!Path::new(other).exists());
}

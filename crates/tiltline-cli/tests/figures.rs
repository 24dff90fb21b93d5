//! `tiltline figures --small`: every table and figure on small foils.
#![allow(clippy::unwrap_used)] // a failed unwrap is a failed test

use std::fs;
use std::path::Path;

use assert_cmd::Command;
use tempfile::tempdir;

fn figures(output: &Path, more: &[&str]) -> assert_cmd::assert::Assert {
    let mut command = Command::cargo_bin("tiltline").unwrap();
    command.args(["figures", "--small", "--quiet", "-o"]).arg(output).args(more).assert()
}

#[test]
fn a_small_run_makes_every_table_and_figure_and_is_taken_up() {
    let folder = tempdir().unwrap();
    let output = folder.path().join("figures");
    figures(&output, &["--retrain"]).success();
    let page = fs::read_to_string(output.join("README.md")).unwrap();
    let headings: Vec<&str> = page.lines().filter_map(|line| line.strip_prefix("## ")?.split(':').next()).collect();
    let expected = [
        "Figure 4",
        "Figure 5",
        "Figure 6",
        "Figure 7",
        "Figure 8",
        "Figure 9",
        "Table 1",
        "Table 2",
        "Figure 10",
        "Figure 11",
        "Table 3",
        "Figure 12",
    ];
    assert_eq!(headings, expected);
    assert!(!page.contains("Left out"), "{page}");
    let pictures: Vec<&str> =
        page.split("](").filter_map(|rest| rest.split(')').next()?.strip_suffix(".png")).collect();
    assert!(pictures.len() >= 10, "{pictures:?}");
    for picture in pictures {
        let bytes = fs::read(output.join(format!("{picture}.png"))).unwrap();
        assert!(bytes.starts_with(b"\x89PNG"), "{picture}");
    }

    // The same without trainings: from records and measurements, and to the same page.
    let before = fs::metadata(output.join("records/losses.json")).unwrap().modified().unwrap();
    figures(&output, &[]).success();
    assert_eq!(fs::read_to_string(output.join("README.md")).unwrap(), page);
    assert_eq!(fs::metadata(output.join("records/losses.json")).unwrap().modified().unwrap(), before);
    // Measured anew, the figures are the same; a page of something else is not written over.
    let work = folder.path().join("work");
    figures(&output, &["--work", work.to_str().unwrap()]).success();
    assert_eq!(fs::read_to_string(output.join("README.md")).unwrap(), page);
    fs::write(output.join("README.md"), "# Mine\n").unwrap();
    figures(&output, &[]).failure();
    assert_eq!(fs::read_to_string(output.join("README.md")).unwrap(), "# Mine\n");
}

//! The report: made with a result, made again, drawn for print, opened.
#![allow(clippy::unwrap_used)] // a failed unwrap is a failed test

use std::fs;
use std::path::{Path, PathBuf};

use assert_cmd::Command;

fn tiltline() -> Command {
    Command::cargo_bin("tiltline").unwrap()
}

/// The example pair, reconstructed with the classical methods.
fn result(folder: &Path) -> PathBuf {
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples");
    let out = folder.join("out");
    tiltline()
        .arg("reconstruct")
        .args([examples.join("rendered_-4deg.png"), examples.join("rendered_+4deg.png")])
        .args(["--tilts", "-4,4", "--pixel-size", "1.2nm", "--detector", "ridge", "--matcher", "classical", "-q", "-o"])
        .arg(&out)
        .assert()
        .success();
    out
}

#[test]
fn a_report_is_made_again_from_itself_and_its_figures_are_svg_and_png() {
    let folder = tempfile::tempdir().unwrap();
    let out = result(folder.path());
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    // Small enough to mail, with everything in it, run record included.
    assert!(page.len() < 2_000_000, "{}", page.len());
    assert!(page.contains("rendered_-4deg.png") && page.contains("max_keypoints"));
    let printed = tiltline().arg("report").arg(&out).arg("--png").assert().success();
    assert_eq!(fs::read_to_string(out.join("report.html")).unwrap(), page);
    let printed = String::from_utf8(printed.get_output().stdout.clone()).unwrap();
    for name in ["images", "projections", "histograms", "residuals"] {
        let file = |extension: &str| out.join("figures").join(format!("{name}.{extension}"));
        assert!(fs::read_to_string(file("svg")).unwrap().contains("<svg"));
        let png = fs::read(file("png")).unwrap();
        assert_eq!(&png[1..4], b"PNG");
        // 180 mm at 300 dots per inch, and the chunk that says so.
        assert_eq!(u32::from_be_bytes(png[16..20].try_into().unwrap()), 2126, "{name}");
        assert_eq!(&png[37..41], b"pHYs");
        assert!(printed.contains(&file("png").display().to_string()), "{printed}");
    }
    // A page alone, as it comes by mail, is enough.
    let mailed = folder.path().join("mailed.html");
    fs::write(&mailed, &page).unwrap();
    tiltline().arg("report").arg(&mailed).assert().success();
    assert_eq!(fs::read_to_string(&mailed).unwrap(), page);
}

#[test]
fn what_is_no_report_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let other = folder.path().join("other.html");
    fs::write(&other, "<html></html>").unwrap();
    for (path, words) in [(folder.path(), "report.html"), (&other, "not a report")] {
        let assert = tiltline().arg("report").arg(path).assert().code(1);
        let text = String::from_utf8_lossy(&assert.get_output().stderr).into_owned();
        assert!(text.contains(words), "{text}");
    }
    assert_eq!(fs::read_to_string(&other).unwrap(), "<html></html>");
}

#[cfg(unix)]
#[test]
fn view_starts_the_chosen_browser_or_says_where_the_page_is() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("report.html");
    fs::write(&page, "").unwrap();
    let seen = folder.path().join("seen");
    let browser = folder.path().join("browser");
    fs::write(&browser, format!("#!/bin/sh\nprintf %s \"$1\" > '{}'\n", seen.display())).unwrap();
    fs::set_permissions(&browser, fs::Permissions::from_mode(0o755)).unwrap();
    tiltline().arg("view").arg(folder.path()).env("BROWSER", &browser).assert().success();
    assert_eq!(fs::read_to_string(&seen).unwrap(), page.display().to_string());
    // No browser anywhere.
    let assert = tiltline().arg("view").arg(&page).env("BROWSER", "").env("PATH", "").assert().code(1);
    let text = String::from_utf8_lossy(&assert.get_output().stderr).replace(['\n', ' ', '│'], "");
    assert!(text.contains("BROWSER") && text.contains("report.html"), "{text}");
}

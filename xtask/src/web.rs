//! `cargo xtask web [--check|--test]`: the report's page, built from `web/` (needs Node.js and npm) and tested in Chromium.

mod pages;

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use miette::{IntoDiagnostic, Result, miette};

use crate::venv::root;

/// The built page, which the program embeds.
const PAGE: &str = "crates/tiltline/src/report/page.html";
/// Browsers that the tests can use, unless `TILTLINE_CHROMIUM` names one.
const BROWSERS: [&str; 3] = ["chromium", "chromium-browser", "google-chrome"];

/// Builds the page into the place where the program embeds it; `--check` only compares; `--test` tests that one.
pub fn run(arguments: &[String]) -> Result<()> {
    match arguments {
        [] => {
            let built = build()?;
            std::fs::write(root().join(PAGE), built).into_diagnostic()?;
            println!("wrote {PAGE}");
            Ok(())
        }
        [flag] if flag == "--check" => check(),
        [flag] if flag == "--test" => {
            let browser = browser().ok_or_else(|| miette!("no Chromium was found; TILTLINE_CHROMIUM names one"))?;
            test(&browser)
        }
        _ => Err(miette!("usage: cargo xtask web [--check|--test]")),
    }
}

/// What CI does: as much as the machine has tools for, and a word about the rest.
pub fn ci() -> Result<()> {
    if !starts("npm") {
        println!("Node.js is not installed: the report's page was neither built nor tested");
        return Ok(());
    }
    check()?;
    match browser() {
        Some(browser) => test(&browser),
        None => {
            println!("Chromium is not installed: the report's page was not tested in a browser");
            Ok(())
        }
    }
}

fn check() -> Result<()> {
    let committed = std::fs::read_to_string(root().join(PAGE)).into_diagnostic()?;
    if build()? == committed {
        println!("{PAGE} is what web/ builds");
        return Ok(());
    }
    Err(miette!("{PAGE} is not what web/ builds: run `cargo xtask web` and commit the result"))
}

/// Builds the page and returns it.
fn build() -> Result<String> {
    prepare()?;
    let folder = root().join("target/web");
    npm(&["run", "--silent", "build"], &[("TILTLINE_PAGE_FOLDER", folder.as_os_str())])?;
    std::fs::read_to_string(folder.join("page.html")).into_diagnostic()
}

fn test(browser: &Path) -> Result<()> {
    prepare()?;
    let folder = root().join("target/web-pages");
    pages::write(&folder)?;
    npm(
        &["run", "--silent", "test"],
        &[("TILTLINE_PAGES", folder.as_os_str()), ("TILTLINE_CHROMIUM", browser.as_os_str())],
    )
}

/// Installs what package-lock.json names, unless that was done.
fn prepare() -> Result<()> {
    let web = root().join("web");
    let lock = std::fs::read(web.join("package-lock.json")).into_diagnostic()?;
    let stamp = web.join("node_modules/.tiltline-lock");
    if std::fs::read(&stamp).ok().as_ref() != Some(&lock) {
        npm(&["ci", "--no-audit", "--no-fund", "--ignore-scripts"], &[])?;
        std::fs::write(&stamp, &lock).into_diagnostic()?;
    }
    Ok(())
}

fn npm(arguments: &[&str], environment: &[(&str, &std::ffi::OsStr)]) -> Result<()> {
    println!("$ npm {}", arguments.join(" "));
    let status = Command::new("npm")
        .args(arguments)
        .envs(environment.iter().copied())
        .current_dir(root().join("web"))
        .status()
        .map_err(|error| miette!("cannot start npm ({error}): install Node.js 20 or newer"))?;
    if status.success() { Ok(()) } else { Err(miette!("npm {} failed", arguments.join(" "))) }
}

fn browser() -> Option<PathBuf> {
    if let Some(named) = std::env::var_os("TILTLINE_CHROMIUM") {
        return Some(named.into());
    }
    let folders = std::env::var_os("PATH")?;
    let candidates = std::env::split_paths(&folders).flat_map(|folder| BROWSERS.map(|name| folder.join(name)));
    candidates.into_iter().find(|path| path.is_file())
}

fn starts(program: &str) -> bool {
    let version = Command::new(program).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
    version.is_ok_and(|status| status.success())
}

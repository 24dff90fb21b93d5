//! `tiltline view`: opens a report in the system's browser.

use std::ffi::OsString;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use miette::{IntoDiagnostic, Result, miette};

use crate::args::View;
use crate::output;
use crate::report::report_in;

/// A program that has not given up by then has opened the page, or is the browser itself.
const PATIENCE: Duration = Duration::from_secs(3);

/// Runs the command.
pub fn run(flags: &View) -> Result<()> {
    let path = std::path::absolute(report_in(&flags.result)?).into_diagnostic()?;
    for (program, arguments) in openers(&path) {
        if opens(Command::new(program).args(arguments)) {
            return output::print(&format!("{}\n", path.display()));
        }
    }
    Err(miette!(
        "no browser could be started (set BROWSER to the name of one); open this file in any browser, here or on another \
         computer, it needs nothing else:\n{}",
        path.display()
    ))
}

/// Programs that open a file in a browser and their arguments, the user's own choice first.
fn openers(path: &Path) -> Vec<(OsString, Vec<OsString>)> {
    let file = path.as_os_str().to_owned();
    let mut openers = Vec::new();
    // A list parted by colons, as xdg-open and others read it; ones with arguments are left to them.
    let chosen = std::env::var("BROWSER").unwrap_or_default();
    for program in chosen.split(':').filter(|program| !program.is_empty() && !program.contains(' ')) {
        openers.push((program.into(), vec![file.clone()]));
    }
    let system: &[&str] = if cfg!(target_os = "macos") {
        &["open"]
    } else if cfg!(windows) {
        &["explorer"]
    } else {
        &["xdg-open", "gio"]
    };
    for program in system {
        let arguments = if *program == "gio" { vec!["open".into(), file.clone()] } else { vec![file.clone()] };
        openers.push(((*program).into(), arguments));
    }
    openers
}

/// Whether a program starts and does not fail at once.
fn opens(command: &mut Command) -> bool {
    let Ok(mut child) = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn() else {
        return false;
    };
    let start = Instant::now();
    while start.elapsed() < PATIENCE {
        match child.try_wait() {
            // Windows' explorer says 1 when all is well.
            Ok(Some(status)) => return status.success() || cfg!(windows),
            Ok(None) => std::thread::sleep(Duration::from_millis(50)),
            Err(_) => return false,
        }
    }
    true
}

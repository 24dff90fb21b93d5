//! Ctrl-C: nothing half-written stays behind.
//!
//! Results appear in their folder only when all are complete; until then they lie in a temporary folder, which a
//! signal would leave behind. The handler removes it and exits with 130.

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use miette::{IntoDiagnostic, Result};
use tiltline::export::{self, Staging};
use tiltline::reconstruction::Reconstruction;

static TEMPORARY: Mutex<Option<PathBuf>> = Mutex::new(None);

/// Exit code of an interrupted run, as shells expect it (128 + SIGINT).
const INTERRUPTED: i32 = 130;

/// Installs the handler.
pub fn install() -> Result<()> {
    ctrlc::set_handler(|| {
        // Held until the process ends, so that no move into place starts under our feet.
        let temporary = TEMPORARY.lock();
        if let Ok(Some(folder)) = temporary.as_deref() {
            let _ = std::fs::remove_dir_all(folder);
        }
        eprintln!("interrupted; nothing was written");
        std::process::exit(INTERRUPTED);
    })
    .into_diagnostic()
}

/// [`export::write_all`], with its temporary folder known to the handler while it is being filled.
pub fn write_all(result: &Reconstruction, extra: &[(&str, Vec<u8>)], folder: &Path, force: bool) -> Result<()> {
    let staging = Staging::begin(folder, force).into_diagnostic()?;
    let remember = |path: Option<PathBuf>| *TEMPORARY.lock().expect("the lock is never poisoned") = path;
    remember(Some(staging.path().to_owned()));
    let written = export::write_staged(result, extra, staging);
    remember(None);
    written.into_diagnostic()?;
    Ok(())
}

//! Ctrl-C: nothing half-written stays behind.
//!
//! Results appear in their folder only when all are complete; until then they lie in a temporary folder, which a
//! signal would leave behind. The handler removes it and exits with 130.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use miette::{IntoDiagnostic, Result, miette};
use tiltline::export::{self, Staging};
use tiltline::reconstruction::Reconstruction;

/// How far writing has come.
enum Writing {
    NotBegun,
    /// Files are being written to this temporary folder.
    Filling(PathBuf),
    /// One file is being written under this temporary name.
    FillingFile(PathBuf),
    /// They are in their place.
    Done,
}

static WRITING: Mutex<Writing> = Mutex::new(Writing::NotBegun);

/// Whether the command keeps what it has done and goes on from there when it is run again.
static RESUMABLE: AtomicBool = AtomicBool::new(false);

/// Says that what is complete stays, and that the same command goes on from there.
pub fn resumable() {
    RESUMABLE.store(true, Ordering::Relaxed);
}

/// Whether the command stops by itself when asked to, and whether it was asked.
static STOPS: AtomicBool = AtomicBool::new(false);
static ASKED: AtomicBool = AtomicBool::new(false);

/// From now on the first signal only sets the flag that is returned; a second one ends the program.
pub fn ask_to_stop() -> &'static AtomicBool {
    STOPS.store(true, Ordering::Relaxed);
    &ASKED
}

/// The first signal ends the program again.
pub fn stop_at_once() {
    STOPS.store(false, Ordering::Relaxed);
}

/// Exit code of an interrupted run, as shells expect it (128 + SIGINT).
pub const INTERRUPTED: i32 = 130;
/// Writers that are still at work may add a file while the folder is being removed.
const REMOVALS: usize = 20;

/// Installs the handler.
pub fn install() -> Result<()> {
    ctrlc::set_handler(|| {
        if STOPS.load(Ordering::Relaxed) && !ASKED.swap(true, Ordering::Relaxed) {
            eprintln!("stopping after this step; once more to stop at once");
            return;
        }
        // Held until the process ends. A move into place holds it too: it is finished first, or never begins.
        let writing = WRITING.lock();
        let message = match writing.as_deref() {
            Ok(Writing::Done) => "interrupted; the results had been written",
            Ok(Writing::FillingFile(file)) => {
                // Nothing better can be done where that fails.
                let _ = std::fs::remove_file(file);
                "interrupted; nothing was written"
            }
            Ok(Writing::Filling(folder)) => {
                for _ in 0..REMOVALS {
                    if std::fs::remove_dir_all(folder).is_ok() || !folder.exists() {
                        break;
                    }
                    std::thread::sleep(std::time::Duration::from_millis(10));
                }
                "interrupted; nothing was written"
            }
            _ => "interrupted; nothing was written",
        };
        let resumed = "interrupted; what was complete is kept, and the same command goes on from there";
        eprintln!("{}", if RESUMABLE.load(Ordering::Relaxed) { resumed } else { message });
        std::process::exit(INTERRUPTED);
    })
    .into_diagnostic()
}

/// Fills a new file by `fill` and puts it in place when it is complete; its temporary name is known to the handler.
pub fn write_file(path: &Path, fill: impl FnOnce(&mut std::fs::File) -> Result<()>) -> Result<()> {
    let lock = || WRITING.lock().expect("no thread panics while it holds the lock");
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut file = tiltline::temporary::file_in(folder, ".tiltline-")
        .map_err(|error| miette!("cannot write to {}: {error}; name another output file", folder.display()))?;
    *lock() = Writing::FillingFile(file.path().to_owned());
    fill(file.as_file_mut())?;
    let mut writing = lock();
    file.persist(path).map_err(|error| miette!("cannot put {} in its place: {}", path.display(), error.error))?;
    *writing = Writing::Done;
    Ok(())
}

/// Files that `fill` writes (and names), into a folder: all of them or none.
pub fn write_folder(folder: &Path, force: bool, fill: impl FnOnce(&Staging) -> Result<Vec<String>>) -> Result<()> {
    let lock = || WRITING.lock().expect("no thread panics while it holds the lock");
    let staging = Staging::begin(folder, force).into_diagnostic()?;
    *lock() = Writing::Filling(staging.path().to_owned());
    let names = fill(&staging)?;
    let mut writing = lock();
    staging.commit(names.iter().map(String::as_str)).into_diagnostic()?;
    *writing = Writing::Done;
    Ok(())
}

/// [`export::write_all`], with its temporary folder known to the handler while it is being filled.
pub fn write_all(result: &Reconstruction, extra: &[(&str, Vec<u8>)], folder: &Path, force: bool) -> Result<()> {
    write_folder(folder, force, |staging| {
        let names = export::fill(result, extra, staging).into_diagnostic()?;
        Ok(names.into_iter().map(str::to_owned).collect())
    })
}

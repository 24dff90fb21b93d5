//! A Python environment with the peers we compare against, made on demand under `reference/`.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;

use miette::{IntoDiagnostic, Result, miette};

/// The root of the repository.
pub fn root() -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.parent().expect("xtask lies in the repository's root").to_path_buf()
}

/// A Python environment with the packages of `xtask/reference/requirements.txt`.
pub struct Venv {
    python: PathBuf,
    /// Folder for what travels between Rust and Python; git ignores it.
    pub work: PathBuf,
}

impl Venv {
    /// Makes the environment if it is not there, or if its requirements changed.
    ///
    /// `TILTLINE_REFERENCE_PYTHON` names an interpreter that has the packages already.
    pub fn ready() -> Result<Self> {
        let work = root().join("reference");
        std::fs::create_dir_all(&work).into_diagnostic()?;
        if let Some(python) = std::env::var_os("TILTLINE_REFERENCE_PYTHON") {
            return Ok(Self { python: python.into(), work });
        }
        let folder = work.join("venv");
        let python = folder.join("bin").join("python");
        let requirements = root().join("xtask/reference/requirements.txt");
        let wanted = std::fs::read_to_string(&requirements).into_diagnostic()?;
        let stamp = folder.join("requirements.txt");
        if std::fs::read_to_string(&stamp).ok().as_ref() != Some(&wanted) {
            check(Command::new("python3").args(["-m", "venv"]).arg(&folder))?;
            check(Command::new(&python).args(["-m", "pip", "install", "--quiet", "-r"]).arg(&requirements))?;
            std::fs::write(&stamp, &wanted).into_diagnostic()?;
        }
        Ok(Self { python, work })
    }

    /// Runs `xtask/reference/SCRIPT` with arguments and returns what it printed (JSON, by habit).
    pub fn run<S: AsRef<OsStr>>(&self, script: &str, arguments: &[S]) -> Result<String> {
        let script = root().join("xtask/reference").join(script);
        let output = Command::new(&self.python)
            .arg(&script)
            .args(arguments)
            // Some machines pin OpenBLAS to an old kernel; the peers shall run at their best.
            .env_remove("OPENBLAS_CORETYPE")
            .env_remove("OPENBLAS_L2_SIZE")
            .stderr(std::process::Stdio::inherit())
            .output()
            .into_diagnostic()?;
        if !output.status.success() {
            return Err(miette!("{} failed with {}", script.display(), output.status));
        }
        String::from_utf8(output.stdout).into_diagnostic()
    }
}

fn check(command: &mut Command) -> Result<()> {
    let status = command.status().into_diagnostic()?;
    if status.success() { Ok(()) } else { Err(miette!("{command:?} failed with {status}")) }
}

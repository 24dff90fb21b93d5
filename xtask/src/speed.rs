//! Time and peak memory of the whole command, from files to files, on foils of growing size.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use miette::{IntoDiagnostic, Result, miette};

use crate::venv::root;

/// Rows and columns of the pairs, and how often each is run.
const SIZES: [(usize, usize); 4] = [(512, 5), (1024, 5), (2048, 3), (4096, 1)];
/// Seed of the foils.
const SEED: &str = "5";
/// How often memory is looked at: the peak is the kernel's own, only the last look must not be too early.
const LOOK: Duration = Duration::from_millis(5);

/// Makes the pairs, reconstructs them and prints a table.
pub fn measure() -> Result<()> {
    let program = built()?;
    let folder = root().join("target/speed");
    std::fs::create_dir_all(&folder).into_diagnostic()?;
    println!("| size | seconds | microseconds per pixel of one image | peak memory, MiB |\n|---|---|---|---|");
    for (side, runs) in SIZES {
        let data = folder.join(side.to_string());
        let size = side.to_string();
        let foil = ["simulate", "--family", "tial", "--mode", "parametric", "--tilts=-4,4", "--count", "1", "--quiet"];
        let made = Command::new(&program)
            .args(foil)
            .args(["--size", &size, "--seed", SEED, "-o"])
            .arg(&data)
            .stdout(Stdio::null())
            .status()
            .into_diagnostic()?;
        if !made.success() {
            return Err(miette!("the pair of {side} px could not be made"));
        }
        let mut measured = Vec::new();
        for _ in 0..runs {
            measured.push(run(&program, &data.join("00000"), &folder.join("out"))?);
        }
        let median = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values[values.len() / 2]
        };
        let seconds = median(measured.iter().map(|(seconds, _)| *seconds).collect());
        let memory = median(measured.iter().map(|(_, memory)| *memory).collect());
        println!("| {side}x{side} | {seconds:.2} | {:.2} | {memory:.0} |", seconds * 1e6 / (side * side) as f64);
    }
    Ok(())
}

/// The release build of the command.
pub fn built() -> Result<std::path::PathBuf> {
    let status = Command::new(env!("CARGO"))
        .args(["build", "--quiet", "--release", "--workspace", "--bin", "tiltline"])
        .current_dir(root())
        .status()
        .into_diagnostic()?;
    if !status.success() {
        return Err(miette!("tiltline does not build"));
    }
    Ok(root().join("target/release").join(format!("tiltline{}", std::env::consts::EXE_SUFFIX)))
}

/// Seconds and peak memory in MiB of one reconstruction.
fn run(program: &Path, data: &Path, output: &Path) -> Result<(f64, f64)> {
    let start = Instant::now();
    let mut child = Command::new(program)
        .args(["reconstruct", "--tilts=-4,4", "--quiet", "--force", "-o"])
        .arg(output)
        .args([data.join("left.tif"), data.join("right.tif")])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .into_diagnostic()?;
    let mut peak = 0.0_f64;
    loop {
        peak = peak.max(peak_memory_mib(child.id()).unwrap_or(0.0));
        match child.try_wait().into_diagnostic()? {
            Some(status) if status.success() => return Ok((start.elapsed().as_secs_f64(), peak)),
            Some(status) => return Err(miette!("the reconstruction of {} failed: {status}", data.display())),
            None => std::thread::sleep(LOOK),
        }
    }
}

/// Peak resident memory of a process so far; none where the system does not say.
fn peak_memory_mib(process: u32) -> Option<f64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: f64 = line.trim().trim_end_matches("kB").trim().parse().ok()?;
    Some(kib / 1024.0)
}

//! The networks against the same in PyTorch: outputs, losses and gradients from the same weights, then time and memory.

use std::process::Command;

use miette::{IntoDiagnostic, Result, miette};
use serde_json::Value;

use crate::venv::{Venv, root};

/// Rounds in which both are timed in turn, and runs a round.
const ROUNDS: usize = 5;
const RUNS: &str = "3";

/// Runs the comparison and prints its table.
pub fn run(venv: &Venv) -> Result<()> {
    let fixture = venv.work.join("parity.safetensors");
    let path = fixture.to_string_lossy().into_owned();
    venv.run("nets.py", &["parity", path.as_str()])?;
    let cargo = || {
        let mut command = Command::new("cargo");
        command.current_dir(root()).env("TILTLINE_PARITY_FIXTURE", &fixture);
        command
    };
    let status = cargo()
        .args(["test", "--release", "--quiet", "-p", "tiltline-nets", "--test", "parity"])
        .status()
        .into_diagnostic()?;
    if !status.success() {
        return Err(miette!("the networks differ from PyTorch's"));
    }
    println!("outputs and losses agree to 1e-4, gradients to 1e-3 (a fixture made now)");
    let example = ["run", "--release", "--quiet", "-p", "tiltline-nets", "--example", "speed", "--"];
    println!(
        "{:10} {:8} {:>10} {:>10} {:>7} {:>12} {:>12}",
        "", "", "ours, s", "theirs, s", "ratio", "ours, MiB", "theirs, MiB"
    );
    for kind in ["detector", "matcher"] {
        for work in ["forward", "step"] {
            let (mut ours, mut theirs, mut memory) = (Vec::new(), Vec::new(), [0.0_f64; 2]);
            for _ in 0..ROUNDS {
                let output = cargo().args(example).args([kind, work, RUNS]).output().into_diagnostic()?;
                let own: Value = serde_json::from_slice(&output.stdout).into_diagnostic()?;
                let peer: Value =
                    serde_json::from_str(&venv.run("nets.py", &["speed", kind, work, RUNS])?).into_diagnostic()?;
                for (index, (seconds, value)) in [(&mut ours, &own), (&mut theirs, &peer)].into_iter().enumerate() {
                    let list = value["seconds"].as_array().ok_or_else(|| miette!("no seconds in {value}"))?;
                    seconds.extend(list.iter().filter_map(Value::as_f64));
                    memory[index] = memory[index].max(value["peak_mib"].as_f64().unwrap_or(f64::NAN));
                }
            }
            let [own, peer] = [&mut ours, &mut theirs].map(|seconds| {
                seconds.sort_by(f64::total_cmp);
                seconds[seconds.len() / 2]
            });
            let ratio = own / peer;
            println!("{kind:10} {work:8} {own:10.3} {peer:10.3} {ratio:7.2} {:12.0} {:12.0}", memory[0], memory[1]);
        }
    }
    Ok(())
}

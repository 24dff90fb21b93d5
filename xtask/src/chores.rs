//! What CI runs.

use std::process::Command;

use miette::{IntoDiagnostic, Result, miette};

use crate::venv::root;
use crate::web;

/// Everything CI checks, quickest first.
pub fn ci() -> Result<()> {
    cargo(&["fmt", "--all", "--check"], &[])?;
    // With graphics cards, so that their code keeps compiling; nothing else is built with it.
    let wgpu = ["--features", "tiltline-nets/wgpu"];
    let clippy = [&["clippy", "--release", "--workspace", "--all-targets"][..], &wgpu, &["--", "--deny", "warnings"]];
    cargo(&clippy.concat(), &[])?;
    let doc = [&["doc", "--release", "--workspace", "--no-deps"][..], &wgpu];
    cargo(&doc.concat(), &[("RUSTDOCFLAGS", "--deny warnings")])?;
    if Command::new("cargo-deny").arg("--version").output().is_ok() {
        cargo(&["deny", "--offline", "check", "licenses", "bans", "sources"], &[])?;
    } else {
        println!("cargo-deny is not installed: licences and bans of dependencies were not checked");
    }
    test()?;
    web::ci()
}

/// The README's test command.
pub fn test() -> Result<()> {
    cargo(&["test", "--release", "--workspace"], &[])
}

fn cargo(arguments: &[&str], environment: &[(&str, &str)]) -> Result<()> {
    println!("$ cargo {}", arguments.join(" "));
    let status = Command::new(env!("CARGO"))
        .args(arguments)
        .envs(environment.iter().copied())
        .current_dir(root())
        .status()
        .into_diagnostic()?;
    if status.success() { Ok(()) } else { Err(miette!("cargo {} failed", arguments.join(" "))) }
}

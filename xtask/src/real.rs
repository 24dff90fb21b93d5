//! `cargo xtask real [IMAGES [WEIGHTS|ridge]]`: a detector on real images that were labelled by hand (`xtask/labels`). The images
//! are not part of the project; without their folder there is nothing to measure, and that is said.

use std::path::Path;
use std::process::Command;

use miette::{IntoDiagnostic, Result, miette};

use crate::venv::root;

/// Where the images are looked for.
const IMAGES: &str = "../shared/data/real";

/// Prints what was found and what invented, and draws pictures into `target/real`.
pub fn measure(arguments: &[String]) -> Result<()> {
    let images = arguments.first().map_or(IMAGES, String::as_str);
    if !root().join(images).is_dir() {
        println!("skipped: there is no folder {images}; give one with the images that xtask/labels names");
        return Ok(());
    }
    let example = ["run", "--release", "--quiet", "-p", "tiltline-nets", "--example", "real", "--"];
    let status = Command::new(env!("CARGO"))
        .args(example)
        .args([Path::new(images), Path::new("xtask/labels"), Path::new("target/real")])
        .args(arguments.get(1))
        .current_dir(root())
        .status()
        .into_diagnostic()?;
    if status.success() { Ok(()) } else { Err(miette!("the example real failed")) }
}

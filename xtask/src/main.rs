//! The project's own chores: `cargo xtask ci|test|reference`.
#![allow(clippy::print_stdout, clippy::print_stderr)]

mod npy;
mod reference;
mod venv;

use miette::{Result, miette};

const USAGE: &str = "usage: cargo xtask reference [TOPIC...]";

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.first().map(String::as_str) {
        Some("reference") => reference::run(&arguments[1..]),
        _ => Err(miette!("{USAGE}")),
    }
}

//! The project's own chores: `cargo xtask ci|test|reference|accuracy|tomography|real|weights|figures|example`.
#![allow(clippy::print_stdout, clippy::print_stderr)]

mod accuracy;
mod chores;
mod example;
mod figures;
mod npy;
mod real;
mod reference;
mod tomography;
mod venv;
mod weights;

use miette::{Result, miette};

const USAGE: &str = "usage: cargo xtask COMMAND
  ci                    formatting, clippy, docs, tests, and cargo-deny where it is installed
  test                  the tests
  reference [TOPIC...]  comparisons with independent implementations (needs Python)
  accuracy              scores the program on the fixed sets: docs/accuracy.md
  tomography            WBP and SIRT against the number of views, on the series of bench-series
  real [IMAGES]         the detector on real images labelled by hand (xtask/labels)
  weights               trains the shipped networks again (hours; goes on where it was stopped)
  figures               draws the pictures of docs/simulator.md again
  example               renders the example pair in examples/ again";

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.first().map(String::as_str) {
        Some("ci") => chores::ci(),
        Some("test") => chores::test(),
        Some("reference") => reference::run(&arguments[1..]),
        Some("accuracy") => accuracy::measure(),
        Some("tomography") => tomography::measure(&arguments[1..]),
        Some("real") => real::measure(&arguments[1..]),
        Some("weights") => weights::train(),
        Some("figures") => figures::draw(),
        Some("example") => example::render_pair(),
        _ => Err(miette!("{USAGE}")),
    }
}

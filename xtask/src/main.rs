//! The project's own chores: `cargo xtask ci|test|reference|accuracy|ablation|own|real|speed|weights|figures|example|web`.
#![allow(clippy::print_stdout, clippy::print_stderr)]

mod ablation;
mod accuracy;
mod chores;
mod example;
mod figures;
mod npy;
mod own;
mod real;
mod reference;
mod speed;
mod venv;
mod web;
mod weights;

use miette::{Result, miette};

const USAGE: &str = "usage: cargo xtask COMMAND
  ci                    formatting, clippy, docs, tests, and cargo-deny where it is installed
  test                  the tests
  reference [TOPIC...]  comparisons with independent implementations (needs Python)
  accuracy              scores the program on the fixed sets: docs/accuracy.md
  ablation              what each stage loses on the fixed sets: docs/ablation.md
  real [IMAGES]         the detector on real images labelled by hand (xtask/labels)
  own                   what training on one's own pairs buys: docs/own-images.md
  speed                 time and memory of `tiltline reconstruct` from 512 to 4096 px
  weights               trains the shipped networks again (hours; goes on where it was stopped)
  figures               draws the pictures of docs/simulator.md again
  example               renders the example pair in examples/ again
  web [--check|--test]  builds the report's page from web/; checks that the committed one is what it builds; tests it in Chromium";

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.first().map(String::as_str) {
        Some("ci") => chores::ci(),
        Some("test") => chores::test(),
        Some("reference") => reference::run(&arguments[1..]),
        Some("accuracy") => accuracy::measure(),
        Some("ablation") => ablation::measure(),
        Some("real") => real::measure(&arguments[1..]),
        Some("speed") => speed::measure(),
        Some("own") => own::measure(),
        Some("weights") => weights::train(),
        Some("figures") => figures::draw(),
        Some("web") => web::run(&arguments[1..]),
        Some("example") => example::render_pair(),
        _ => Err(miette!("{USAGE}")),
    }
}

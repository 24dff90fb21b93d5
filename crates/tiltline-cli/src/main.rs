//! The command `tiltline`: flags in, results and messages out. All science is in the library.
#![allow(clippy::print_stderr)]

mod args;
mod bench;
mod compared;
mod config;
mod dataset;
mod figures;
mod info;
mod interrupt;
mod method;
mod output;
mod progress;
mod quantity;
mod reconstruct;
mod report;
mod reproject;
mod score;
mod series;
mod simulate;
mod summary;
mod tomography;
mod train;
mod view;

use std::process::ExitCode;

use clap::{CommandFactory, Parser};
use miette::Result;

use crate::args::{Cli, Command};

fn main() -> ExitCode {
    match interrupt::install().and_then(|()| run(Cli::parse())) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error:?}");
            ExitCode::FAILURE
        }
    }
}

fn run(cli: Cli) -> Result<()> {
    match cli.command {
        Command::Reconstruct(flags) => reconstruct::run(&flags),
        Command::Reproject(flags) => reproject::run(&flags),
        Command::Simulate(flags) => simulate::run(&flags),
        Command::Score(flags) => score::run(&flags),
        Command::Bench(flags) => bench::run(&flags),
        Command::Dataset(flags) => dataset::run(&flags),
        Command::Train(flags) => train::run(&flags),
        Command::View(flags) => view::run(&flags),
        Command::Report(flags) => report::run(&flags),
        Command::Tomography(flags) => tomography::run(&flags),
        Command::Figures(flags) => figures::run(&flags),
        Command::Info(flags) => info::run(&flags),
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "tiltline", &mut script);
            output::print(&String::from_utf8_lossy(&script))
        }
    }
}

//! Draws the library's progress events: a bar on a terminal, plain lines when piped.

use std::io::IsTerminal;

use indicatif::{ProgressBar, ProgressStyle};
use tiltline::progress::{Event, Stage};

use crate::args::Verbosity;

/// Where progress is shown.
pub enum Display {
    /// `-q`.
    Nothing,
    /// A bar with the stage's name.
    Bar(ProgressBar),
    /// A line a stage, with its time if verbose.
    Lines {
        /// Whether to give times.
        verbose: bool,
    },
}

impl Display {
    /// The display that fits stderr and the flags.
    pub fn new(verbosity: Verbosity) -> Self {
        if verbosity.quiet {
            Display::Nothing
        } else if std::io::stderr().is_terminal() && !verbosity.verbose {
            let bar = ProgressBar::new(Stage::ALL.len() as u64);
            let style = ProgressStyle::with_template("{bar:24} {pos}/{len} {msg}");
            bar.set_style(style.expect("the template is valid"));
            Display::Bar(bar)
        } else {
            Display::Lines { verbose: verbosity.verbose }
        }
    }

    /// Shows an event.
    pub fn show(&self, event: &Event) {
        match (self, event) {
            (Display::Bar(bar), Event::Started(stage)) => bar.set_message(stage.word()),
            (Display::Bar(bar), Event::Finished(..)) => bar.inc(1),
            (Display::Lines { verbose: false }, Event::Started(stage)) => eprintln!("{stage}"),
            (Display::Lines { verbose: true }, Event::Finished(stage, seconds)) => {
                eprintln!("{stage:<12} {seconds:7.2} s")
            }
            (Display::Nothing | Display::Lines { .. }, _) => {}
        }
    }

    /// Takes the bar off the screen.
    pub fn clear(&self) {
        if let Display::Bar(bar) = self {
            bar.finish_and_clear();
        }
    }
}

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
            (_, Event::Advanced(..)) | (Display::Nothing | Display::Lines { .. }, _) => {}
        }
    }

    /// Takes the bar off the screen.
    pub fn clear(&self) {
        if let Display::Bar(bar) = self {
            bar.finish_and_clear();
        }
    }
}

/// Progress of work on a number of like things.
pub struct Count {
    what: &'static str,
    bar: Option<ProgressBar>,
    lines: bool,
}

impl Count {
    /// A bar on a terminal, lines when piped and verbose, nothing when quiet.
    pub fn new(what: &'static str, verbosity: Verbosity) -> Self {
        let terminal = std::io::stderr().is_terminal() && !verbosity.quiet;
        let bar = terminal.then(|| {
            let style = ProgressStyle::with_template("{msg} {bar:24} {pos}/{len} {eta}");
            ProgressBar::new(0).with_message(what).with_style(style.expect("the template is valid"))
        });
        Self { what, bar, lines: verbosity.verbose && !terminal }
    }

    /// Shows how far the work has come.
    pub fn show(&self, done: usize, of: usize) {
        if let Some(bar) = &self.bar {
            bar.set_length(of as u64);
            bar.set_position(done as u64);
        } else if self.lines {
            eprintln!("{} {done}/{of}", self.what);
        }
    }

    /// Takes the bar off the screen.
    pub fn clear(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

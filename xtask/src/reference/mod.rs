//! Comparisons with independent implementations: `cargo xtask reference [TOPIC...]`, one file a topic.

mod formats;
mod nets;
mod readers;
mod sgbm;
mod sgbm_sets;
mod sift;
mod tomography;
mod trace;

use miette::{Result, miette};

use crate::venv::Venv;

/// A topic's name and what it runs.
type Topic = (&'static str, fn(&Venv) -> Result<()>);

const TOPICS: &[Topic] = &[
    ("formats", formats::run),
    ("nets", nets::run),
    ("readers", readers::run),
    ("sgbm", sgbm::run),
    ("sgbm-sets", sgbm_sets::run),
    ("sift", sift::run),
    ("tomography", tomography::run),
    ("trace", trace::run),
];

/// Runs the named topics, or all.
pub fn run(names: &[String]) -> Result<()> {
    if let Some(unknown) = names.iter().find(|name| TOPICS.iter().all(|(topic, _)| topic != name)) {
        let known: Vec<&str> = TOPICS.iter().map(|(topic, _)| *topic).collect();
        return Err(miette!("no topic {unknown}; there are: {}", known.join(", ")));
    }
    let venv = Venv::ready()?;
    for (topic, run) in TOPICS {
        if names.is_empty() || names.iter().any(|name| name == topic) {
            println!("== {topic}");
            run(&venv)?;
        }
    }
    Ok(())
}

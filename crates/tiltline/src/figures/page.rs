//! The page about the tables and figures: Markdown, in the order of the paper.

use std::fmt::Write;

/// First line of the page.
pub const TITLE: &str = "# The paper's tables and figures on this project's benchmark";

/// A table or figure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Section {
    /// For example `Figure 9`.
    pub heading: String,
    /// What is shown, of which data, made how.
    pub caption: String,
    /// The table, or a reference to the picture; both for some.
    pub body: String,
}

/// What all sections have in common.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Provenance {
    /// Version of the program.
    pub version: String,
    /// Names of detector and matcher, with the hashes of their weights.
    pub method: [String; 2],
    /// Sets: name, seed and hash of the data.
    pub sets: Vec<(String, Option<u64>, String)>,
}

/// A reference to a picture beside the page.
pub fn picture(name: &str, words: &str) -> String {
    format!("![{words}]({name}.png)\n")
}

/// The page.
pub fn write(provenance: &Provenance, notes: &str, sections: &[Section]) -> String {
    let Provenance { version, method: [detector, matcher], sets } = provenance;
    let mut page = format!(
        "{TITLE}\n\n\
         Made by `tiltline figures` (version {version}; {detector} detector, {matcher} matcher, default settings) from the sets below, whose \
         images are simulated and whose truth is exact; nothing is trained on the sets that are scored. Figures 1 to 3 of the paper are schematic. \
         Figures in square brackets are the paper's own, of its own images and hand labels: they show what was expected, and cannot be \
         compared to the last digit. In round brackets: 95 percent intervals over images (bootstrap, seed 1). Scores are those of \
         [truth.md](../truth.md).\n\n{notes}\n| set | seed | SHA-256 |\n|---|---|---|\n"
    );
    for (name, seed, hash) in sets {
        let seed = seed.map_or("-".into(), |seed| seed.to_string());
        let _ = writeln!(page, "| `{name}` | {seed} | `{}` |", hash.get(..16).unwrap_or(hash));
    }
    for Section { heading, caption, body } in sections {
        let caption = if caption.is_empty() { String::new() } else { format!("{caption}\n\n") };
        let _ = write!(page, "\n## {heading}\n\n{caption}{}\n", body.trim_end());
    }
    page
}

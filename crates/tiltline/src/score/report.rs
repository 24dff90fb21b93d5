//! Reports of scores: JSON for programs, Markdown for people.
//!
//! A figure without its protocol, seed, data version and weights is not a figure, so a report carries them; what is not known
//! is called unknown.

use std::fmt::Write;

use serde::{Deserialize, Serialize};

use crate::score::summary::Figures;
use crate::score::{Calibration, Group, GroupScore, PairScore, ScoreSettings, Summary};

/// Where figures come from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Name of the data set.
    pub dataset: Option<String>,
    /// Its version.
    pub dataset_version: Option<String>,
    /// Its seed.
    pub dataset_seed: Option<u64>,
    /// How the result was made: detector, matcher, settings that differ from the defaults.
    pub method: Option<String>,
    /// SHA-256 of the weights; none where no network took part.
    pub weights_sha256: Option<String>,
    /// Version of the program.
    pub program: Option<String>,
}

/// Which protocols a report shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Protocol {
    /// The paper's, with calibration.
    Paper,
    /// End to end.
    EndToEnd,
    /// Both.
    #[default]
    Both,
}

/// Scores of a result on a set of pairs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Where the figures come from.
    pub provenance: Provenance,
    /// Tolerances and bootstrap.
    pub settings: ScoreSettings,
    /// Pooled scores.
    pub summary: Summary,
    /// Scores of each pair.
    pub pairs: Vec<PairScore>,
}

impl Report {
    /// A report on scored pairs.
    pub fn new(provenance: Provenance, settings: ScoreSettings, pairs: Vec<PairScore>) -> Self {
        let summary = Summary::new(&pairs, &settings);
        Self { provenance, settings, summary, pairs }
    }

    /// All of it as JSON.
    pub fn to_json(&self) -> String {
        serde_json::to_string_pretty(self).expect("scores are plain numbers and strings")
    }

    /// The pooled scores as Markdown, with one line for each pair if there are not many.
    pub fn to_markdown(&self, protocol: Protocol) -> String {
        let mut text = String::new();
        self.write_markdown(&mut text, protocol).expect("a String takes everything");
        text
    }

    fn write_markdown(&self, text: &mut String, protocol: Protocol) -> std::fmt::Result {
        let Provenance { dataset, dataset_version, dataset_seed, method, weights_sha256, program } = &self.provenance;
        let known = |value: &Option<String>| value.clone().unwrap_or_else(|| "unknown".into());
        writeln!(text, "# Scores\n")?;
        writeln!(
            text,
            "Data: {} (version {}, seed {}). Method: {}. Weights: {}. Program: {}. {} pairs. Pooled by length; in brackets the \
             95 percent interval over pairs ({} bootstrap samples, seed {}).\n",
            known(dataset),
            known(dataset_version),
            dataset_seed.map_or("unknown".into(), |seed| seed.to_string()),
            known(method),
            weights_sha256.clone().unwrap_or_else(|| "none".into()),
            known(program),
            self.pairs.len(),
            self.settings.bootstrap_samples,
            self.settings.bootstrap_seed,
        )?;
        let groups: Vec<&GroupScore> =
            std::iter::once(&self.summary.all).chain(&self.summary.by_angle).chain(&self.summary.by_family).collect();
        if protocol != Protocol::EndToEnd {
            writeln!(text, "## Paper protocol\n")?;
            writeln!(
                text,
                "True left line visible in both views, input px, no free offset; without a prediction is bad.\n"
            )?;
            table(text, &groups, |name| PAPER.contains(&name))?;
            calibration_table(text, &self.summary.all.calibration)?;
        }
        if protocol != Protocol::Paper {
            let (across, disparity) = (self.settings.across_tolerance_px, self.settings.disparity_tolerance_px);
            writeln!(text, "## End to end\n")?;
            writeln!(
                text,
                "Curves in 3D, within {across} px across the line and {disparity} px of disparity, one depth offset per pair \
                 removed; one-to-one, weighted by length.\n"
            )?;
            table(text, &groups, |name| !PAPER.contains(&name))?;
            self.write_contrast(text)?;
        }
        let Summary { by_family_and_angle, by_kind, .. } = &self.summary;
        rows(text, "By family and angle", by_family_and_angle)?;
        rows(text, "By kind", by_kind)?;
        self.write_pairs(text)
    }

    /// What the shift of contrast from the core costs: means over the pairs that know both.
    fn write_contrast(&self, text: &mut String) -> std::fmt::Result {
        let both: Vec<_> = self.pairs.iter().filter_map(|pair| pair.end_to_end.on_contrast).collect();
        if both.is_empty() {
            return Ok(());
        }
        let count = both.len() as f64;
        let completeness = both.iter().map(|score| score.completeness).sum::<f64>() / count;
        let f_score = both.iter().map(|score| score.f_score).sum::<f64>() / count;
        let apart: Vec<f64> = both.iter().filter_map(|score| Some(score.core_to_contrast_px?.mean)).collect();
        let apart = apart.iter().sum::<f64>() / apart.len().max(1) as f64;
        writeln!(
            text,
            "Against the centres of contrast instead of the cores (mean of {} pairs): completeness {completeness:.3}, F-score \
             {f_score:.3}; contrast lies {apart:.2} px off the core on average.\n",
            both.len()
        )
    }

    fn write_pairs(&self, text: &mut String) -> std::fmt::Result {
        const MOST: usize = 40;
        writeln!(text, "## Pairs\n")?;
        if self.pairs.len() > MOST {
            return writeln!(text, "{} pairs; each is in the JSON report.", self.pairs.len());
        }
        writeln!(text, "| pair | phi, deg | coverage | EPE, px | bad-3, % | completeness | correctness | F-score |")?;
        writeln!(text, "|---|---|---|---|---|---|---|---|")?;
        let number = |value: Option<f64>, digits: usize| value.map_or("-".into(), |value| format!("{value:.digits$}"));
        for pair in &self.pairs {
            let (paper, end) = (&pair.paper, &pair.end_to_end);
            writeln!(
                text,
                "| {} | {} | {:.3} | {} | {:.1} | {:.3} | {} | {:.3} |",
                pair.name.replace('|', "\\|"),
                number(pair.phi_deg, 2),
                paper.coverage,
                number(paper.epe_px, 2),
                paper.bad_3_percent,
                end.completeness,
                number(end.correctness, 3),
                end.f_score,
            )?;
        }
        let notes: Vec<String> =
            self.pairs.iter().flat_map(|pair| pair.notes.iter().map(|note| format!("{}: {note}", pair.name))).collect();
        if !notes.is_empty() {
            writeln!(text, "\nNotes:\n")?;
        }
        notes.iter().try_for_each(|note| writeln!(text, "- {note}"))
    }
}

/// The figures of the paper's protocol; all others are end to end.
const PAPER: [&str; 8] = [
    "coverage",
    "epe_px",
    "bad_1_percent",
    "bad_3_percent",
    "bad_5_percent",
    "depth_error_px",
    "within_1_sigma",
    "within_2_sigma",
];

/// One row a figure, one column a group.
fn table(text: &mut String, groups: &[&GroupScore], shown: impl Fn(&str) -> bool) -> std::fmt::Result {
    write!(text, "| |")?;
    for score in groups {
        let group = &score.group;
        let title = match (group.phi_deg, &group.family) {
            (Some(phi), _) => format!("{phi} deg"),
            (None, Some(family)) => family.clone(),
            (None, None) => "all".into(),
        };
        write!(text, " {title} ({}) |", score.images)?;
    }
    writeln!(text, "\n|---|{}", "---|".repeat(groups.len()))?;
    for (index, (name, title)) in Figures::NAMES.iter().enumerate().filter(|(_, (name, _))| shown(name)) {
        // Shares are near 1 and want a digit more.
        let digits = if name.ends_with("percent") {
            1
        } else if name.contains("px") {
            2
        } else {
            3
        };
        write!(text, "| {title} |")?;
        for score in groups {
            match score.figures.values()[index] {
                None => write!(text, " - |")?,
                Some(estimate) => {
                    write!(text, " {:.digits$}", estimate.value)?;
                    if let Some([low, high]) = estimate.interval_95 {
                        write!(text, " ({low:.digits$} to {high:.digits$})")?;
                    }
                    write!(text, " |")?;
                }
            }
        }
        writeln!(text)?;
    }
    writeln!(text)
}

/// The main figures, one row a group; for groups that are too many for columns.
fn rows(text: &mut String, title: &str, groups: &[GroupScore]) -> std::fmt::Result {
    if groups.is_empty() {
        return Ok(());
    }
    writeln!(text, "## {title}\n")?;
    writeln!(
        text,
        "| group | pairs | coverage | EPE, px | bad-1, % | bad-3, % | bad-5, % | depth error, px | completeness | correctness | F-score | \
         clDice |\n|---|---|---|---|---|---|---|---|---|---|---|---|"
    )?;
    for score in groups {
        let Group { phi_deg, family, kind } = &score.group;
        let names = [family.clone(), kind.clone(), phi_deg.map(|phi| format!("{phi} deg"))];
        let name = names.into_iter().flatten().collect::<Vec<_>>().join(", ");
        write!(text, "| {name} | {} |", score.images)?;
        let figures = &score.figures;
        let shown = [
            (figures.coverage, 3),
            (figures.epe_px, 2),
            (figures.bad_1_percent, 1),
            (figures.bad_3_percent, 1),
            (figures.bad_5_percent, 1),
            (figures.depth_error_px, 1),
            (figures.completeness, 3),
            (figures.correctness, 3),
            (figures.f_score, 3),
            (figures.cl_dice, 3),
        ];
        for (estimate, digits) in shown {
            match estimate {
                Some(estimate) => write!(text, " {:.digits$} |", estimate.value)?,
                None => write!(text, " - |")?,
            }
        }
        writeln!(text)?;
    }
    writeln!(text)
}

fn calibration_table(text: &mut String, calibration: &Calibration) -> std::fmt::Result {
    let Some(median) = calibration.median_sigma_px else { return Ok(()) };
    writeln!(text, "Calibration: median sigma {median:.2} px; 0.683 and 0.954 are due within 1 and 2 sigma.\n")?;
    writeln!(text, "| sigma, px (tenths of the line) | rms error, px | median error, px |\n|---|---|---|")?;
    for decile in &calibration.deciles {
        writeln!(text, "| {:.3} | {:.3} | {:.3} |", decile.sigma_px, decile.rms_error_px, decile.median_error_px)?;
    }
    writeln!(text)?;
    if !calibration.by_flag.is_empty() {
        writeln!(text, "| flag | length, px | within 1 sigma | within 2 sigma |\n|---|---|---|---|")?;
        for flag in &calibration.by_flag {
            let (length, within) = (flag.length_px, [flag.within_1_sigma, flag.within_2_sigma]);
            writeln!(text, "| {} | {length:.0} | {:.3} | {:.3} |", flag.flag.word(), within[0], within[1])?;
        }
        writeln!(text)?;
    }
    Ok(())
}

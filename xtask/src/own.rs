//! docs/own-images.md: what a user's own pairs buy, shown on a simulated microscope with settings that the networks never saw.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use miette::{IntoDiagnostic, Result, miette};

use crate::ablation::{read, row, titles};
use crate::speed::built;
use crate::venv::root;
use crate::weights::done;

const INTRODUCTION: &str = "# Training on one's own images

Made by `cargo xtask own`: a simulated microscope whose settings the networks never saw (`xtask/own/microscope.toml`: bright lines on strong texture, blurred, few
electrons; family `gan`, drawn, 512 px, 8 degrees), from which a user has 1, 3 or 10 labelled pairs (seed 306, the fifth that was tried: of others some
pairs cannot be rectified; each number contains the lower one), or ten with masks of the lines and no disparities. Scores on 12
other pairs (seed 302), end to end as in [accuracy.md](accuracy.md).

";

/// What the figures show; written by hand, to be checked whenever they change.
const FINDINGS: &str = include_str!("own_findings.md");

/// Labelled pairs that are tried, and the foils of a data set of which so many are for training.
const PAIRS: [(&str, &str); 3] = [("1", "1"), ("3", "3"), ("10", "13")];
/// Seeds of the user's pairs (all of them can be rectified) and of the others.
const SEEDS: [&str; 2] = ["306", "302"];
const LOOKED_AT: &str = "12";
/// Steps of a detector and of a matcher.
const STEPS: [&str; 2] = ["200", "150"];

/// Runs everything in `target/own` (what is there is taken up) and writes the page.
pub fn measure() -> Result<()> {
    let program = built()?;
    let study = Study { program, folder: root().join("target/own") };
    std::fs::create_dir_all(&study.folder).into_diagnostic()?;
    for (pairs, foils) in PAIRS {
        study.simulate(&format!("mine-{pairs}"), foils, SEEDS[0])?;
    }
    study.simulate("others", LOOKED_AT, SEEDS[1])?;
    let mut page = format!("{INTRODUCTION}{FINDINGS}\n## Scores\n\n{}", titles("networks"));
    row(&mut page, "as shipped", &study.scores("shipped", &[])?)?;
    let mixed = ["--simulate", "mixed"];
    let mut detector = String::new();
    for (pairs, _) in PAIRS {
        let data = study.path(&format!("mine-{pairs}"));
        detector = study.train("detector", &format!("detector-{pairs}"), STEPS[0], &["shipped"], &data, &mixed)?;
        let words = format!("detector trained on {pairs}");
        row(&mut page, &words, &study.scores(&format!("detector-{pairs}"), &[&detector])?)?;
    }
    let data = study.path("mine-10");
    let matcher = study.train("matcher", "matcher-10", STEPS[1], &[&detector, "shipped"], &data, &mixed)?;
    row(&mut page, "detector and matcher trained on 10", &study.scores("both-10", &[&detector, &matcher])?)?;
    let warp = study.train("matcher", "warp", STEPS[1], &["shipped"], &data, &["--config", "xtask/own/warp.toml"])?;
    row(&mut page, "matcher trained on 10 with masks only (L_warp alone)", &study.scores("warp", &[&warp])?)?;
    std::fs::write(root().join("docs/own-images.md"), page).into_diagnostic()
}

struct Study {
    program: PathBuf,
    folder: PathBuf,
}

impl Study {
    fn path(&self, name: &str) -> String {
        self.folder.join(name).to_string_lossy().into_owned()
    }

    fn run(&self, arguments: &[&str]) -> Result<()> {
        let status = Command::new(&self.program).args(arguments).current_dir(root()).stdout(Stdio::null()).status();
        if status.into_diagnostic()?.success() {
            Ok(())
        } else {
            Err(miette!("tiltline {} failed", arguments.join(" ")))
        }
    }

    fn simulate(&self, name: &str, count: &str, seed: &str) -> Result<()> {
        let foils = ["simulate", "--family", "gan", "--mode", "parametric", "--tilts=-4,4", "--size", "512", "--quiet"];
        let of_microscope =
            ["--config", "xtask/own/microscope.toml", "--count", count, "--seed", seed, "-o", &self.path(name)];
        self.run(&[&foils[..], &of_microscope].concat())
    }

    /// The last weights of a training.
    fn train(&self, task: &str, name: &str, steps: &str, from: &[&str], data: &str, flags: &[&str]) -> Result<String> {
        let folder = self.path(name);
        let last = Path::new(&folder).join("last.safetensors").to_string_lossy().into_owned();
        if done(Path::new(&folder))? {
            return Ok(last);
        }
        if Path::new(&folder).join("train.toml").exists() {
            self.run(&["train", "--resume", &folder, "--quiet"])?;
            return Ok(last);
        }
        let from: Vec<&str> = from.iter().flat_map(|weights| ["--from", weights]).collect();
        let own = ["train", task, "--data", data, "--steps", steps, "--seed", "5", "--quiet", "-o", &folder];
        self.run(&[&own[..], &from, flags].concat())?;
        Ok(last)
    }

    fn scores(&self, name: &str, weights: &[&str]) -> Result<serde_json::Value> {
        let (results, scores) = (self.path(&format!("results-{name}")), self.path(&format!("scores-{name}")));
        let weights: Vec<&str> = weights.iter().flat_map(|weights| ["--weights", weights]).collect();
        self.run(&[&["bench", &self.path("others"), "--quiet", "-o", &results], &weights[..]].concat())?;
        if Path::new(&scores).exists() {
            std::fs::remove_dir_all(&scores).into_diagnostic()?;
        }
        self.run(&["score", &results, "-o", &scores])?;
        read(&Path::new(&scores).join("scores.json"))
    }
}

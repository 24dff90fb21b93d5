//! `tiltline info`: what is in a micrograph or series.

use miette::{IntoDiagnostic, Result, WrapErr, miette};

use crate::args::Info;

/// Describes each file; a file that cannot be read does not keep the others from being described.
pub fn run(flags: &Info) -> Result<()> {
    let mut failures = 0;
    let mut described = Vec::new();
    for file in &flags.files {
        match tiltline::io::info(file).into_diagnostic().wrap_err_with(|| format!("cannot read {file}")) {
            Ok(info) if flags.json => described.push(info),
            Ok(info) => println!("{info}"),
            Err(error) => {
                failures += 1;
                eprintln!("{error:?}");
            }
        }
    }
    if flags.json {
        println!("{}", serde_json::to_string_pretty(&described).into_diagnostic()?);
    }
    if failures > 0 {
        return Err(miette!("{failures} of {} files could not be read", flags.files.len()));
    }
    Ok(())
}

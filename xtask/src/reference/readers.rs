//! Readers against tifffile and mrcfile: the same files, the same pixels.

use miette::{IntoDiagnostic, Result, miette};
use serde_json::Value;
use tiltline::io::read_micrograph;

use crate::npy;
use crate::venv::Venv;

/// Makes files in several types, reads them with both, and prints a row for each.
pub fn run(venv: &Venv) -> Result<()> {
    let folder = venv.work.join("readers");
    if folder.exists() {
        std::fs::remove_dir_all(&folder).into_diagnostic()?;
    }
    std::fs::create_dir_all(&folder).into_diagnostic()?;
    let folder_text = folder.to_str().ok_or_else(|| miette!("{} is no UTF-8", folder.display()))?;
    let names: Vec<String> =
        serde_json::from_str(&venv.run("readers.py", &["make", folder_text])?).into_diagnostic()?;
    let mut pixel_sizes = Vec::new();
    for name in &names {
        let micrograph = read_micrograph(&format!("{folder_text}/{name}")).into_diagnostic()?;
        npy::write_f32(&folder.join(format!("{name}.npy")), &micrograph.pixels)?;
        pixel_sizes.push(micrograph.pixel_size_nm);
    }
    let results: Value = serde_json::from_str(&venv.run("readers.py", &["compare", folder_text])?).into_diagnostic()?;
    println!("{:<16} {:<9} {:>20} {:>12}", "file", "type", "largest difference", "nm/px");
    let mut differing = 0;
    for (name, pixel_size_nm) in names.iter().zip(pixel_sizes) {
        let difference = results[name]["difference"].as_f64().unwrap_or(f64::INFINITY);
        let kind = results[name]["type"].as_str().unwrap_or("?");
        let size = pixel_size_nm.map_or("unknown".to_owned(), |size| format!("{size:.4}"));
        println!("{name:<16} {kind:<9} {difference:>20} {size:>12}");
        differing += usize::from(difference != 0.0);
    }
    // Integers up to 2^24 are exact in float32, and doubles are rounded to it in one way only: nothing may differ.
    if differing > 0 { Err(miette!("{differing} of {} files differ", names.len())) } else { Ok(()) }
}

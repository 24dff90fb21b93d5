//! Files beside an image that say what its header does not: tilts in `.tlt`, `.rawtlt`, `.mdoc`; pixel size in `.mdoc`.
//!
//! In this order: `.tlt` holds the tilts after alignment, `.rawtlt` those of the goniometer, `.mdoc` what the microscope
//! noted, and the extended header the same. A file that does not fit (another number of tilts, damaged) is passed over
//! with a note.

use std::path::{Path, PathBuf};

use super::{Found, Header, mdoc, tilts};

/// Looks beside `path`, and puts what it finds into the header.
pub(super) fn look(path: &str, header: &mut Header) {
    let path = Path::new(path);
    let with_name_kept = path.file_name().map(|name| {
        let mut name = name.to_os_string();
        name.push(".mdoc");
        path.with_file_name(name)
    });
    let lists = [path.with_extension("tlt"), path.with_extension("rawtlt")];
    let documents: Vec<PathBuf> = with_name_kept.into_iter().chain([path.with_extension("mdoc")]).collect();
    let mut found = None;
    for file in lists.iter().chain(&documents).filter(|file| file.as_path() != path && file.is_file()) {
        let name = file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        if found.is_none() {
            match tilts::read_file(&file.to_string_lossy()) {
                Ok(values) if values.len() == header.pages => found = Some(Found::new(values, name)),
                Ok(values) => header.notes.push(format!(
                    "{name} beside it holds {} tilt(s) for {} page(s); it is not used",
                    values.len(),
                    header.pages
                )),
                Err(error) => header.notes.push(format!("the tilts beside it are not used: {error}")),
            }
        }
    }
    if found.is_some() {
        header.tilts_deg = found;
    }
    if header.pixel_size_nm.is_some() {
        return;
    }
    for file in documents.iter().filter(|file| file.is_file()) {
        let text = tilts::read_text(&file.to_string_lossy()).ok();
        if let Some(size) = text.and_then(|text| mdoc::parse(&text).ok()).and_then(|mdoc| mdoc.pixel_size_nm) {
            let name = file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            header.take_pixel_size(size, size, &name);
            return;
        }
    }
}

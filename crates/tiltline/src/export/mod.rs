//! Writers: one file a format, each with its specification named at its top; docs/formats.md describes what is in
//! them. [`write_all`] puts a whole result into a folder: everything or nothing.

pub mod csv;
pub mod graph;
pub mod json;
pub mod mrc;
pub mod mrc_volume;
pub mod number;
pub mod obj;
pub mod overlay;
pub mod paradis;
pub mod ply;
pub mod png;
pub mod reprojection;
mod staging;
pub mod swc;
pub mod tiff;
pub mod vtp;
pub mod xf;

use std::io::{self, Seek, Write};
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use crate::micrograph::View;
use crate::reconstruction::Reconstruction;
pub use staging::{ExportError, Staging, check_target};

/// What a writer writes to: some formats come back to their header at the end.
pub trait WriteSeek: Write + Seek {}
impl<W: Write + Seek> WriteSeek for W {}

/// Writes one file of a result.
pub type Writer = fn(&Reconstruction, &mut dyn WriteSeek) -> io::Result<()>;

/// Every file of a result and its writer; the slowest first, because they run side by side.
pub const WRITERS: [(&str, Writer); 15] = [
    ("overlay.png", |result, out| overlay::write(result, out)),
    ("rectified_left.tif", |result, out| tiff::write_rectified(result, View::Left, out)),
    ("rectified_right.tif", |result, out| tiff::write_rectified(result, View::Right, out)),
    ("lines_left.png", |result, out| png::write_lines(result, View::Left, out)),
    ("lines_right.png", |result, out| png::write_lines(result, View::Right, out)),
    ("disparity.tif", |result, out| tiff::write_disparity(result, out)),
    ("sigma.tif", |result, out| tiff::write_sigma(result, out)),
    ("curves.json", |result, out| json::write(result, out)),
    ("curves.vtp", |result, out| vtp::write(result, out)),
    ("curves.csv", |result, out| csv::write_curves(result, out)),
    ("curves.data", |result, out| paradis::write(result, out)),
    ("curves.ply", |result, out| ply::write(result, out)),
    ("curves.swc", |result, out| swc::write(result, out)),
    ("curves.obj", |result, out| obj::write(result, out)),
    ("lines.csv", |result, out| csv::write_lines(result, out)),
];

/// Writes every file of a result, and `extra` ones (name, content), into `folder`: all of them or none.
///
/// The files are first written beside the folder and then moved into place. A folder that holds anything is refused
/// unless `force`, which replaces files of the same name and leaves others alone. Returns the paths written.
pub fn write_all(
    reconstruction: &Reconstruction,
    extra: &[(&str, Vec<u8>)],
    folder: &Path,
    force: bool,
) -> Result<Vec<PathBuf>, ExportError> {
    let staging = Staging::begin(folder, force)?;
    let names = fill(reconstruction, extra, &staging)?;
    staging.commit(names.into_iter())
}

/// The first half of [`write_all`]: every file into the temporary folder. Returns their names for [`Staging::commit`],
/// the second half; a shell that must clean up when it is interrupted does the two itself and keeps [`Staging::path`].
pub fn fill<'a>(
    reconstruction: &Reconstruction,
    extra: &'a [(&str, Vec<u8>)],
    staging: &Staging,
) -> Result<Vec<&'a str>, ExportError> {
    WRITERS.par_iter().try_for_each(|(name, writer)| staging.write(name, |out| writer(reconstruction, out)))?;
    for (name, content) in extra {
        staging.write(name, |out| out.write_all(content))?;
    }
    // The extra files come last: a run record says that the rest is complete.
    Ok(WRITERS.iter().map(|(name, _)| *name).chain(extra.iter().map(|(name, _)| *name)).collect())
}

//! Everything or nothing: files are written to a temporary folder on the same file system and moved into place when all
//! are complete.
//!
//! A folder that does not exist yet appears by one rename. In a folder that exists each file is moved by a rename of
//! its own, which replaces an older file of that name.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::export::WriteSeek;
use crate::temporary;

/// How the names of temporary folders begin.
const PREFIX: &str = ".tiltline-";

/// Why a result could not be written.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The output folder holds something.
    #[error("the output folder {} is not empty (it holds {entry}); name another folder, or give --force to replace files of the same name", folder.display())]
    NotEmpty {
        /// The folder.
        folder: PathBuf,
        /// One of the things in it.
        entry: String,
    },
    /// The output folder is a file.
    #[error("the output folder {} is a file; name another folder", folder.display())]
    NotAFolder {
        /// The path.
        folder: PathBuf,
    },
    /// The folder that shall hold the output folder is not there.
    #[error("cannot make the output folder {}: {} is not an existing folder; make it first or name another", folder.display(), parent.display())]
    NoParent {
        /// The output folder.
        folder: PathBuf,
        /// Its parent.
        parent: PathBuf,
    },
    /// Nothing can be written there.
    #[error("cannot write to {}: {source}; check its permissions or name another output folder", folder.display())]
    NotWritable {
        /// The folder that cannot be written to.
        folder: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The file system is full.
    #[error("no space left for {}; free some, or name an output folder on another disk (nothing was kept)", path.display())]
    NoSpace {
        /// The file being written.
        path: PathBuf,
    },
    /// A file could not be written.
    #[error("cannot write {}: {source} (nothing was kept)", path.display())]
    Write {
        /// The file, as the user would find it.
        path: PathBuf,
        /// What went wrong.
        source: io::Error,
    },
    /// All files were complete, but one could not be moved to its place.
    #[error("cannot put {} in its place: {source}; {moved} files were replaced before it", path.display())]
    Move {
        /// The file or folder, as the user would find it.
        path: PathBuf,
        /// What went wrong.
        source: io::Error,
        /// Files that are in their place already; 0 unless the folder existed and was not empty.
        moved: usize,
    },
    /// The name of an extra file is a path.
    #[error("{name:?} is not the name of a file")]
    BadName {
        /// The name.
        name: String,
    },
}

/// Whether a result can be written to `folder`: call it before long work. Leaves nothing behind.
pub fn check_target(folder: &Path, force: bool) -> Result<(), ExportError> {
    Staging::begin(folder, force).map(drop)
}

/// What is at the output path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Target {
    Missing,
    Empty,
    Filled,
}

/// A temporary folder that becomes the output folder; removed when dropped before that.
#[derive(Debug)]
pub struct Staging {
    temporary: TempDir,
    folder: PathBuf,
    target: Target,
    /// Whether the temporary folder lies beside the output folder, not in it.
    beside: bool,
}

impl Staging {
    /// Checks the output folder and makes the temporary one: beside it, or in it where only that is possible.
    pub fn begin(folder: &Path, force: bool) -> Result<Self, ExportError> {
        let target = inspect(folder, force)?;
        let parent = parent_of(folder, target);
        let beside = match (target, &parent) {
            (Target::Missing, Some(parent)) => Some(temporary_in(parent)?),
            // A mounted folder may be writable while its parent is not.
            (Target::Empty, Some(parent)) => temporary_in(parent).ok(),
            // A folder that is replaced file by file must itself be writable.
            _ => None,
        };
        let (temporary, beside) = match beside {
            Some(temporary) => (temporary, true),
            None => (temporary_in(folder)?, false),
        };
        Ok(Self { temporary, folder: folder.to_owned(), target, beside })
    }

    /// The temporary folder: what to remove when the program is stopped by a signal, since nothing is dropped then.
    pub fn path(&self) -> &Path {
        self.temporary.path()
    }

    /// Writes one file to the temporary folder, to the disk.
    pub fn write(
        &self,
        name: &str,
        content: impl FnOnce(&mut dyn WriteSeek) -> io::Result<()>,
    ) -> Result<(), ExportError> {
        if Path::new(name).file_name() != Some(name.as_ref()) {
            return Err(ExportError::BadName { name: name.to_owned() });
        }
        let write = || {
            let mut file = BufWriter::with_capacity(1 << 16, File::create(self.path().join(name))?);
            content(&mut file)?;
            file.flush()?;
            // Some file systems say only now that they are full.
            file.get_ref().sync_all()
        };
        write().map_err(|source| {
            let path = self.folder.join(name);
            match source.kind() {
                io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => ExportError::NoSpace { path },
                _ => ExportError::Write { path, source },
            }
        })
    }

    /// Moves everything into place and returns the paths of `names`.
    pub fn commit<'a>(self, names: impl Iterator<Item = &'a str>) -> Result<Vec<PathBuf>, ExportError> {
        let names: Vec<&str> = names.collect();
        let written = names.iter().map(|name| self.folder.join(name)).collect();
        let renamed = match self.target {
            Target::Missing => {
                fs::rename(self.path(), &self.folder).map_err(|source| self.not_moved(&self.folder, source, 0))?;
                true
            }
            // Windows does not rename over an empty folder, nor does Linux over a mounted one: then file by file.
            Target::Empty => self.beside && fs::rename(self.path(), &self.folder).is_ok(),
            Target::Filled => false,
        };
        if renamed {
            // The temporary folder is the output folder now.
            let _ = self.temporary.keep();
            return Ok(written);
        }
        for (moved, name) in names.iter().enumerate() {
            let path = self.folder.join(name);
            if let Err(source) = replace(&self.path().join(name), &path) {
                // A folder that was empty is empty again; what was replaced by force is gone.
                let undo = self.target == Target::Empty;
                for name in names[..moved].iter().filter(|_| undo) {
                    let _ = fs::remove_file(self.folder.join(name));
                }
                return Err(self.not_moved(&path, source, if undo { 0 } else { moved }));
            }
        }
        Ok(written)
    }

    fn not_moved(&self, path: &Path, source: io::Error, moved: usize) -> ExportError {
        ExportError::Move { path: path.to_owned(), source, moved }
    }
}

fn inspect(folder: &Path, force: bool) -> Result<Target, ExportError> {
    let not_writable = |source| ExportError::NotWritable { folder: folder.to_owned(), source };
    match fs::metadata(folder) {
        Ok(metadata) if metadata.is_dir() => {
            let mut entries = fs::read_dir(folder).map_err(not_writable)?;
            match entries.next() {
                None => Ok(Target::Empty),
                Some(_) if force => Ok(Target::Filled),
                Some(entry) => {
                    let entry = entry.map_err(not_writable)?.file_name().to_string_lossy().into_owned();
                    Err(ExportError::NotEmpty { folder: folder.to_owned(), entry })
                }
            }
        }
        Ok(_) => Err(ExportError::NotAFolder { folder: folder.to_owned() }),
        // A link that leads nowhere.
        Err(error) if error.kind() == io::ErrorKind::NotFound && fs::symlink_metadata(folder).is_ok() => {
            Err(ExportError::NotAFolder { folder: folder.to_owned() })
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            let parent = parent_of(folder, Target::Missing).unwrap_or_default();
            if parent.is_dir() {
                Ok(Target::Missing)
            } else {
                Err(ExportError::NoParent { folder: folder.to_owned(), parent })
            }
        }
        Err(error) if error.kind() == io::ErrorKind::NotADirectory => {
            let parent = parent_of(folder, Target::Missing).unwrap_or_default();
            Err(ExportError::NoParent { folder: folder.to_owned(), parent })
        }
        Err(error) => Err(not_writable(error)),
    }
}

/// The folder above; of one that exists, after links and dots are resolved.
fn parent_of(folder: &Path, target: Target) -> Option<PathBuf> {
    if target == Target::Missing {
        let parent = folder.parent()?;
        return Some(if parent.as_os_str().is_empty() { PathBuf::from(".") } else { parent.to_owned() });
    }
    fs::canonicalize(folder).ok()?.parent().map(Path::to_owned)
}

fn temporary_in(folder: &Path) -> Result<TempDir, ExportError> {
    temporary::folder_in(folder, PREFIX)
        .map_err(|source| ExportError::NotWritable { folder: folder.to_owned(), source })
}

/// Moves a file over another; across file systems by way of a copy beside it.
fn replace(from: &Path, to: &Path) -> io::Result<()> {
    match fs::rename(from, to) {
        Err(error) if error.kind() == io::ErrorKind::CrossesDevices => {
            let mut copy = temporary::file_in(to.parent().unwrap_or(Path::new(".")), PREFIX)?;
            io::copy(&mut File::open(from)?, copy.as_file_mut())?;
            copy.persist(to).map_err(|error| error.error)?;
            Ok(())
        }
        moved => moved,
    }
}

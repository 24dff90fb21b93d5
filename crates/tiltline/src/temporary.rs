//! Files and folders that take their place when they are complete, with the permissions that others of the user have:
//! temporary ones are for their owner alone, and results are for a group. Public for `tiltline-nets`, which writes weights so.

use std::io;
use std::path::Path;

use tempfile::{Builder, NamedTempFile, TempDir};

/// A new file in a folder.
///
/// # Errors
/// Where it cannot be made.
pub fn file_in(folder: &Path, prefix: &str) -> io::Result<NamedTempFile> {
    let mut builder = Builder::new();
    // The system takes the user's mask away.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.prefix(prefix).tempfile_in(folder)
}

/// A new folder in a folder.
///
/// # Errors
/// Where it cannot be made.
pub fn folder_in(folder: &Path, prefix: &str) -> io::Result<TempDir> {
    let mut builder = Builder::new();
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o777));
    builder.prefix(prefix).tempdir_in(folder)
}

#[cfg(all(test, unix))]
mod tests {
    use std::fs;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn permissions_are_those_of_any_other_file() {
        let here = tempfile::tempdir().unwrap();
        let mode = |path: &std::path::Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
        let at = |name: &str| here.path().join(name);
        fs::write(at("file"), "").unwrap();
        fs::create_dir(at("folder")).unwrap();
        assert_eq!(mode(super::file_in(here.path(), ".t-").unwrap().path()), mode(&at("file")));
        assert_eq!(mode(super::folder_in(here.path(), ".t-").unwrap().path()), mode(&at("folder")));
    }
}

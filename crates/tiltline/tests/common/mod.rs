//! What several test files use: golden files, and truth for rendered pairs.
#![allow(dead_code, clippy::unwrap_used)] // clippy.toml allows it in tests, but does not see helpers as such

pub mod truth;

use std::path::Path;

/// Compares content with `tests/golden/NAME`; `UPDATE_GOLDEN=1` rewrites the file instead.
pub fn assert_golden(name: &str, content: &[u8]) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name);
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, content).unwrap();
        return;
    }
    let golden =
        std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}; UPDATE_GOLDEN=1 makes it", path.display()));
    if golden == content {
        return;
    }
    let (golden, content) = (String::from_utf8_lossy(&golden), String::from_utf8_lossy(content));
    for (number, (old, new)) in golden.lines().zip(content.lines()).enumerate() {
        assert_eq!(old, new, "{name}, line {}; UPDATE_GOLDEN=1 rewrites it", number + 1);
    }
    panic!("{name} has {} lines, not {}; UPDATE_GOLDEN=1 rewrites it", content.lines().count(), golden.lines().count());
}

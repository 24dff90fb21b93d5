//! Why a truth could not be read or used.

use std::path::PathBuf;

/// Why a truth could not be read or used; every message says what to change.
#[derive(Debug, thiserror::Error)]
pub enum TruthError {
    /// The file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not the JSON it should be.
    #[error("{}: {source} (the keys are listed in docs/truth.md)", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// Line, column and what was wrong there.
        source: serde_json::Error,
    },
    /// A file far larger than any truth.
    #[error("{}: {bytes} bytes; a truth file is at most {limit} bytes: is this the right file?", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Its size.
        bytes: u64,
        /// The limit.
        limit: u64,
    },
    /// Another version of the format.
    #[error("truth of version {found}, this program reads version {known}; use a newer program or make the set again")]
    Version {
        /// In the file.
        found: u32,
        /// [`super::TRUTH_VERSION`].
        known: u32,
    },
    /// A number that cannot be.
    #[error("{what} is {value}; it must be {expected}")]
    Value {
        /// What it is, with the place in the file.
        what: String,
        /// Its value.
        value: String,
        /// What it may be.
        expected: &'static str,
    },
    /// Lists that should be aligned have different lengths.
    #[error("curve '{label}' in {place}: {found} points, {expected} expected: lists of one curve are aligned by index")]
    Length {
        /// The curve.
        label: String,
        /// The list.
        place: String,
        /// Its length.
        found: usize,
        /// The length of the list it is aligned with.
        expected: usize,
    },
    /// One label for two curves.
    #[error(
        "label '{label}' is used by {count} curves in {place}; give each curve its own (in LabelMe, a label or group_id)"
    )]
    DuplicateLabel {
        /// The label.
        label: String,
        /// How often.
        count: usize,
        /// The list or file.
        place: String,
    },
    /// A view shows a curve that the truth does not have.
    #[error("view '{view}' has a curve '{label}' that is not in `curves`; add it there, with or without 3D points")]
    UnknownLabel {
        /// The view.
        view: String,
        /// The label.
        label: String,
    },
    /// A pair was asked for that is not there.
    #[error("views {left} and {right} do not make a pair: the truth has {count} views, numbered from 0")]
    NoPair {
        /// Left view.
        left: usize,
        /// Right view.
        right: usize,
        /// Number of views.
        count: usize,
    },
    /// The truth belongs to other images.
    #[error(
        "truth of '{view}' is {truth_width}x{truth_height} px and the image is {width}x{height} px; they must agree"
    )]
    ImageSize {
        /// The view.
        view: String,
        /// Columns in the truth.
        truth_width: usize,
        /// Rows in the truth.
        truth_height: usize,
        /// Columns of the image.
        width: usize,
        /// Rows of the image.
        height: usize,
    },
    /// Labels of left and right have nothing in common.
    #[error("no label is in both {} and {}; give the same line the same label in both", left.display(), right.display())]
    NothingInCommon {
        /// Left file.
        left: PathBuf,
        /// Right file.
        right: PathBuf,
    },
}

//! What can be wrong with a shape.

use std::fmt;

/// Why a shape was refused.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ShapeError {
    /// A size is zero: `(name, value)` of all sizes given.
    Zero(Vec<(&'static str, usize)>),
    /// Stride is neither 1 nor 2.
    Stride(usize),
    /// The array would have more elements than can be addressed.
    TooLarge(Vec<(&'static str, usize)>),
}

impl fmt::Display for ShapeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let list = |sizes: &[(&str, usize)]| {
            sizes.iter().map(|(name, value)| format!("{name} {value}")).collect::<Vec<_>>().join(", ")
        };
        match self {
            Self::Zero(sizes) => write!(f, "every size must be at least 1, but they are: {}", list(sizes)),
            Self::Stride(stride) => write!(f, "stride {stride} has no kernel; use 1 or 2"),
            Self::TooLarge(sizes) => {
                write!(f, "too many elements to address, make the crop or the batch smaller: {}", list(sizes))
            }
        }
    }
}

impl std::error::Error for ShapeError {}

/// Checks that no size is zero and that their product, with room for doubled sides and padding, can be addressed.
pub(crate) fn check(sizes: &[(&'static str, usize)]) -> Result<(), ShapeError> {
    if sizes.iter().any(|&(_, size)| size == 0) {
        return Err(ShapeError::Zero(sizes.to_vec()));
    }
    // Two sides at most double, each side may be padded by a few, an element has 4 bytes: 2^12 is ample.
    let elements = sizes.iter().try_fold(1usize << 12, |product, &(_, size)| product.checked_mul(size));
    match elements {
        Some(bytes) if bytes <= isize::MAX as usize => Ok(()),
        _ => Err(ShapeError::TooLarge(sizes.to_vec())),
    }
}

/// Panics if a slice has not the length its shape asks for. A wrong length is the caller's mistake, not a user's.
#[track_caller]
pub(crate) fn assert_len(what: &str, found: usize, expected: usize) {
    assert!(found == expected, "{what} has {found} elements, its shape asks for {expected}");
}

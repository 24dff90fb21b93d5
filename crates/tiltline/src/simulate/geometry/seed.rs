//! Seeds by split: what keeps the foils of training, validation and test apart.
//!
//! All views of one foil share one geometry, so sets are split by geometry, never by image. Each split owns a quarter of
//! the 64-bit seeds (its two highest bits), within which an index is mixed one-to-one. Two different (split, index)
//! therefore never share a seed.

use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

/// What a foil is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Split {
    /// Fitting weights.
    Train,
    /// Choosing between settings and weights.
    Val,
    /// Reporting: first test subset.
    TestA,
    /// Reporting: second test subset.
    TestB,
}

impl Split {
    /// Every split.
    pub const ALL: [Split; 4] = [Split::Train, Split::Val, Split::TestA, Split::TestB];

    /// The word used in files and flags.
    pub fn word(self) -> &'static str {
        match self {
            Split::Train => "train",
            Split::Val => "val",
            Split::TestA => "test-a",
            Split::TestB => "test-b",
        }
    }
}

/// Largest number of foils of one split: indices are below this.
pub const INDICES_PER_SPLIT: u64 = 1 << 62;

/// The seed of the foil with this index in a split. Distinct for every (split, index).
///
/// Indices wrap at [`INDICES_PER_SPLIT`]. A data set with a seed of its own can use
/// `index = (data_set_seed << 32) | foil_number`, with a data set seed below 2^30.
pub fn geometry_seed(split: Split, index: u64) -> u64 {
    let mask = INDICES_PER_SPLIT - 1;
    // Multiplication by an odd number and xor with the own high bits are both one-to-one on 62 bits. The constants are
    // those of splitmix64 (Steele, Lea, Flood 2014).
    let mut mixed = index & mask;
    for odd in [0xbf58_476d_1ce4_e5b9_u64, 0x94d0_49bb_1331_11eb] {
        mixed ^= mixed >> 31;
        mixed = mixed.wrapping_mul(odd) & mask;
    }
    mixed ^= mixed >> 31;
    ((split as u64) << 62) | mixed
}

/// The generator of random numbers of that foil.
pub fn geometry_rng(split: Split, index: u64) -> Pcg64 {
    rand::SeedableRng::seed_from_u64(geometry_seed(split, index))
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn no_two_foils_share_a_seed() {
        let seeds: HashSet<u64> =
            Split::ALL.iter().flat_map(|&split| (0..5000).map(move |index| geometry_seed(split, index))).collect();
        assert_eq!(seeds.len(), 4 * 5000);
    }

    #[test]
    fn a_split_owns_its_two_highest_bits() {
        for (tag, split) in Split::ALL.into_iter().enumerate() {
            for index in [0, 1, 77, 1 << 40, INDICES_PER_SPLIT - 1] {
                assert_eq!(geometry_seed(split, index) >> 62, tag as u64);
            }
        }
    }
}

//! From a line map to a skeleton: hysteresis threshold and topology-preserving thinning.
//!
//! Hysteresis after Canny (PAMI 1986). Thinning removes simple points (Yokoi's connectivity number is 1: Yokoi,
//! Toriwaki and Fukumura, CGIP 1975) from the four sides in turn, so that the skeleton is 8-connected, one pixel wide,
//! in the middle, and has the components and holes of the mask. Masks are `[row, column]`; outside is background.

use ndarray::Array2;

/// The eight neighbours (down, right), counter-clockwise from the right.
pub(super) const NEIGHBOURS: [(isize, isize); 8] =
    [(0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0), (1, 1)];

/// Whether a pixel is set; `false` outside.
pub(super) fn is_set(mask: &Array2<bool>, row: isize, column: isize) -> bool {
    row >= 0 && column >= 0 && mask.get([row as usize, column as usize]).copied().unwrap_or(false)
}

/// Pixels of at least `low` that are 8-connected, through such pixels, to one of at least `high`.
pub fn hysteresis(probability: &Array2<f32>, low: f32, high: f32) -> Array2<bool> {
    let mut mask = Array2::from_elem(probability.dim(), false);
    let mut open: Vec<[usize; 2]> = Vec::new();
    for ((row, column), value) in probability.indexed_iter() {
        if *value >= high {
            mask[[row, column]] = true;
            open.push([row, column]);
        }
    }
    while let Some([row, column]) = open.pop() {
        for (down, right) in NEIGHBOURS {
            let (Some(row), Some(column)) = (row.checked_add_signed(down), column.checked_add_signed(right)) else {
                continue;
            };
            if probability.get([row, column]).is_some_and(|value| *value >= low) && !mask[[row, column]] {
                mask[[row, column]] = true;
                open.push([row, column]);
            }
        }
    }
    mask
}

/// Fills holes (4-connected background not connected to the outside) of at most `largest` pixels: thinning would turn
/// each into a loop.
pub fn fill_small_holes(mask: &mut Array2<bool>, largest: usize) {
    let (height, width) = mask.dim();
    let mut seen = mask.clone();
    for start_row in 0..height {
        for start_column in 0..width {
            if seen[[start_row, start_column]] {
                continue;
            }
            seen[[start_row, start_column]] = true;
            let mut region = vec![[start_row, start_column]];
            let (mut next, mut outside) = (0, false);
            while next < region.len() {
                let [row, column] = region[next];
                next += 1;
                outside |= row == 0 || column == 0 || row + 1 == height || column + 1 == width;
                for (down, right) in NEIGHBOURS.into_iter().step_by(2) {
                    let at = (row.checked_add_signed(down), column.checked_add_signed(right));
                    if let (Some(row), Some(column)) = at
                        && seen.get([row, column]) == Some(&false)
                    {
                        seen[[row, column]] = true;
                        region.push([row, column]);
                    }
                }
            }
            if !outside && region.len() <= largest {
                for at in region {
                    mask[at] = true;
                }
            }
        }
    }
}

/// The neighbours of a pixel as bits, in the order of [`NEIGHBOURS`].
fn neighbourhood(mask: &Array2<bool>, row: isize, column: isize) -> u8 {
    NEIGHBOURS
        .iter()
        .enumerate()
        .fold(0, |bits, (bit, (down, right))| bits | u8::from(is_set(mask, row + down, column + right)) << bit)
}

/// Whether removing a pixel with these neighbours keeps components (8-connected) and holes (4-connected).
fn is_simple(bits: u8) -> bool {
    let clear = |index: usize| i32::from(bits >> (index % 8) & 1 == 0);
    let number: i32 = [0, 2, 4, 6].iter().map(|&k| clear(k) - clear(k) * clear(k + 1) * clear(k + 2)).sum();
    number == 1
}

/// The skeleton of a mask: 8-connected, one pixel wide, with the same components and holes.
pub fn thin(mask: &Array2<bool>) -> Array2<bool> {
    let simple: Vec<bool> = (0..=255).map(is_simple).collect();
    let mut skeleton = mask.clone();
    let mut pixels: Vec<[usize; 2]> =
        mask.indexed_iter().filter(|(_, set)| **set).map(|((row, column), _)| [row, column]).collect();
    let removable = |skeleton: &Array2<bool>, [row, column]: [usize; 2]| {
        let bits = neighbourhood(skeleton, row as isize, column as isize);
        bits.count_ones() > 1 && simple[usize::from(bits)]
    };
    loop {
        let before = pixels.len();
        // Opposite sides follow each other, which keeps the skeleton in the middle.
        for (down, right) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
            let side: Vec<[usize; 2]> = pixels
                .iter()
                .copied()
                .filter(|at| !is_set(&skeleton, at[0] as isize + down, at[1] as isize + right))
                .filter(|at| removable(&skeleton, *at))
                .collect();
            // Chosen together, removed one by one: a pixel whose neighbour has just gone may have to stay.
            for at in side {
                if removable(&skeleton, at) {
                    skeleton[at] = false;
                }
            }
            pixels.retain(|at| skeleton[*at]);
        }
        if pixels.len() == before {
            return skeleton;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::filter::gaussian_blur;
    use rand::{RngExt, SeedableRng};

    /// Number of regions of `value`, 8-connected or 4-connected.
    fn regions(mask: &Array2<bool>, value: bool, step: usize) -> usize {
        // A frame of background joins all that is outside.
        let (height, width) = mask.dim();
        let framed = Array2::from_shape_fn((height + 2, width + 2), |(row, column)| {
            is_set(mask, row as isize - 1, column as isize - 1) == value
        });
        let mut left = framed;
        let mut count = 0;
        while let Some(start) = left.indexed_iter().find(|(_, set)| **set).map(|(at, _)| at) {
            count += 1;
            let mut open = vec![start];
            left[start] = false;
            while let Some((row, column)) = open.pop() {
                for (down, right) in NEIGHBOURS.into_iter().step_by(step) {
                    let (row, column) = (row as isize + down, column as isize + right);
                    if is_set(&left, row, column) {
                        left[[row as usize, column as usize]] = false;
                        open.push((row as usize, column as usize));
                    }
                }
            }
        }
        count
    }

    #[test]
    fn thinning_keeps_components_and_holes_of_random_blobs_and_leaves_one_pixel() {
        for seed in 0..12 {
            let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
            let noise = Array2::from_shape_simple_fn((60, 70), || rng.random_range(-1.0..1.0_f32));
            let mask = gaussian_blur(&noise, 0.5 + 0.2 * seed as f64).mapv(|value| value > 0.0);
            let skeleton = thin(&mask);
            assert_eq!(regions(&mask, true, 1), regions(&skeleton, true, 1), "components, seed {seed}");
            assert_eq!(regions(&mask, false, 2), regions(&skeleton, false, 2), "holes, seed {seed}");
            assert!(skeleton.iter().zip(&mask).all(|(thin, thick)| !thin || *thick));
            assert_eq!(thin(&skeleton), skeleton, "thinning twice changes nothing");
            for ((row, column), _) in skeleton.indexed_iter().filter(|(_, set)| **set) {
                let bits = neighbourhood(&skeleton, row as isize, column as isize);
                assert!(bits.count_ones() <= 1 || !is_simple(bits), "a pixel could still go");
            }
        }
    }

    #[test]
    fn a_bar_becomes_its_middle_row() {
        let mask = Array2::from_shape_fn((20, 40), |(row, column)| (8..13).contains(&row) && (5..35).contains(&column));
        let skeleton = thin(&mask);
        for column in 10..30 {
            assert!(skeleton[[10, column]]);
            assert_eq!(skeleton.column(column).iter().filter(|set| **set).count(), 1);
        }
    }

    #[test]
    fn hysteresis_keeps_weak_pixels_only_beside_strong_ones() {
        let mut map = Array2::zeros((5, 9));
        for (column, value) in [0.3, 0.6, 0.3, 0.3, 0.0, 0.3, 0.3, 0.0, 0.5].into_iter().enumerate() {
            map[[2, column]] = value;
        }
        let row: Vec<bool> = hysteresis(&map, 0.25, 0.5).row(2).to_vec();
        assert_eq!(row, [true, true, true, true, false, false, false, false, true]);
    }

    #[test]
    fn small_holes_are_filled_and_large_ones_stay() {
        let large = |row: usize, column: usize| (4..8).contains(&row) && (8..14).contains(&column);
        let mut mask = Array2::from_shape_fn((12, 20), |(row, column)| !large(row, column));
        mask[[3, 3]] = false;
        mask[[0, 0]] = false;
        fill_small_holes(&mut mask, 6);
        assert!(mask[[3, 3]] && !mask[[5, 9]] && !mask[[0, 0]]);
    }
}

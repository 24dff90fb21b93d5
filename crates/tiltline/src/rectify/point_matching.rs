//! Matches SIFT features of two images: nearest descriptor with a ratio test (Lowe 2004, section 7.1), both ways.
//!
//! Only features of like kind are compared: both dark or both bright, and of like size, because the two micrographs of
//! a pair have about the same magnification. That is two thirds of the work saved, and fewer false matches.

use std::collections::HashSet;

use rayon::prelude::*;

use super::descriptor::LENGTH;
use super::sift::Feature;
use crate::geometry::Point2;

/// A point of the left image and the point of the right image that looks like it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointMatch {
    /// In left input px.
    pub left: Point2,
    /// In right input px.
    pub right: Point2,
}

impl PointMatch {
    /// Both places as keys: a place is the same only if all its bits are.
    pub(super) fn places(&self) -> [[u64; 2]; 2] {
        [self.left, self.right].map(|point| [point.x.to_bits(), point.y.to_bits()])
    }
}

/// Nearest descriptor must be this much nearer than the second nearest (Lowe, figure 11).
pub const RATIO: f32 = 0.8;
/// Largest ratio of sizes of two features that are compared.
const SIZE_RATIO: f32 = 1.8;
/// Descriptors are stored as whole numbers of 1/1024: products of 16-bit numbers are summed fastest.
const QUANTUM: f32 = 1024.0;
/// Right features that are compared with one left feature before the next: they stay in the first-level cache.
const BLOCK: usize = 64;

/// Nearest features of the other image that are remembered for each.
const REMEMBERED: usize = 5;

type Quantised = [i16; LENGTH];

/// The largest products of descriptors met so far, descending, with the index they were met at.
#[derive(Clone, Copy)]
struct Best([(i32, u32); REMEMBERED]);

impl Best {
    const NONE: Self = Self([(-1, u32::MAX); REMEMBERED]);

    fn meet(&mut self, product: i32, index: u32) {
        if product > self.0[REMEMBERED - 1].0 {
            let place = self.0.iter().position(|&(other, _)| product > other).unwrap_or(REMEMBERED - 1);
            self.0.copy_within(place..REMEMBERED - 1, place + 1);
            self.0[place] = (product, index);
        }
    }

    /// The nearest, if its distance is below [`RATIO`] of the second's. Squared distances are `2 - 2 product`.
    fn distinct(&self) -> Option<usize> {
        let [(best, index), (second, _), ..] = self.0;
        let distance2 = |product: i32| (2.0 - 2.0 * product as f32 / (QUANTUM * QUANTUM)).max(0.0);
        // Without a second the best has proved nothing.
        (second >= 0 && distance2(best) < RATIO * RATIO * distance2(second)).then_some(index as usize)
    }

    fn all(&self) -> impl Iterator<Item = (i32, usize)> {
        self.0.into_iter().filter(|(product, _)| *product >= 0).map(|(product, index)| (product, index as usize))
    }
}

/// One kind of features (dark or bright) in order of size.
struct Kind {
    features: Vec<usize>,
    sizes: Vec<f32>,
    descriptors: Vec<Quantised>,
}

impl Kind {
    fn new(features: &[Feature], dark: bool) -> Self {
        let mut order: Vec<usize> = (0..features.len()).filter(|&i| (features[i].contrast > 0.0) == dark).collect();
        order.sort_by(|&a, &b| features[a].sigma_px.total_cmp(&features[b].sigma_px));
        let sizes = order.iter().map(|&i| features[i].sigma_px).collect();
        let descriptors =
            order.iter().map(|&i| features[i].descriptor.map(|value| (value * QUANTUM).round() as i16)).collect();
        Self { features: order, sizes, descriptors }
    }

    fn similar(&self, size: f32) -> std::ops::Range<usize> {
        let start = self.sizes.partition_point(|&other| other * SIZE_RATIO < size);
        start..self.sizes.partition_point(|&other| other <= size * SIZE_RATIO).max(start)
    }
}

fn product(a: &Quantised, b: &Quantised) -> i32 {
    a.iter().zip(b).map(|(&a, &b)| i32::from(a) * i32::from(b)).sum()
}

/// For each of `from`, the nearest of `to`.
fn nearest(from: &Kind, to: &Kind) -> Vec<Best> {
    /// Left features that one thread works on together.
    const GROUP: usize = 16;
    from.descriptors
        .par_chunks(GROUP)
        .enumerate()
        .flat_map_iter(|(group, descriptors)| {
            let first = group * GROUP;
            let ranges: Vec<_> = (0..descriptors.len()).map(|i| to.similar(from.sizes[first + i])).collect();
            let mut best = vec![Best::NONE; descriptors.len()];
            let start = ranges.first().map_or(0, |range| range.start);
            let end = ranges.last().map_or(0, |range| range.end);
            for block in (start..end).step_by(BLOCK) {
                for ((descriptor, range), best) in descriptors.iter().zip(&ranges).zip(&mut best) {
                    for index in block.max(range.start)..(block + BLOCK).min(range.end) {
                        best.meet(product(descriptor, &to.descriptors[index]), index as u32);
                    }
                }
            }
            best
        })
        .collect()
}

/// What the descriptors say about which left point is which right point.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointMatches {
    /// Distinct nearest both ways: most are right. No two share both places.
    pub distinct: Vec<PointMatch>,
    /// Pairs that are among the few nearest of each other, nearest first: many are wrong, but few of those also lie
    /// where a known geometry wants them.
    pub possible: Vec<PointMatch>,
}

/// Matches features by their descriptors.
pub fn match_features(left: &[Feature], right: &[Feature]) -> PointMatches {
    let mut distinct = Vec::new();
    let mut possible = Vec::new();
    for dark in [true, false] {
        let (left, right) = (Kind::new(left, dark), Kind::new(right, dark));
        let (forward, backward) = (nearest(&left, &right), nearest(&right, &left));
        for (i, best) in forward.iter().enumerate() {
            if let Some(j) = best.distinct()
                && backward[j].distinct() == Some(i)
            {
                distinct.push((left.features[i], right.features[j]));
            }
            let mutual = best.all().filter(|&(_, j)| backward[j].all().any(|(_, back)| back == i));
            possible.extend(mutual.map(|(product, j)| (-product, left.features[i], right.features[j])));
        }
    }
    // The strongest first, whatever their kind.
    distinct.sort_unstable();
    possible.sort_unstable();
    let point = |feature: &Feature| Point2::new(f64::from(feature.x), f64::from(feature.y));
    let pair = |i: usize, j: usize| PointMatch { left: point(&left[i]), right: point(&right[j]) };
    let mut seen = HashSet::new();
    let distinct = distinct.into_iter().map(|(i, j)| pair(i, j)).filter(|pair| seen.insert(pair.places())).collect();
    PointMatches { distinct, possible: possible.into_iter().map(|(_, i, j)| pair(i, j)).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn feature(x: f32, contrast: f32, sigma_px: f32, peak: usize) -> Feature {
        let mut descriptor = [0.0; LENGTH];
        descriptor[peak] = 1.0;
        Feature { x, y: 0.0, sigma_px, orientation_rad: 0.0, contrast, descriptor }
    }

    #[test]
    fn like_meets_like_and_doubt_is_left_out() {
        let left = [feature(0.0, 0.1, 2.0, 0), feature(1.0, 0.1, 2.0, 1), feature(2.0, 0.1, 2.0, 2)];
        // 10 looks like left 0; two look like left 1, so it is in doubt; left 2's twin is bright.
        let right =
            [(10.0, 0.1, 0), (11.0, 0.1, 1), (12.0, 0.1, 1), (13.0, -0.1, 2)].map(|(x, c, p)| feature(x, c, 2.0, p));
        let matches = match_features(&left, &right).distinct;
        assert_eq!(matches.len(), 1);
        assert_eq!((matches[0].left.x, matches[0].right.x), (0.0, 10.0));
    }

    #[test]
    fn features_of_unlike_size_are_not_compared() {
        let left = [feature(0.0, 0.1, 2.0, 0)];
        let right = [feature(10.0, 0.1, 8.0, 0), feature(11.0, 0.1, 2.1, 3), feature(12.0, 0.1, 1.9, 4)];
        assert_eq!(match_features(&left, &right).distinct, []);
    }

    #[test]
    fn two_features_of_one_place_give_one_match() {
        let left = [feature(0.0, 0.1, 2.0, 0), feature(0.0, 0.1, 2.0, 5)];
        let right = [feature(9.0, 0.1, 2.0, 0), feature(9.0, 0.1, 2.0, 5)];
        assert_eq!(match_features(&left, &right).distinct.len(), 1);
    }
}

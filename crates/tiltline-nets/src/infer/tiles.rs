//! How a line of pixels is cut into tiles with margins.

use std::ops::Range;

/// A stretch of pixels that is worked on, and the part of it that is kept.
#[derive(Clone, Debug, PartialEq)]
pub struct Tile {
    /// First pixel, a multiple of what sides must be: pooling cells lie as they would without tiles.
    pub start: usize,
    /// Pixels, a multiple too; may reach beyond the image.
    pub length: usize,
    /// Pixels of the image that are taken from this tile.
    pub keep: Range<usize>,
}

impl Tile {
    /// What is kept, counted from the tile's start.
    pub fn inner(&self) -> Range<usize> {
        self.keep.start - self.start..self.keep.end - self.start
    }
}

/// Tiles that cover `count` pixels, `side` kept px each with `margin` on either side where the image goes on. An image that
/// is hardly larger than one tile is one tile.
pub fn tiles(count: usize, side: usize, margin: usize, multiple: usize) -> Vec<Tile> {
    let (side, margin) = (side.next_multiple_of(multiple), margin.next_multiple_of(multiple));
    if count <= side + 2 * margin {
        return vec![Tile { start: 0, length: count.next_multiple_of(multiple), keep: 0..count }];
    }
    (0..count.div_ceil(side))
        .map(|index| {
            let keep = index * side..((index + 1) * side).min(count);
            let start = keep.start.saturating_sub(margin);
            let end = (keep.end + margin).min(count).next_multiple_of(multiple);
            Tile { start, length: end - start, keep }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_keep_every_pixel_once_with_its_margin() {
        for count in [10, 512, 768, 769, 2000, 4096] {
            let all = tiles(count, 512, 112, 16);
            assert_eq!(
                all.iter().flat_map(|tile| tile.keep.clone()).collect::<Vec<_>>(),
                (0..count).collect::<Vec<_>>()
            );
            for tile in &all {
                assert!(tile.start.is_multiple_of(16) && tile.length.is_multiple_of(16));
                assert!(tile.start == 0 || tile.keep.start - tile.start >= 112);
                let end = tile.start + tile.length;
                assert!(end >= count || end - tile.keep.end >= 112);
            }
        }
    }
}

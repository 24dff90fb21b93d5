//! The driver of weight gradients: for each pair of coarse and fine channels and each tap, the sum over the grid of the coarse
//! tensor times the fine one shifted by the tap.

use crate::coupling::{Correlation, Coupling, volume};
use crate::gather::{Blocking, Corner, Layout, Source, Window};
use crate::lanes::{Lanes, MAX_COUNT};
use crate::path::{Kernel, Path};
use crate::scratch::with_scratch;
use crate::tile::tiles;
use rayon::prelude::*;
use std::ops::Range;

/// Floats of the fine tensor in a gathered block.
const BLOCK_FLOATS: usize = 120_000;
/// Most positions in a block: long runs spread the cost of the sums across lanes at their end, and a tile's rows of coarse
/// values must still leave room in the second-level cache.
const BLOCK_POSITIONS: usize = 4096;
/// Fewest fine channels that are gathered together.
const CHANNELS: usize = 16;
/// Partial sums that the work is cut into, and the most floats that all of them may take.
const PARTIALS: usize = 16;
const PARTIAL_FLOATS: usize = 1 << 22;

/// The gradient of the weights `[coarse channel, fine channel, kernel]`, given the values of one tensor and the gradient of the other.
pub(crate) fn weight_gradient(path: Path, coupling: &Coupling, fine: &[f32], coarse: &[f32]) -> Vec<f32> {
    let correlation = &coupling.downward();
    let full = path.tile();
    let tiles = tiles(coupling.coarse_channels, full);
    let group_channels = group_channels(correlation);
    let blocking = Blocking::new(correlation, group_channels, BLOCK_FLOATS, BLOCK_POSITIONS);
    // Items of work, depth innermost so that gathered planes are kept; cut into partial sums by shape alone.
    let items = coupling.batch * blocking.count() * correlation.grid[0];
    let partials = (PARTIAL_FLOATS / coupling.weight_len()).clamp(1, PARTIALS).min(items);
    let tile_groups = (PARTIALS / partials).min(tiles.len());
    let tiles_each = tiles.len().div_ceil(tile_groups);
    let tile_groups = tiles.len().div_ceil(tiles_each);
    let columns = coupling.fine_channels * correlation.kernel_len;

    let sums: Vec<Vec<f32>> = (0..partials * tile_groups)
        .into_par_iter()
        .map(|task| {
            let (partial, group) = (task / tile_groups, task % tile_groups);
            let tiles = &tiles[group * tiles_each..((group + 1) * tiles_each).min(tiles.len())];
            let mut sums = vec![0.0; tiles.len() * full * columns];
            let layout = Layout::new(correlation, blocking.rows, blocking.columns);
            let gathered = group_channels * layout.channel_len;
            let staged = tiles.len() * full * layout.positions().next_multiple_of(MAX_COUNT);
            with_scratch(gathered + staged, |buffer| {
                let (block, stage) = buffer.split_at_mut(gathered);
                path.run(OuterKernel {
                    correlation,
                    blocking,
                    group_channels,
                    items: items * partial / partials..items * (partial + 1) / partials,
                    fine: Source { values: fine, channels: coupling.fine_channels, size: coupling.fine },
                    coarse: Source { values: coarse, channels: coupling.coarse_channels, size: coupling.coarse },
                    tiles,
                    full_tile: full,
                    block,
                    stage,
                    sums: &mut sums,
                });
            });
            sums
        })
        .collect();

    let mut gradient = vec![0.0; coupling.weight_len()];
    gradient.par_chunks_mut(columns).enumerate().for_each(|(channel, gradient)| {
        let (tile, o) = (channel / full, channel % full);
        let (group, tile) = (tile / tiles_each, tile % tiles_each);
        let width = tiles[channel / full].2;
        for partial in 0..partials {
            let sums = &sums[partial * tile_groups + group][tile * full * columns..];
            for (gradient, sums) in gradient.iter_mut().zip(sums.chunks_exact(width)) {
                *gradient += sums[o];
            }
        }
    });
    gradient
}

/// Fine channels to gather at once: all, where enough rows of them fit.
fn group_channels(correlation: &Correlation) -> usize {
    let planes = (correlation.halo[0] + 1) * volume(correlation.source_stride);
    let fitting = BLOCK_FLOATS / (planes * BLOCK_POSITIONS.min(volume(correlation.grid)));
    fitting.max(CHANNELS).min(correlation.source_channels)
}

/// Some items (batch entry, block, depth) of the sum, for some tiles of coarse channels.
struct OuterKernel<'a> {
    correlation: &'a Correlation,
    blocking: Blocking,
    group_channels: usize,
    items: Range<usize>,
    fine: Source<'a>,
    coarse: Source<'a>,
    tiles: &'a [(usize, usize, usize)],
    full_tile: usize,
    block: &'a mut [f32],
    stage: &'a mut [f32],
    /// `[tile][fine channel, kernel][tile width]`; a tile starts at a multiple of the full width.
    sums: &'a mut [f32],
}

impl Kernel for OuterKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        assert!(L::TILE == self.full_tile);
        let correlation = self.correlation;
        let depth = correlation.grid[0];
        let taps = &correlation.sets[0].taps;
        let all_columns = self.fine.channels * taps.len();
        let mut columns: Vec<usize> = Vec::new();
        for first_channel in (0..self.fine.channels).step_by(self.group_channels) {
            let channels = first_channel..(first_channel + self.group_channels).min(self.fine.channels);
            let mut previous = None;
            for item in self.items.clone() {
                let (place, z) = (item / depth, item % depth);
                let ([row, column], [rows, width]) = self.blocking.block(correlation, place % self.blocking.count());
                let corner = Corner { batch: place / self.blocking.count(), row, column };
                let layout = Layout::new(correlation, rows, width);
                let continues = previous == Some(place);
                previous = Some(place);
                let window = Window { source: self.fine, corner, channels: channels.clone() };
                layout.gather_depth(lanes, self.block, &window, z, continues);
                let stage_len = layout.positions().next_multiple_of(MAX_COUNT);
                for (tile, &(first, channels, width)) in self.tiles.iter().enumerate() {
                    let stage = &mut self.stage[tile * L::TILE * stage_len..][..width * stage_len];
                    stage_coarse(stage, stage_len, self.coarse, first..first + channels, &layout, corner, z);
                }
                columns.clear();
                for channel in 0..channels.len() {
                    for tap in taps {
                        columns.push(channel * layout.channel_len + layout.tap_offset(tap, z));
                    }
                }
                assert!(self.block.len() >= channels.len() * layout.channel_len);
                assert!(self.stage.len() >= self.tiles.len() * L::TILE * stage_len);
                for (tile, &(_, _, width)) in self.tiles.iter().enumerate() {
                    let coarse = self.stage[tile * L::TILE * stage_len..].as_ptr();
                    let sums = &mut self.sums[tile * L::TILE * all_columns..];
                    let sums = &mut sums[first_channel * taps.len() * width..][..columns.len() * width];
                    // SAFETY: the stage holds a full tile of rows of `stage_len` values; each column points into its channel
                    // of the block, whose layout leaves room for the vectors up to `stage_len` (positions rounded up by less
                    // than a vector).
                    unsafe { outer_products(lanes, width, coarse, stage_len, self.block.as_ptr(), &columns, sums) };
                }
            }
        }
    }
}

/// Copies the coarse values of a block to rows at the gathered pitch, one run a channel, with zeros between rows and behind
/// the last, so that what the fine block holds there counts for nothing. Channels that a tile lacks are zero.
#[inline(always)]
fn stage_coarse(
    stage: &mut [f32],
    stage_len: usize,
    coarse: Source,
    channels: Range<usize>,
    layout: &Layout,
    corner: Corner,
    z: usize,
) {
    let [depth, height, width] = coarse.size;
    for (o, run) in stage.chunks_exact_mut(stage_len).enumerate() {
        if o >= channels.len() {
            run.fill(0.0);
            continue;
        }
        let plane = ((corner.batch * coarse.channels + channels.start + o) * depth + z) * height;
        for (row, run) in run[..].chunks_mut(layout.pitch).enumerate() {
            if row >= layout.rows {
                run.fill(0.0);
                continue;
            }
            let from = (plane + corner.row + row) * width + corner.column;
            let (values, halo) = run.split_at_mut(layout.columns);
            values.copy_from_slice(&coarse.values[from..from + layout.columns]);
            halo.fill(0.0);
        }
    }
}

/// Adds to `sums`, `[column][width]`, the products of `width` rows of coarse values with each column's run of fine values.
///
/// # Safety
///
/// `coarse + 0..width * len` and, for each column, `block + column + 0..len` must be readable; `len` is a multiple of
/// `L::COUNT`; `width` is one that [`crate::tile::tile_width`] gives for `L::TILE`.
#[inline(always)]
unsafe fn outer_products<L: Lanes>(
    lanes: L,
    width: usize,
    coarse: *const f32,
    len: usize,
    block: *const f32,
    columns: &[usize],
    sums: &mut [f32],
) {
    // SAFETY: the same conditions; in each arm there are `width` rows.
    unsafe {
        match width {
            1 => outer_width::<L, 1, 9>(lanes, coarse, len, block, columns, sums),
            4 => outer_width::<L, 4, 3>(lanes, coarse, len, block, columns, sums),
            _ if L::TILE > 4 => outer_width::<L, 8, 3>(lanes, coarse, len, block, columns, sums),
            _ => unreachable!("no tile of width {width}"),
        }
    }
}

/// # Safety
///
/// As for [`outer_products`], with `NO` the width.
#[inline(always)]
unsafe fn outer_width<L: Lanes, const NO: usize, const NC: usize>(
    lanes: L,
    coarse: *const f32,
    len: usize,
    block: *const f32,
    columns: &[usize],
    sums: &mut [f32],
) {
    let (groups, rest) = columns.as_chunks::<NC>();
    let (group_sums, rest_sums) = sums.split_at_mut(groups.len() * NC * NO);
    for (group, sums) in groups.iter().zip(group_sums.chunks_exact_mut(NC * NO)) {
        // SAFETY: the same conditions, for columns from the same list.
        unsafe { outer_tile::<L, NO, NC>(lanes, coarse, len, block, group, sums) };
    }
    for (column, sums) in rest.iter().zip(rest_sums.chunks_exact_mut(NO)) {
        // SAFETY: as above.
        unsafe { outer_tile::<L, NO, 1>(lanes, coarse, len, block, &[*column], sums) };
    }
}

/// # Safety
///
/// As for [`outer_products`], with `NO` the width and `NC` columns.
#[inline(always)]
unsafe fn outer_tile<L: Lanes, const NO: usize, const NC: usize>(
    lanes: L,
    coarse: *const f32,
    len: usize,
    block: *const f32,
    columns: &[usize; NC],
    sums: &mut [f32],
) {
    let mut products = [[lanes.splat(0.0); NO]; NC];
    let mut position = 0;
    while position < len {
        // SAFETY: `position + L::COUNT <= len`, and the caller promises these runs.
        unsafe {
            let mut fine = [lanes.splat(0.0); NC];
            for c in 0..NC {
                fine[c] = lanes.load(block.add(columns[c] + position));
            }
            for o in 0..NO {
                let coarse = lanes.load(coarse.add(o * len + position));
                for c in 0..NC {
                    products[c][o] = lanes.mul_add(coarse, fine[c], products[c][o]);
                }
            }
        }
        position += L::COUNT;
    }
    for c in 0..NC {
        let totals = lanes.sums(products[c]);
        for o in 0..NO {
            sums[c * NO + o] += totals[o];
        }
    }
}

//! The register tile of a correlation: a few output channels by a few vectors of positions, held in registers while all
//! input channels and taps pass by.

use crate::lanes::{Lanes, MAX_COUNT};
use std::mem::MaybeUninit;

/// Widths of tiles: a full one, and narrower ones for what is left of the channels.
pub(crate) fn tile_width(channels_left: usize, full: usize) -> usize {
    match channels_left {
        1 => 1,
        2..=4 => 4.min(full),
        _ => full,
    }
}

/// The tiles that cover some channels: `(first channel, channels, width)`.
pub(crate) fn tiles(channels: usize, full: usize) -> Vec<(usize, usize, usize)> {
    (0..channels.div_ceil(full))
        .map(|tile| {
            let first = tile * full;
            let left = channels - first;
            (first, left.min(full), tile_width(left, full))
        })
        .collect()
}

/// What a tile reads: see [`crate::gather`].
#[derive(Clone, Copy)]
pub(crate) struct TileInput<'a> {
    pub block: *const f32,
    pub channels: usize,
    pub channel_len: usize,
    pub taps: &'a [usize],
    /// `[channel, tap, tile width]`
    pub weights: *const f32,
    /// One a channel of the tile.
    pub bias: *const f32,
    pub relu: bool,
}

/// Where a tile stores: positions at `pitch` become rows of `columns` at `row_stride`.
#[derive(Clone, Copy)]
pub(crate) struct TileOutput {
    pub to: *mut f32,
    pub channel_stride: usize,
    /// Channels to store; the tile may be wider.
    pub channels: usize,
    pub positions: usize,
    pub pitch: usize,
    pub columns: usize,
    pub row_stride: usize,
}

/// Runs tiles of `width` over all positions of the output.
///
/// # Safety
///
/// With `n` the positions rounded up to whole vectors, `block + channel * channel_len + tap + 0..n` must be readable for all
/// channels and taps, `weights` and `bias` hold what `TileInput` says, and all elements that `TileOutput` names be
/// writable by this thread alone. `width` is one that [`tile_width`] gives for `L::TILE`.
#[inline(always)]
pub(crate) unsafe fn sweep<L: Lanes>(lanes: L, width: usize, input: TileInput, output: TileOutput) {
    // SAFETY: the same conditions; in each arm the tile has `width` channels.
    unsafe {
        match width {
            1 => sweep_width::<L, 1, 6>(lanes, input, output),
            4 if L::TILE > 4 => sweep_width::<L, 4, 4>(lanes, input, output),
            // With sixteen registers three vectors would fit, just, but the compiler then spills.
            4 => sweep_width::<L, 4, 2>(lanes, input, output),
            _ if L::TILE > 4 => sweep_width::<L, 8, 3>(lanes, input, output),
            _ => unreachable!("no tile of width {width}"),
        }
    }
}

/// # Safety
///
/// As for [`sweep`], with `NO` the width.
#[inline(always)]
unsafe fn sweep_width<L: Lanes, const NO: usize, const NV: usize>(lanes: L, input: TileInput, output: TileOutput) {
    let vectors = output.positions.div_ceil(L::COUNT);
    let mut vector = 0;
    while vector < vectors {
        let left = vectors - vector;
        // SAFETY: each tile covers vectors below `vectors`.
        unsafe {
            // Three vectors and then one are slower than twice two.
            if left >= NV && left != NV + 1 {
                tile::<L, NO, NV>(lanes, input, output, vector * L::COUNT);
                vector += NV;
            } else if left >= 2 {
                tile::<L, NO, 2>(lanes, input, output, vector * L::COUNT);
                vector += 2;
            } else {
                tile::<L, NO, 1>(lanes, input, output, vector * L::COUNT);
                vector += 1;
            }
        }
    }
}

/// # Safety
///
/// As for [`sweep`], with `NO` the width and `NV` vectors from `position` on.
#[inline(always)]
unsafe fn tile<L: Lanes, const NO: usize, const NV: usize>(
    lanes: L,
    input: TileInput,
    output: TileOutput,
    position: usize,
) {
    let mut sums = [[lanes.splat(0.0); NV]; NO];
    // SAFETY: the caller promises all of these reads: `NO` biases, for each channel and tap `NO` weights, and `NV` vectors of
    // the block from `position` on.
    unsafe {
        for o in 0..NO {
            sums[o] = [lanes.splat(*input.bias.add(o)); NV];
        }
        let mut weights = input.weights;
        for channel in 0..input.channels {
            let block = input.block.add(channel * input.channel_len + position);
            for &tap in input.taps {
                let from = block.add(tap);
                let mut values = [lanes.splat(0.0); NV];
                for v in 0..NV {
                    values[v] = lanes.load(from.add(v * L::COUNT));
                }
                for o in 0..NO {
                    let weight = lanes.splat(*weights.add(o));
                    for v in 0..NV {
                        sums[o][v] = lanes.mul_add(weight, values[v], sums[o][v]);
                    }
                }
                weights = weights.add(NO);
            }
        }
    }
    if input.relu {
        for o in 0..NO {
            for v in 0..NV {
                sums[o][v] = lanes.relu(sums[o][v]);
            }
        }
    }
    let (row, column) = (position / output.pitch, position % output.pitch);
    if column + NV * L::COUNT <= output.columns {
        let to = output.to.wrapping_add(row * output.row_stride + column);
        for o in 0..NO {
            if o < output.channels {
                for v in 0..NV {
                    // SAFETY: all lanes lie in one row of the output, which the caller promises to be writable.
                    unsafe { lanes.store(to.wrapping_add(o * output.channel_stride + v * L::COUNT), sums[o][v]) };
                }
            }
        }
        return;
    }
    // Row ends inside the tile. By way of memory, so that the loops over rows do not index registers.
    let mut spilled = MaybeUninit::<[[f32; MAX_COUNT]; 32]>::uninit();
    let spilled = spilled.as_mut_ptr().cast::<f32>();
    for o in 0..NO {
        for v in 0..NV {
            // SAFETY: `NO * NV <= 32` vectors of at most `MAX_COUNT` floats.
            unsafe { lanes.store(spilled.add((o * NV + v) * L::COUNT), sums[o][v]) };
        }
    }
    for v in 0..NV {
        let position = position + v * L::COUNT;
        let (mut row, mut column) = (position / output.pitch, position % output.pitch);
        let mut lane = 0;
        while lane < L::COUNT && position + lane < output.positions {
            if column < output.columns {
                let end = (lane + output.columns - column).min(L::COUNT);
                // Lane 0 may belong before the row, even before the array.
                let to = output.to.wrapping_add(row * output.row_stride + column).wrapping_sub(lane);
                for o in 0..output.channels.min(NO) {
                    // SAFETY: this vector was spilled above; lanes `lane..end` lie in one row of the output.
                    unsafe {
                        let sums = lanes.load(spilled.add((o * NV + v) * L::COUNT));
                        lanes.store_lanes(to.wrapping_add(o * output.channel_stride), sums, lane, end);
                    }
                }
            }
            lane += output.pitch - column;
            (row, column) = (row + 1, 0);
        }
    }
}

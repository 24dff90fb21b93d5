//! The driver of convolutions, of their input gradients, and of transposed convolutions: any [`Correlation`].

use crate::conv::Activation;
use crate::coupling::{Correlation, volume};
use crate::gather::{Blocking, Corner, Layout, Source, Window};
use crate::lanes::{Lanes, MAX_COUNT};
use crate::path::{Kernel, Path};
use crate::scratch::{Output, fill_output, with_scratch};
use crate::tile::{TileInput, TileOutput, sweep, tiles};
use rayon::prelude::*;
use std::ops::Range;

/// Floats in a gathered block: with weights and outputs it should stay in a second-level cache of 512 KiB to 1 MiB.
const BLOCK_FLOATS: usize = 128_000;
/// More positions than this only delay the other threads.
const BLOCK_POSITIONS: usize = 8192;
/// Grid planes that one task walks through, keeping the planes that the next step needs again.
const DEPTH_STEPS: usize = 8;
/// Tasks wanted, where the work can be cut into as many; a number for many cores, so that it need not depend on them.
const TASKS: usize = 32;

/// Computes the whole target. `bias` has one value a target channel.
pub(crate) fn correlate(
    path: Path,
    correlation: &Correlation,
    source: &[f32],
    weights: &[f32],
    bias: Option<&[f32]>,
    activation: Activation,
) -> Vec<f32> {
    let tiles = tiles(correlation.target_channels, path.tile());
    let packed = pack(correlation, &tiles, path.tile(), weights);
    let mut biases = vec![0.0; tiles.len() * path.tile()];
    if let Some(bias) = bias {
        biases[..bias.len()].copy_from_slice(bias);
    }
    let blocking = Blocking::new(correlation, correlation.source_channels, BLOCK_FLOATS, BLOCK_POSITIONS);
    let depth_blocks = correlation.grid[0].div_ceil(DEPTH_STEPS);
    let places = correlation.batch * depth_blocks * blocking.count();
    // Where there are few places, the tiles are shared out too; the gathering is then repeated.
    let tile_groups = TASKS.div_ceil(places).min(tiles.len());
    let tiles_each = tiles.len().div_ceil(tile_groups);
    let tile_groups = tiles.len().div_ceil(tiles_each);
    let len = correlation.batch * correlation.target_channels * volume(correlation.target);
    let source = Source { values: source, channels: correlation.source_channels, size: correlation.source };
    let fill = |output: Output| {
        (0..places * tile_groups).into_par_iter().for_each(|task| {
            let (place, group) = (task / tile_groups, task % tile_groups);
            let ([row, column], [rows, columns]) = blocking.block(correlation, place % blocking.count());
            let depth = place / blocking.count() % depth_blocks * DEPTH_STEPS;
            let batch = place / blocking.count() / depth_blocks;
            let layout = Layout::new(correlation, rows, columns);
            let gathered = correlation.source_channels * layout.channel_len;
            // Room for two phases of a tile, which are interleaved afterwards.
            let staged = 2 * path.tile() * layout.positions().next_multiple_of(MAX_COUNT);
            with_scratch(gathered + staged, |buffer| {
                let (block, stage) = buffer.split_at_mut(gathered);
                path.run(BlockKernel {
                    correlation,
                    layout,
                    window: Window { source, corner: Corner { batch, row, column }, channels: 0..source.channels },
                    depths: depth..(depth + DEPTH_STEPS).min(correlation.grid[0]),
                    tiles: &tiles[group * tiles_each..((group + 1) * tiles_each).min(tiles.len())],
                    full_tile: path.tile(),
                    packed: &packed,
                    biases: &biases,
                    relu: activation == Activation::Relu,
                    block,
                    stage,
                    output,
                });
            });
        });
    };
    // SAFETY: the tasks' blocks cut the grid, batch and tiles into disjoint parts that cover them, and the phases of the
    // target do so within a grid place; a task writes exactly its own part (`BlockKernel::run`).
    unsafe { fill_output(len, fill) }
}

/// Weights in the order in which tiles use them: for each tap set `[tile][source channel][tap][tile width]`.
///
/// All tiles but the last are full, so that a tile's weights start at `first channel * source channels * taps`.
fn pack(correlation: &Correlation, tiles: &[(usize, usize, usize)], full: usize, weights: &[f32]) -> Vec<Vec<f32>> {
    let sources = correlation.source_channels;
    correlation
        .sets
        .iter()
        .map(|set| {
            let mut packed = vec![0.0; tiles.len() * full * sources * set.taps.len()];
            if set.taps.is_empty() {
                return packed;
            }
            packed.par_chunks_mut(full * sources * set.taps.len()).zip(tiles).for_each(
                |(packed, &(first, channels, width))| {
                    let mut columns = packed.chunks_exact_mut(width);
                    for source in 0..sources {
                        for (tap, column) in set.taps.iter().zip(&mut columns) {
                            for (o, weight) in column[..channels].iter_mut().enumerate() {
                                *weight = weights[correlation.weight_index(first + o, source, tap.weight)];
                            }
                        }
                    }
                },
            );
            packed
        })
        .collect()
}

/// One block of the grid through some depths, for some tiles of target channels.
struct BlockKernel<'a> {
    correlation: &'a Correlation,
    layout: Layout,
    window: Window<'a>,
    depths: Range<usize>,
    tiles: &'a [(usize, usize, usize)],
    full_tile: usize,
    packed: &'a [Vec<f32>],
    biases: &'a [f32],
    relu: bool,
    block: &'a mut [f32],
    stage: &'a mut [f32],
    output: Output,
}

impl Kernel for BlockKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        assert!(L::TILE == self.full_tile);
        let correlation = self.correlation;
        let interleaved = correlation.target_stride[2] == 2;
        let phases = correlation.target_stride[2];
        let positions = self.layout.positions();
        let stage_len = positions.next_multiple_of(MAX_COUNT);
        assert!(self.block.len() >= correlation.source_channels * self.layout.channel_len);
        assert!(self.stage.len() >= 2 * L::TILE * stage_len);
        let mut offsets: Vec<usize> = Vec::new();
        for z in self.depths.clone() {
            let continues = z > self.depths.start;
            self.layout.gather_depth(lanes, self.block, &self.window, z, continues);
            for (group, sets) in correlation.sets.chunks_exact(phases).enumerate() {
                let [phase_z, phase_y, _] = sets[0].target_phase;
                let target_z = correlation.target_stride[0] * z + phase_z;
                if target_z >= correlation.target[0] {
                    continue;
                }
                for &(first_channel, channels, width) in self.tiles {
                    for (phase, set) in sets.iter().enumerate() {
                        offsets.clear();
                        for tap in &set.taps {
                            offsets.push(self.layout.tap_offset(tap, z));
                        }
                        let weights = &self.packed[group * phases + phase];
                        let weights = &weights[first_channel * correlation.source_channels * set.taps.len()..];
                        assert!(weights.len() >= width * correlation.source_channels * set.taps.len());
                        let input = TileInput {
                            block: self.block.as_ptr(),
                            channels: correlation.source_channels,
                            channel_len: self.layout.channel_len,
                            taps: &offsets,
                            weights: weights.as_ptr(),
                            bias: self.biases[first_channel..first_channel + width].as_ptr(),
                            relu: self.relu,
                        };
                        let output = if interleaved {
                            TileOutput {
                                to: self.stage[phase * L::TILE * stage_len..].as_mut_ptr(),
                                channel_stride: stage_len,
                                channels,
                                positions: stage_len,
                                pitch: stage_len,
                                columns: stage_len,
                                row_stride: 0,
                            }
                        } else {
                            self.direct_output(first_channel, channels, target_z)
                        };
                        // SAFETY: the block holds `source.channels` channels of `layout.channel_len`, and
                        // `layout` leaves room behind its planes for the vectors that start within the last position, at
                        // any tap; weights and bias were packed for this width. A staged output fills its part of the
                        // stage, in whole vectors (`stage_len` is a multiple of any vector); a direct one is
                        // this task's own part of the output.
                        unsafe { sweep(lanes, width, input, output) };
                    }
                    if interleaved {
                        self.interleave(lanes, first_channel, channels, target_z, phase_y, stage_len);
                    }
                }
            }
        }
    }
}

impl BlockKernel<'_> {
    /// Offset of a target row in the whole output.
    #[inline(always)]
    fn target_row(&self, channel: usize, z: usize, y: usize) -> usize {
        let [depth, height, width] = self.correlation.target;
        (((self.window.corner.batch * self.correlation.target_channels + channel) * depth + z) * height + y) * width
    }

    /// Stores of a correlation whose target has the grid's own resolution.
    #[inline(always)]
    fn direct_output(&self, first_channel: usize, channels: usize, z: usize) -> TileOutput {
        let [_, _, width] = self.correlation.target;
        let Layout { rows, columns, pitch, .. } = self.layout;
        let start = self.target_row(first_channel, z, self.window.corner.row) + self.window.corner.column;
        let to = self.output.part(start, (rows - 1) * width + columns);
        let channel_stride = volume(self.correlation.target);
        let positions = self.layout.positions();
        if pitch == width {
            // No halo: the block is one run of memory.
            return TileOutput {
                to,
                channel_stride,
                channels,
                positions,
                pitch: positions,
                columns: positions,
                row_stride: 0,
            };
        }
        TileOutput { to, channel_stride, channels, positions, pitch, columns, row_stride: width }
    }

    /// Writes the two staged phases as even and odd columns of the target's rows of phase `phase_y`.
    #[inline(always)]
    fn interleave<L: Lanes>(
        &self,
        lanes: L,
        first_channel: usize,
        channels: usize,
        z: usize,
        phase_y: usize,
        stage_len: usize,
    ) {
        let [_, height, width] = self.correlation.target;
        let (even, odd) = self.stage.split_at(self.full_tile * stage_len);
        let column = 2 * self.window.corner.column;
        // Of an odd width the last column has no odd partner.
        let written = (2 * self.layout.columns).min(width - column);
        for channel in 0..channels {
            for row in 0..self.layout.rows {
                let y = self.correlation.target_stride[1] * (self.window.corner.row + row) + phase_y;
                if y >= height {
                    break;
                }
                let from = channel * stage_len + row * self.layout.pitch;
                let (even, odd) = (&even[from..from + self.layout.columns], &odd[from..from + self.layout.columns]);
                let to = self.output.part(self.target_row(first_channel + channel, z, y) + column, written);
                // SAFETY: `written` elements from `to` on lie in one row of the target, and are this task's own: whole vectors
                // as long as they fit, then pairs, then the single last one where `written` is odd. The
                // halves of the stage were sliced to as many elements as there are pairs, or one more.
                unsafe {
                    let mut i = 0;
                    while 2 * (i + L::COUNT) <= written {
                        let (even, odd) = (lanes.load(even.as_ptr().add(i)), lanes.load(odd.as_ptr().add(i)));
                        lanes.store_interleaved(to.add(2 * i), even, odd);
                        i += L::COUNT;
                    }
                    for i in i..written / 2 {
                        to.add(2 * i).write(even[i]);
                        to.add(2 * i + 1).write(odd[i]);
                    }
                    if written % 2 == 1 {
                        to.add(written - 1).write(even[written / 2]);
                    }
                }
            }
        }
    }
}

//! Copies a block of a tensor into a dense, zero-padded buffer in which every tap of a kernel is one fixed offset.
//!
//! Rows lie one after the other at a pitch of `columns + halo`, so that the block is one long run of positions and vectors
//! cross from row to row; the positions in the halo give results nobody stores. Axes with stride 2 are split by parity
//! into planes of their own. Along the depth a few planes are kept in a ring, so that a step in depth copies only one.

use crate::coupling::{Correlation, Tap, volume};
use crate::lanes::{Lanes, MAX_COUNT};
use std::ops::Range;

/// Where things lie in the buffer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Layout {
    /// Grid rows and columns of the block.
    pub rows: usize,
    pub columns: usize,
    /// From a row to the next.
    pub pitch: usize,
    plane_rows: usize,
    plane_len: usize,
    pub channel_len: usize,
    /// Planes of each depth phase that are held at once.
    slots: usize,
    stride: [usize; 3],
    low: [isize; 3],
}

impl Layout {
    pub(crate) fn new(correlation: &Correlation, rows: usize, columns: usize) -> Self {
        let pitch = columns + correlation.halo[2];
        let plane_rows = rows + correlation.halo[1];
        // The last vector of a block may begin in its last position, and reads on from there.
        let plane_len = plane_rows * pitch + MAX_COUNT;
        let slots = correlation.halo[0] + 1;
        let planes = slots * volume(correlation.source_stride);
        Self {
            rows,
            columns,
            pitch,
            plane_rows,
            plane_len,
            channel_len: (planes * plane_len).next_multiple_of(MAX_COUNT),
            slots,
            stride: correlation.source_stride,
            low: correlation.low,
        }
    }

    /// Positions from the first to the last of the block, including the halo between rows.
    pub(crate) fn positions(&self) -> usize {
        (self.rows - 1) * self.pitch + self.columns
    }

    /// Where a tap finds the value for the block's first position at depth `z` of the grid.
    pub(crate) fn tap_offset(&self, tap: &Tap, z: usize) -> usize {
        let shift = [0, 1, 2].map(|axis| (tap.shift[axis] - self.low[axis]) as usize);
        self.plane(tap.phase, z + shift[0]) * self.plane_len + shift[1] * self.pitch + shift[2]
    }

    /// Index of the plane with these phases; `ring` is the depth counted from the least shift.
    fn plane(&self, phase: [usize; 3], ring: usize) -> usize {
        let slot = phase[0] * self.slots + ring % self.slots;
        (slot * self.stride[1] + phase[1]) * self.stride[2] + phase[2]
    }
}

/// A tensor `[batch, channel, depth, row, column]` to gather from.
#[derive(Clone, Copy)]
pub(crate) struct Source<'a> {
    pub values: &'a [f32],
    pub channels: usize,
    pub size: [usize; 3],
}

/// Where a block begins in a tensor's grid.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Corner {
    pub batch: usize,
    pub row: usize,
    pub column: usize,
}

/// The part of a tensor that a buffer is to hold; its rows and columns are the layout's.
#[derive(Clone)]
pub(crate) struct Window<'a> {
    pub source: Source<'a>,
    pub corner: Corner,
    pub channels: Range<usize>,
}

impl Layout {
    /// Gathers what depth `z` needs. If `continues`, the buffer holds what `z - 1` needed, and only what is new is copied.
    #[inline(always)]
    pub(crate) fn gather_depth<L: Lanes>(
        &self,
        lanes: L,
        buffer: &mut [f32],
        window: &Window,
        z: usize,
        continues: bool,
    ) {
        let first = if continues { self.slots - 1 } else { 0 };
        for ring in z + first..z + self.slots {
            self.gather_plane(lanes, buffer, window, ring);
        }
    }

    #[inline(always)]
    fn gather_plane<L: Lanes>(&self, lanes: L, buffer: &mut [f32], window: &Window, ring: usize) {
        let Window { source, corner, channels } = window;
        let [depth, height, width] = source.size;
        let len = volume(source.size);
        for (channel, to) in channels.clone().zip(buffer.chunks_exact_mut(self.channel_len)) {
            let from = &source.values[(corner.batch * source.channels + channel) * len..][..len];
            for phase in 0..volume(self.stride) {
                let phase = [
                    phase / (self.stride[1] * self.stride[2]),
                    phase / self.stride[2] % self.stride[1],
                    phase % self.stride[2],
                ];
                let plane = &mut to[self.plane(phase, ring) * self.plane_len..][..self.plane_len];
                let z = self.stride[0] as isize * (ring as isize + self.low[0]) + phase[0] as isize;
                if z < 0 || z as usize >= depth {
                    plane.fill(0.0);
                    continue;
                }
                let from = &from[z as usize * height * width..][..height * width];
                self.gather_rows(lanes, plane, from, [height, width], *corner, phase);
            }
        }
    }

    #[inline(always)]
    fn gather_rows<L: Lanes>(
        &self,
        lanes: L,
        plane: &mut [f32],
        from: &[f32],
        [height, width]: [usize; 2],
        corner: Corner,
        phase: [usize; 3],
    ) {
        let (rows, slack) = plane.split_at_mut(self.plane_rows * self.pitch);
        slack.fill(0.0);
        if self.pitch == width && self.plane_rows == self.rows && self.stride == [1; 3] {
            // No halo and whole rows: one run of memory.
            rows.copy_from_slice(&from[corner.row * width..][..rows.len()]);
            return;
        }
        let stride = self.stride[2];
        // Column `stride * (first + i) + phase` of the source goes to place `i`; places `begin..end` are inside of it.
        let first = corner.column as isize + self.low[2];
        let begin = ((-first).max(0) as usize).min(self.pitch);
        let inside = width.saturating_sub(phase[2]).div_ceil(stride) as isize;
        let end = ((inside - first).max(0) as usize).clamp(begin, self.pitch);
        for (i, row) in rows.chunks_exact_mut(self.pitch).enumerate() {
            let y = self.stride[1] as isize * ((corner.row + i) as isize + self.low[1]) + phase[1] as isize;
            if y < 0 || y as usize >= height || begin == end {
                row.fill(0.0);
                continue;
            }
            let from = &from[y as usize * width..][..width];
            let from = &from[stride * (first + begin as isize) as usize + phase[2]..];
            row[..begin].fill(0.0);
            row[end..].fill(0.0);
            let row = &mut row[begin..end];
            if stride == 1 {
                row.copy_from_slice(&from[..row.len()]);
            } else {
                let mut i = 0;
                while i + L::COUNT <= row.len() && 2 * (i + L::COUNT) <= from.len() {
                    // SAFETY: both ranges were just checked.
                    unsafe {
                        let [even, _] = lanes.load_deinterleaved(from.as_ptr().add(2 * i));
                        lanes.store(row.as_mut_ptr().add(i), even);
                    };
                    i += L::COUNT;
                }
                for i in i..row.len() {
                    row[i] = from[2 * i];
                }
            }
        }
    }
}

/// How a grid plane is cut into blocks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Blocking {
    /// Rows and columns of a block; the last ones may be smaller.
    pub rows: usize,
    pub columns: usize,
    pub row_blocks: usize,
    pub column_blocks: usize,
}

impl Blocking {
    /// Blocks of about `floats` in the gathered buffer for `channels` of the source, and at most `max_positions` in the grid.
    ///
    /// Depends on shapes alone, so that results do not depend on the machine's cores.
    pub(crate) fn new(correlation: &Correlation, channels: usize, floats: usize, max_positions: usize) -> Self {
        let [_, height, width] = correlation.grid;
        let planes = (correlation.halo[0] + 1) * volume(correlation.source_stride);
        let per_plane = (floats / (channels * planes)).min(max_positions);
        let rows_of =
            |columns: usize| (per_plane / (columns + correlation.halo[2])).saturating_sub(correlation.halo[1]);
        // Narrower blocks where whole rows would leave so few of them that the halo costs more than the work.
        let mut column_blocks = 1;
        while rows_of(width.div_ceil(column_blocks)) < 6.min(height) && width / (column_blocks + 1) >= 96 {
            column_blocks += 1;
        }
        let columns = width.div_ceil(column_blocks);
        let row_blocks = height.div_ceil(rows_of(columns).clamp(1, height));
        let rows = height.div_ceil(row_blocks);
        Self { rows, columns, row_blocks: height.div_ceil(rows), column_blocks: width.div_ceil(columns) }
    }

    pub(crate) fn count(&self) -> usize {
        self.row_blocks * self.column_blocks
    }

    /// First row and column, rows and columns of block `index` of a grid plane.
    pub(crate) fn block(&self, correlation: &Correlation, index: usize) -> ([usize; 2], [usize; 2]) {
        let row = index / self.column_blocks * self.rows;
        let column = index % self.column_blocks * self.columns;
        let [_, height, width] = correlation.grid;
        ([row, column], [self.rows.min(height - row), self.columns.min(width - column)])
    }
}

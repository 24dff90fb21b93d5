//! Which element of a fine tensor meets which of a coarse tensor, and through which weight.
//!
//! A convolution maps a fine tensor `x` (the larger one where the stride is 2) to a coarse one `y`:
//! `y[o, q] = sum over c, k of w[o, c, k] x[c, stride q + k - padding]`. Its input gradient is the transposed map with the same
//! coupling, and its weight gradient the sum over `q` of `y` times `x`. A transposed convolution swaps the two roles. So a
//! coupling and three operations on it are all that [`crate::Conv`] and [`crate::TransposedConv`] need.
//!
//! With stride 2 every axis is split by parity: `stride q + k - padding = stride (q + shift) + phase`, where phase and shift
//! depend on `k` alone. Within one phase, then, everything is a convolution with stride 1.

/// Sizes are `[depth, row, column]`; a plane has depth 1. Weights are `[coarse channel, fine channel, depth, row, column]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Coupling {
    pub batch: usize,
    pub fine_channels: usize,
    pub coarse_channels: usize,
    pub fine: [usize; 3],
    pub coarse: [usize; 3],
    pub kernel: [usize; 3],
    pub stride: [usize; 3],
    pub padding: [usize; 3],
}

/// One weight's place: the fine index is `stride * (coarse index + shift) + phase`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Tap {
    /// Place in the kernel, row-major.
    pub weight: usize,
    pub phase: [usize; 3],
    pub shift: [isize; 3],
}

impl Coupling {
    pub(crate) fn fine_len(&self) -> usize {
        self.batch * self.fine_channels * volume(self.fine)
    }

    pub(crate) fn coarse_len(&self) -> usize {
        self.batch * self.coarse_channels * volume(self.coarse)
    }

    pub(crate) fn weight_len(&self) -> usize {
        self.coarse_channels * self.fine_channels * volume(self.kernel)
    }

    pub(crate) fn taps(&self) -> Vec<Tap> {
        (0..volume(self.kernel))
            .map(|weight| {
                let [_, rows, columns] = self.kernel;
                let place = [weight / (rows * columns), weight / columns % rows, weight % columns];
                let (mut phase, mut shift) = ([0; 3], [0; 3]);
                for axis in 0..3 {
                    let reach = place[axis] as isize - self.padding[axis] as isize;
                    let stride = self.stride[axis] as isize;
                    phase[axis] = reach.rem_euclid(stride) as usize;
                    shift[axis] = reach.div_euclid(stride);
                }
                Tap { weight, phase, shift }
            })
            .collect()
    }

    /// The map from fine to coarse.
    pub(crate) fn downward(&self) -> Correlation {
        Correlation::new(
            self,
            (self.fine_channels, self.fine, self.stride),
            (self.coarse_channels, self.coarse, [1; 3]),
            vec![TapSet { target_phase: [0; 3], taps: self.taps() }],
            WeightOrder::TargetFirst,
        )
    }

    /// The transposed map, from coarse to fine.
    pub(crate) fn upward(&self) -> Correlation {
        let [depth, rows, columns] = self.stride;
        let sets = (0..depth * rows * columns)
            .map(|set| {
                let target_phase = [set / (rows * columns), set / columns % rows, set % columns];
                let taps = self.taps().into_iter().filter(|tap| tap.phase == target_phase);
                // q = j - shift: seen from the fine side everything is mirrored.
                let mirrored = taps.map(|tap| Tap { phase: [0; 3], shift: tap.shift.map(|shift| -shift), ..tap });
                TapSet { target_phase, taps: mirrored.collect() }
            })
            .collect();
        Correlation::new(
            self,
            (self.coarse_channels, self.coarse, [1; 3]),
            (self.fine_channels, self.fine, self.stride),
            sets,
            WeightOrder::SourceFirst,
        )
    }
}

/// The weights that serve one phase of the target.
#[derive(Clone, Debug)]
pub(crate) struct TapSet {
    pub target_phase: [usize; 3],
    pub taps: Vec<Tap>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum WeightOrder {
    /// `[target channel, source channel, kernel]`
    TargetFirst,
    /// `[source channel, target channel, kernel]`
    SourceFirst,
}

/// A sum of shifted copies of a source: one direction of a [`Coupling`].
///
/// For grid place `j`, `target[target_stride j + target_phase]` is the sum over the phase's taps of
/// `weight * source[source_stride (j + shift) + phase]`, where the source is zero outside.
#[derive(Clone, Debug)]
pub(crate) struct Correlation {
    pub batch: usize,
    pub source_channels: usize,
    pub target_channels: usize,
    pub source: [usize; 3],
    pub target: [usize; 3],
    pub source_stride: [usize; 3],
    pub target_stride: [usize; 3],
    /// Places `j` on each axis.
    pub grid: [usize; 3],
    pub sets: Vec<TapSet>,
    /// The least shift of all taps.
    pub low: [isize; 3],
    /// By how much the greatest shift exceeds it.
    pub halo: [usize; 3],
    pub weight_order: WeightOrder,
    /// Elements of the kernel.
    pub kernel_len: usize,
}

impl Correlation {
    fn new(
        coupling: &Coupling,
        (source_channels, source, source_stride): (usize, [usize; 3], [usize; 3]),
        (target_channels, target, target_stride): (usize, [usize; 3], [usize; 3]),
        sets: Vec<TapSet>,
        weight_order: WeightOrder,
    ) -> Self {
        let (mut low, mut high, mut grid) = ([0; 3], [0; 3], [0; 3]);
        for axis in 0..3 {
            // Zero is among the shifts of all kernels here, so it may start the search.
            let shifts = sets.iter().flat_map(|set| &set.taps).map(|tap| tap.shift[axis]);
            (low[axis], high[axis]) = shifts.fold((0, 0), |(low, high), shift| (low.min(shift), high.max(shift)));
            grid[axis] = target[axis].div_ceil(target_stride[axis]);
        }
        let halo = [0, 1, 2].map(|axis| (high[axis] - low[axis]) as usize);
        Self {
            batch: coupling.batch,
            source_channels,
            target_channels,
            source,
            target,
            source_stride,
            target_stride,
            grid,
            sets,
            low,
            halo,
            weight_order,
            kernel_len: volume(coupling.kernel),
        }
    }

    /// Where a weight lies in the caller's array.
    #[inline(always)]
    pub(crate) fn weight_index(&self, target_channel: usize, source_channel: usize, tap: usize) -> usize {
        let pair = match self.weight_order {
            WeightOrder::TargetFirst => target_channel * self.source_channels + source_channel,
            WeightOrder::SourceFirst => source_channel * self.target_channels + target_channel,
        };
        pair * self.kernel_len + tap
    }
}

pub(crate) fn volume(size: [usize; 3]) -> usize {
    size.iter().product()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The places that a coupling joins are exactly those of the definition, in both directions.
    #[test]
    fn directions_join_the_same_places() {
        for (kernel, stride, padding, fine) in
            [(3, 1, 1, 5), (3, 2, 1, 5), (3, 2, 1, 6), (2, 2, 0, 6), (1, 1, 0, 4), (3, 2, 1, 1)]
        {
            let coarse: usize = (fine + 2 * padding - kernel) / stride + 1;
            let coupling = Coupling {
                batch: 1,
                fine_channels: 1,
                coarse_channels: 1,
                fine: [1, 1, fine],
                coarse: [1, 1, coarse],
                kernel: [1, 1, kernel],
                stride: [1, 1, stride],
                padding: [0, 0, padding],
            };
            let mut expected = Vec::new();
            for (q, k) in (0..coarse).flat_map(|q| (0..kernel).map(move |k| (q, k))) {
                if let Some(x) = (stride * q + k).checked_sub(padding).filter(|&x| x < fine) {
                    expected.push((x, q, k));
                }
            }
            expected.sort_unstable();
            for (correlation, upward) in [(coupling.downward(), false), (coupling.upward(), true)] {
                let mut found = Vec::new();
                for set in &correlation.sets {
                    for (j, tap) in (0..correlation.grid[2]).flat_map(|j| set.taps.iter().map(move |tap| (j, tap))) {
                        let target = correlation.target_stride[2] * j + set.target_phase[2];
                        let source =
                            correlation.source_stride[2] as isize * (j as isize + tap.shift[2]) + tap.phase[2] as isize;
                        let inside = source >= 0 && (source as usize) < correlation.source[2];
                        if target < correlation.target[2] && inside {
                            let source = source as usize;
                            found.push(if upward {
                                (target, source, tap.weight)
                            } else {
                                (source, target, tap.weight)
                            });
                        }
                    }
                }
                found.sort_unstable();
                assert_eq!(found, expected, "kernel {kernel}, stride {stride}, fine {fine}, upward {upward}");
            }
        }
    }
}

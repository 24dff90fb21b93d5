//! Sums over many values: short runs in vectors of `f32`, then in `f64`, so that a megapixel's mean is good to the last digits.

use crate::lanes::Lanes;
use crate::path::{Kernel, Path};
use rayon::prelude::*;

/// Values that are added in `f32` before the sum goes into an `f64`.
pub(crate) const RUN: usize = 4096;

/// The sum over batch and positions for each channel of `[batch, channel, positions]`.
pub(crate) fn channel_sums(path: Path, values: &[f32], batch: usize, channels: usize) -> Vec<f32> {
    let positions = values.len() / (batch * channels);
    (0..channels)
        .into_par_iter()
        .map(|channel| {
            let planes = (0..batch).map(|n| &values[(n * channels + channel) * positions..][..positions]);
            planes.map(|plane| path.run(Sum(plane))).sum::<f64>() as f32
        })
        .collect()
}

/// The sum of a slice.
pub(crate) struct Sum<'a>(pub &'a [f32]);

impl Kernel for Sum<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> f64 {
        let mut total = 0.0;
        for run in self.0.chunks(RUN) {
            // Four sums hide the latency of the additions.
            let mut sums = [lanes.splat(0.0); 4];
            let mut quads = run.chunks_exact(4 * L::COUNT);
            for quad in &mut quads {
                for i in 0..4 {
                    // SAFETY: the quad has four vectors.
                    sums[i] = lanes.add(sums[i], unsafe { lanes.load(quad.as_ptr().add(i * L::COUNT)) });
                }
            }
            total += f64::from(lanes.sum(lanes.add(lanes.add(sums[0], sums[1]), lanes.add(sums[2], sums[3]))));
            for &value in quads.remainder() {
                total += f64::from(value);
            }
        }
        total
    }
}

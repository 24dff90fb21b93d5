//! Batch norm, its folding, and max-pool against their definitions in `f64`.
#![allow(missing_docs, clippy::print_stderr)]

mod reference;

use reference::{noise, on_threads, paths};
use tiltline_kernels::{Activation, BatchNorm, BatchNormStatistics, Conv, MaxPool, ShapeError, fold_batch_norm};

const EPSILON: f64 = 1e-5;

/// Batch norm by its definition; the loss is `<output, gy>`.
struct Norm<'a> {
    shape: [usize; 3],
    gamma: &'a [f64],
    beta: &'a [f64],
    relu: bool,
}

impl Norm<'_> {
    fn channel(&self, index: usize) -> usize {
        index / self.shape[2] % self.shape[1]
    }

    /// Mean and biased variance of each channel.
    fn statistics(&self, x: &[f64]) -> Vec<[f64; 2]> {
        let of = |channel| x.iter().enumerate().filter(move |&(i, _)| self.channel(i) == channel).map(|(_, &x)| x);
        let count = (self.shape[0] * self.shape[2]) as f64;
        (0..self.shape[1])
            .map(|channel| {
                let mean = of(channel).sum::<f64>() / count;
                [mean, of(channel).map(|x| (x - mean).powi(2)).sum::<f64>() / count]
            })
            .collect()
    }

    fn forward(&self, x: &[f64]) -> Vec<f64> {
        let statistics = self.statistics(x);
        let normalise = |(i, &x): (usize, &f64)| {
            let channel = self.channel(i);
            let [mean, variance] = statistics[channel];
            let y = self.gamma[channel] * (x - mean) / (variance + EPSILON).sqrt() + self.beta[channel];
            if self.relu { y.max(0.0) } else { y }
        };
        x.iter().enumerate().map(normalise).collect()
    }

    fn loss(&self, x: &[f64], gy: &[f64]) -> f64 {
        self.forward(x).iter().zip(gy).map(|(y, g)| y * g).sum()
    }
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&value| f64::from(value)).collect()
}

const NORM_SHAPES: [[usize; 3]; 8] =
    [[1, 1, 2], [2, 3, 1], [1, 5, 15], [2, 3, 17], [3, 1, 63], [1, 2, 130], [1, 1, 4097], [2, 2, 9000]];

fn close(found: f32, expected: f64, tolerance: f64) -> bool {
    (f64::from(found) - expected).abs() <= tolerance
}

#[test]
fn batch_norm_is_its_definition() {
    for shape @ [batch, channels, positions] in NORM_SHAPES {
        if cfg!(miri) && positions > 200 {
            continue;
        }
        let norm = BatchNorm::new(batch, channels, positions, EPSILON).expect("a good shape");
        // An offset, so that forgetting the mean shows.
        let x: Vec<f32> = noise(norm.len(), 1).iter().map(|x| x + 0.5).collect();
        let (gamma, beta) = (noise(channels, 2), noise(channels, 3));
        for (path, relu) in paths().into_iter().flat_map(|path| [(path, false), (path, true)]) {
            let activation = if relu { Activation::Relu } else { Activation::Identity };
            let definition = Norm { shape, gamma: &wide(&gamma), beta: &wide(&beta), relu };
            let found = norm.forward(path, &x, &gamma, &beta, activation);
            let expected = definition.forward(&wide(&x));
            let statistics = definition.statistics(&wide(&x));
            for (channel, &[mean, variance]) in statistics.iter().enumerate() {
                assert!(close(found.mean[channel], mean, 1e-6), "{shape:?}");
                assert!(close(found.variance[channel], variance, 1e-6), "{shape:?}");
                let inverse = 1.0 / (variance + EPSILON).sqrt();
                // Of two values, a nearly equal pair has a variance with few digits left.
                assert!(close(found.inverse_deviation[channel], inverse, 1e-4 * inverse), "{shape:?}");
            }
            // The tolerance grows with 1 / deviation, by which rounding errors of x are multiplied.
            for (i, (&y, &expected)) in found.output.iter().zip(&expected).enumerate() {
                let inverse = f64::from(found.inverse_deviation[definition.channel(i)]);
                assert!(
                    close(y, expected, 2e-6 * (1.0 + inverse)),
                    "{shape:?} on {}: {y} and {expected}",
                    path.instructions()
                );
            }
        }
    }
}

/// Central differences of the definition's loss. A value close to the kink of ReLU has no slope: those are left out.
#[test]
#[cfg_attr(miri, ignore = "too slow")]
fn batch_norm_gradients_are_slopes() {
    for shape @ [batch, channels, positions] in [[1, 1, 15], [2, 3, 17], [3, 2, 40], [1, 2, 130]] {
        let norm = BatchNorm::new(batch, channels, positions, EPSILON).expect("a good shape");
        let x: Vec<f32> = noise(norm.len(), 4).iter().map(|x| x + 0.5).collect();
        let (gamma, beta, gy) = (noise(channels, 5), noise(channels, 6), noise(norm.len(), 7));
        for (path, relu) in paths().into_iter().flat_map(|path| [(path, false), (path, true)]) {
            let activation = if relu { Activation::Relu } else { Activation::Identity };
            let forward = norm.forward(path, &x, &gamma, &beta, activation);
            let found =
                norm.backward(path, &x, &gamma, &beta, &forward.mean, &forward.inverse_deviation, activation, &gy);
            let gy = wide(&gy);
            let linear = Norm { shape, gamma: &wide(&gamma), beta: &wide(&beta), relu: false };
            if relu {
                let nearest = linear.forward(&wide(&x)).into_iter().map(f64::abs).fold(f64::MAX, f64::min);
                assert!(nearest > 1e-5, "choose another seed: a value lies {nearest} from the kink");
            }
            let step = 1e-6;
            let slope = |values: &[f32], i: usize, loss: &dyn Fn(&[f64]) -> f64| {
                let mut values = wide(values);
                values[i] += step;
                let above = loss(&values);
                values[i] -= 2.0 * step;
                (above - loss(&values)) / (2.0 * step)
            };
            let (g, b) = (wide(&gamma), wide(&beta));
            let what = format!("{shape:?} on {}, relu {relu}", path.instructions());
            for i in 0..x.len() {
                let definition = Norm { shape, gamma: &g, beta: &b, relu };
                let expected = slope(&x, i, &|x| definition.loss(x, &gy));
                assert!(close(found.input[i], expected, 1e-5), "{what}: input {i}: {} and {expected}", found.input[i]);
            }
            for i in 0..channels {
                let expected = slope(&gamma, i, &|gamma| Norm { shape, gamma, beta: &b, relu }.loss(&wide(&x), &gy));
                assert!(close(found.gamma[i], expected, 1e-4), "{what}: gamma {i}: {} and {expected}", found.gamma[i]);
                let expected = slope(&beta, i, &|beta| Norm { shape, gamma: &g, beta, relu }.loss(&wide(&x), &gy));
                assert!(close(found.beta[i], expected, 1e-4), "{what}: beta {i}: {} and {expected}", found.beta[i]);
            }
        }
    }
}

/// One folded convolution does what the convolution and a batch norm with the same statistics do.
#[test]
fn folded_norm_equals_norm_after_convolution() {
    let (inputs, outputs, size) = (3, 5, [6, 9]);
    let conv = Conv::plane(1, inputs, outputs, size, 1).expect("a good shape");
    let norm = BatchNorm::new(1, outputs, size[0] * size[1], EPSILON).expect("a good shape");
    let (x, w, bias) = (noise(conv.input_len(), 1), noise(conv.weight_len(), 2), noise(outputs, 3));
    let (gamma, beta) = (noise(outputs, 4), noise(outputs, 5));
    for (path, bias) in paths().into_iter().flat_map(|path| [(path, None), (path, Some(&bias[..]))]) {
        let convolved = conv.forward(path, &x, &w, bias, Activation::Identity);
        let expected = norm.forward(path, &convolved, &gamma, &beta, Activation::Relu);
        let statistics = BatchNormStatistics {
            gamma: &gamma,
            beta: &beta,
            mean: &expected.mean,
            variance: &expected.variance,
            epsilon: EPSILON,
        };
        let (folded_weight, folded_bias) = fold_batch_norm(&w, bias, &statistics);
        let found = conv.forward(path, &x, &folded_weight, Some(&folded_bias), Activation::Relu);
        for (found, expected) in found.iter().zip(&expected.output) {
            // Values of order 1, each a sum of 27 rounded products.
            assert!((found - expected).abs() < 1e-5, "{found} and {expected}");
        }
    }
}

#[test]
fn max_pool_by_hand() {
    // An odd row and column are left out; equal values: the first in reading order gets the gradient.
    #[rustfmt::skip]
    let x = [
        1.0, 2.0,  5.0, 5.0,  9.0,
        3.0, 0.0,  5.0, 4.0,  9.0,
        -1.0, -2.0,  0.0, 1.0,  9.0,
        -4.0, -0.5,  1.0, 2.0,  9.0,
        9.0, 9.0,  9.0, 9.0,  9.0,
    ];
    #[rustfmt::skip]
    let gradient = [
        0.0, 0.0,  20.0, 0.0,  0.0,
        10.0, 0.0,  0.0, 0.0,  0.0,
        0.0, 0.0,  0.0, 0.0,  0.0,
        0.0, 30.0,  0.0, 40.0,  0.0,
        0.0, 0.0,  0.0, 0.0,  0.0,
    ];
    let pool = MaxPool::new(1, [5, 5]).expect("a good shape");
    for path in paths() {
        assert_eq!(pool.forward(path, &x), [3.0, 5.0, -0.5, 2.0]);
        assert_eq!(pool.input_gradient(path, &x, &[10.0, 20.0, 30.0, 40.0]), gradient);
    }
}

#[test]
fn max_pool_is_its_definition() {
    for (planes, [rows, columns]) in [(1, [2, 2]), (3, [3, 2]), (2, [2, 33]), (5, [7, 64]), (2, [6, 67]), (1, [4, 130])]
    {
        let pool = MaxPool::new(planes, [rows, columns]).expect("a good shape");
        // Few different values, so that there are ties.
        let x: Vec<f32> = noise(pool.input_len(), 1).iter().map(|x| (x * 3.0).round()).collect();
        let gy = noise(pool.output_len(), 2);
        let (mut y, mut gx) = (Vec::new(), vec![0.0; x.len()]);
        for plane in 0..planes {
            for (row, column) in (0..rows / 2).flat_map(|row| (0..columns / 2).map(move |column| (row, column))) {
                let at = |i: usize| (plane * rows + 2 * row + i / 2) * columns + 2 * column + i % 2;
                let first_largest = (1..4).fold(0, |best, i| if x[at(i)] > x[at(best)] { i } else { best });
                gx[at(first_largest)] = gy[y.len()];
                y.push(x[at(first_largest)]);
            }
        }
        for path in paths() {
            assert_eq!(pool.forward(path, &x), y, "{planes} of {rows}x{columns} on {}", path.instructions());
            assert_eq!(
                pool.input_gradient(path, &x, &gy),
                gx,
                "{planes} of {rows}x{columns} on {}",
                path.instructions()
            );
        }
    }
}

#[test]
fn max_pool_passes_nan_on() {
    let pool = MaxPool::new(1, [2, 2]).expect("a good shape");
    for (path, place) in paths().into_iter().flat_map(|path| (0..4).map(move |place| (path, place))) {
        let mut x = [1.0, 2.0, 3.0, 4.0];
        x[place] = f32::NAN;
        assert!(pool.forward(path, &x)[0].is_nan());
    }
    assert!(matches!(MaxPool::new(1, [1, 4]), Err(ShapeError::Zero(_))));
}

#[test]
#[cfg_attr(miri, ignore = "too slow")]
fn threads_change_no_bit() {
    let norm = BatchNorm::new(2, 7, 5000, EPSILON).expect("a good shape");
    let (x, gy) = (noise(norm.len(), 1), noise(norm.len(), 2));
    let (gamma, beta) = (noise(7, 3), noise(7, 4));
    for path in paths() {
        let all = || {
            let forward = norm.forward(path, &x, &gamma, &beta, Activation::Relu);
            let (mean, deviation) = (&forward.mean, &forward.inverse_deviation);
            let backward = norm.backward(path, &x, &gamma, &beta, mean, deviation, Activation::Relu, &gy);
            [forward.output, forward.mean, forward.variance, backward.input, backward.gamma, backward.beta]
                .map(|values| values.into_iter().map(f32::to_bits).collect::<Vec<_>>())
        };
        let one = on_threads(1, all);
        for threads in [2, 5] {
            assert!(one == on_threads(threads, all), "on {} with {threads} threads", path.instructions());
        }
    }
}

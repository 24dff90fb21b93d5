//! Convolutions against their definition, and their gradients against the definition, finite differences and the adjoint law.
#![allow(missing_docs, clippy::print_stderr)]

mod reference;

use proptest::prelude::*;
use reference::{Definition, dot, noise, on_threads, paths};
use tiltline_kernels::{Activation, Path};

/// One, odd, just below and above the lengths of vectors, and more than a tile.
const SIDES: [[usize; 2]; 9] = [[1, 1], [1, 5], [5, 1], [2, 2], [3, 15], [4, 16], [5, 17], [7, 33], [9, 67]];
const CHANNELS: [[usize; 2]; 7] = [[1, 1], [3, 5], [5, 3], [17, 1], [1, 17], [8, 9], [4, 12]];

/// Shapes of one kind; `depths` are the depths to try.
fn shapes(make: impl Fn(usize, usize, usize, [usize; 3]) -> Definition, depths: &[usize]) -> Vec<Definition> {
    let mut shapes = Vec::new();
    for &depth in depths {
        for (s, [rows, columns]) in SIDES.into_iter().enumerate() {
            for (c, [inputs, outputs]) in CHANNELS.into_iter().enumerate() {
                let batch = 1 + (s + c) % 2;
                shapes.push(make(batch, inputs, outputs, [depth, rows, columns]));
            }
        }
    }
    if cfg!(miri) {
        // Miri is some thousand times slower: a few of the smaller ones.
        shapes.retain(|shape| shape.output_len() * shape.weight_len() / shape.outputs < 5000);
        shapes = shapes.iter().copied().step_by(shapes.len() / 3).collect();
    }
    shapes
}

fn check(definition: Definition, path: Path) {
    let shape = definition.kernel_shape().expect("a good shape");
    let what = |part: &str| format!("{part} of {definition:?} on {}", path.instructions());
    assert_eq!(on!(shape, input_len()), definition.input_len());
    assert_eq!(on!(shape, weight_len()), definition.weight_len());
    assert_eq!(on!(shape, output_len()), definition.output_len());
    if definition.kernel != [1; 3] {
        assert_eq!(on!(shape, output_size()), definition.output_size());
    }
    let x = noise(definition.input_len(), 1);
    let w = noise(definition.weight_len(), 2);
    let gy = noise(definition.output_len(), 3);
    let bias = noise(definition.outputs, 4);

    let y = on!(shape, forward(path, &x, &w, None, Activation::Identity));
    definition.forward(&x, &w).assert_close(&y, &what("output"));
    let gx = on!(shape, input_gradient(path, &gy, &w));
    definition.input_gradient(&w, &gy).assert_close(&gx, &what("input gradient"));
    let gw = on!(shape, weight_gradient(path, &x, &gy));
    definition.weight_gradient(&x, &gy).assert_close(&gw, &what("weight gradient"));

    // With bias and ReLU.
    let mut expected = definition.forward(&x, &w);
    for i in 0..expected.values.len() {
        expected.add(i, bias[definition.channel_of_output(i)], 1.0);
        expected.values[i] = expected.values[i].max(0.0);
    }
    let y_relu = on!(shape, forward(path, &x, &w, Some(&bias), Activation::Relu));
    expected.assert_close(&y_relu, &what("biased, rectified output"));
    let gb = on!(shape, bias_gradient(path, &gy));
    for (channel, &found) in gb.iter().enumerate() {
        let terms = || {
            gy.iter()
                .enumerate()
                .filter(|&(i, _)| definition.channel_of_output(i) == channel)
                .map(|(_, &g)| f64::from(g))
        };
        let tolerance = 4.0 * f64::from(f32::EPSILON) * terms().map(f64::abs).sum::<f64>();
        assert!((f64::from(found) - terms().sum::<f64>()).abs() <= tolerance, "{}", what("bias gradient"));
    }

    // <conv(x), gy> = <x, conv'(gy)> = <w, gw>, up to the rounding of a sum of random signs.
    let law = dot(&y, &gy);
    let size = (dot(&y, &y) * dot(&gy, &gy)).sqrt();
    for (other, name) in [(dot(&x, &gx), "input"), (dot(&w, &gw), "weight")] {
        assert!((law - other).abs() <= 1e-6 * size, "adjoint law, {}: {law} and {other}", what(name));
    }
}

fn check_all(definitions: Vec<Definition>) {
    for path in paths() {
        for &definition in &definitions {
            check(definition, path);
        }
    }
}

#[test]
fn plane_3x3() {
    check_all(shapes(|n, i, o, size| Definition::conv([1, 3, 3], 1, n, i, o, size), &[1]));
}

#[test]
fn plane_3x3_stride_2() {
    check_all(shapes(|n, i, o, size| Definition::conv([1, 3, 3], 2, n, i, o, size), &[1]));
}

#[test]
fn volume_3x3x3() {
    check_all(shapes(|n, i, o, size| Definition::conv([3; 3], 1, n, i, o, size), &[1, 2, 3]));
}

#[test]
fn volume_3x3x3_stride_2() {
    check_all(shapes(|n, i, o, size| Definition::conv([3; 3], 2, n, i, o, size), &[1, 2, 5]));
}

#[test]
fn pointwise() {
    check_all(shapes(|n, i, o, size| Definition::conv([1; 3], 1, n, i, o, size), &[1, 3]));
}

#[test]
fn transposed_2x2() {
    check_all(shapes(|n, i, o, size| Definition::transposed([1, 2, 2], n, i, o, size), &[1]));
}

#[test]
fn transposed_3x3x3() {
    check_all(shapes(|n, i, o, size| Definition::transposed([3; 3], n, i, o, size), &[1, 3]));
}

/// Shapes that need several blocks of rows and of columns, several steps in depth, and several groups of channels.
fn large() -> Vec<Definition> {
    vec![
        Definition::conv([1, 3, 3], 1, 1, 33, 9, [1, 40, 150]),
        Definition::conv([1, 3, 3], 1, 1, 2, 3, [1, 20, 1100]),
        Definition::conv([1, 3, 3], 1, 2, 70, 66, [1, 17, 13]),
        Definition::conv([1, 3, 3], 2, 1, 40, 10, [1, 61, 301]),
        Definition::conv([3; 3], 1, 1, 12, 8, [19, 30, 41]),
        Definition::conv([3; 3], 2, 1, 24, 9, [19, 30, 63]),
        Definition::conv([1; 3], 1, 1, 20, 11, [1, 70, 71]),
        Definition::transposed([1, 2, 2], 1, 34, 9, [1, 40, 170]),
        Definition::transposed([3; 3], 1, 20, 9, [9, 15, 40]),
    ]
}

#[test]
#[cfg_attr(miri, ignore = "too slow")]
fn many_blocks() {
    check_all(large());
}

/// Each gradient, at some elements, is the slope of the defined loss `<forward(x, w), gy>`.
///
/// The loss is linear in each argument, so that central differences have no truncation error, and a step of 1 is best.
#[test]
#[cfg_attr(miri, ignore = "too slow")]
fn gradients_are_slopes() {
    for definition in [
        Definition::conv([1, 3, 3], 1, 2, 3, 5, [1, 6, 17]),
        Definition::conv([1, 3, 3], 2, 1, 3, 5, [1, 7, 18]),
        Definition::conv([3; 3], 1, 1, 3, 2, [3, 4, 9]),
        Definition::conv([3; 3], 2, 1, 2, 3, [4, 5, 9]),
        Definition::conv([1; 3], 1, 2, 3, 5, [1, 6, 17]),
        Definition::transposed([1, 2, 2], 2, 3, 5, [1, 5, 9]),
        Definition::transposed([3; 3], 1, 3, 2, [2, 3, 5]),
    ] {
        let shape = definition.kernel_shape().expect("a good shape");
        let (x, w) = (noise(definition.input_len(), 5), noise(definition.weight_len(), 6));
        let gy = noise(definition.output_len(), 7);
        let loss = |x: &[f32], w: &[f32]| {
            definition.forward(x, w).values.iter().zip(&gy).map(|(y, &g)| y * f64::from(g)).sum::<f64>()
        };
        let slope = |values: &[f32], i: usize, loss: &dyn Fn(&[f32]) -> f64| {
            let (mut above, mut below) = (values.to_vec(), values.to_vec());
            above[i] += 1.0;
            below[i] -= 1.0;
            let step = f64::from(above[i]) - f64::from(below[i]);
            (loss(&above) - loss(&below)) / step
        };
        for path in paths() {
            let gx = on!(shape, input_gradient(path, &gy, &w));
            let gw = on!(shape, weight_gradient(path, &x, &gy));
            for i in (0..x.len()).step_by(1 + x.len() / 20) {
                let expected = slope(&x, i, &|x| loss(x, &w));
                assert!((f64::from(gx[i]) - expected).abs() < 1e-4, "{definition:?}: {} and {expected}", gx[i]);
            }
            for i in (0..w.len()).step_by(1 + w.len() / 20) {
                let expected = slope(&w, i, &|w| loss(&x, w));
                assert!((f64::from(gw[i]) - expected).abs() < 1e-4, "{definition:?}: {} and {expected}", gw[i]);
            }
        }
    }
}

#[test]
#[cfg_attr(miri, ignore = "too slow")]
fn threads_change_no_bit() {
    for definition in large() {
        let shape = definition.kernel_shape().expect("a good shape");
        let (x, w) = (noise(definition.input_len(), 8), noise(definition.weight_len(), 9));
        let gy = noise(definition.output_len(), 10);
        for path in paths() {
            let all = || {
                [
                    on!(shape, forward(path, &x, &w, None, Activation::Identity)),
                    on!(shape, input_gradient(path, &gy, &w)),
                    on!(shape, weight_gradient(path, &x, &gy)),
                    on!(shape, bias_gradient(path, &gy)),
                ]
                .map(|values| values.into_iter().map(f32::to_bits).collect::<Vec<_>>())
            };
            let one = on_threads(1, all);
            for threads in [2, 5] {
                assert!(
                    one == on_threads(threads, all),
                    "{definition:?} on {} with {threads} threads",
                    path.instructions()
                );
            }
        }
    }
}

/// What a channel's neighbours hold must not leak into it, even where it is not finite.
#[test]
fn not_a_number_stays_in_its_batch_entry() {
    let definition = Definition::conv([1, 3, 3], 1, 2, 2, 3, [1, 5, 6]);
    let shape = definition.kernel_shape().expect("a good shape");
    let mut x = noise(definition.input_len(), 11);
    let w = noise(definition.weight_len(), 12);
    x[..definition.input_len() / 2].fill(f32::NAN);
    for path in paths() {
        let y = on!(shape, forward(path, &x, &w, None, Activation::Identity));
        let (first, second) = y.split_at(y.len() / 2);
        assert!(first.iter().all(|y| y.is_nan()));
        assert!(second.iter().all(|y| y.is_finite()));
        // ReLU must not hide it.
        let y = on!(shape, forward(path, &x, &w, None, Activation::Relu));
        assert!(y[..y.len() / 2].iter().all(|y| y.is_nan()));
    }
}

#[test]
fn bad_shapes_are_refused() {
    use tiltline_kernels::{Conv, ShapeError};
    assert_eq!(Conv::plane(1, 1, 1, [4, 4], 3), Err(ShapeError::Stride(3)));
    assert!(matches!(Conv::plane(1, 0, 1, [4, 4], 1), Err(ShapeError::Zero(_))));
    assert!(matches!(Conv::volume(1, 1, 1, [1 << 30, 1 << 30, 4], 1), Err(ShapeError::TooLarge(_))));
    let error = Conv::plane(1, 1, 1, [0, 4], 1).expect_err("no rows");
    assert!(error.to_string().contains("rows 0"), "{error}");
}

#[test]
#[should_panic(expected = "the weight has 8 elements, its shape asks for 9")]
fn wrong_lengths_panic() {
    let conv = tiltline_kernels::Conv::plane(1, 1, 1, [2, 2], 1).expect("a good shape");
    let _ = conv.forward(Path::best(), &[0.0; 4], &[0.0; 8], None, Activation::Identity);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    #[cfg_attr(miri, ignore = "too slow")]
    fn any_shape(
        kind in 0..7,
        batch in 1..3_usize,
        inputs in 1..20_usize,
        outputs in 1..20_usize,
        depth in 1..6_usize,
        rows in 1..14_usize,
        columns in 1..54_usize,
    ) {
        let (plane, volume) = ([1, rows, columns], [depth, rows, columns]);
        let definition = match kind {
            0 => Definition::conv([1, 3, 3], 1, batch, inputs, outputs, plane),
            1 => Definition::conv([1, 3, 3], 2, batch, inputs, outputs, plane),
            2 => Definition::conv([3; 3], 1, batch, inputs, outputs, volume),
            3 => Definition::conv([3; 3], 2, batch, inputs, outputs, volume),
            4 => Definition::conv([1; 3], 1, batch, inputs, outputs, volume),
            5 => Definition::transposed([1, 2, 2], batch, inputs, outputs, plane),
            _ => Definition::transposed([3; 3], batch, inputs, outputs, volume),
        };
        check_all(vec![definition]);
    }
}

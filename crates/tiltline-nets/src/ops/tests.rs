//! Our kernels against burn's own operations, values and gradients, over odd shapes.

use burn::tensor::TensorData;
use burn::tensor::activation::relu;

use super::*;

fn random<const D: usize>(shape: [usize; D], seed: u64, device: &Device) -> Tensor<D> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let values: Vec<f32> = (0..shape.iter().product::<usize>())
        .map(|_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1_u64 << 23) as f32 - 1.0
        })
        .collect();
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn host<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_to_vec().unwrap()
}

/// Relative difference in the L2 norm. Sums over up to 1000 products in another order differ by about 1e-6.
fn assert_near(what: &str, ours: &[f32], theirs: &[f32]) {
    assert_eq!(ours.len(), theirs.len(), "{what}");
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|value| value * value).sum::<f64>().sqrt();
    let difference = norm(&mut ours.iter().zip(theirs).map(|(a, b)| f64::from(a - b)));
    let size = norm(&mut theirs.iter().map(|value| f64::from(*value)));
    assert!(size > 0.0 && difference < 2e-5 * size, "{what}: {difference} of {size}");
}

fn agrees<const D: usize>(kernel: Kernel, shape: [usize; D], out: usize) {
    let device = Device::flex().autodiff();
    let side = match (kernel, D) {
        (Kernel::Pointwise, _) => 1,
        (Kernel::Double, 4) => 2,
        _ => 3,
    };
    let mut weight_shape = [side; D];
    [weight_shape[0], weight_shape[1]] = if kernel == Kernel::Double { [shape[1], out] } else { [out, shape[1]] };
    let leaves = || {
        let x = random(shape, 1, &device).require_grad();
        (x, random(weight_shape, 2, &device).require_grad(), random([out], 3, &device).require_grad())
    };
    let run = |ours: bool| {
        let (x, w, b) = leaves();
        let y = if ours {
            convolve(kernel, x.clone(), w.clone(), Some(b.clone()), false)
        } else {
            burn_convolve(kernel, x.clone(), w.clone(), Some(b.clone()))
        };
        let g = random(y.dims(), 4, &device);
        let gradients = y.clone().mul(g).sum().backward();
        let values = host(y.inner());
        [
            values,
            host(x.grad(&gradients).unwrap()),
            host(w.grad(&gradients).unwrap()),
            host(b.grad(&gradients).unwrap()),
        ]
    };
    let names = ["output", "input's gradient", "weight's gradient", "bias's gradient"];
    for ((ours, theirs), name) in run(true).iter().zip(&run(false)).zip(names) {
        assert_near(&format!("{kernel:?} {shape:?} {name}"), ours, theirs);
    }
}

#[test]
fn convolutions_agree_with_burns() {
    for stride in [1, 2] {
        agrees(Kernel::Same { stride }, [2, 3, 13, 17], 5);
        agrees(Kernel::Same { stride }, [1, 4, 5, 9, 11], 6);
    }
    agrees(Kernel::Pointwise, [2, 5, 7, 3], 4);
    agrees(Kernel::Pointwise, [1, 5, 2, 7, 3], 1);
    agrees(Kernel::Double, [2, 6, 5, 7], 3);
    agrees(Kernel::Double, [1, 4, 3, 5, 6], 7);
}

#[test]
fn batch_norm_with_relu_agrees_with_burns() {
    let device = Device::flex().autodiff();
    let run = |ours: bool| {
        let x = random([3, 4, 9, 5], 1, &device).require_grad();
        let gamma = random([4], 2, &device).add_scalar(1.5).require_grad();
        let beta = random([4], 3, &device).require_grad();
        let y = if ours {
            normalise(x.clone(), gamma.clone(), beta.clone(), 1e-5, true).0
        } else {
            relu(burn::tensor::module::batch_norm_train(x.clone(), gamma.clone(), beta.clone(), 1e-5).output)
        };
        let g = random(y.dims(), 4, &device);
        let gradients = y.clone().mul(g).sum().backward();
        let grads = [gamma.grad(&gradients).unwrap(), beta.grad(&gradients).unwrap()].map(host);
        (host(y.inner()), host(x.grad(&gradients).unwrap()), grads)
    };
    let (ours, theirs) = (run(true), run(false));
    assert_near("output", &ours.0, &theirs.0);
    assert_near("input's gradient", &ours.1, &theirs.1);
    assert_near("gamma's gradient", &ours.2[0], &theirs.2[0]);
    assert_near("beta's gradient", &ours.2[1], &theirs.2[1]);
}

#[test]
fn max_pool_agrees_with_burns() {
    let device = Device::flex().autodiff();
    let run = |ours: bool| {
        let x = random([2, 3, 8, 10], 1, &device).require_grad();
        let y = if ours {
            max_pool(x.clone())
        } else {
            burn::tensor::module::max_pool2d(x.clone(), MaxPoolOptions::new([2; 2]).with_stride([2; 2]))
        };
        let gradients = y.clone().mul(random(y.dims(), 2, &device)).sum().backward();
        (host(y.inner()), host(x.grad(&gradients).unwrap()))
    };
    let (ours, theirs) = (run(true), run(false));
    assert_eq!(ours.0, theirs.0);
    assert_eq!(ours.1, theirs.1);
}

/// Inference's ReLU is the same as one after the fact.
#[test]
fn a_fused_relu_is_a_relu() {
    let device = Device::flex();
    let (x, w, b) = (random([1, 2, 6, 7], 1, &device), random([3, 2, 3, 3], 2, &device), random([3], 3, &device));
    let kernel = Kernel::Same { stride: 1 };
    let fused = host(convolve(kernel, x.clone(), w.clone(), Some(b.clone()), true));
    assert_eq!(fused, host(relu(convolve(kernel, x, w, Some(b), false))));
}

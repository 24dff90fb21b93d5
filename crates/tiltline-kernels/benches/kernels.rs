//! `cargo bench -p tiltline-kernels --bench kernels [-- FILTER]`: the convolutions of the matcher and of a 16-channel U-Net on 512x512.
//!
//! criterion prints the throughput in operations (multiply and add counted as two): Gelem/s are GFLOP/s.
#![allow(missing_docs)]

use criterion::{BenchmarkGroup, Criterion, Throughput, criterion_group, criterion_main, measurement::WallTime};
use std::hint::black_box;
use tiltline_kernels::{Activation, BatchNorm, Conv, Instructions, MaxPool, Path, ShapeError, TransposedConv};

fn noise(len: usize) -> Vec<f32> {
    let mut state = 1_u32;
    (0..len)
        .map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 23) as f32 - 1.0
        })
        .collect()
}

/// Benchmarks forward pass and both gradients of either kind of convolution.
macro_rules! bench {
    ($group:expr, $path:expr, $name:expr, $shape:expr, $operations:expr) => {{
        let (group, path, name, shape): (&mut BenchmarkGroup<WallTime>, Path, String, _) =
            ($group, $path, $name, $shape);
        let (x, w, gy) = (noise(shape.input_len()), noise(shape.weight_len()), noise(shape.output_len()));
        group.throughput(Throughput::Elements($operations as u64));
        group.bench_function(format!("{name} forward"), |bencher| {
            bencher.iter(|| black_box(shape.forward(path, &x, &w, None, Activation::Identity)));
        });
        group.bench_function(format!("{name} input gradient"), |bencher| {
            bencher.iter(|| black_box(shape.input_gradient(path, &gy, &w)));
        });
        group.bench_function(format!("{name} weight gradient"), |bencher| {
            bencher.iter(|| black_box(shape.weight_gradient(path, &x, &gy)));
        });
    }};
}

/// The convolution that the matcher spends its time in, on each path of the machine, and its neighbours.
fn matcher(criterion: &mut Criterion) -> Result<(), ShapeError> {
    let mut group = criterion.benchmark_group("24x128x128");
    group.sample_size(10);
    let size = [24, 128, 128];
    let pairs =
        |channels: usize, size: [usize; 3], kernel: usize| 2 * channels * size.iter().product::<usize>() * kernel;
    for path in Instructions::ALL.into_iter().filter_map(Path::forced) {
        let name = format!("3x3x3 32->32 on {}", path.instructions());
        bench!(&mut group, path, name, Conv::volume(1, 32, 32, size, 1)?, pairs(32 * 32, size, 27));
    }
    let path = Path::best();
    let half = size.map(|side| side / 2);
    bench!(
        &mut group,
        path,
        "3x3x3 32->64 stride 2".into(),
        Conv::volume(1, 32, 64, size, 2)?,
        pairs(32 * 64, half, 27)
    );
    bench!(
        &mut group,
        path,
        "3x3x3 transposed 64->32".into(),
        TransposedConv::volume(1, 64, 32, half)?,
        pairs(32 * 64, half, 27)
    );
    bench!(&mut group, path, "3x3x3 32->1".into(), Conv::volume(1, 32, 1, size, 1)?, pairs(32, size, 27));
    bench!(
        &mut group,
        path,
        "1x1x1 32->32".into(),
        Conv::pointwise(1, 32, 32, 24 * 128 * 128)?,
        pairs(32 * 32, size, 1)
    );
    group.finish();
    Ok(())
}

/// The layers of a U-Net of 16 base channels and 4 levels below the first.
fn unet(criterion: &mut Criterion) -> Result<(), ShapeError> {
    let mut group = criterion.benchmark_group("U-Net 512x512");
    group.sample_size(10);
    let path = Path::best();
    for (side, inputs, outputs) in [
        (512, 1, 16),
        (512, 16, 16),
        (512, 32, 16),
        (256, 32, 32),
        (256, 64, 32),
        (128, 64, 64),
        (64, 128, 128),
        (32, 256, 256),
    ] {
        let name = format!("3x3 {inputs}->{outputs} on {side}");
        bench!(
            &mut group,
            path,
            name,
            Conv::plane(1, inputs, outputs, [side; 2], 1)?,
            18 * inputs * outputs * side * side
        );
    }
    let name = "2x2 transposed 32->16 on 256".to_owned();
    bench!(&mut group, path, name, TransposedConv::plane(1, 32, 16, [256; 2])?, 8 * 32 * 16 * 256 * 256);
    let name = "3x3 16->32 stride 2 on 512".to_owned();
    bench!(&mut group, path, name, Conv::plane(1, 16, 32, [512; 2], 2)?, 18 * 16 * 32 * 256 * 256);

    let norm = BatchNorm::new(1, 16, 512 * 512, 1e-5)?;
    let (x, gy) = (noise(norm.len()), noise(norm.len()));
    let (gamma, beta) = ([1.0; 16], [0.0; 16]);
    group.throughput(Throughput::Bytes(4 * norm.len() as u64));
    group.bench_function("batch norm + ReLU, 16 channels, forward", |bencher| {
        bencher.iter(|| black_box(norm.forward(path, &x, &gamma, &beta, Activation::Relu)));
    });
    let found = norm.forward(path, &x, &gamma, &beta, Activation::Relu);
    group.bench_function("batch norm + ReLU, 16 channels, backward", |bencher| {
        let (mean, deviation) = (&found.mean, &found.inverse_deviation);
        bencher.iter(|| black_box(norm.backward(path, &x, &gamma, &beta, mean, deviation, Activation::Relu, &gy)));
    });
    let pool = MaxPool::new(16, [512; 2])?;
    group.bench_function("2x2 max-pool, 16 channels, forward", |bencher| {
        bencher.iter(|| black_box(pool.forward(path, &x)));
    });
    let gradient = noise(pool.output_len());
    group.bench_function("2x2 max-pool, 16 channels, backward", |bencher| {
        bencher.iter(|| black_box(pool.input_gradient(path, &x, &gradient)));
    });
    group.finish();
    Ok(())
}

fn all(criterion: &mut Criterion) {
    matcher(criterion).expect("shapes that can be addressed");
    unet(criterion).expect("shapes that can be addressed");
}

criterion_group!(benches, all);
criterion_main!(benches);

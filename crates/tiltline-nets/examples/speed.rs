//! Time of the default networks: `speed detector|matcher forward|step N` prints the seconds of N runs as JSON.
//!
//! `cargo xtask reference nets` alternates it with the same networks in PyTorch.
#![allow(clippy::print_stdout)] // what a program is for

use std::error::Error;
use std::time::Instant;

use burn::module::Module;
use burn::optim::GradientsParams;
use burn::tensor::{Device, Tensor, TensorData};
use tiltline_nets::config::{DetectorConfig, MatcherConfig};
use tiltline_nets::detector::Detector;
use tiltline_nets::device::prepare_memory;
use tiltline_nets::matcher::Matcher;
use tiltline_nets::train::Adam;
use tiltline_nets::weights::initialise;

const RATE: f64 = 1e-4;

fn random(shape: [usize; 4], device: &Device) -> Tensor<4> {
    let mut state = 1_u64;
    let values: Vec<f32> = (0..shape.iter().product::<usize>())
        .map(|_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1_u64 << 23) as f32 - 1.0
        })
        .collect();
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// Seconds of each run after one to warm up.
fn time(count: usize, mut run: impl FnMut()) -> Vec<f64> {
    run();
    (0..count)
        .map(|_| {
            let start = Instant::now();
            run();
            start.elapsed().as_secs_f64()
        })
        .collect()
}

fn step<M: Module>(module: M, count: usize, forward: impl Fn(&M) -> Tensor<4>) -> Vec<f64> {
    let (mut module, mut adam) = (Some(module), Adam::default());
    time(count, || {
        let now = module.take().expect("it is put back at the end of each step");
        let gradients = GradientsParams::from_grads(forward(&now).square().mean().backward(), &now);
        module = Some(adam.step(now, gradients, RATE));
    })
}

/// Largest memory of the process so far, MiB, where the system says it.
fn peak_mib() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find(|line| line.starts_with("VmHWM:"))?;
    Some(line.split_whitespace().nth(1)?.parse::<f64>().ok()? / 1024.0)
}

fn main() -> Result<(), Box<dyn Error>> {
    prepare_memory();
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [kind, work, count] = &arguments[..] else { return Err("speed detector|matcher forward|step N".into()) };
    let count: usize = count.parse()?;
    let train = work == "step";
    let device = if train { Device::flex().autodiff() } else { Device::flex() };
    let seconds = if kind == "detector" {
        let network = initialise(Detector::new(&DetectorConfig::default(), &device), 1);
        let images = random(if train { [4, 1, 224, 224] } else { [1, 1, 512, 512] }, &device);
        if train {
            step(network, count, |network| network.forward(images.clone()).logits)
        } else {
            time(count, || drop(network.forward(images.clone()).logits.into_data()))
        }
    } else {
        let network = initialise(Matcher::new(&MatcherConfig::default(), &device), 1);
        let images = random(if train { [2, 2, 256, 256] } else { [1, 2, 512, 512] }, &device);
        let last = |network: &Matcher| network.forward(images.clone(), images.clone()).pop().expect("a cost volume");
        if train { step(network, count, last) } else { time(count, || drop(last(&network).into_data())) }
    };
    println!("{}", serde_json::json!({ "seconds": seconds, "peak_mib": peak_mib() }));
    Ok(())
}

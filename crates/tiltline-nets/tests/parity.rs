//! The networks and losses against PyTorch: the same weights and inputs give the same outputs, losses and gradients.
//!
//! `xtask/reference/nets.py` made the fixture; `cargo xtask reference nets` makes it anew and runs this test on it. Outputs and losses
//! agree to 1e-4 (relative), gradients to 1e-3 (relative L2 of each tensor): both add in other orders, and where a value lies within
//! rounding of a ReLU's zero, one lets its gradient pass and the other does not.

#![allow(clippy::unwrap_used)] // a failed unwrap is a failed test

use std::collections::BTreeMap;

use burn::module::{Module, ModuleVisitor, Param};
use burn::tensor::activation::sigmoid;
use burn::tensor::{Device, Gradients, Tensor, TensorData};
use safetensors::SafeTensors;
use tiltline_nets::config::{DetectorConfig, MatcherConfig, MatcherInput};
use tiltline_nets::losses::{Labelled, detection_loss, disparity_loss, entropy_loss, variance_loss, warp, warp_loss};
use tiltline_nets::networks::{Networks, matcher_input};
use tiltline_nets::volume::{at_levels, at_pixels, probabilities, soft_argmin};
use tiltline_nets::weights::{Values, collect, replace};

const OUTPUT: f64 = 1e-4;
const GRADIENT: f64 = 1e-3;

fn fixture() -> BTreeMap<String, Values> {
    let path = std::env::var_os("TILTLINE_PARITY_FIXTURE").map_or_else(
        || concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/parity.safetensors").into(),
        std::path::PathBuf::from,
    );
    let bytes = std::fs::read(path).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let values = file.iter().map(|(name, view)| {
        let values = view.data().as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
        (name.to_owned(), Values { shape: view.shape().to_vec(), values })
    });
    values.collect()
}

fn difference(ours: &[f32], theirs: &[f32]) -> f64 {
    assert_eq!(ours.len(), theirs.len());
    let square = |value: f64| value * value;
    let apart: f64 = ours.iter().zip(theirs).map(|(a, b)| square(f64::from(a - b))).sum();
    let size: f64 = theirs.iter().map(|value| square(f64::from(*value))).sum();
    (apart / size.max(1e-30)).sqrt()
}

fn host<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_to_vec().unwrap()
}

struct Compare<'a> {
    path: Vec<String>,
    gradients: &'a Gradients,
    expected: &'a BTreeMap<String, Values>,
    seen: usize,
}

impl ModuleVisitor for Compare<'_> {
    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.push(name.to_owned());
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let name = format!("gradient.{}", self.path.join("."));
        let Some(expected) = self.expected.get(&name) else { return };
        let found = host(param.val().grad(self.gradients).unwrap_or_else(|| panic!("no {name}")));
        let apart = difference(&found, &expected.values);
        // Before a batch norm a shift has no effect: its gradient is rounding in both.
        let size = expected.values.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
        assert!(apart < GRADIENT || size < 1e-6, "{name}: {apart}");
        self.seen += 1;
    }
}

#[test]
fn networks_losses_and_gradients_agree_with_pytorch() {
    let fixture = fixture();
    let device = Device::flex().autodiff();
    let detector = DetectorConfig { channels: 3, depth: 2 };
    let matcher = MatcherConfig {
        input: MatcherInput::Image,
        input_channels: 2,
        features: 6,
        downscale: 4,
        concatenated: 3,
        groups: 2,
        channels: 4,
        hourglasses: 2,
        levels: 8,
    };
    let networks = Networks::new(&detector, Some(&matcher), &device);
    let names = collect(&networks);
    assert!(names.keys().all(|name| fixture.contains_key(name)), "every tensor has its counterpart");
    let networks = replace(networks, |name, shape| {
        let found = &fixture[name];
        assert_eq!(found.shape, shape, "{name}");
        Some(found.values.clone())
    });
    let image = |name: &str| {
        let values = &fixture[name];
        let shape: [usize; 4] = values.shape.clone().try_into().unwrap();
        Tensor::<4>::from_data(TensorData::new(values.values.clone(), shape), &device)
    };
    let (left, right) = (image("input.left"), image("input.right"));
    let [n, _, height, width] = left.dims();
    let both = Tensor::cat(vec![left, right], 0);
    let detected = networks.detector.forward(both.clone());
    let output = |name: &str, found: Vec<f32>| {
        let apart = difference(&found, &fixture[name].values);
        assert!(apart < OUTPUT, "{name}: {apart}");
    };
    output("output.logits", host(detected.logits.clone().inner()));
    output("output.features", host(detected.features.clone().inner()));
    let logits = detected.logits.clone();
    let inputs = matcher_input(both, detected, &matcher);
    let network = networks.matcher.as_ref().unwrap();
    let costs = network.forward(inputs.clone().narrow(0, 0, n), inputs.narrow(0, n, n));
    for (index, cost) in costs.iter().enumerate() {
        output(&format!("output.cost.{index}"), host(cost.clone().inner()));
    }

    let lines = &fixture["input.left_lines"].values;
    let labelled = Labelled::of(&fixture["input.disparity"].values, [-1e6, 1e6]);
    let truth = || labelled.tensor(&device);
    let all = at_levels(at_pixels(costs[1].clone(), &matcher), &matcher);
    let dense = soft_argmin(probabilities(all.clone()), &matcher);
    let cost = all.select(0, labelled.indices(&device));
    let p = probabilities(cost.clone());
    let warped =
        warp(sigmoid(logits.clone().narrow(0, n, n)).reshape([n, height, width]), dense.reshape([n, height, width]));
    let terms = [
        ("disparity", disparity_loss(soft_argmin(p.clone(), &matcher), truth())),
        ("variance", variance_loss(p, truth(), &matcher)),
        ("entropy", entropy_loss(cost, &labelled.values, &matcher)),
        ("warp", warp_loss(warped, lines)),
        ("detection", detection_loss(logits.narrow(0, 0, n), lines, 3.0)),
    ];
    let mut total: Option<Tensor<1>> = None;
    for (name, term) in terms {
        output(&format!("loss.{name}"), host(term.clone().inner()));
        total = Some(match total {
            Some(total) => total.add(term),
            None => term,
        });
    }
    let gradients = total.unwrap().backward();
    let mut compare = Compare { path: Vec::new(), gradients: &gradients, expected: &fixture, seen: 0 };
    networks.visit(&mut compare);
    let expected = fixture.keys().filter(|name| name.starts_with("gradient.")).count();
    assert_eq!(compare.seen, expected);
    for (name, values) in collect(&networks).iter().filter(|(name, _)| name.contains("running")) {
        let apart = difference(&values.values, &fixture[&format!("after.{name}")].values);
        assert!(apart < OUTPUT, "{name}: {apart}");
    }
}

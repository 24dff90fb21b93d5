//! The backward passes of our kernels, for burn's automatic differentiation.

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::autodiff::{Autodiff, NodeId};
use burn::backend::tensor::FloatTensor;

use super::Geometry;
use super::cpu::CpuOps;

const ONCE: &str = "only called while gradients are taken, and there are no gradients of gradients";
const NO_RELU: &str = "a ReLU fused into a convolution has no gradient";

#[derive(Debug)]
struct ConvBias;

impl<B: CpuOps> Backward<B, 3> for ConvBias {
    type State = (NodeId, NodeId, Geometry);

    fn backward(self, ops: Ops<Self::State, 3>, gradients: &mut Gradients, checkpointer: &mut Checkpointer) {
        let [input_node, weight_node, bias_node] = ops.parents;
        let gradient = gradients.consume::<B>(&ops.node);
        let (input, weight, geometry) = ops.state;
        let input = checkpointer.retrieve_node_output::<B::FloatTensorPrimitive>(input);
        let weight = checkpointer.retrieve_node_output::<B::FloatTensorPrimitive>(weight);
        if let Some(node) = input_node {
            gradients.register::<B>(node.id, B::tiltline_conv_input(gradient.clone(), weight, geometry));
        }
        if let Some(node) = weight_node {
            gradients.register::<B>(node.id, B::tiltline_conv_weight(input, gradient.clone(), geometry));
        }
        if let Some(node) = bias_node {
            gradients.register::<B>(node.id, B::tiltline_conv_shift(gradient, geometry));
        }
    }
}

#[derive(Debug)]
struct Conv;

impl<B: CpuOps> Backward<B, 2> for Conv {
    type State = (NodeId, NodeId, Geometry);

    fn backward(self, ops: Ops<Self::State, 2>, gradients: &mut Gradients, checkpointer: &mut Checkpointer) {
        let [input_node, weight_node] = ops.parents;
        let gradient = gradients.consume::<B>(&ops.node);
        let (input, weight, geometry) = ops.state;
        let input = checkpointer.retrieve_node_output::<B::FloatTensorPrimitive>(input);
        let weight = checkpointer.retrieve_node_output::<B::FloatTensorPrimitive>(weight);
        if let Some(node) = input_node {
            gradients.register::<B>(node.id, B::tiltline_conv_input(gradient.clone(), weight, geometry));
        }
        if let Some(node) = weight_node {
            gradients.register::<B>(node.id, B::tiltline_conv_weight(input, gradient, geometry));
        }
    }
}

#[derive(Debug)]
struct Norm;

/// Input, gamma and beta by node; mean and variance; epsilon and whether there is a ReLU.
type NormState<P> = ([NodeId; 3], [P; 2], f64, bool);

impl<B: CpuOps> Backward<B, 3> for Norm {
    type State = NormState<B::FloatTensorPrimitive>;

    fn backward(self, ops: Ops<Self::State, 3>, gradients: &mut Gradients, checkpointer: &mut Checkpointer) {
        let [input_node, gamma_node, beta_node] = ops.parents;
        let gradient = gradients.consume::<B>(&ops.node);
        let (nodes, [mean, variance], epsilon, relu) = ops.state;
        let [input, gamma, beta] = nodes.map(|node| checkpointer.retrieve_node_output::<B::FloatTensorPrimitive>(node));
        let (input, gamma, beta) = B::tiltline_norm_back(input, gamma, beta, mean, variance, gradient, epsilon, relu);
        for (node, gradient) in [(input_node, input), (gamma_node, gamma), (beta_node, beta)] {
            if let Some(node) = node {
                gradients.register::<B>(node.id, gradient);
            }
        }
    }
}

#[derive(Debug)]
struct Pool;

impl<B: CpuOps> Backward<B, 1> for Pool {
    type State = NodeId;

    fn backward(self, ops: Ops<Self::State, 1>, gradients: &mut Gradients, checkpointer: &mut Checkpointer) {
        let [node] = ops.parents;
        let gradient = gradients.consume::<B>(&ops.node);
        let input = checkpointer.retrieve_node_output::<B::FloatTensorPrimitive>(ops.state);
        if let Some(node) = node {
            gradients.register::<B>(node.id, B::tiltline_pool_back(input, gradient));
        }
    }
}

impl<B: CpuOps, C: CheckpointStrategy> CpuOps for Autodiff<B, C> {
    fn tiltline_conv(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        geometry: Geometry,
        relu: bool,
    ) -> FloatTensor<Self> {
        assert!(!relu, "{NO_RELU}");
        match Conv.prepare::<C>([input.node(), weight.node()]).compute_bound().stateful() {
            OpsKind::Tracked(mut prepared) => {
                let state = (prepared.checkpoint(&input), prepared.checkpoint(&weight), geometry);
                let output = B::tiltline_conv(input.into_primitive(), weight.into_primitive(), geometry, false);
                prepared.finish(state, output)
            }
            OpsKind::UnTracked(prepared) => {
                prepared.finish(B::tiltline_conv(input.into_primitive(), weight.into_primitive(), geometry, false))
            }
        }
    }

    fn tiltline_conv_bias(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        geometry: Geometry,
        relu: bool,
    ) -> FloatTensor<Self> {
        assert!(!relu, "{NO_RELU}");
        let forward = |input: FloatTensor<Self>, weight: FloatTensor<Self>, bias: FloatTensor<Self>| {
            let (input, weight, bias) = (input.into_primitive(), weight.into_primitive(), bias.into_primitive());
            B::tiltline_conv_bias(input, weight, bias, geometry, false)
        };
        match ConvBias.prepare::<C>([input.node(), weight.node(), bias.node()]).compute_bound().stateful() {
            OpsKind::Tracked(mut prepared) => {
                let state = (prepared.checkpoint(&input), prepared.checkpoint(&weight), geometry);
                prepared.finish(state, forward(input, weight, bias))
            }
            OpsKind::UnTracked(prepared) => prepared.finish(forward(input, weight, bias)),
        }
    }

    fn tiltline_norm(
        input: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        epsilon: f64,
        relu: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        let forward = |input: FloatTensor<Self>, gamma: FloatTensor<Self>, beta: FloatTensor<Self>| {
            let (input, gamma, beta) = (input.into_primitive(), gamma.into_primitive(), beta.into_primitive());
            B::tiltline_norm(input, gamma, beta, epsilon, relu)
        };
        let (output, mean, variance);
        match Norm.prepare::<C>([input.node(), gamma.node(), beta.node()]).compute_bound().stateful() {
            OpsKind::Tracked(mut prepared) => {
                let nodes = [&input, &gamma, &beta].map(|tensor| prepared.checkpoint(tensor));
                let made = forward(input, gamma, beta);
                (mean, variance) = (made.1, made.2);
                output = prepared.finish((nodes, [mean.clone(), variance.clone()], epsilon, relu), made.0);
            }
            OpsKind::UnTracked(prepared) => {
                let made = forward(input, gamma, beta);
                (mean, variance) = (made.1, made.2);
                output = prepared.finish(made.0);
            }
        }
        (output, <FloatTensor<Self>>::new(mean), <FloatTensor<Self>>::new(variance))
    }

    fn tiltline_pool(input: FloatTensor<Self>) -> FloatTensor<Self> {
        match Pool.prepare::<C>([input.node()]).compute_bound().stateful() {
            OpsKind::Tracked(mut prepared) => {
                let state = prepared.checkpoint(&input);
                prepared.finish(state, B::tiltline_pool(input.into_primitive()))
            }
            OpsKind::UnTracked(prepared) => prepared.finish(B::tiltline_pool(input.into_primitive())),
        }
    }

    fn tiltline_conv_input(_: FloatTensor<Self>, _: FloatTensor<Self>, _: Geometry) -> FloatTensor<Self> {
        unreachable!("{ONCE}")
    }

    fn tiltline_conv_weight(_: FloatTensor<Self>, _: FloatTensor<Self>, _: Geometry) -> FloatTensor<Self> {
        unreachable!("{ONCE}")
    }

    fn tiltline_conv_shift(_: FloatTensor<Self>, _: Geometry) -> FloatTensor<Self> {
        unreachable!("{ONCE}")
    }

    fn tiltline_norm_back(
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: f64,
        _: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        unreachable!("{ONCE}")
    }

    fn tiltline_pool_back(_: FloatTensor<Self>, _: FloatTensor<Self>) -> FloatTensor<Self> {
        unreachable!("{ONCE}")
    }
}

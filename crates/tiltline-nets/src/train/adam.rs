//! Adam (Kingma & Ba 2015, arXiv:1412.6980, algorithm 1), its moments kept by the weights' names.
//!
//! Not burn's, because that keys its record by random numbers of one process: ours goes into the same file as the weights,
//! and a run goes on from it bit by bit.

use std::collections::BTreeMap;

use burn::module::{Module, ModuleMapper, Param};
use burn::optim::GradientsParams;
use burn::tensor::{Device, Tensor, TensorData};

use crate::weights::{Named, Values};

const BETA: [f64; 2] = [0.9, 0.999];
const EPSILON: f64 = 1e-8;

/// The optimiser's state.
#[derive(Clone, Debug, Default)]
pub struct Adam {
    /// Steps taken.
    pub time: u64,
    /// Mean and mean square of each weight's gradients, flat.
    moments: BTreeMap<String, [Tensor<1>; 2]>,
}

struct Update<'a> {
    path: Vec<String>,
    adam: &'a mut Adam,
    gradients: GradientsParams,
    rate: f64,
}

impl ModuleMapper for Update<'_> {
    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.push(name.to_owned());
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }

    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let (id, tensor, mapper) = param.consume();
        let Some(gradient) = self.gradients.remove::<D>(id) else {
            return Param::from_mapped_value(id, tensor, mapper);
        };
        let required = tensor.is_require_grad();
        let shape = tensor.dims();
        let count = tensor.shape().num_elements();
        let gradient = gradient.inner().reshape([count]);
        let squared = gradient.clone().square();
        let name = self.path.join(".");
        let old = self.adam.moments.remove(&name);
        let [mean, square] = match old {
            Some([mean, square]) => [
                mean.mul_scalar(BETA[0]).add(gradient.mul_scalar(1.0 - BETA[0])),
                square.mul_scalar(BETA[1]).add(squared.mul_scalar(1.0 - BETA[1])),
            ],
            None => [gradient.mul_scalar(1.0 - BETA[0]), squared.mul_scalar(1.0 - BETA[1])],
        };
        let [mean_bias, square_bias] = BETA.map(|beta| 1.0 - beta.powf(self.adam.time as f64));
        let deviation = square.clone().div_scalar(square_bias).sqrt().add_scalar(EPSILON);
        let change = mean.clone().mul_scalar(self.rate / mean_bias).div(deviation);
        self.adam.moments.insert(name, [mean, square]);
        let tensor = tensor.inner().sub(change.reshape(shape)).autodiff().set_require_grad(required);
        Param::from_mapped_value(id, tensor, mapper)
    }
}

impl Adam {
    /// The module after a step; weights without a gradient stay as they are.
    pub fn step<M: Module>(&mut self, module: M, gradients: GradientsParams, rate: f64) -> M {
        self.time += 1;
        module.map(&mut Update { path: Vec::new(), adam: self, gradients, rate })
    }

    /// The moments by name: `mean.` and `square.` before the weight's name.
    pub fn to_named(&self) -> Named {
        let mut named = Named::new();
        for (name, moments) in &self.moments {
            for (prefix, moment) in ["mean", "square"].into_iter().zip(moments) {
                let values: Vec<f32> = moment.to_data().try_to_vec().expect("moments are f32");
                named.insert(format!("{prefix}.{name}"), Values { shape: vec![values.len()], values });
            }
        }
        named
    }

    /// The state from [`Adam::to_named`]; entries of other names are left alone.
    pub fn from_named(named: &Named, time: u64, device: &Device) -> Self {
        let device = device.clone().inner();
        let tensor = |values: &Values| {
            Tensor::<1>::from_data(TensorData::new(values.values.clone(), [values.values.len()]), &device)
        };
        let pairs = named.iter().filter_map(|(key, mean)| {
            let name = key.strip_prefix("mean.")?;
            let square = named.get(&format!("square.{name}"))?;
            Some((name.to_owned(), [tensor(mean), tensor(square)]))
        });
        Self { time, moments: pairs.collect() }
    }
}

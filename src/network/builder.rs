//! Named weights to Burn's parameters and back.

use std::collections::HashMap;
use std::ops::Range;

use burn::module::{ModuleVisitor, Param, ParamId};
use burn::tensor::{Device, Shape, Tensor, TensorData};

use super::architecture::Architecture;
use super::operations::{ConvolutionWeights, ResBlockWeights};
use super::parameters::{Parameter, Parameters};

/// Makes layers of named weights. A weight's id is its place in the architecture's order, so that ids mean
/// the same in every process.
pub(super) struct Builder<'a> {
    source: Source<'a>,
    device: &'a Device,
}

/// Where weights are.
enum Source<'a> {
    /// In main memory.
    Host(HashMap<&'a str, (u64, &'a Parameter)>),
    /// One after another in a tensor on the device: the id, the place and the shape of each.
    Device(&'a Tensor<1>, HashMap<String, (u64, Range<usize>, Vec<usize>)>),
}

impl<'a> Builder<'a> {
    /// Looks weights up by name and puts them on a device.
    pub(super) fn new(parameters: &'a Parameters, device: &'a Device) -> Self {
        let by_name = (0..).zip(parameters.iter()).map(|(id, p)| (p.name.as_str(), (id, p))).collect();
        Self { source: Source::Host(by_name), device }
    }

    /// Looks weights up in a tensor that holds all of an architecture's one after another, on the device.
    pub(super) fn of_flat(architecture: &Architecture, flat: &'a Tensor<1>, device: &'a Device) -> Self {
        let mut from = 0;
        let places = (0..).zip(architecture.tensors()).map(|(id, spec)| {
            let place = from..from + spec.shape.iter().product::<usize>();
            from = place.end;
            (spec.name, (id, place, spec.shape))
        });
        Self { source: Source::Device(flat, places.collect()), device }
    }

    /// One weight tensor.
    pub(super) fn tensor<const D: usize>(&self, name: &str) -> Param<Tensor<D>> {
        let (id, tensor) = match &self.source {
            Source::Host(by_name) => by_name.get(name).map(|(id, parameter)| {
                let data = TensorData::new(parameter.values.clone(), parameter.shape.clone());
                (*id, Tensor::from_data(data, self.device))
            }),
            Source::Device(flat, places) => places.get(name).map(|(id, place, shape)| {
                let part = Tensor::clone(flat).slice(place.clone()).reshape(Shape::from(shape.clone()));
                (*id, if self.device.is_autodiff() { part.autodiff() } else { part })
            }),
        }
        .unwrap_or_else(|| panic!("there is no weight {name}"));
        Param::initialized(ParamId::from(id), tensor).set_require_grad(self.device.is_autodiff())
    }

    /// Weight and bias of a convolution.
    pub(super) fn convolution(&self, name: &str) -> ConvolutionWeights {
        ConvolutionWeights {
            weight: self.tensor(&format!("{name}.weight")),
            bias: self.tensor(&format!("{name}.bias")),
        }
    }

    /// The convolutions of a residual block.
    pub(super) fn res_block(&self, name: &str) -> ResBlockWeights {
        ResBlockWeights {
            conv1: self.convolution(&format!("{name}.conv1")),
            conv2: self.convolution(&format!("{name}.conv2")),
        }
    }
}

/// Copies every weight to its place in the architecture's order.
pub(super) struct Collect {
    pub(super) parameters: Vec<Option<Vec<f32>>>,
}

impl ModuleVisitor for Collect {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let index = usize::try_from(param.id.val()).expect("ids are small indices");
        let values = param.val().try_into_vec_as::<f32>().expect("weights are 32-bit floats");
        self.parameters[index] = Some(values);
    }
}

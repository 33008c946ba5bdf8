//! A training's weights and the optimiser's memory on a device: one flat tensor each, so that a step is a few operations on
//! each and nothing but three numbers comes back.

use std::iter;

use burn::module::{Module as _, ModuleVisitor, Param};
use burn::tensor::{Device, Gradients as BurnGradients, Tensor, TensorData};

use super::config::OptimizerConfig;
use super::optimizer::{Constants, Moments};
use super::trainer::State;
use crate::core::error::Result;
use crate::network::{Network, Parameters, largest_of_all, numbers_of, sum_of_all};

/// What a step changes, on a device without gradients.
#[derive(Clone, Debug)]
pub(super) struct OnDevice {
    weights: Tensor<1>,
    first: Tensor<1>,
    second: Tensor<1>,
    average: Option<Tensor<1>>,
}

/// What a step tells of itself.
#[derive(Clone, Copy, Debug)]
pub(super) struct Told {
    /// Norm of the gradients before any clipping.
    pub(super) gradient_norm: f64,
    /// The largest weight in magnitude, of the running mean too; infinite where one is no number.
    pub(super) largest_weight: f64,
}

impl OnDevice {
    /// Brings a state to a device.
    pub(super) fn upload(state: &State, device: &Device) -> Self {
        let values = |parameters: &Parameters| parameters.iter().flat_map(|p| &p.values).copied().collect();
        let flat = |values: Vec<f32>| {
            let count = values.len();
            Tensor::from_data(TensorData::new(values, [count]), device)
        };
        let moments = |moments: &[Vec<f32>]| moments.concat();
        Self {
            weights: flat(values(&state.parameters)),
            first: flat(moments(&state.moments.first)),
            second: flat(moments(&state.moments.second)),
            average: state.average.as_ref().map(|average| flat(values(average))),
        }
    }

    /// Writes what is on the device to the arrays of a state of the same architecture.
    pub(super) fn download(&self, state: &mut State) {
        let State { parameters, moments: Moments { first, second }, average, .. } = state;
        let of = |parameters: &'_ mut Parameters, flat: &Tensor<1>| {
            spread(parameters.iter_mut().map(|p| &mut p.values[..]), flat);
        };
        of(parameters, &self.weights);
        spread(first.iter_mut().map(Vec::as_mut_slice), &self.first);
        spread(second.iter_mut().map(Vec::as_mut_slice), &self.second);
        if let Some((average, flat)) = average.as_mut().zip(self.average.as_ref()) {
            of(average, flat);
        }
    }

    /// The weights to use: their running mean when it is asked for.
    pub(super) fn download_weights(&self, parameters: &mut Parameters) {
        let flat = self.average.as_ref().unwrap_or(&self.weights);
        spread(parameters.iter_mut().map(|p| &mut p.values[..]), flat);
    }

    /// The weights.
    pub(super) fn weights(&self) -> &Tensor<1> {
        &self.weights
    }

    /// The weights, and their running mean.
    pub(super) fn kept(&self) -> impl Iterator<Item = &Tensor<1>> {
        iter::once(&self.weights).chain(&self.average)
    }

    /// What a step of Adam makes of it, with clipping before and the running mean after: the equations of the CPU's.
    ///
    /// # Errors
    /// [`Error::Device`](crate::core::error::Error::Device), also of the way back before it.
    pub(super) fn stepped(
        &self,
        gradients: Tensor<1>,
        config: &OptimizerConfig,
        (iteration, rate): (u64, f64),
    ) -> Result<(Self, Told)> {
        let squared = sum_of_all(gradients.clone() * gradients.clone());
        let gradients = if config.clip_norm > 0.0 {
            let norm = squared.clone().sqrt().clamp_min(config.clip_norm);
            gradients * norm.recip().mul_scalar(config.clip_norm)
        } else {
            gradients
        };
        let c = Constants::new(config, iteration, rate);
        let squares = gradients.clone() * gradients.clone();
        let first = self.first.clone() * c.first_keep + gradients * c.first_take;
        let second = self.second.clone() * c.second_keep + squares * c.second_take;
        let divisor = second.clone().sqrt() / c.second_correction + c.epsilon;
        let weights = self.weights.clone() - first.clone() / divisor * c.step_size;
        #[expect(clippy::cast_possible_truncation, reason = "weights are 32-bit floats")]
        let take = (1.0 - config.ema_decay) as f32;
        let average =
            self.average.as_ref().map(|mean| mean.clone() + (weights.clone() - mean.clone()) * take);
        let largest = average.iter().chain([&weights]).map(|flat| largest_of_all(flat.clone().abs()));
        let told = Tensor::cat(iter::once(squared).chain(largest).collect(), 0);
        let told = numbers_of(told)?;
        let largest_weight = told[1..].iter().map(|w| f64::from(*w)).fold(0.0, worst);
        let told = Told { gradient_norm: f64::from(told[0]).sqrt(), largest_weight };
        Ok((Self { weights, first, second, average }, told))
    }
}

/// The larger of two magnitudes; infinite where one is no number.
fn worst(a: f64, b: f64) -> f64 {
    if b.is_nan() { f64::INFINITY } else { a.max(b) }
}

/// Cuts a flat tensor into arrays, one after another.
fn spread<'a>(arrays: impl Iterator<Item = &'a mut [f32]>, flat: &Tensor<1>) {
    let values: Vec<f32> = flat.clone().try_into_vec_as::<f32>().expect("weights are 32-bit floats");
    let mut from = 0;
    for array in arrays {
        array.copy_from_slice(&values[from..from + array.len()]);
        from += array.len();
    }
    assert_eq!(from, values.len(), "the arrays hold all of the tensor");
}

/// Every weight's gradient where the loss has one, flat, in the architecture's order.
pub(super) struct Gather {
    pub(super) gradients: BurnGradients,
    pub(super) found: Vec<Option<Tensor<1>>>,
}

impl Gather {
    pub(super) fn of(network: &Network, gradients: BurnGradients, count: usize) -> Vec<Option<Tensor<1>>> {
        let mut gather = Self { gradients, found: vec![None; count] };
        network.visit(&mut gather);
        gather.found
    }
}

impl ModuleVisitor for Gather {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let index = usize::try_from(param.id.val()).expect("ids are small indices");
        let gradient = param.val().grad_remove(&mut self.gradients);
        self.found[index] = gradient.map(|gradient| {
            let count: usize = gradient.dims().iter().product();
            gradient.reshape([count])
        });
    }
}

#[cfg(test)]
mod tests {
    use super::super::optimizer::{average, clip, global_norm};
    use super::*;
    use crate::network::{Architecture, Initialisation};

    fn state() -> State {
        let architecture = Architecture { features: 2, filter_size: 3, ..Architecture::default() };
        let parameters = Parameters::random(&architecture, Initialisation::Released, 3);
        let (moments, average) = (Moments::zeros(&parameters), Some(parameters.clone()));
        State { iteration: 0, parameters, moments, average }
    }

    fn gradients(state: &State, step: usize) -> Vec<Vec<f32>> {
        let value = |i: usize| ((i * 7919 + step * 31) % 1000) as f32 / 500.0 - 1.0;
        state.parameters.iter().map(|p| (0..p.values.len()).map(value).collect()).collect()
    }

    /// The same sums of 32-bit floats, but for the order of those of the norm.
    #[test]
    fn steps_are_those_of_the_cpu() {
        let config = OptimizerConfig { clip_norm: 0.5, ema_decay: 0.9, ..OptimizerConfig::default() };
        let mut expected = state();
        let mut on_device = OnDevice::upload(&expected, &Device::flex());
        for step in 1..=3 {
            let mut of_step = gradients(&expected, step);
            let flat = of_step.concat();
            let count = flat.len();
            let flat = Tensor::from_data(TensorData::new(flat, [count]), &Device::flex());
            let (next, told) = on_device.stepped(flat, &config, (step as u64, 1e-2)).unwrap();
            on_device = next;
            let norm = global_norm(&of_step);
            assert!((told.gradient_norm / norm - 1.0).abs() < 1e-5, "{} {norm}", told.gradient_norm);
            clip(&mut of_step, norm, config.clip_norm);
            expected.moments.step(&mut expected.parameters, &of_step, &config, (step as u64, 1e-2));
            average(expected.average.as_mut().unwrap(), &expected.parameters, config.ema_decay);
        }
        let mut found = state();
        on_device.download(&mut found);
        let all = |state: &State| -> Vec<f32> {
            let of = |parameters: &Parameters| parameters.iter().flat_map(|p| p.values.clone()).collect();
            let moments = [&state.moments.first, &state.moments.second].map(|moments| moments.concat());
            [of(&state.parameters), of(state.average.as_ref().unwrap())]
                .into_iter()
                .chain(moments)
                .flatten()
                .collect()
        };
        for (found, expected) in all(&found).into_iter().zip(all(&expected)) {
            assert!((found - expected).abs() <= 1e-5 * expected.abs().max(1e-3), "{found} {expected}");
        }
        let mut weights = state().parameters;
        on_device.download_weights(&mut weights);
        assert_eq!(Some(weights), found.average);
    }

    #[test]
    fn a_weight_that_is_no_number_is_told() {
        let mut broken = state();
        broken.parameters.iter_mut().next().unwrap().values[0] = f32::NAN;
        let on_device = OnDevice::upload(&broken, &Device::flex());
        let flat = gradients(&broken, 1).concat();
        let count = flat.len();
        let flat = Tensor::from_data(TensorData::new(flat, [count]), &Device::flex());
        let (_, told) = on_device.stepped(flat, &OptimizerConfig::default(), (1, 1e-3)).unwrap();
        assert!(told.largest_weight.is_infinite(), "{told:?}");
    }
}

//! Turns a restored batch and its clean one into the number that training makes small.

use std::path::Path;
use std::sync::Arc;

use burn::tensor::{Tensor, TensorData};

use super::config::{LossConfig, PerceptualConfig};
use crate::core::error::{Error, Result};
use crate::network::{Backend, numbers_of};
use crate::perceptual::{PerceptualLoss, PerceptualTensors};

/// What a training minimises, with the frozen network that it needs.
#[derive(Clone, Debug)]
pub(super) struct Loss {
    /// Weight of the mean absolute difference.
    l1: f64,
    /// What that difference is relative to at least, where it is relative.
    relative_floor: Option<f64>,
    /// Weight and network of the perceptual distance.
    perceptual: Option<(f64, Perceptual)>,
}

/// The perceptual distance, where a training computes.
#[derive(Clone, Debug)]
enum Perceptual {
    /// By the kernels.
    Kernels(Arc<PerceptualLoss>),
    /// In operations of the device.
    Tensors(Arc<PerceptualTensors>),
}

impl Loss {
    /// Reads the weights of the perceptual distance, if it is asked for, for a training on a backend.
    ///
    /// # Errors
    /// [`Error::Config`] when it is and no file is named; those of [`PerceptualLoss::load`].
    pub(super) fn new(config: &LossConfig, backend: Backend) -> Result<Self> {
        let PerceptualConfig { weight, distance, file } = &config.perceptual;
        if *weight > 0.0 && file.is_empty() {
            let reason = format!(
                "names no file; give {}, or train without it: --set loss.perceptual.weight=0",
                PerceptualLoss::expected_file()
            );
            return Err(Error::config("loss.perceptual.file", reason));
        }
        let path = Path::new(file);
        let load = || {
            Ok(if backend.is_cpu() {
                Perceptual::Kernels(Arc::new(PerceptualLoss::load(path, *distance)?))
            } else {
                let device = backend.device().autodiff();
                Perceptual::Tensors(Arc::new(PerceptualLoss::load_tensors(path, *distance, &device)?))
            })
        };
        let perceptual = if *weight > 0.0 { Some((*weight, load()?)) } else { None };
        let relative_floor = (config.relative_floor > 0.0).then_some(config.relative_floor);
        Ok(Self { l1: config.l1, relative_floor, perceptual })
    }

    /// A loss with a network that was not read from a file.
    #[cfg(test)]
    pub(super) fn with_perceptual(l1: f64, weight: f64, perceptual: PerceptualLoss) -> Self {
        Self {
            l1,
            relative_floor: None,
            perceptual: Some((weight, Perceptual::Kernels(Arc::new(perceptual)))),
        }
    }

    /// Computes the loss of a batch, and a tensor of one number with the same gradient.
    ///
    /// # Equation
    /// `w₁ · mean |restored − clean| + w₂ · d(VGG(restored), VGG(clean))`, means over all values; with a floor f, the first is
    /// `w₁ · mean ln(1 + e/f)`, e the mean absolute difference of each item: the error in decibels where it is above f.
    ///
    /// # Errors
    /// Those of [`PerceptualLoss::value_and_gradient`]; [`Error::Device`](crate::core::error::Error::Device).
    pub(super) fn of(&self, restored: Tensor<4>, clean: Tensor<4>) -> Result<(f64, Tensor<1>)> {
        let difference = (restored.clone() - clean.clone()).abs();
        let difference = match self.relative_floor {
            None => mean(difference),
            Some(floor) => mean(of_items(difference).mul_scalar(1.0 / floor).add_scalar(1.0).log()),
        };
        let l1 = difference.mul_scalar(self.l1);
        let value = number(l1.clone())?;
        let (weight, perceptual) = match &self.perceptual {
            None => return Ok((value, l1)),
            Some((weight, Perceptual::Tensors(tensors))) => {
                let distance = tensors.distance(restored, clean)?.mul_scalar(*weight);
                let of_distance = number(distance.clone())?;
                return Ok((value + of_distance, l1 + distance));
            }
            Some((weight, Perceptual::Kernels(kernels))) => (weight, kernels),
        };
        let [items, channels, height, width] = restored.dims();
        let sides = [items, height, width];
        let restored_numbers = numbers_of(restored.clone().detach())?;
        let (distance, gradient) =
            perceptual.value_and_gradient(&restored_numbers, &numbers_of(clean)?, sides)?;
        let gradient = TensorData::new(gradient, [items, channels, height, width]);
        let gradient = Tensor::<4>::from_data(gradient, &restored.device());
        // Its gradient to `restored` is the distance's; its value means nothing.
        let slope = (restored * gradient).sum().mul_scalar(*weight);
        Ok((value + weight * distance, l1 + slope))
    }
}

fn number(tensor: Tensor<1>) -> Result<f64> {
    Ok(numbers_of(tensor)?.into_iter().map(f64::from).sum())
}

/// The mean of each item, `[item, 1, 1, 1]`.
fn of_items(x: Tensor<4>) -> Tensor<4> {
    (1..4).rev().fold(x, |x, axis| x.mean_dim(axis))
}

/// Axis by axis: Burn sums many values at once in an order that differs from run to run.
fn mean(x: Tensor<4>) -> Tensor<1> {
    (0..4).rev().fold(x, |x, axis| x.mean_dim(axis)).reshape([1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::Device;

    /// Two items, one with errors of 0.3 and one with errors of 0.01.
    #[test]
    fn relative_to_itself_a_small_error_teaches_as_much_as_a_large_one() {
        let device = Device::default().autodiff();
        let errors = [0.3_f32, 0.3, 0.01, 0.01];
        let restored =
            Tensor::<4>::from_data(TensorData::new(errors.to_vec(), [2, 1, 1, 2]), &device).require_grad();
        let clean = Tensor::zeros([2, 1, 1, 2], &device);
        let config = LossConfig { relative_floor: 0.001, ..LossConfig::default() };
        let (value, loss) =
            Loss::new(&config, Backend::default()).unwrap().of(restored.clone(), clean).unwrap();
        let expected = 0.5 * ((1.0 + 300.0_f64).ln() + (1.0 + 10.0_f64).ln());
        assert!((value - expected).abs() < 1e-4, "{value} {expected}");
        let gradient = restored.grad(&loss.backward()).unwrap().into_data().try_into_vec::<f32>().unwrap();
        for (gradient, error) in gradient.iter().zip(errors) {
            let expected = 0.25 / (error + 0.001);
            assert!((gradient / expected - 1.0).abs() < 1e-3, "{gradient} {expected}");
        }
    }
}

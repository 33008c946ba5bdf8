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
    /// Weight of the mean squared difference.
    l2: f64,
    /// What these differences, the second's root, are relative to at least, where they are relative.
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
        Ok(Self { l1: config.l1, l2: config.l2, relative_floor, perceptual })
    }

    /// A loss with a network that was not read from a file.
    #[cfg(test)]
    pub(super) fn with_perceptual(l1: f64, weight: f64, perceptual: PerceptualLoss) -> Self {
        Self {
            l1,
            l2: 0.0,
            relative_floor: None,
            perceptual: Some((weight, Perceptual::Kernels(Arc::new(perceptual)))),
        }
    }

    /// Computes the loss of a batch, and a tensor of one number with the same gradient.
    ///
    /// # Equation
    /// `w₁ · mean |restored − clean| + w₂ · mean (restored − clean)² + w₃ · d(VGG(restored), VGG(clean))`, means over all values;
    /// with a floor f, the first two are `w₁ · mean ln(1 + e/f)` and `w₂ · mean ½ ln(1 + s/f²)`, e and s the mean absolute and the
    /// mean squared difference of each item: the error in decibels where it is above f.
    ///
    /// # Errors
    /// Those of [`PerceptualLoss::value_and_gradient`]; [`Error::Device`](crate::core::error::Error::Device).
    pub(super) fn of(&self, restored: Tensor<4>, clean: Tensor<4>) -> Result<(f64, Tensor<1>)> {
        let difference = restored.clone() - clean.clone();
        let absolute =
            (self.l1 > 0.0).then(|| self.relative(difference.clone().abs(), 1).mul_scalar(self.l1));
        let squared =
            (self.l2 > 0.0).then(|| self.relative(difference.powi_scalar(2), 2).mul_scalar(self.l2));
        let difference = match (absolute, squared) {
            (Some(absolute), Some(squared)) => absolute + squared,
            (absolute, squared) => absolute.or(squared).expect("a configuration names one of the two"),
        };
        let value = number(difference.clone())?;
        let (weight, perceptual) = match &self.perceptual {
            None => return Ok((value, difference)),
            Some((weight, Perceptual::Tensors(tensors))) => {
                let distance = tensors.distance(restored, clean)?.mul_scalar(*weight);
                let of_distance = number(distance.clone())?;
                return Ok((value + of_distance, difference + distance));
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
        Ok((value + weight * distance, difference + slope))
    }

    /// The mean of powers of differences, or of their logarithms relative to the floor.
    fn relative(&self, powers: Tensor<4>, power: i32) -> Tensor<1> {
        match self.relative_floor {
            None => mean(powers),
            Some(floor) => {
                let relative = of_items(powers).mul_scalar(floor.powi(-power)).add_scalar(1.0);
                mean(relative.log()).mul_scalar(1.0 / f64::from(power))
            }
        }
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
    const ERRORS: [f32; 4] = [0.3, 0.3, 0.01, 0.01];

    /// The loss of two items with these errors, and its gradient.
    fn loss_of_errors(config: &LossConfig) -> (f64, Vec<f64>) {
        let device = Device::default().autodiff();
        let restored =
            Tensor::<4>::from_data(TensorData::new(ERRORS.to_vec(), [2, 1, 1, 2]), &device).require_grad();
        let clean = Tensor::zeros([2, 1, 1, 2], &device);
        let (value, loss) =
            Loss::new(config, Backend::default()).unwrap().of(restored.clone(), clean).unwrap();
        let gradient = restored.grad(&loss.backward()).unwrap().into_data().try_into_vec::<f32>().unwrap();
        (value, gradient.into_iter().map(f64::from).collect())
    }

    fn agree(found: &(f64, Vec<f64>), value: f64, gradient: impl Fn(f64) -> f64) {
        assert!((found.0 / value - 1.0).abs() < 1e-4, "{} {value}", found.0);
        for (found, error) in found.1.iter().zip(ERRORS) {
            let expected = gradient(f64::from(error));
            assert!((found / expected - 1.0).abs() < 1e-3, "{found} {expected}");
        }
    }

    #[test]
    fn relative_to_itself_a_small_error_teaches_as_much_as_a_large_one() {
        let config = LossConfig { relative_floor: 0.001, ..LossConfig::default() };
        let absolute = loss_of_errors(&config);
        agree(&absolute, 0.5 * (301.0_f64.ln() + 11.0_f64.ln()), |error| 0.25 / (error + 0.001));
        let squared = loss_of_errors(&LossConfig { l1: 0.0, l2: 1.0, ..config.clone() });
        let value = 0.25 * (90_001.0_f64.ln() + 101.0_f64.ln());
        agree(&squared, value, |error| 0.25 * error / (error * error + 1e-6));
        let both = loss_of_errors(&LossConfig { l1: 1.0, l2: 1.0, ..config });
        agree(&both, absolute.0 + squared.0, |error| {
            0.25 / (error + 0.001) + 0.25 * error / (error * error + 1e-6)
        });
    }

    #[test]
    fn squares_count_by_themselves() {
        let found = loss_of_errors(&LossConfig { l1: 0.0, l2: 2.0, ..LossConfig::default() });
        agree(&found, 0.09 + 0.0001, |error| error);
    }
}

//! Turns a restored batch and its clean one into the number that training makes small.

use std::path::Path;
use std::sync::Arc;

use burn::tensor::{Tensor, TensorData};

use super::config::{LossConfig, PerceptualConfig};
use crate::core::error::{Error, Result};
use crate::perceptual::PerceptualLoss;

/// What a training minimises, with the frozen network that it needs.
#[derive(Clone, Debug)]
pub(super) struct Loss {
    /// Weight of the mean absolute difference.
    l1: f64,
    /// Weight and network of the perceptual distance.
    perceptual: Option<(f64, Arc<PerceptualLoss>)>,
}

impl Loss {
    /// Reads the weights of the perceptual distance, if it is asked for.
    ///
    /// # Errors
    /// [`Error::Config`] when it is and no file is named; those of [`PerceptualLoss::load`].
    pub(super) fn new(config: &LossConfig) -> Result<Self> {
        let PerceptualConfig { weight, distance, file } = &config.perceptual;
        if *weight > 0.0 && file.is_empty() {
            let reason = format!(
                "names no file; give {}, or train without it: --set loss.perceptual.weight=0",
                PerceptualLoss::expected_file()
            );
            return Err(Error::config("loss.perceptual.file", reason));
        }
        let load = || PerceptualLoss::load(Path::new(file), *distance).map(Arc::new);
        let perceptual = if *weight > 0.0 { Some((*weight, load()?)) } else { None };
        Ok(Self { l1: config.l1, perceptual })
    }

    /// A loss with a network that was not read from a file.
    #[cfg(test)]
    pub(super) fn with_perceptual(l1: f64, weight: f64, perceptual: PerceptualLoss) -> Self {
        Self { l1, perceptual: Some((weight, Arc::new(perceptual))) }
    }

    /// Computes the loss of a batch, and a tensor of one number with the same gradient.
    ///
    /// # Equation
    /// `w₁ · mean |restored − clean| + w₂ · d(VGG(restored), VGG(clean))`, means over all values.
    ///
    /// # Errors
    /// Those of [`PerceptualLoss::value_and_gradient`].
    ///
    /// # Panics
    /// Never: the network computes in 32-bit floats.
    pub(super) fn of(&self, restored: Tensor<4>, clean: Tensor<4>) -> Result<(f64, Tensor<1>)> {
        let l1 = mean((restored.clone() - clean.clone()).abs()).mul_scalar(self.l1);
        let value = f64::from(l1.clone().into_scalar::<f32>());
        let Some((weight, perceptual)) = &self.perceptual else { return Ok((value, l1)) };
        let [items, channels, height, width] = restored.dims();
        let numbers = |tensor: Tensor<4>| tensor.try_into_vec_as::<f32>().expect("images are 32-bit floats");
        let sides = [items, height, width];
        let restored_numbers = numbers(restored.clone().detach());
        let (distance, gradient) =
            perceptual.value_and_gradient(&restored_numbers, &numbers(clean), sides)?;
        let gradient = TensorData::new(gradient, [items, channels, height, width]);
        let gradient = Tensor::<4>::from_data(gradient, &restored.device());
        // Its gradient to `restored` is the distance's; its value means nothing.
        let slope = (restored * gradient).sum().mul_scalar(*weight);
        Ok((value + weight * distance, l1 + slope))
    }
}

/// Axis by axis: Burn sums many values at once in an order that differs from run to run.
fn mean(x: Tensor<4>) -> Tensor<1> {
    (0..4).rev().fold(x, |x, axis| x.mean_dim(axis)).reshape([1])
}

//! The perceptual loss on a device: VGG-19 of Burn's operations, which take its gradient by themselves.

use burn::tensor::activation::relu;
use burn::tensor::module::{conv2d, max_pool2d};
use burn::tensor::ops::{ConvOptions, MaxPoolOptions};
use burn::tensor::{Device, Tensor, TensorData};

use super::vgg::{DEVIATION, FeatureDistance, MEAN, check_sides};
use crate::core::error::Result;
use crate::core::image::CHANNELS;

/// VGG-19 up to conv5_4, before its rectifier, on a device.
#[derive(Debug)]
pub struct PerceptualTensors {
    /// Weight `[outputs, inputs, 3, 3]` and bias of the convolutions of each resolution.
    stages: Vec<Vec<(Tensor<4>, Tensor<1>)>>,
    distance: FeatureDistance,
}

impl PerceptualTensors {
    /// Brings convolutions to a device, stage by stage.
    pub(super) fn new(
        stages: &[Vec<(Vec<f32>, Vec<f32>)>],
        distance: FeatureDistance,
        device: &Device,
    ) -> Self {
        let bring = |(weight, bias): &(Vec<f32>, Vec<f32>)| {
            let (outputs, inputs) = (bias.len(), weight.len() / bias.len() / 9);
            let weight = TensorData::new(weight.clone(), [outputs, inputs, 3, 3]);
            let bias = TensorData::new(bias.clone(), [outputs]);
            (Tensor::from_data(weight, device), Tensor::from_data(bias, device))
        };
        Self { stages: stages.iter().map(|stage| stage.iter().map(bring).collect()).collect(), distance }
    }

    /// The loss of a batch of tone-mapped images against the clean ones, as
    /// [`PerceptualLoss::value_and_gradient`](super::PerceptualLoss::value_and_gradient) computes it.
    ///
    /// # Shapes
    /// Both are `[item, 3, height, width]` on the network's device.
    ///
    /// # Errors
    /// [`Error::Shape`](crate::core::error::Error::Shape) when the images are shorter than 16 pixels.
    pub fn distance(&self, restored: Tensor<4>, clean: Tensor<4>) -> Result<Tensor<1>> {
        let [_, _, height, width] = restored.dims();
        check_sides([height, width])?;
        let difference = self.features(restored) - self.features(clean);
        Ok(match self.distance {
            FeatureDistance::SquaredL2 => (difference.clone() * difference).mean(),
            FeatureDistance::L1 => difference.abs().mean(),
        })
    }

    fn features(&self, images: Tensor<4>) -> Tensor<4> {
        let device = images.device();
        let per_channel = |values: [f32; CHANNELS]| {
            Tensor::<4>::from_data(TensorData::new(values.to_vec(), [1, CHANNELS, 1, 1]), &device)
        };
        let mut x = (images - per_channel(MEAN)) / per_channel(DEVIATION);
        let last = self.stages.len() - 1;
        for (s, stage) in self.stages.iter().enumerate() {
            if s > 0 {
                x = max_pool2d(x, MaxPoolOptions::new([2, 2]));
            }
            for (c, (weight, bias)) in stage.iter().enumerate() {
                let options = ConvOptions::new([1, 1], [1, 1], [1, 1], 1);
                x = conv2d(x, weight.clone(), Some(bias.clone()), options);
                if s < last || c + 1 < stage.len() {
                    x = relu(x);
                }
            }
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::super::PerceptualLoss;
    use super::*;

    fn numbers(seed: usize, count: usize) -> Vec<f32> {
        (0..count).map(|i| ((i * 7919 + seed * 31) % 1000) as f32 / 1000.0).collect()
    }

    fn stages() -> Vec<Vec<(Vec<f32>, Vec<f32>)>> {
        let convolution = |seed: usize, inputs: usize, outputs: usize| {
            let weight = numbers(seed, outputs * inputs * 9).into_iter().map(|w| w - 0.5).collect();
            (weight, numbers(seed + 1, outputs))
        };
        vec![
            vec![convolution(1, 3, 4), convolution(2, 4, 4)],
            vec![convolution(3, 4, 5), convolution(4, 5, 6)],
        ]
    }

    /// The same sums in another order.
    #[test]
    fn value_and_gradient_are_those_of_the_kernels() {
        let device = Device::flex().autodiff();
        let shape = [2, CHANNELS, 16, 18];
        let (restored, clean) = (numbers(5, shape.iter().product()), numbers(9, shape.iter().product()));
        for distance in [FeatureDistance::SquaredL2, FeatureDistance::L1] {
            let kernels = PerceptualLoss::of_convolutions(&stages(), distance);
            let (value, gradient) = kernels.value_and_gradient(&restored, &clean, [2, 16, 18]).unwrap();
            let tensors = PerceptualTensors::new(&stages(), distance, &device);
            let tensor =
                |values: &Vec<f32>| Tensor::<4>::from_data(TensorData::new(values.clone(), shape), &device);
            let restored = tensor(&restored).require_grad();
            let found = tensors.distance(restored.clone(), tensor(&clean)).unwrap();
            let slope = restored.grad(&found.backward()).unwrap().try_into_vec_as::<f32>().unwrap();
            let found = f64::from(found.into_scalar::<f32>());
            assert!((found / value - 1.0).abs() < 1e-4, "{distance:?}: {found} {value}");
            let largest = gradient.iter().fold(0.0f32, |largest, g| largest.max(g.abs()));
            let error = slope.iter().zip(&gradient).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(error < 1e-3 * largest, "{distance:?}: {error:e} of {largest:e}");
        }
    }
}

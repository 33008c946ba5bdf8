//! LPIPS on a device, in Burn's operations.

use burn::tensor::activation::relu;
use burn::tensor::module::{conv2d, max_pool2d};
use burn::tensor::ops::{ConvOptions, MaxPoolOptions};
use burn::tensor::{Device, Tensor, TensorData};

use super::{FIRST_STRIDE, LAYERS, POOLED, SCALE, SHIFT, Weights, values_of};
use crate::core::error::Result;
use crate::core::image::{CHANNELS, ToneMappedImage};
use crate::network::numbers_of;

/// What keeps the division by a feature vector's length finite.
const EPSILON: f32 = 1e-10;

/// The network on a device.
#[derive(Debug)]
pub(super) struct LpipsTensors {
    layers: Vec<Layer>,
    device: Device,
}

/// A convolution, and how the features after it are compared.
#[derive(Debug)]
struct Layer {
    /// `[outputs, inputs, side, side]`.
    weight: Tensor<4>,
    bias: Tensor<1>,
    options: ConvOptions<2>,
    /// A weight for every channel, `[1, channels, 1, 1]`.
    linear: Tensor<4>,
}

impl LpipsTensors {
    /// Brings the weights to the device.
    pub(super) fn new(weights: Weights, device: &Device) -> Self {
        let convolutions = weights.convolutions.into_iter().zip(weights.linear).zip(LAYERS);
        let bring = |(((weight, bias), linear), (place, inputs, outputs, side)): (_, _)| {
            let (stride, padding) = if place == 0 { (FIRST_STRIDE, 2) } else { (1, side / 2) };
            Layer {
                weight: Tensor::from_data(TensorData::new(weight, [outputs, inputs, side, side]), device),
                bias: Tensor::from_data(TensorData::new(bias, [outputs]), device),
                options: ConvOptions::new([stride; 2], [padding; 2], [1, 1], 1),
                linear: Tensor::from_data(TensorData::new(linear, [1, outputs, 1, 1]), device),
            }
        };
        Self { layers: convolutions.map(bring).collect(), device: device.clone() }
    }

    /// The distance of two images of one size.
    ///
    /// # Errors
    /// [`Error::Device`](crate::core::error::Error::Device).
    pub(super) fn distance(&self, a: &ToneMappedImage, b: &ToneMappedImage) -> Result<f64> {
        let per_channel = |values: [f32; CHANNELS]| {
            Tensor::<4>::from_data(TensorData::new(values.to_vec(), [1, CHANNELS, 1, 1]), &self.device)
        };
        let values: Vec<f32> = values_of(a).chain(values_of(b)).collect();
        let pair = TensorData::new(values, [2, CHANNELS, a.height(), a.width()]);
        let mut x = (Tensor::<4>::from_data(pair, &self.device) - per_channel(SHIFT)) / per_channel(SCALE);
        let mut rows = Vec::with_capacity(LAYERS.len());
        for (index, layer) in self.layers.iter().enumerate() {
            if POOLED.contains(&index) {
                x = max_pool2d(x, MaxPoolOptions::new([3, 3]).with_stride([2, 2]));
            }
            x = relu(conv2d(x, layer.weight.clone(), Some(layer.bias.clone()), layer.options.clone()));
            rows.push(layer.compare(x.clone()));
        }
        Ok(numbers_of(Tensor::cat(rows, 2))?.into_iter().map(f64::from).sum())
    }
}

impl Layer {
    /// What each row of a pair of features adds to the distance, `[1, 1, height, 1]`.
    ///
    /// Rows are summed by the caller, with 64 bits: a device's sum over all pixels is less exact.
    fn compare(&self, features: Tensor<4>) -> Tensor<4> {
        let height = features.dims()[2] as f64;
        let length = (features.clone() * features.clone()).sum_dim(1).sqrt() + EPSILON;
        let unit = features / length;
        let difference = unit.clone().narrow(0, 0, 1) - unit.narrow(0, 1, 1);
        let of_pixels = (difference.clone() * difference * self.linear.clone()).sum_dim(1);
        of_pixels.mean_dim(3) / height
    }
}

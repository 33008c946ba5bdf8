//! LPIPS: a learned distance between two images' AlexNet features.

mod kernels;
mod tensors;

use std::path::Path;

use self::kernels::LpipsKernels;
use self::tensors::LpipsTensors;
use super::weights::Source;
use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, ToneMappedImage};
use crate::network::Backend;

/// Place in torchvision's list, inputs, outputs, side of AlexNet's convolutions.
const LAYERS: [(usize, usize, usize, usize); 5] =
    [(0, 3, 64, 11), (3, 64, 192, 5), (6, 192, 384, 3), (8, 384, 256, 3), (10, 256, 256, 3)];

/// The layers before which a 3 × 3 pooling of stride 2 stands.
const POOLED: [usize; 2] = [1, 2];

/// The first layer's stride.
const FIRST_STRIDE: usize = 4;

/// What is subtracted from, and divides, images of range [−1, 1].
const SHIFT: [f32; CHANNELS] = [-0.030, -0.088, -0.188];
const SCALE: [f32; CHANNELS] = [0.458, 0.448, 0.450];

/// The shortest side that leaves a pixel after both poolings.
const SHORTEST_SIDE: usize = 31;

const ALEXNET: Source = Source {
    network: "AlexNet",
    origin: "torchvision's, https://download.pytorch.org/models/alexnet-owt-7be5be79.pth, or a .safetensors file of \
             the same tensors (features.0.weight [64, 3, 11, 11], features.0.bias [64], … up to features.10)",
};

const LINEAR: Source = Source {
    network: "LPIPS' linear layers",
    origin: "lpips/weights/v0.1/alex.pth of https://github.com/richzhang/PerceptualSimilarity, or a .safetensors \
             file of the same tensors (lin0.model.1.weight [1, 64, 1, 1] … lin4.model.1.weight)",
};

/// The weights, as files have them.
struct Weights {
    /// Weight `[outputs, inputs, side, side]` and bias `[outputs]` of each of [`LAYERS`].
    convolutions: Vec<(Vec<f32>, Vec<f32>)>,
    /// A weight for every channel of every layer.
    linear: Vec<Vec<f32>>,
}

/// The metric with its weights.
#[derive(Debug)]
pub struct Lpips(Place);

/// Where the network computes.
#[derive(Debug)]
enum Place {
    /// In main memory, by the kernels.
    Kernels(LpipsKernels),
    /// In operations of a device.
    Tensors(LpipsTensors),
}

impl Lpips {
    /// Reads AlexNet's weights and those of the linear layers (`.pth` or `.safetensors`), to compute on a backend.
    ///
    /// # Errors
    /// [`Error::Format`] when a file is missing, damaged or of another layout, saying what it should be.
    pub fn load(alexnet: &Path, linear: &Path, backend: Backend) -> Result<Self> {
        let weights = Weights::read(alexnet, linear)?;
        Ok(Self(if backend.is_cpu() {
            Place::Kernels(LpipsKernels::new(weights))
        } else {
            Place::Tensors(LpipsTensors::new(weights, &backend.device()))
        }))
    }

    /// The distance of two tone-mapped images of one size; 0 when they are equal, the smaller the more alike.
    ///
    /// Values are clamped to [0, 1] and not rounded; the published evaluation rounds images to 8 bits before,
    /// which is left to the caller.
    ///
    /// # Equation
    /// `Σ_layers mean_pixels Σ_channels w·(f/|f| − g/|g|)²` with f, g the features after each of AlexNet's five
    /// ReLUs (Zhang, Isola, Efros, Shechtman, Wang, CVPR 2018; version 0.1, without dropout).
    ///
    /// # Errors
    /// [`Error::Shape`] when the images differ in size or are shorter than 31 pixels; [`Error::Device`] when a device fails.
    pub fn distance(&self, a: &ToneMappedImage, b: &ToneMappedImage) -> Result<f64> {
        let size = |image: &ToneMappedImage| format!("{} × {}", image.height(), image.width());
        if (a.height(), a.width()) != (b.height(), b.width()) {
            return Err(Error::shape("size of the compared image", size(b), size(a)));
        }
        if a.height().min(a.width()) < SHORTEST_SIDE {
            let expected = format!("at least {SHORTEST_SIDE} × {SHORTEST_SIDE}");
            return Err(Error::shape("image to measure", expected, size(a)));
        }
        match &self.0 {
            Place::Kernels(kernels) => Ok(kernels.distance(a, b)),
            Place::Tensors(tensors) => tensors.distance(a, b),
        }
    }
}

impl Weights {
    fn read(alexnet: &Path, linear: &Path) -> Result<Self> {
        let of_layer = |(place, inputs, outputs, side): (usize, usize, usize, usize)| {
            let name = |part: &str| format!("features.{place}.{part}");
            [(name("weight"), vec![outputs, inputs, side, side]), (name("bias"), vec![outputs])]
        };
        let wanted: Vec<_> = LAYERS.into_iter().flat_map(of_layer).collect();
        let mut tensors = ALEXNET.read(alexnet, &wanted)?.into_iter();
        let convolutions = std::iter::from_fn(|| tensors.next().zip(tensors.next())).collect();
        let name = |(i, (_, _, channels, _)): (usize, _)| {
            (format!("lin{i}.model.1.weight"), vec![1, channels, 1, 1])
        };
        let wanted: Vec<_> = LAYERS.into_iter().enumerate().map(name).collect();
        Ok(Self { convolutions, linear: LINEAR.read(linear, &wanted)? })
    }
}

/// The values of an image in the network's range, [−1, 1], before they are normalised; planes.
fn values_of(image: &ToneMappedImage) -> impl Iterator<Item = f32> {
    image.as_slice().iter().map(|value| 2.0 * value.clamp(0.0, 1.0) - 1.0)
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;

    use super::*;

    /// Numbers of [−1, 1) without order.
    fn numbers(seed: u64, count: usize) -> Vec<f32> {
        let number = |i: u64| {
            let z = (i + (seed << 32)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            let z = (z ^ (z >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            ((z >> 40) as f32 / 8_388_608.0) - 1.0
        };
        (0..count as u64).map(number).collect()
    }

    fn weights() -> Weights {
        let convolution = |(i, (_, inputs, outputs, side)): (usize, (usize, usize, usize, usize))| {
            let fan_in = inputs * side * side;
            let scale = (6.0 / fan_in as f32).sqrt();
            let weight = numbers(i as u64, outputs * fan_in).into_iter().map(|w| w * scale).collect();
            (weight, numbers(10 + i as u64, outputs).into_iter().map(|b| 0.1 * b).collect())
        };
        let linear = |(i, (_, _, outputs, _)): (usize, (usize, usize, usize, usize))| {
            numbers(20 + i as u64, outputs).into_iter().map(|w| 1.0 + w).collect()
        };
        Weights {
            convolutions: LAYERS.into_iter().enumerate().map(convolution).collect(),
            linear: LAYERS.into_iter().enumerate().map(linear).collect(),
        }
    }

    fn image(seed: u64, [height, width]: [usize; 2]) -> ToneMappedImage {
        let values = numbers(seed, CHANNELS * height * width).into_iter().map(|v| 0.5 + 0.6 * v).collect();
        ToneMappedImage::from_planes(Array3::from_shape_vec((CHANNELS, height, width), values).unwrap())
            .unwrap()
    }

    /// The same sums in another order; sides that the strides do not divide, and the shortest.
    #[test]
    fn distances_on_a_device_are_those_of_the_kernels() {
        let kernels = LpipsKernels::new(weights());
        let tensors = LpipsTensors::new(weights(), &Backend::AsDevice.device());
        for size in [[31, 31], [64, 50], [47, 90]] {
            let (a, b) = (image(40, size), image(41, size));
            let (expected, found) = (kernels.distance(&a, &b), tensors.distance(&a, &b).unwrap());
            assert!((found / expected - 1.0).abs() < 1e-5, "{size:?}: {found}, {expected} by the kernels");
            assert!(tensors.distance(&a, &a).unwrap().abs() < 1e-12, "{size:?}");
        }
    }
}

//! LPIPS: a learned distance between two images' AlexNet features.

use std::path::Path;

use super::features::Features;
use super::pool::max_pool;
use super::weights::Source;
use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, ToneMappedImage};
use crate::kernels::{Convolution, Geometry, Shape};

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

/// What keeps the division by a feature vector's length finite.
const EPSILON: f64 = 1e-10;

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

/// The metric with its weights.
pub struct Lpips {
    convolutions: Vec<Convolution>,
    /// A weight for every channel of every layer.
    linear: Vec<Vec<f32>>,
}

impl std::fmt::Debug for Lpips {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Lpips").finish_non_exhaustive()
    }
}

impl Lpips {
    /// Reads AlexNet's weights and those of the linear layers (`.pth` or `.safetensors`).
    ///
    /// # Errors
    /// [`Error::Format`] when a file is missing, damaged or of another layout, saying what it should be.
    pub fn load(alexnet: &Path, linear: &Path) -> Result<Self> {
        let of_layer = |(place, inputs, outputs, side): (usize, usize, usize, usize)| {
            let name = |part: &str| format!("features.{place}.{part}");
            [(name("weight"), vec![outputs, inputs, side, side]), (name("bias"), vec![outputs])]
        };
        let wanted: Vec<_> = LAYERS.into_iter().flat_map(of_layer).collect();
        let tensors = ALEXNET.read(alexnet, &wanted)?;
        let pack = |(pair, (place, inputs, outputs, side)): (&[Vec<f32>], _)| {
            let stride = if place == 0 { FIRST_STRIDE } else { 1 };
            Convolution::new(Geometry { inputs, outputs, side, stride }, &pair[0], &pair[1])
        };
        let convolutions = tensors.chunks_exact(2).zip(LAYERS).map(pack).collect();
        let name = |(i, (_, _, channels, _)): (usize, _)| {
            (format!("lin{i}.model.1.weight"), vec![1, channels, 1, 1])
        };
        let wanted: Vec<_> = LAYERS.into_iter().enumerate().map(name).collect();
        Ok(Self { convolutions, linear: LINEAR.read(linear, &wanted)? })
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
    /// [`Error::Shape`] when the images differ in size or are shorter than 31 pixels.
    pub fn distance(&self, a: &ToneMappedImage, b: &ToneMappedImage) -> Result<f64> {
        let size = |image: &ToneMappedImage| format!("{} × {}", image.height(), image.width());
        if (a.height(), a.width()) != (b.height(), b.width()) {
            return Err(Error::shape("size of the compared image", size(b), size(a)));
        }
        if a.height().min(a.width()) < SHORTEST_SIDE {
            let expected = format!("at least {SHORTEST_SIDE} × {SHORTEST_SIDE}");
            return Err(Error::shape("image to measure", expected, size(a)));
        }
        let (mut a, mut b) = (input(a), input(b));
        let mut distance = 0.0;
        for (layer, (convolution, linear)) in self.convolutions.iter().zip(&self.linear).enumerate() {
            a = advance(layer, convolution, &a);
            b = advance(layer, convolution, &b);
            distance += compare(&a, &b, linear);
        }
        Ok(distance)
    }
}

/// An image as the network reads it.
///
/// The first convolution pads by 2 where the kernels pad by 5: with one row and column of zeros on top and on the
/// left, the kernels' second output, 4 pixels on, sees what the network's first should.
fn input(image: &ToneMappedImage) -> Features {
    let shape = Shape::new(1, image.height(), image.width(), CHANNELS);
    let clamped: Vec<f32> = image.as_slice().iter().map(|value| 2.0 * value.clamp(0.0, 1.0) - 1.0).collect();
    let scale = SCALE.map(f32::recip);
    let shift = std::array::from_fn(|c| -SHIFT[c] / SCALE[c]);
    let pixels = Features::of_planes(&clamped, shape, scale, shift);
    let padded = Shape { height: shape.height + 1, width: shape.width + 1, ..shape };
    let mut values = vec![0.0; padded.len()];
    let rows = values.chunks_exact_mut(padded.row_len()).skip(1);
    for (to, from) in rows.zip(pixels.values.chunks_exact(shape.row_len())) {
        to[CHANNELS..].copy_from_slice(from);
    }
    Features { values, shape: padded }
}

/// The features after a layer's ReLU.
fn advance(layer: usize, convolution: &Convolution, x: &Features) -> Features {
    if POOLED.contains(&layer) {
        return max_pool(x, 3, 2).convolve(convolution, 0.0);
    }
    let features = x.convolve(convolution, 0.0);
    if layer > 0 {
        return features;
    }
    // The network's outputs among the kernels', which are more by the first and sometimes the last.
    let extent = |padded: usize| (padded - 1 - 7) / FIRST_STRIDE + 1;
    let (from, channels) = (features.shape, features.shape.channels);
    let shape = Shape { height: extent(x.shape.height), width: extent(x.shape.width), ..from };
    let rows = features.values.chunks_exact(from.row_len()).skip(1).take(shape.height);
    let values = rows.flat_map(|row| &row[channels..][..shape.row_len()]).copied().collect();
    Features { values, shape }
}

/// The mean over pixels of the weighted squared difference of unit feature vectors.
fn compare(a: &Features, b: &Features, linear: &[f32]) -> f64 {
    let channels = a.shape.channels;
    let length =
        |pixel: &[f32]| pixel.iter().map(|v| f64::from(*v) * f64::from(*v)).sum::<f64>().sqrt() + EPSILON;
    let of_pixel = |(a, b): (&[f32], &[f32])| {
        let (of_a, of_b) = (length(a), length(b));
        let values = a.iter().zip(b).zip(linear);
        values
            .map(|((a, b), w)| f64::from(*w) * (f64::from(*a) / of_a - f64::from(*b) / of_b).powi(2))
            .sum::<f64>()
    };
    let pixels = a.values.chunks_exact(channels).zip(b.values.chunks_exact(channels));
    #[expect(clippy::cast_precision_loss, reason = "numbers of pixels are exact in f64")]
    let count = a.shape.pixels() as f64;
    pixels.map(of_pixel).sum::<f64>() / count
}

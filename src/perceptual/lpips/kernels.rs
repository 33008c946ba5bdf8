//! LPIPS in main memory.

use super::{FIRST_STRIDE, LAYERS, POOLED, SCALE, SHIFT, Weights, values_of};
use crate::core::image::{CHANNELS, ToneMappedImage};
use crate::kernels::{Convolution, Geometry, Shape};
use crate::perceptual::features::Features;
use crate::perceptual::pool::max_pool;

/// What keeps the division by a feature vector's length finite.
const EPSILON: f64 = 1e-10;

/// The network of the project's kernels.
pub(super) struct LpipsKernels {
    convolutions: Vec<Convolution>,
    /// A weight for every channel of every layer.
    linear: Vec<Vec<f32>>,
}

impl std::fmt::Debug for LpipsKernels {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LpipsKernels").finish_non_exhaustive()
    }
}

impl LpipsKernels {
    pub(super) fn new(weights: Weights) -> Self {
        let pack = |((weight, bias), (place, inputs, outputs, side)): (&(Vec<f32>, Vec<f32>), _)| {
            let stride = if place == 0 { FIRST_STRIDE } else { 1 };
            Convolution::new(Geometry { inputs, outputs, side, stride }, weight, bias)
        };
        let convolutions = weights.convolutions.iter().zip(LAYERS).map(pack).collect();
        Self { convolutions, linear: weights.linear }
    }

    /// The distance of two images of one size.
    pub(super) fn distance(&self, a: &ToneMappedImage, b: &ToneMappedImage) -> f64 {
        let (mut a, mut b) = (input(a), input(b));
        let mut distance = 0.0;
        for (layer, (convolution, linear)) in self.convolutions.iter().zip(&self.linear).enumerate() {
            a = advance(layer, convolution, &a);
            b = advance(layer, convolution, &b);
            distance += compare(&a, &b, linear);
        }
        distance
    }
}

/// An image as the network reads it.
///
/// The first convolution pads by 2 where the kernels pad by 5: with one row and column of zeros on top and on the
/// left, the kernels' second output, 4 pixels on, sees what the network's first should.
fn input(image: &ToneMappedImage) -> Features {
    let shape = Shape::new(1, image.height(), image.width(), CHANNELS);
    let clamped: Vec<f32> = values_of(image).collect();
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

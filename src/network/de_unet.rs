//! DE-UNet: a U-Net with two encoders of the image, whose features are added.
//!
//! # Source
//! The double-encoder U-Net of "Image restoration for under-display camera" (Zhou, Ren, Emerton, Lim, Large, CVPR
//! 2021), where one encoder finds the content and the other the residual details, as the DISCNet paper compares
//! with it: on three-channel images, 9.02 M parameters, 169 GMAC for 800 × 800. Neither paper prints the layers;
//! these meet both numbers (9,019,459 parameters, 169.27 GMAC):
//! - five resolutions of n = 32, 2n, 4n, 8n, 16n features; two 3 × 3 convolutions on each, the first of stride 2
//!   but on the finest;
//! - a second encoder like it for the four finest, its features added to the first one's: the sums are the skip
//!   connections, and the fourth is what the coarsest resolution reads;
//! - back up: nearest-neighbour enlargement and a 3 × 3 convolution to half the features, the sum of both
//!   encoders' features added, two 3 × 3 convolutions;
//! - a 1 × 1 convolution to the image, to which the input is added.
//!
//! LeakyReLU 0.2 follows every convolution but the last. Strides in place of pooling, and the input that is added,
//! are choices of this project: they cost neither parameters nor multiplications.

use burn::module::Module;
use burn::tensor::Tensor;

use super::architecture::{Architecture, Condition};
use super::builder::Builder;
use super::family::{Family, Forward, Stream, check_condition};
use super::inputs::InputTensors;
use super::layers::{Layer, LayerList};
use super::operations::{
    Activation, ConvolutionWeights, LEAKY_SLOPE, convolution, enlarged_convolution, enlarging_weights,
    from_layout, to_layout, widened,
};
use super::precision::Precision;
use super::streamed::{Part, StreamBuilder};
use crate::core::error::Result;
use crate::core::image::CHANNELS;
use crate::kernels::{self, stream};

/// Number of resolutions.
const LEVELS: usize = 5;

/// The surroundings of a tile that starts at a multiple of 16. Its first row depends on 2, 4, 5, 5, 4 rows above it
/// in the decoder's resolutions, from the finest to the coarsest, and through these on 10, 22, 46 and at last 95 in
/// the encoders', back to the finest; its last row on fewer below.
const HALO: usize = 96;

/// The encoder that reaches down to the coarsest resolution, and the one that stops before it.
const ENCODERS: [(&str, usize); 2] = [("content", LEVELS), ("detail", LEVELS - 1)];

/// The family.
pub(super) struct DeUnet;

impl Family for DeUnet {
    type Network = Layers;

    fn layers(&self, architecture: &Architecture) -> Vec<Layer> {
        layers(architecture)
    }

    fn halo(&self) -> usize {
        HALO
    }

    fn side_multiple(&self) -> usize {
        1 << (LEVELS - 1)
    }

    fn validate(&self, architecture: &Architecture) -> Result<()> {
        check_condition(architecture, (Condition::Image, "image"))
    }

    fn stream(&self) -> Option<Stream> {
        Some(stream)
    }

    fn build(&self, _architecture: &Architecture, build: &Builder<'_>) -> Layers {
        let [content, detail] = ENCODERS.map(|(encoder, levels)| {
            (0..levels).map(|level| Pair::new(build, &format!("{encoder}.{level}"))).collect()
        });
        let decoder = |level: usize| DecoderScale {
            up: build.convolution(&format!("decoder.{level}.up")),
            pair: Pair::new(build, &format!("decoder.{level}")),
        };
        let decoder = (0..LEVELS - 1).map(decoder).collect();
        Layers { content, detail, decoder, last: build.convolution("last") }
    }
}

/// Every layer with weights, in order.
fn layers(architecture: &Architecture) -> Vec<Layer> {
    let channels = |level: usize| architecture.features << level;
    let mut list = LayerList::default();
    for (encoder, levels) in ENCODERS {
        for level in 0..levels {
            let inputs = if level == 0 { CHANNELS } else { channels(level - 1) };
            list.convolution(format!("{encoder}.{level}.0"), [inputs, channels(level), 3], level);
            list.convolution(format!("{encoder}.{level}.1"), [channels(level), channels(level), 3], level);
        }
    }
    for level in (0..LEVELS - 1).rev() {
        let (fine, coarse) = (channels(level), channels(level + 1));
        list.convolution(format!("decoder.{level}.up"), [coarse, fine, 3], level);
        list.convolution(format!("decoder.{level}.0"), [fine, fine, 3], level);
        list.convolution(format!("decoder.{level}.1"), [fine, fine, 3], level);
    }
    list.convolution("last", [channels(0), CHANNELS, 1], 0);
    list.0
}

/// The stride of an encoder's first convolution on a level.
fn stride(level: usize) -> usize {
    if level == 0 { 1 } else { 2 }
}

/// The two convolutions of one resolution.
#[derive(Module, Debug)]
struct Pair {
    first: ConvolutionWeights,
    second: ConvolutionWeights,
}

/// One resolution of the decoder.
#[derive(Module, Debug)]
struct DecoderScale {
    up: ConvolutionWeights,
    pair: Pair,
}

/// The network's weights.
#[derive(Module, Debug)]
pub(super) struct Layers {
    content: Vec<Pair>,
    detail: Vec<Pair>,
    decoder: Vec<DecoderScale>,
    last: ConvolutionWeights,
}

impl Pair {
    fn new(build: &Builder<'_>, name: &str) -> Self {
        let [first, second] = ["0", "1"].map(|part| build.convolution(&format!("{name}.{part}")));
        Self { first, second }
    }

    fn forward(&self, x: Tensor<4>, stride: usize) -> Tensor<4> {
        let x = convolution(x, &self.first, stride, Activation::LeakyRelu);
        convolution(x, &self.second, 1, Activation::LeakyRelu)
    }
}

impl Forward for Layers {
    fn forward(&self, inputs: InputTensors, precision: Precision) -> Tensor<4> {
        let image = inputs.image;
        let input = to_layout(image.clone(), precision);
        let (mut content, mut detail) = (input.clone(), input);
        let mut skips = Vec::with_capacity(self.detail.len());
        for (level, (first, second)) in self.content.iter().zip(&self.detail).enumerate() {
            content = first.forward(content, stride(level));
            detail = second.forward(detail, stride(level));
            skips.push(content.clone() + detail.clone());
        }
        let coarsest = self.content.last().expect("there are five resolutions");
        let joined = skips.last().expect("there are four skip connections").clone();
        let x = coarsest.forward(joined, stride(LEVELS - 1));
        let x = self
            .decoder
            .iter()
            .zip(skips)
            .rev()
            .fold(x, |x, (scale, skip)| scale.pair.forward(enlarged_convolution(x, &scale.up, skip), 1));
        from_layout(convolution(widened(x), &self.last, 1, Activation::None)) + image
    }
}

/// Appends all steps.
fn stream(build: &mut StreamBuilder<'_>, _architecture: &Architecture) {
    let image = build.input(&[Part::Image]);
    let (mut content, mut detail) = (image, image);
    let mut skips = Vec::new();
    for level in 0..LEVELS - 1 {
        content = pair(build, &format!("content.{level}"), (content, stride(level)));
        detail = pair(build, &format!("detail.{level}"), (detail, stride(level)));
        skips.push(build.network.add(content, detail));
    }
    let level = LEVELS - 1;
    let mut x = pair(build, &format!("content.{level}"), (skips[level - 1], stride(level)));
    for (level, skip) in skips.into_iter().enumerate().rev() {
        let (weight, bias) = build.layer(&format!("decoder.{level}.up"));
        let (weight, bias) = enlarging_weights(weight, bias);
        build.derived_weights += weight.len();
        let inputs = weight.len() / bias.len() / 9;
        let up = kernels::Convolution::up(build.isa, inputs, &weight, &bias);
        x = build.network.convolution(x, up, LEAKY_SLOPE, Some(skip));
        x = pair(build, &format!("decoder.{level}"), (x, 1));
    }
    let last = build.pack_sized("last", 1, 1);
    build.network.convolution(x, last, 1.0, Some(image));
}

fn pair(
    build: &mut StreamBuilder<'_>,
    name: &str,
    (input, stride): (stream::Tensor, usize),
) -> stream::Tensor {
    let first = build.pack(&format!("{name}.0"), stride);
    let x = build.network.convolution(input, first, LEAKY_SLOPE, None);
    build.convolution(&format!("{name}.1"), x, LEAKY_SLOPE, None)
}

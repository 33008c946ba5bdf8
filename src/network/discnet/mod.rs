//! DISCNet: a U-Net whose skip connections are filtered, pixel by pixel, with filters predicted from the
//! degraded image and the kernel code.
//!
//! The graph is written three times, as the list of layers, as tensors and as streamed steps: the second must keep each
//! weight in a field of a module, by which Burn finds it, and the third counts rows, so that one text for all would be an
//! interpreter longer than the three.

mod layers;
mod stream;

use burn::module::{Module, Param};
use burn::tensor::Tensor;

use super::architecture::{Architecture, Condition};
use super::builder::Builder;
use super::family::{Family, Forward, Stream, check_condition};
use super::inputs::InputTensors;
use super::layers::Layer;
use super::operations::{
    Activation, ConvolutionWeights, FilterHead, LEAKY_SLOPE, ResBlockWeights, convolution, dynamic_filter,
    from_layout, res_block, to_layout, up_convolution, widened,
};
use super::precision::Precision;
use crate::core::error::Result;
use layers::{LEVELS, filter_generator_name, has_filters};

/// The surroundings of a tile: the receptive field has a radius of 79 for every filter size.
const HALO: usize = 80;

/// The family of DISCNet and its ablations.
pub(super) struct Discnet;

impl Family for Discnet {
    type Network = DiscNet;

    fn layers(&self, architecture: &Architecture) -> Vec<Layer> {
        layers::layers(architecture)
    }

    fn halo(&self) -> usize {
        HALO
    }

    fn side_multiple(&self) -> usize {
        1 << (LEVELS - 1)
    }

    fn validate(&self, _architecture: &Architecture) -> Result<()> {
        Ok(())
    }

    fn reads_key(&self, architecture: &Architecture, key: &str) -> bool {
        !["scales", "filter-size"].contains(&key) || architecture.condition != Condition::None
    }

    fn stream(&self) -> Option<Stream> {
        Some(stream::stream)
    }

    fn build(&self, architecture: &Architecture, build: &Builder<'_>) -> DiscNet {
        DiscNet::new(architecture, build)
    }
}

/// The family of its restoration branch, a DISCNet that is told nothing.
pub(super) struct Unet;

impl Family for Unet {
    type Network = DiscNet;

    fn layers(&self, architecture: &Architecture) -> Vec<Layer> {
        Discnet.layers(architecture)
    }

    fn halo(&self) -> usize {
        Discnet.halo()
    }

    fn side_multiple(&self) -> usize {
        Discnet.side_multiple()
    }

    fn validate(&self, architecture: &Architecture) -> Result<()> {
        check_condition(architecture, (Condition::None, "none"))
    }

    fn stream(&self) -> Option<Stream> {
        Discnet.stream()
    }

    fn build(&self, architecture: &Architecture, build: &Builder<'_>) -> DiscNet {
        Discnet.build(architecture, build)
    }
}

/// A strided convolution and two residual blocks: one resolution of an encoder.
#[derive(Module, Debug)]
struct EncoderScale {
    conv: ConvolutionWeights,
    blocks: [ResBlockWeights; 2],
}

/// Predicts the filters of one resolution.
#[derive(Module, Debug)]
struct FilterGenerator {
    conv: ConvolutionWeights,
    slope: Param<Tensor<1>>,
    blocks: [ResBlockWeights; 2],
    head: FilterHead,
}

/// An up-convolution and two residual blocks: one resolution of the decoder.
#[derive(Module, Debug)]
struct DecoderScale {
    conv: ConvolutionWeights,
    blocks: [ResBlockWeights; 2],
}

/// The network's weights, and what tells how to connect them.
#[derive(Module, Debug)]
pub(super) struct DiscNet {
    encoder: Vec<EncoderScale>,
    condition_encoder: Vec<EncoderScale>,
    filters: Vec<Option<FilterGenerator>>,
    decoder: Vec<DecoderScale>,
    last: ConvolutionWeights,
    #[module(skip)]
    condition: Condition,
    #[module(skip)]
    filter_size: usize,
}

impl DiscNet {
    fn new(architecture: &Architecture, build: &Builder<'_>) -> Self {
        let encoder = |prefix: &str| {
            (1..=LEVELS).map(|scale| EncoderScale::new(build, prefix, scale)).collect::<Vec<_>>()
        };
        let filters = |level| has_filters(architecture, level).then(|| FilterGenerator::new(build, level));
        let has_condition = layers::condition_channels(architecture).is_some();
        Self {
            encoder: encoder("conv"),
            condition_encoder: if has_condition { encoder("kconv") } else { Vec::new() },
            filters: (0..LEVELS).map(filters).collect(),
            decoder: (1..LEVELS).map(|scale| DecoderScale::new(build, scale)).collect(),
            last: build.convolution("final_conv.0"),
            condition: architecture.condition,
            filter_size: architecture.filter_size,
        }
    }

    /// What the condition encoder reads: the code's map first, then the image.
    fn condition_input(&self, image: &Tensor<4>, map: Option<Tensor<4>>) -> Option<Tensor<4>> {
        match (map, self.condition.uses_image().then(|| image.clone())) {
            (Some(map), Some(image)) => Some(Tensor::cat(vec![map, image], 1)),
            (map, image) => map.or(image),
        }
    }

    fn filter_skips(&self, skips: Vec<Tensor<4>>, conditions: Vec<Tensor<4>>) -> Vec<Tensor<4>> {
        let size = self.filter_size;
        let filter = |((skip, condition), generator): ((_, _), &Option<FilterGenerator>)| match generator {
            Some(generator) => dynamic_filter(&generator.forward(condition), skip, &generator.head, size),
            None => skip,
        };
        skips.into_iter().zip(conditions).zip(&self.filters).map(filter).collect()
    }

    fn decode(&self, mut skips: Vec<Tensor<4>>) -> Tensor<4> {
        let coarsest = skips.pop().expect("the encoder has three resolutions");
        skips.into_iter().zip(&self.decoder).rev().fold(coarsest, |x, (skip, scale)| {
            refine(up_convolution(x, &scale.conv, LEAKY_SLOPE, skip), &scale.blocks)
        })
    }
}

impl Forward for DiscNet {
    fn forward(&self, InputTensors { image, map, .. }: InputTensors, precision: Precision) -> Tensor<4> {
        let skips = encode(&self.encoder, to_layout(image.clone(), precision)); // n, 2n, 4n channels
        let skips = match self.condition_input(&image, map) {
            Some(input) => {
                self.filter_skips(skips, encode(&self.condition_encoder, to_layout(input, precision)))
            }
            None => skips,
        };
        let decoded = widened(self.decode(skips)); // n channels
        from_layout(convolution(decoded, &self.last, 1, Activation::LeakyRelu)) + image
    }
}

impl EncoderScale {
    fn new(build: &Builder<'_>, prefix: &str, scale: usize) -> Self {
        Self {
            conv: build.convolution(&format!("{prefix}_{scale}1.0")),
            blocks: [2, 3].map(|part| build.res_block(&format!("{prefix}_{scale}{part}"))),
        }
    }
}

impl DecoderScale {
    fn new(build: &Builder<'_>, scale: usize) -> Self {
        Self {
            conv: build.convolution(&format!("upconv_{scale}1.0")),
            blocks: [2, 3].map(|part| build.res_block(&format!("upconv_{scale}{part}"))),
        }
    }
}

impl FilterGenerator {
    fn new(build: &Builder<'_>, level: usize) -> Self {
        let name = filter_generator_name(level);
        Self {
            conv: build.convolution(&format!("{name}.0.0")),
            slope: build.tensor(&format!("{name}.0.1.weight")),
            blocks: [1, 2].map(|part| build.res_block(&format!("{name}.{part}"))),
            head: FilterHead {
                conv: build.convolution(&format!("{name}.3.0")),
                slope: build.tensor(&format!("{name}.3.1.weight")),
            },
        }
    }

    /// All layers but the head, which is fused with the filters' application.
    fn forward(&self, condition: Tensor<4>) -> Tensor<4> {
        refine(convolution(condition, &self.conv, 1, Activation::PRelu(&self.slope)), &self.blocks)
    }
}

/// The features of every resolution, finest first.
fn encode(encoder: &[EncoderScale], input: Tensor<4>) -> Vec<Tensor<4>> {
    let mut x = input;
    let mut features = Vec::with_capacity(encoder.len());
    for (level, scale) in encoder.iter().enumerate() {
        let stride = if level == 0 { 1 } else { 2 };
        x = refine(convolution(x, &scale.conv, stride, Activation::LeakyRelu), &scale.blocks);
        features.push(x.clone());
    }
    features
}

fn refine(x: Tensor<4>, blocks: &[ResBlockWeights]) -> Tensor<4> {
    blocks.iter().fold(x, res_block)
}

//! SRMDNF without up-sampling: plain convolutions of the image and its degradation map.
//!
//! # Source
//! "Learning a single convolutional super-resolution network for multiple degradations" (Zhang, Zuo, Zhang,
//! CVPR 2018): the noise-free variant, twelve 3 × 3 convolutions of n = 128 features with ReLU between, without
//! batch normalisation. Its last layer gives an image of the input's size here: 1,488,643 parameters and
//! 951.8 GMAC for 800 × 800, the paper's 1.49 M and 951. Names count convolutions and ReLUs, as the authors'
//! sequential module does.

use burn::module::Module;
use burn::tensor::Tensor;

use super::architecture::{Architecture, Condition};
use super::builder::Builder;
use super::family::{Family, Forward, Stream, check_condition};
use super::inputs::InputTensors;
use super::layers::{Layer, LayerList};
use super::operations::{Activation, ConvolutionWeights, convolution, from_layout, to_layout, widened};
use super::precision::Precision;
use super::streamed::{Part, StreamBuilder};
use crate::core::error::Result;
use crate::core::image::CHANNELS;

/// Number of convolutions.
const DEPTH: usize = 12;

/// The surroundings of a tile: a pixel for each convolution.
const HALO: usize = DEPTH;

fn name(index: usize) -> String {
    format!("model.{}", 2 * index)
}

/// The family.
pub(super) struct Srmdnf;

impl Family for Srmdnf {
    type Network = Layers;

    fn layers(&self, architecture: &Architecture) -> Vec<Layer> {
        let mut list = LayerList::default();
        for index in 0..DEPTH {
            let inputs = if index == 0 { CHANNELS + architecture.code_dim } else { architecture.features };
            let outputs = if index == DEPTH - 1 { CHANNELS } else { architecture.features };
            list.convolution(name(index), [inputs, outputs, 3], 0);
        }
        list.0
    }

    fn halo(&self) -> usize {
        HALO
    }

    fn validate(&self, architecture: &Architecture) -> Result<()> {
        check_condition(architecture, (Condition::ImagePsf, "image+psf"))
    }

    fn stream(&self) -> Option<Stream> {
        Some(stream)
    }

    fn build(&self, _architecture: &Architecture, build: &Builder<'_>) -> Layers {
        Layers { convolutions: (0..DEPTH).map(|index| build.convolution(&name(index))).collect() }
    }
}

/// The network's weights.
#[derive(Module, Debug)]
pub(super) struct Layers {
    convolutions: Vec<ConvolutionWeights>,
}

impl Forward for Layers {
    fn forward(&self, inputs: InputTensors, precision: Precision) -> Tensor<4> {
        let (last, first) = self.convolutions.split_last().expect("there are twelve");
        let map = inputs.map();
        let input = to_layout(Tensor::cat(vec![inputs.image, map], 1), precision);
        let features = first.iter().fold(input, |x, layer| convolution(x, layer, 1, Activation::Relu));
        from_layout(convolution(widened(features), last, 1, Activation::None))
    }
}

/// Appends all steps.
fn stream(build: &mut StreamBuilder<'_>, architecture: &Architecture) {
    let input = build.input(&[Part::Image, Part::Map(architecture.code_dim)]);
    let features = (0..DEPTH - 1).fold(input, |x, index| build.convolution(&name(index), x, 0.0, None));
    build.convolution(&name(DEPTH - 1), features, 1.0, None);
}

//! The smallest network that reads every plane, to test all that hands planes on: as streamed rows and as tensors.

use burn::module::Module;
use burn::tensor::Tensor;

use super::architecture::{Architecture, Condition};
use super::builder::Builder;
use super::family::{Family, Forward, Stream, check_condition};
use super::inputs::{InputTensors, Plane};
use super::layers::{Layer, LayerList};
use super::operations::{
    Activation, ConvolutionWeights, LEAKY_SLOPE, convolution, from_layout, to_layout, widened,
};
use super::precision::Precision;
use super::streamed::{Part, StreamBuilder};
use crate::core::error::Result;
use crate::core::image::CHANNELS;

/// What it reads, in the order of its first layer.
pub(crate) const PLANES: &[Plane] = &[Plane::Deconvolved, Plane::Noise, Plane::Saturated, Plane::Outside];

/// A pixel for each convolution, rounded up to a multiple of 4.
const HALO: usize = 4;

/// The family that is streamed.
pub(super) struct AllPlanes;

/// The family that is not.
pub(super) struct AllPlanesTensors;

impl Family for AllPlanes {
    type Network = Layers;

    fn layers(&self, architecture: &Architecture) -> Vec<Layer> {
        let mut list = LayerList::default();
        let inputs = CHANNELS * (1 + PLANES.len());
        list.convolution("first", [inputs, architecture.features, 3], 0);
        list.convolution("last", [architecture.features, CHANNELS, 3], 0);
        list.0
    }

    fn halo(&self) -> usize {
        HALO
    }

    fn planes(&self) -> &'static [Plane] {
        PLANES
    }

    fn validate(&self, architecture: &Architecture) -> Result<()> {
        check_condition(architecture, (Condition::None, "none"))
    }

    fn stream(&self) -> Option<Stream> {
        Some(stream)
    }

    fn build(&self, _architecture: &Architecture, build: &Builder<'_>) -> Layers {
        Layers { first: build.convolution("first"), last: build.convolution("last") }
    }
}

impl Family for AllPlanesTensors {
    type Network = Layers;

    fn layers(&self, architecture: &Architecture) -> Vec<Layer> {
        AllPlanes.layers(architecture)
    }

    fn halo(&self) -> usize {
        HALO
    }

    fn planes(&self) -> &'static [Plane] {
        PLANES
    }

    fn validate(&self, architecture: &Architecture) -> Result<()> {
        AllPlanes.validate(architecture)
    }

    fn build(&self, architecture: &Architecture, build: &Builder<'_>) -> Layers {
        AllPlanes.build(architecture, build)
    }
}

/// Two convolutions, whose result is added to the image.
#[derive(Module, Debug)]
pub(super) struct Layers {
    first: ConvolutionWeights,
    last: ConvolutionWeights,
}

impl Forward for Layers {
    fn forward(&self, inputs: InputTensors, precision: Precision) -> Tensor<4> {
        let planes = PLANES.iter().map(|&plane| inputs.plane(plane));
        let input = std::iter::once(inputs.image.clone()).chain(planes).collect();
        let x =
            convolution(to_layout(Tensor::cat(input, 1), precision), &self.first, 1, Activation::LeakyRelu);
        from_layout(convolution(widened(x), &self.last, 1, Activation::None)) + inputs.image
    }
}

fn stream(build: &mut StreamBuilder<'_>, _architecture: &Architecture) {
    let mut parts = vec![Part::Image];
    parts.extend(PLANES.iter().copied().map(Part::from));
    let (image, input) = (build.input(&[Part::Image]), build.input(&parts));
    let x = build.convolution("first", input, LEAKY_SLOPE, None);
    build.convolution("last", x, 1.0, Some(image));
}

/// Planes that differ from each other, for images of any sides.
pub(crate) fn planes_of(image: &crate::core::image::ToneMappedImage) -> super::Planes {
    let scales = [0.7, -0.4, 1.3, 0.9];
    PLANES.iter().zip(scales).map(|(&plane, scale)| (plane, image.map_values(|v| scale * v * v))).collect()
}

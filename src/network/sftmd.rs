//! SFTMD without up-sampling: residual blocks whose features the degradation map scales and shifts.
//!
//! # Source
//! "Blind super-resolution with iterative kernel correction" (Gu, Lu, Zuo, Dong, CVPR 2019), the network that is
//! told the kernel. Three 3 × 3 convolutions (LeakyReLU 0.2 between them, none after), sixteen blocks, their
//! sum with what the first block was given, one more modulation, a 3 × 3 convolution, and a 9 × 9 convolution to
//! the image where the original's pixel shuffles stood before. n = 64 features and n/2 inside of a modulation give
//! 3,844,227 parameters (the paper has 3.85 M) and 2454.8 GMAC for 800 × 800, or 2460.3 with an addition for each
//! bias: the paper's 2460. The original's final clamp to [0, 1] is left out: it has no gradient outside.
//!
//! # Equation
//! With c the features followed by the map: `SFT(x) = x · σ(M₂(LeakyReLU(M₁ c))) + A₂(LeakyReLU(A₁ c))`, and
//! `block(x) = x + conv2(ReLU(SFT₂(conv1(ReLU(SFT₁(x))))))`.

use burn::module::Module;
use burn::tensor::Tensor;

use super::architecture::{Architecture, Condition};
use super::builder::Builder;
use super::family::{Family, Forward, Stream, check_condition};
use super::inputs::InputTensors;
use super::layers::{Layer, LayerList};
use super::operations::{
    Activation, ConvolutionWeights, LEAKY_SLOPE, convolution, from_layout, modulation, to_layout, widened,
};
use super::parameters::Initialisation;
use super::precision::Precision;
use super::streamed::{Part, StreamBuilder};
use crate::core::error::{Error, Result};
use crate::core::image::CHANNELS;
use crate::kernels::stream;

/// Number of residual blocks.
const BLOCKS: usize = 16;

/// Side of the last convolution.
const LAST_SIDE: usize = 9;

/// The surroundings of a tile: 3 pixels for the head, 6 for each block, 3 for modulation and convolution, 4 for
/// the last; 106 rounded up to a multiple of 4.
const HALO: usize = (3 + 6 * BLOCKS + 3 + LAST_SIDE / 2_usize).next_multiple_of(4);

fn block_name(index: usize) -> String {
    format!("SFT-residual{}", index + 1)
}

/// The family.
pub(super) struct Sftmd;

impl Family for Sftmd {
    type Network = Layers;

    fn layers(&self, architecture: &Architecture) -> Vec<Layer> {
        layers(architecture)
    }

    fn halo(&self) -> usize {
        HALO
    }

    fn validate(&self, architecture: &Architecture) -> Result<()> {
        check_condition(architecture, (Condition::ImagePsf, "image+psf"))
    }

    fn check_initialisation(&self, initialisation: Initialisation) -> Result<()> {
        if initialisation == Initialisation::Paper {
            let reason = "\"paper\" makes the sixteen residual blocks of sftmd multiply their signals to 10⁶; use \
                          \"released\"";
            return Err(Error::config("initialisation", reason));
        }
        Ok(())
    }

    fn stream(&self) -> Option<Stream> {
        Some(stream)
    }

    fn build(&self, _architecture: &Architecture, build: &Builder<'_>) -> Layers {
        Layers {
            head: ["conv1", "conv2", "conv3"].map(|name| build.convolution(name)),
            blocks: (0..BLOCKS).map(|index| Block::new(build, &block_name(index))).collect(),
            modulation: Modulation::new(build, "sft"),
            middle: build.convolution("conv_mid"),
            last: build.convolution("conv_output"),
        }
    }
}

/// Every layer with weights, in order.
fn layers(architecture: &Architecture) -> Vec<Layer> {
    let (n, b) = (architecture.features, architecture.code_dim);
    let mut list = LayerList::default();
    let modulation = |list: &mut LayerList, name: &str| {
        let inner = n.div_ceil(2);
        for part in ["mul", "add"] {
            list.convolution(format!("{name}.{part}_conv1"), [n + b, inner, 3], 0);
            list.convolution(format!("{name}.{part}_conv2"), [inner, n, 3], 0);
        }
    };
    list.convolution("conv1", [CHANNELS, n, 3], 0);
    list.convolution("conv2", [n, n, 3], 0);
    list.convolution("conv3", [n, n, 3], 0);
    for block in (0..BLOCKS).map(block_name) {
        modulation(&mut list, &format!("{block}.sft1"));
        modulation(&mut list, &format!("{block}.sft2"));
        list.convolution(format!("{block}.conv1"), [n, n, 3], 0);
        list.convolution(format!("{block}.conv2"), [n, n, 3], 0);
    }
    modulation(&mut list, "sft");
    list.convolution("conv_mid", [n, n, 3], 0);
    list.convolution("conv_output", [n, CHANNELS, LAST_SIDE], 0);
    list.0
}

/// Two convolutions with a LeakyReLU between them.
#[derive(Module, Debug)]
struct Branch {
    conv1: ConvolutionWeights,
    conv2: ConvolutionWeights,
}

/// A spatial feature transform.
#[derive(Module, Debug)]
struct Modulation {
    scale: Branch,
    offset: Branch,
}

/// A residual block with a modulation before each convolution.
#[derive(Module, Debug)]
struct Block {
    modulations: [Modulation; 2],
    convolutions: [ConvolutionWeights; 2],
}

/// The network's weights.
#[derive(Module, Debug)]
pub(super) struct Layers {
    head: [ConvolutionWeights; 3],
    blocks: Vec<Block>,
    modulation: Modulation,
    middle: ConvolutionWeights,
    last: ConvolutionWeights,
}

impl Branch {
    fn new(build: &Builder<'_>, name: &str) -> Self {
        let [conv1, conv2] = ["conv1", "conv2"].map(|part| build.convolution(&format!("{name}_{part}")));
        Self { conv1, conv2 }
    }
}

impl Modulation {
    fn new(build: &Builder<'_>, name: &str) -> Self {
        let [scale, offset] = ["mul", "add"].map(|part| Branch::new(build, &format!("{name}.{part}")));
        Self { scale, offset }
    }

    fn forward(&self, x: Tensor<4>, map: &Tensor<4>, slope: f32) -> Tensor<4> {
        let branches = [&self.scale, &self.offset].map(|branch| [&branch.conv1, &branch.conv2]);
        modulation(x, map, branches, slope)
    }
}

impl Block {
    fn new(build: &Builder<'_>, name: &str) -> Self {
        Self {
            modulations: ["sft1", "sft2"].map(|part| Modulation::new(build, &format!("{name}.{part}"))),
            convolutions: ["conv1", "conv2"].map(|part| build.convolution(&format!("{name}.{part}"))),
        }
    }

    fn forward(&self, x: Tensor<4>, map: &Tensor<4>) -> Tensor<4> {
        let steps = self.modulations.iter().zip(&self.convolutions);
        let inner = steps.fold(x.clone(), |x, (modulation, layer)| {
            convolution(modulation.forward(x, map, 0.0), layer, 1, Activation::None)
        });
        x + inner
    }
}

impl Forward for Layers {
    fn forward(&self, inputs: InputTensors, precision: Precision) -> Tensor<4> {
        let map = to_layout(inputs.map(), precision);
        let [first, second, third] = &self.head;
        let x = convolution(to_layout(inputs.image, precision), first, 1, Activation::LeakyRelu);
        let x = convolution(x, second, 1, Activation::LeakyRelu);
        let head = convolution(x, third, 1, Activation::None);
        let x = self.blocks.iter().fold(head.clone(), |x, block| block.forward(x, &map));
        let x = self.modulation.forward(x + head, &map, 1.0);
        let x = convolution(x, &self.middle, 1, Activation::None);
        from_layout(convolution(widened(x), &self.last, 1, Activation::None))
    }
}

/// Appends all steps.
fn stream(build: &mut StreamBuilder<'_>, architecture: &Architecture) {
    let image = build.input(&[Part::Image]);
    let map = build.input(&[Part::Map(architecture.code_dim)]);
    let x = build.convolution("conv1", image, LEAKY_SLOPE, None);
    let x = build.convolution("conv2", x, LEAKY_SLOPE, None);
    let head = build.convolution("conv3", x, 1.0, None);
    let mut x = head;
    for block in (0..BLOCKS).map(block_name) {
        let inner = modulate(build, &format!("{block}.sft1"), (x, map), 0.0);
        let inner = build.convolution(&format!("{block}.conv1"), inner, 1.0, None);
        let inner = modulate(build, &format!("{block}.sft2"), (inner, map), 0.0);
        x = build.convolution(&format!("{block}.conv2"), inner, 1.0, Some(x));
    }
    let x = build.network.add(x, head);
    let x = modulate(build, "sft", (x, map), 1.0);
    let x = build.convolution("conv_mid", x, 1.0, None);
    let last = build.pack_sized("conv_output", LAST_SIDE, 1);
    build.network.convolution(x, last, 1.0, None);
}

fn modulate(
    build: &mut StreamBuilder<'_>,
    name: &str,
    (x, map): (stream::Tensor, stream::Tensor),
    slope: f32,
) -> stream::Tensor {
    let joined = build.network.concatenate(x, map);
    let [scale, offset] = ["mul", "add"].map(|part| {
        let inner = build.convolution(&format!("{name}.{part}_conv1"), joined, LEAKY_SLOPE, None);
        build.convolution(&format!("{name}.{part}_conv2"), inner, 1.0, None)
    });
    build.network.modulate(x, scale, offset, slope)
}

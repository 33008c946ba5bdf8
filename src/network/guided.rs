//! The guided network: a U-Net that corrects an image which was deconvolved with its PSF.
//!
//! # Method
//! It reads the capture, the deconvolved image, the noise that is left in it, which pixels were saturated and how much light
//! may have come from outside of the frame, all tone-mapped, and adds what it makes of them to the deconvolved image. A
//! deconvolution has undone what the PSF explains by then, for any panel; what remains looks alike behind all of them: noise,
//! rings around what was clipped, lost detail.
//!
//! The finest features have half the image's sides: a convolution of stride 2 reads all fifteen channels, and a pixel
//! shuffle brings the correction back to the full sides. There a pixel of n = 48 features has room for all that is in the
//! images of its 2 × 2 pixels, one multiplication reaches twice as far, and a vector of the CPU is full. At full
//! resolution the same multiplications buy 16 features.
//!
//! Three resolutions of n, 4n/3 and 2n features (48, 64 and 96); at each, residual blocks (`x + conv(LeakyReLU(conv(x)))`)
//! on the way down and up, a convolution of stride 2 to the next, an up-convolution with pixel shuffle back, to which the
//! skip connection is added. All convolutions are 3 × 3.

use burn::module::Module;
use burn::tensor::Tensor;

use super::architecture::{Architecture, Condition};
use super::builder::Builder;
use super::family::{Family, Forward, Stream, check_condition};
use super::inputs::{InputTensors, Plane};
use super::layers::{Layer, LayerList};
use super::operations::{
    Activation, ConvolutionWeights, LEAKY_SLOPE, ResBlockWeights, convolution, from_layout, res_block,
    to_layout, up_convolution, widened,
};
use super::precision::Precision;
use super::streamed::{Part, StreamBuilder};
use crate::core::error::Result;
use crate::core::image::CHANNELS;
use crate::kernels::stream::Tensor as Streamed;
use crate::kernels::{Convolution, Geometry};

/// One resolution: its features in thirds of n, and its residual blocks on the way down and up.
struct Scale {
    thirds: usize,
    encoder: usize,
    decoder: usize,
}

/// From half the image's sides on. The blocks fill 80,000 multiplications a pixel; those of the coarsest reach far, for
/// 2,592 each, and the finest ones cost 10,368.
const SCALES: [Scale; 3] = [
    Scale { thirds: 3, encoder: 2, decoder: 2 },
    Scale { thirds: 4, encoder: 1, decoder: 2 },
    Scale { thirds: 6, encoder: 3, decoder: 0 },
];

/// The planes that it reads after the image.
const PLANES: &[Plane] = &[Plane::Deconvolved, Plane::Noise, Plane::Saturated, Plane::Outside];

/// What the noise is multiplied by: its deviation is some hundredths of white, and weights should not have to grow to tell
/// one noise from another.
const NOISE_SCALE: f32 = 16.0;

/// Channels that the first layer reads, and those among them that are noise.
const INPUTS: usize = CHANNELS * (1 + PLANES.len());
const NOISE_INPUTS: std::ops::Range<usize> = 2 * CHANNELS..3 * CHANNELS;

/// Sides of the image per side of the coarsest resolution.
const SIDE_MULTIPLE: usize = 1 << SCALES.len();

/// The surroundings of a tile that starts at a multiple of 8.
const HALO: usize = reach().next_multiple_of(SIDE_MULTIPLE);

/// Pixels above the first row of such a tile that it depends on; its last row depends on fewer below.
const fn reach() -> usize {
    // From the output inwards: above row 0 of twice the sides lies one row less than half of them, and a tap.
    let (mut above, mut scale) = (1, 0);
    while scale + 1 < SCALES.len() {
        above = (above + 2 * SCALES[scale].decoder).div_ceil(2) + 1;
        scale += 1;
    }
    above += 2 * SCALES[scale].decoder;
    loop {
        above = 2 * (above + 2 * SCALES[scale].encoder) + 1;
        if scale == 0 {
            return above;
        }
        scale -= 1;
    }
}

/// The family.
pub(super) struct Guided;

impl Family for Guided {
    type Network = Layers;

    fn layers(&self, architecture: &Architecture) -> Vec<Layer> {
        layers(architecture)
    }

    fn halo(&self) -> usize {
        HALO
    }

    fn side_multiple(&self) -> usize {
        SIDE_MULTIPLE
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
        let blocks = |part: &str, scale: usize, count: usize| -> Vec<ResBlockWeights> {
            (0..count).map(|block| build.res_block(&block_name(part, scale, block))).collect()
        };
        let encoder = |(scale, spec): (usize, &Scale)| EncoderScale {
            down: build.convolution(&format!("encoder.{scale}.down")),
            blocks: blocks("encoder", scale, spec.encoder),
        };
        let decoder = |(scale, spec): (usize, &Scale)| DecoderScale {
            up: build.convolution(&format!("decoder.{scale}.up")),
            blocks: blocks("decoder", scale, spec.decoder),
        };
        Layers {
            encoder: SCALES.iter().enumerate().map(encoder).collect(),
            decoder: finer_scales().map(decoder).collect(),
            last: build.convolution("last"),
        }
    }
}

/// Features of a resolution.
fn channels(architecture: &Architecture, scale: usize) -> usize {
    architecture.features * SCALES[scale].thirds / 3
}

/// The resolutions that are returned to, the finest first.
fn finer_scales() -> impl DoubleEndedIterator<Item = (usize, &'static Scale)> + ExactSizeIterator {
    SCALES.iter().enumerate().take(SCALES.len() - 1)
}

fn block_name(part: &str, scale: usize, block: usize) -> String {
    format!("{part}.{scale}.{block}")
}

/// Every layer with weights, in order.
fn layers(architecture: &Architecture) -> Vec<Layer> {
    let channels = |scale| channels(architecture, scale);
    let mut list = LayerList::default();
    let blocks = |list: &mut LayerList, (part, scale): (&str, usize), count: usize| {
        for block in 0..count {
            list.res_block(&block_name(part, scale, block), channels(scale), scale + 1);
        }
    };
    for (scale, Scale { encoder, .. }) in SCALES.iter().enumerate() {
        let inputs = if scale == 0 { INPUTS } else { channels(scale - 1) };
        list.convolution(format!("encoder.{scale}.down"), [inputs, channels(scale), 3], scale + 1);
        blocks(&mut list, ("encoder", scale), *encoder);
    }
    for (scale, Scale { decoder, .. }) in finer_scales().rev() {
        let extent = [channels(scale + 1), 4 * channels(scale), 3];
        list.convolution(format!("decoder.{scale}.up"), extent, scale + 2);
        blocks(&mut list, ("decoder", scale), *decoder);
    }
    list.correction("last", [channels(0), 4 * CHANNELS, 3], 1);
    list.0
}

/// A convolution of stride 2 and residual blocks: one resolution on the way down.
#[derive(Module, Debug)]
struct EncoderScale {
    down: ConvolutionWeights,
    blocks: Vec<ResBlockWeights>,
}

/// An up-convolution and residual blocks: one resolution on the way up.
#[derive(Module, Debug)]
struct DecoderScale {
    up: ConvolutionWeights,
    blocks: Vec<ResBlockWeights>,
}

/// The network's weights.
#[derive(Module, Debug)]
pub(super) struct Layers {
    encoder: Vec<EncoderScale>,
    decoder: Vec<DecoderScale>,
    last: ConvolutionWeights,
}

impl Forward for Layers {
    fn forward(&self, inputs: InputTensors, precision: Precision) -> Tensor<4> {
        let deconvolved = inputs.plane(Plane::Deconvolved);
        let noise = inputs.plane(Plane::Noise) * NOISE_SCALE;
        let [saturated, outside] = [Plane::Saturated, Plane::Outside].map(|plane| inputs.plane(plane));
        let planes = vec![inputs.image, deconvolved.clone(), noise, saturated, outside];
        let mut x = to_layout(Tensor::cat(planes, 1), precision);
        let mut skips = Vec::with_capacity(self.encoder.len());
        for scale in &self.encoder {
            x = refine(convolution(x, &scale.down, 2, Activation::LeakyRelu), &scale.blocks);
            skips.push(x.clone());
        }
        let coarsest = skips.pop().expect("there are three resolutions");
        let x = self.decoder.iter().zip(skips).rev().fold(coarsest, |x, (scale, skip)| {
            refine(up_convolution(x, &scale.up, LEAKY_SLOPE, skip), &scale.blocks)
        });
        let deconvolved = to_layout(deconvolved, Precision::F32);
        from_layout(up_convolution(widened(x), &self.last, 1.0, deconvolved))
    }
}

fn refine(x: Tensor<4>, blocks: &[ResBlockWeights]) -> Tensor<4> {
    blocks.iter().fold(x, res_block)
}

/// Appends all steps.
fn stream(build: &mut StreamBuilder<'_>, architecture: &Architecture) {
    let mut parts = vec![Part::Image];
    parts.extend(PLANES.iter().copied().map(Part::from));
    let deconvolved = build.input(&[Plane::Deconvolved.into()]);
    let input = build.input(&parts);
    let mut x = build.network.convolution(input, first(build, architecture), LEAKY_SLOPE, None);
    let mut skips = Vec::new();
    for (scale, Scale { encoder, .. }) in SCALES.iter().enumerate() {
        if scale > 0 {
            let down = build.pack(&format!("encoder.{scale}.down"), 2);
            x = build.network.convolution(x, down, LEAKY_SLOPE, None);
        }
        x = stream_blocks(build, ("encoder", scale), *encoder, x);
        skips.push(x);
    }
    for ((scale, Scale { decoder, .. }), skip) in finer_scales().zip(skips).rev() {
        let up = pack_up(build, &format!("decoder.{scale}.up"));
        x = build.network.convolution(x, up, LEAKY_SLOPE, Some(skip));
        x = stream_blocks(build, ("decoder", scale), *decoder, x);
    }
    let last = pack_up(build, "last");
    build.network.convolution(x, last, 1.0, Some(deconvolved));
}

/// The first layer, whose weights take the noise's scale on.
fn first(build: &StreamBuilder<'_>, architecture: &Architecture) -> Convolution {
    let (weight, bias) = build.layer("encoder.0.down");
    let geometry = Geometry { inputs: INPUTS, outputs: channels(architecture, 0), side: 3, stride: 2 };
    let is_noise = |at: usize| NOISE_INPUTS.contains(&(at / 9 % INPUTS));
    let scale = |(at, value): (usize, &f32)| if is_noise(at) { NOISE_SCALE * value } else { *value };
    let weight: Vec<f32> = weight.iter().enumerate().map(scale).collect();
    Convolution::for_isa(build.isa, geometry, &weight, bias)
}

fn pack_up(build: &StreamBuilder<'_>, name: &str) -> Convolution {
    let (weight, bias) = build.layer(name);
    Convolution::up(build.isa, weight.len() / bias.len() / 9, weight, bias)
}

fn stream_blocks(
    build: &mut StreamBuilder<'_>,
    (part, scale): (&str, usize),
    count: usize,
    input: Streamed,
) -> Streamed {
    (0..count).fold(input, |x, block| {
        let name = block_name(part, scale, block);
        let [first, second] = ["conv1", "conv2"].map(|conv| build.pack(&format!("{name}.{conv}"), 1));
        build.network.res_block(x, first, second, LEAKY_SLOPE)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::ToneMappedImage;
    use crate::network::testing::planes_of;
    use crate::network::weights::Weights;
    use crate::network::{Backend, Initialisation, Inputs, Kind, Model, Network, Origin, Parameters};
    use burn::tensor::TensorData;
    use ndarray::Array3;

    fn architecture(features: usize) -> Architecture {
        let architecture = Architecture {
            kind: Kind::Guided,
            condition: Condition::None,
            features,
            ..Architecture::default()
        };
        architecture.validate().unwrap();
        architecture
    }

    /// As a program carries it: 80,000 multiplications a pixel, 3 MiB of half floats with what the file says.
    #[test]
    fn the_network_fits_its_budget() {
        let architecture = architecture(48);
        assert_eq!((architecture.parameters(), architecture.macs(800, 800)), (1_313_132, 50_526_720_000));
        assert!(architecture.macs(800, 800) <= 80_000 * 800 * 800);
        assert!(2 * architecture.parameters() < (3 << 20) - (1 << 16));
    }

    #[test]
    fn what_it_reads_and_costs_is_described() {
        let text = architecture(48).describe();
        let reads = "reads         image, deconvolved, noise, saturated, outside";
        for part in ["kind          guided", reads, "78.9 thousand each"] {
            assert!(text.contains(part), "{text}");
        }
        assert!(!text.contains("code-dim") && !text.contains("filter-size"), "{text}");
    }

    #[test]
    fn before_training_it_returns_the_deconvolved_image() {
        let architecture = architecture(6);
        let parameters = Parameters::random(&architecture, Initialisation::default(), 5);
        let model = Model::new(Weights { architecture, parameters, origin: Origin::default() });
        let value = |(c, y, x)| ((c * 7919 + y * 104_729 + x * 1299) % 1000) as f32 / 1000.0;
        let image = ToneMappedImage::from_planes(Array3::from_shape_fn((3, 19, 26), value)).unwrap();
        let planes = planes_of(&image);
        let restored = model.restore(&Inputs::new(&image, None).with_planes(&planes)).unwrap();
        assert_eq!(&restored, planes.get(Plane::Deconvolved).unwrap());
    }

    /// A pixel that is no number makes every pixel that depends on it none; with one feature no tile of Winograd's does.
    #[test]
    fn a_tile_depends_on_its_halo_and_no_further() {
        let device = Backend::default().device();
        let architecture = architecture(1);
        let parameters = Parameters::random(&architecture, Initialisation::Paper, 5);
        let network = Network::new(&architecture, &parameters, &device);
        let (start, width) = (2 * HALO, 5 * HALO);
        let last_that_depends_on = |column: usize| {
            let mut row = vec![0.5_f32; CHANNELS * width];
            row[column] = f32::NAN;
            let image = Tensor::from_data(TensorData::new(row, [1, CHANNELS, 1, width]), &device);
            let planes = PLANES.iter().map(|&plane| (plane, image.clone())).collect();
            let output = network.forward(InputTensors { image, map: None, planes });
            output.try_into_vec_as::<f32>().unwrap().iter().take(width).rposition(|v| v.is_nan()).unwrap()
        };
        assert!(last_that_depends_on(start - reach()) >= start);
        assert!(last_that_depends_on(start - reach() - 1) < start);
    }
}

//! DISCNet: a U-Net whose skip connections are filtered, pixel by pixel, with filters predicted from the
//! degraded image and the kernel code.

use std::collections::HashMap;

use burn::module::{Module, ModuleVisitor, Param, ParamId};
use burn::tensor::ops::PadMode;
use burn::tensor::{Device, Tensor, TensorData, s};

use super::architecture::{Architecture, Condition, LEVELS, SIDE_MULTIPLE, filter_generator_name};
use super::operations::{
    Activation, Convolution, FilterHead, ResBlock, convolution, dynamic_filter, from_layout, res_block,
    to_layout, up_convolution,
};
use super::parameters::{Parameter, Parameters};

/// A strided convolution and two residual blocks: one resolution of an encoder.
#[derive(Module, Debug)]
struct EncoderScale {
    conv: Convolution,
    blocks: [ResBlock; 2],
}

/// Predicts the filters of one resolution.
#[derive(Module, Debug)]
struct FilterGenerator {
    conv: Convolution,
    slope: Param<Tensor<1>>,
    blocks: [ResBlock; 2],
    head: FilterHead,
}

/// An up-convolution and two residual blocks: one resolution of the decoder.
#[derive(Module, Debug)]
struct DecoderScale {
    conv: Convolution,
    blocks: [ResBlock; 2],
}

/// The network, with its weights on a device.
#[derive(Module, Debug)]
pub struct DiscNet {
    encoder: Vec<EncoderScale>,
    condition_encoder: Vec<EncoderScale>,
    filters: Vec<Option<FilterGenerator>>,
    decoder: Vec<DecoderScale>,
    last: Convolution,
    #[module(skip)]
    architecture: Architecture,
}

impl DiscNet {
    /// Builds the network with the given weights; on a device with gradients they can be trained.
    ///
    /// # Panics
    /// When the weights are those of another architecture.
    pub fn new(architecture: &Architecture, parameters: &Parameters, device: &Device) -> Self {
        let build = Builder::new(parameters, device);
        let encoder = |prefix: &str| (1..=LEVELS).map(|scale| build.encoder_scale(prefix, scale)).collect();
        let filters = |level| architecture.has_filters(level).then(|| build.filter_generator(level));
        Self {
            encoder: encoder("conv"),
            condition_encoder: match architecture.condition {
                Condition::None => Vec::new(),
                _ => encoder("kconv"),
            },
            filters: (0..LEVELS).map(filters).collect(),
            decoder: (1..LEVELS).map(|scale| build.decoder_scale(scale)).collect(),
            last: build.convolution("final_conv.0"),
            architecture: architecture.clone(),
        }
    }

    /// The configuration that the network was built from.
    pub fn architecture(&self) -> &Architecture {
        &self.architecture
    }

    /// Restores a batch of tone-mapped images.
    ///
    /// # Shapes
    /// `image` `[item, 3, height, width]` of any size, `degradation_map` `[item, b, height, width]`, or
    /// `[item, b, 1, 1]` for a code that is the same everywhere; the result is shaped like the image.
    ///
    /// # Panics
    /// When the network needs a degradation map and there is none.
    pub fn forward(&self, image: Tensor<4>, degradation_map: Option<Tensor<4>>) -> Tensor<4> {
        let [_, _, height, width] = image.dims();
        let image = pad_to_multiple(image); // [N, 3, H, W]
        let [items, channels, padded_height, padded_width] = image.dims();
        let skips = encode(&self.encoder, to_layout(image.clone())); // n, 2n, 4n channels
        let skips = match self.condition_input(&image, degradation_map) {
            Some(input) => self.filter_skips(skips, encode(&self.condition_encoder, to_layout(input))),
            None => skips,
        };
        let decoded = self.decode(skips); // n channels
        let residual = from_layout(convolution(decoded, &self.last, 1, Activation::LeakyRelu));
        let restored = residual + image;
        if (padded_height, padded_width) == (height, width) {
            return restored;
        }
        restored.slice(s![0..items, 0..channels, 0..height, 0..width])
    }

    /// Copies the weights to main memory.
    ///
    /// # Panics
    /// Never: the network holds every weight of its architecture.
    pub fn parameters(&self) -> Parameters {
        let specs = self.architecture.tensors();
        let mut collect = Collect { parameters: vec![None; specs.len()] };
        self.visit(&mut collect);
        let named = specs.into_iter().zip(collect.parameters).map(|(spec, values)| {
            let values = values.unwrap_or_else(|| panic!("the network holds no {}", spec.name));
            Parameter { name: spec.name, shape: spec.shape, values }
        });
        Parameters::from_list(named.collect())
    }

    /// What the condition encoder reads: the code's map first, then the image.
    fn condition_input(&self, image: &Tensor<4>, map: Option<Tensor<4>>) -> Option<Tensor<4>> {
        let condition = self.architecture.condition;
        let map = condition.uses_code().then(|| {
            let map = map.expect("a network that reads kernel codes is given a degradation map");
            let [items, _, height, width] = image.dims();
            let [_, channels, map_height, map_width] = map.dims();
            let is_uniform = (map_height, map_width) == (1, 1);
            if is_uniform { map.expand([items, channels, height, width]) } else { pad_to_multiple(map) }
        });
        let image = condition.uses_image().then(|| image.clone());
        match (map, image) {
            (Some(map), Some(image)) => Some(Tensor::cat(vec![map, image], 1)),
            (map, image) => map.or(image),
        }
    }

    fn filter_skips(&self, skips: Vec<Tensor<4>>, conditions: Vec<Tensor<4>>) -> Vec<Tensor<4>> {
        let size = self.architecture.filter_size;
        let filter = |((skip, condition), generator): ((_, _), &Option<FilterGenerator>)| match generator {
            Some(generator) => dynamic_filter(&generator.forward(condition), skip, &generator.head, size),
            None => skip,
        };
        skips.into_iter().zip(conditions).zip(&self.filters).map(filter).collect()
    }

    fn decode(&self, mut skips: Vec<Tensor<4>>) -> Tensor<4> {
        let coarsest = skips.pop().expect("the encoder has three resolutions");
        skips
            .into_iter()
            .zip(&self.decoder)
            .rev()
            .fold(coarsest, |x, (skip, scale)| refine(up_convolution(x, &scale.conv, skip), &scale.blocks))
    }
}

impl FilterGenerator {
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

fn refine(x: Tensor<4>, blocks: &[ResBlock]) -> Tensor<4> {
    blocks.iter().fold(x, res_block)
}

/// Repeats the last row and column until the sides are multiples of 4.
fn pad_to_multiple(x: Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = x.dims();
    let missing = |side: usize| side.next_multiple_of(SIDE_MULTIPLE) - side;
    match (missing(height), missing(width)) {
        (0, 0) => x,
        (bottom, right) => x.pad([(0, bottom), (0, right)], PadMode::Edge),
    }
}

/// Makes layers of named weights. A weight's id is its place in the architecture's order, so that ids mean
/// the same in every process.
struct Builder<'a> {
    by_name: HashMap<&'a str, (u64, &'a Parameter)>,
    device: &'a Device,
}

impl<'a> Builder<'a> {
    fn new(parameters: &'a Parameters, device: &'a Device) -> Self {
        let by_name = (0..).zip(parameters.iter()).map(|(id, p)| (p.name.as_str(), (id, p))).collect();
        Self { by_name, device }
    }

    fn tensor<const D: usize>(&self, name: &str) -> Param<Tensor<D>> {
        let (id, parameter) = self.by_name.get(name).unwrap_or_else(|| panic!("there is no weight {name}"));
        let data = TensorData::new(parameter.values.clone(), parameter.shape.clone());
        let tensor = Tensor::from_data(data, self.device);
        Param::initialized(ParamId::from(*id), tensor).set_require_grad(self.device.is_autodiff())
    }

    fn convolution(&self, name: &str) -> Convolution {
        Convolution {
            weight: self.tensor(&format!("{name}.weight")),
            bias: self.tensor(&format!("{name}.bias")),
        }
    }

    fn res_block(&self, name: &str) -> ResBlock {
        ResBlock {
            conv1: self.convolution(&format!("{name}.conv1")),
            conv2: self.convolution(&format!("{name}.conv2")),
        }
    }

    fn encoder_scale(&self, prefix: &str, scale: usize) -> EncoderScale {
        EncoderScale {
            conv: self.convolution(&format!("{prefix}_{scale}1.0")),
            blocks: [2, 3].map(|part| self.res_block(&format!("{prefix}_{scale}{part}"))),
        }
    }

    fn decoder_scale(&self, scale: usize) -> DecoderScale {
        DecoderScale {
            conv: self.convolution(&format!("upconv_{scale}1.0")),
            blocks: [2, 3].map(|part| self.res_block(&format!("upconv_{scale}{part}"))),
        }
    }

    fn filter_generator(&self, level: usize) -> FilterGenerator {
        let name = filter_generator_name(level);
        FilterGenerator {
            conv: self.convolution(&format!("{name}.0.0")),
            slope: self.tensor(&format!("{name}.0.1.weight")),
            blocks: [1, 2].map(|part| self.res_block(&format!("{name}.{part}"))),
            head: FilterHead {
                conv: self.convolution(&format!("{name}.3.0")),
                slope: self.tensor(&format!("{name}.3.1.weight")),
            },
        }
    }
}

/// Copies every weight to its place in the architecture's order.
struct Collect {
    parameters: Vec<Option<Vec<f32>>>,
}

impl ModuleVisitor for Collect {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let index = usize::try_from(param.id.val()).expect("ids are small indices");
        let values = param.val().try_into_vec_as::<f32>().expect("weights are 32-bit floats");
        self.parameters[index] = Some(values);
    }
}

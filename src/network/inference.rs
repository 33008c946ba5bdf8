//! Whole images through the network without Burn's tensors: the kernels' steps, a few rows at a time.

use std::collections::HashMap;
use std::convert::Infallible;

use ndarray::{Array3, ArrayView3};

use super::architecture::{Architecture, LEVELS, SIDE_MULTIPLE, filter_generator_name};
use super::parameters::Parameters;
use crate::core::image::{CHANNELS, ToneMappedImage};
use crate::kernels::stream::{Network, Plan, Tensor};
use crate::kernels::{Convolution, DynamicFilter, Geometry, Isa};

/// The slope of every LeakyReLU.
const LEAKY_SLOPE: f32 = 0.2;

/// Bytes of packed weights per weight: Winograd's 36 points for 9 taps.
const PACKING: u64 = 4 * size_of::<f32>() as u64;

/// A network whose weights are packed for the kernels.
pub(super) struct Inference {
    network: Network,
    /// What the condition encoder reads: channels of the code's map, then of the image.
    condition: Option<(usize, usize)>,
}

impl std::fmt::Debug for Inference {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Inference").field("condition", &self.condition).finish_non_exhaustive()
    }
}

impl Inference {
    /// Packs the weights.
    pub(super) fn new(architecture: &Architecture, parameters: &Parameters) -> Self {
        let mut build = Builder {
            values: parameters.iter().map(|p| (p.name.as_str(), p.values.as_slice())).collect(),
            network: Network::default(),
        };
        let image = build.network.input(CHANNELS);
        let condition = architecture.condition_channels().map(|channels| {
            let of_image = if architecture.condition.uses_image() { CHANNELS } else { 0 };
            (channels - of_image, of_image)
        });
        let condition_input = condition.map(|(map, image)| build.network.input(map + image));
        let skips = build.encoder("conv", image);
        let conditions = condition_input.map(|input| build.encoder("kconv", input));
        let mut filtered = skips.clone();
        for (level, conditions) in conditions.iter().flatten().enumerate() {
            if architecture.has_filters(level) {
                filtered[level] = build.filter(level, architecture.filter_size, *conditions, skips[level]);
            }
        }
        let mut x = filtered[LEVELS - 1];
        for scale in (1..LEVELS).rev() {
            x = build.up_convolution(&format!("upconv_{scale}1.0"), x, filtered[scale - 1]);
            x = build.res_blocks(&[format!("upconv_{scale}2"), format!("upconv_{scale}3")], x);
        }
        build.convolution("final_conv.0", x, 1, LEAKY_SLOPE, Some(image));
        Self { network: build.network, condition }
    }

    /// Estimates the bytes that a run on an image takes, packed weights included, the image's own not.
    pub(super) fn bytes(&self, architecture: &Architecture, height: usize, width: usize) -> u64 {
        let (height, width) = (padded(height), padded(width));
        let windows = Plan::new(&self.network, height, width, rayon::current_num_threads()).bytes();
        windows as u64 + architecture.parameters() * PACKING
    }

    /// Restores an image; `map` is `[b, height, width]`, or `[b, 1, 1]` for a code that is the same everywhere.
    pub(super) fn restore(&self, image: &ToneMappedImage, map: Option<ArrayView3<'_, f32>>) -> Array3<f32> {
        let (height, width) = (image.height(), image.width());
        let planes = image.planes();
        let pixels = |y: usize, row: &mut [f32], offset: usize, channels: usize| {
            let y = y.min(height - 1);
            for c in 0..CHANNELS {
                let plane = planes.index_axis(ndarray::Axis(0), c);
                let from = plane.row(y).to_slice().expect("images are kept C-contiguous");
                let to = row.chunks_exact_mut(channels);
                to.enumerate().for_each(|(x, to)| to[offset + c] = from[x.min(width - 1)]);
            }
        };
        let image_rows = |y: usize, row: &mut [f32]| pixels(y, row, 0, CHANNELS);
        let condition_rows = |y: usize, row: &mut [f32]| {
            let (of_map, of_image) = self.condition.unwrap_or_default();
            if let Some(map) = map.filter(|_| of_map > 0) {
                let (_, map_height, map_width) = map.dim();
                for (x, to) in row.chunks_exact_mut(of_map + of_image).enumerate() {
                    let (y, x) = (y.min(map_height - 1), x.min(map_width - 1));
                    (0..of_map).for_each(|c| to[c] = map[[c, y, x]]);
                }
            }
            if of_image > 0 {
                pixels(y, row, of_map, of_map + of_image);
            }
        };
        let mut restored = Array3::zeros((CHANNELS, height, width));
        let sink = |y: usize, row: &[f32]| {
            if y < height {
                for (x, pixel) in row.chunks_exact(CHANNELS).take(width).enumerate() {
                    (0..CHANNELS).for_each(|c| restored[[c, y, x]] = pixel[c]);
                }
            }
        };
        let plan = Plan::new(&self.network, padded(height), padded(width), rayon::current_num_threads());
        let result = if self.condition.is_some() {
            plan.run(&[&image_rows, &condition_rows], sink, |_| Ok::<(), Infallible>(()))
        } else {
            plan.run(&[&image_rows], sink, |_| Ok(()))
        };
        match result {
            Ok(()) => restored,
        }
    }
}

/// The side that the network computes: a multiple of 4, the image continued by repetition.
fn padded(side: usize) -> usize {
    side.next_multiple_of(SIDE_MULTIPLE)
}

/// Appends layers of named weights.
struct Builder<'a> {
    values: HashMap<&'a str, &'a [f32]>,
    network: Network,
}

impl<'a> Builder<'a> {
    fn values(&self, name: &str) -> &'a [f32] {
        self.values.get(name).unwrap_or_else(|| panic!("there is no weight {name}"))
    }

    fn layer(&self, name: &str) -> (&'a [f32], &'a [f32]) {
        (self.values(&format!("{name}.weight")), self.values(&format!("{name}.bias")))
    }

    fn pack(&self, name: &str, stride: usize) -> Convolution {
        let (weight, bias) = self.layer(name);
        let inputs = weight.len() / bias.len() / 9;
        Convolution::new(Geometry { inputs, outputs: bias.len(), side: 3, stride }, weight, bias)
    }

    #[expect(
        clippy::too_many_arguments,
        reason = "one inner loop's state; a struct would be taken apart at once"
    )]
    fn convolution(
        &mut self,
        name: &str,
        input: Tensor,
        stride: usize,
        slope: f32,
        add: Option<Tensor>,
    ) -> Tensor {
        let packed = self.pack(name, stride);
        self.network.convolution(input, packed, slope, add)
    }

    fn up_convolution(&mut self, name: &str, input: Tensor, skip: Tensor) -> Tensor {
        let (weight, bias) = self.layer(name);
        let inputs = weight.len() / bias.len() / 9;
        let packed = Convolution::up(Isa::current(), inputs, weight, bias);
        self.network.convolution(input, packed, LEAKY_SLOPE, Some(skip))
    }

    fn res_blocks(&mut self, names: &[String; 2], input: Tensor) -> Tensor {
        names.iter().fold(input, |x, name| {
            let [first, second] = ["conv1", "conv2"].map(|part| self.pack(&format!("{name}.{part}"), 1));
            self.network.res_block(x, first, second, LEAKY_SLOPE)
        })
    }

    /// The features of every resolution, finest first.
    fn encoder(&mut self, prefix: &str, input: Tensor) -> Vec<Tensor> {
        let mut x = input;
        let scale = |scale: usize| {
            let stride = if scale == 1 { 1 } else { 2 };
            x = self.convolution(&format!("{prefix}_{scale}1.0"), x, stride, LEAKY_SLOPE, None);
            x = self.res_blocks(&[format!("{prefix}_{scale}2"), format!("{prefix}_{scale}3")], x);
            x
        };
        (1..=LEVELS).map(scale).collect()
    }

    fn filter(&mut self, level: usize, size: usize, condition: Tensor, features: Tensor) -> Tensor {
        let name = filter_generator_name(level);
        let slope = self.values(&format!("{name}.0.1.weight"))[0];
        let x = self.convolution(&format!("{name}.0.0"), condition, 1, slope, None);
        let x = self.res_blocks(&[format!("{name}.1"), format!("{name}.2")], x);
        let (weight, bias) = self.layer(&format!("{name}.3.0"));
        let slope = self.values(&format!("{name}.3.1.weight"))[0];
        let head = DynamicFilter::new(Isa::current(), size, weight, bias, slope);
        self.network.dynamic_filter(x, features, head)
    }
}

//! The network's heavy operations on Burn tensors: everything that is worth a faster implementation stands
//! here, so that one can take its place without a change to the model.
//!
//! Between [`to_layout`] and [`from_layout`] only these functions look at the order of a tensor's axes. Here
//! that order is the batch's own, `[item, channel, height, width]`.

use burn::module::{Module, Param};
use burn::tensor::activation::{leaky_relu, prelu};
use burn::tensor::module::conv2d;
use burn::tensor::ops::{ConvOptions, PadMode};
use burn::tensor::{Tensor, s};

/// The slope of every LeakyReLU.
const LEAKY_SLOPE: f64 = 0.2;

/// Filter values that are kept at a time when no gradient is asked for: 64 MiB, since all filters of a
/// photograph would take gigabytes.
const FILTER_VALUES: usize = 1 << 24;

/// Weight and bias of a convolution with zero padding of half its size.
///
/// # Shapes
/// `weight` `[outputs, inputs, size, size]`, `bias` `[outputs]`.
#[derive(Module, Debug)]
pub struct Convolution {
    pub(super) weight: Param<Tensor<4>>,
    pub(super) bias: Param<Tensor<1>>,
}

/// The two convolutions of a residual block.
#[derive(Module, Debug)]
pub struct ResBlock {
    pub(super) conv1: Convolution,
    pub(super) conv2: Convolution,
}

/// The last two layers of a filter generator: 1 × 1 convolution and the slope of its PReLU.
#[derive(Module, Debug)]
pub struct FilterHead {
    pub(super) conv: Convolution,
    pub(super) slope: Param<Tensor<1>>,
}

/// The non-linearity after a convolution.
#[derive(Clone, Copy, Debug)]
pub enum Activation<'a> {
    /// LeakyReLU of slope 0.2.
    LeakyRelu,
    /// PReLU with one learned slope.
    PRelu(&'a Param<Tensor<1>>),
}

/// Brings a batch `[item, channel, height, width]` into the layout that the operations compute in.
pub fn to_layout(batch: Tensor<4>) -> Tensor<4> {
    batch
}

/// Brings a tensor in the operations' layout back to `[item, channel, height, width]`.
pub fn from_layout(tensor: Tensor<4>) -> Tensor<4> {
    tensor
}

/// Convolves with `stride` and applies a non-linearity.
///
/// # Shapes
/// `inputs` × height × width to `outputs` × ⌈height/stride⌉ × ⌈width/stride⌉.
pub fn convolution(
    x: Tensor<4>,
    layer: &Convolution,
    stride: usize,
    activation: Activation<'_>,
) -> Tensor<4> {
    let x = convolve(x, layer, stride);
    match activation {
        Activation::LeakyRelu => leaky_relu(x, LEAKY_SLOPE),
        Activation::PRelu(slope) => prelu(x, slope.val()),
    }
}

/// Adds to `x` what two convolutions with a LeakyReLU between them make of it.
///
/// # Equation
/// `Res(x) = x + conv2(LeakyReLU(conv1(x)))`.
pub fn res_block(x: Tensor<4>, block: &ResBlock) -> Tensor<4> {
    let inner = convolution(x.clone(), &block.conv1, 1, Activation::LeakyRelu);
    x + convolve(inner, &block.conv2, 1)
}

/// Predicts a filter for every channel and pixel from `condition`, and applies it to `features`.
///
/// # Equation
/// `filter = PReLU(conv₁ₓ₁(condition))` with `s²` values a channel, dy before dx, and `output(c,y,x) =
/// Σ filter(c,dy,dx,y,x) · features(c, y+dy−s/2, x+dx−s/2)`, the features continued by replication.
///
/// # Shapes
/// `condition` and `features` have the same sides; `head` has `channels · filter_size²` outputs.
pub fn dynamic_filter(
    condition: &Tensor<4>,
    features: Tensor<4>,
    head: &FilterHead,
    filter_size: usize,
) -> Tensor<4> {
    let [items, channels, height, width] = features.dims();
    let half = filter_size / 2;
    let features = features.pad([(half, half), (half, half)], PadMode::Edge);
    let row = items * channels * filter_size * filter_size * width;
    let rows = if condition.device().is_autodiff() { height } else { (FILTER_VALUES / row).clamp(1, height) };
    let band = |top: usize| {
        let bottom = (top + rows).min(height);
        let filters = convolve(condition.clone().slice(s![.., .., top..bottom, ..]), &head.conv, 1);
        let filters = prelu(filters, head.slope.val());
        let window = features.clone().slice(s![.., .., top..bottom + 2 * half, ..]);
        apply_filters(&filters, &window, [items, channels, bottom - top, width], filter_size)
    };
    let mut bands: Vec<Tensor<4>> = (0..height).step_by(rows).map(band).collect();
    if bands.len() == 1 { bands.remove(0) } else { Tensor::cat(bands, 2) }
}

/// Convolves to four times the channels, spreads them over twice the sides, and adds the skip connection
/// after the LeakyReLU.
pub fn up_convolution(x: Tensor<4>, layer: &Convolution, skip: Tensor<4>) -> Tensor<4> {
    leaky_relu(pixel_shuffle(convolve(x, layer, 1)), LEAKY_SLOPE) + skip
}

fn convolve(x: Tensor<4>, layer: &Convolution, stride: usize) -> Tensor<4> {
    let weight = layer.weight.val();
    let padding = weight.dims()[2] / 2;
    let options = ConvOptions::new([stride, stride], [padding, padding], [1, 1], 1);
    conv2d(x, weight, Some(layer.bias.val()), options)
}

/// Sums the shifted features, each weighted by its tap of the filters.
fn apply_filters(
    filters: &Tensor<4>,
    padded: &Tensor<4>,
    [items, channels, height, width]: [usize; 4],
    size: usize,
) -> Tensor<4> {
    let filters = filters.clone().reshape([items, channels, size * size, height, width]);
    let tap = |dy: usize, dx: usize| {
        let index = dy * size + dx;
        let weights = filters.clone().slice(s![.., .., index..index + 1, .., ..]);
        let shifted = padded.clone().slice(s![.., .., dy..dy + height, dx..dx + width]);
        shifted * weights.reshape([items, channels, height, width])
    };
    let taps = (0..size).flat_map(|dy| (0..size).map(move |dx| (dy, dx)));
    taps.map(|(dy, dx)| tap(dy, dx)).reduce(|sum, next| sum + next).expect("a filter has taps")
}

/// Spreads channel 4c + 2i + j over the pixels (2y + i, 2x + j) of channel c.
fn pixel_shuffle(x: Tensor<4>) -> Tensor<4> {
    let [items, channels, height, width] = x.dims();
    let channels = channels / 4;
    x.reshape([items, channels, 2, 2, height, width]).permute([0, 1, 4, 2, 5, 3]).reshape([
        items,
        channels,
        2 * height,
        2 * width,
    ])
}

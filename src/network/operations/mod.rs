//! The network's heavy operations on Burn tensors: everything that is worth a faster implementation stands
//! here, so that one can take its place without a change to the model.
//!
//! Between [`to_layout`] and [`from_layout`] only these functions look at the order of a tensor's axes: here
//! `[item, height, width, channel]`, that of the [`kernels`](crate::kernels) which do the work. `custom` tells
//! Burn how to run them and how to take their gradients, `host` how to get at a tensor's numbers. On devices without the
//! kernels `plain` computes the same with Burn's own operations.

mod custom;
mod enlarge;
mod host;
mod plain;
mod sums;

use burn::backend::Dispatch;
use burn::backend::tensor::FloatTensor;
use burn::module::{Module, Param};
use burn::tensor::{DType, Device, Tensor};

use custom::NetworkOperations as _;
use enlarge::enlarging_tensors;

use super::precision::Precision;

pub(super) use enlarge::enlarging_weights;
pub(crate) use sums::{largest_of_all, sum_of_all};

/// Whether the kernels compute with a tensor: those of 32-bit floats in main memory; all others are given plain tensor
/// operations, which compute with numbers like those they are given.
fn uses_kernels<const D: usize>(x: &Tensor<D>) -> bool {
    x.dtype() == DType::F32 && is_main_memory(&x.device())
}

fn is_main_memory(device: &Device) -> bool {
    #[cfg(feature = "ndarray-backend")]
    #[expect(deprecated, reason = "burn-flex succeeds it; it is kept for comparison")]
    if *device == Device::ndarray() {
        return true;
    }
    *device == Device::flex()
}

/// The slope of every LeakyReLU.
pub(super) const LEAKY_SLOPE: f32 = 0.2;

/// Weight and bias of a convolution with zero padding of half its size.
///
/// # Shapes
/// `weight` `[outputs, inputs, size, size]`, `bias` `[outputs]`.
#[derive(Module, Debug)]
pub struct ConvolutionWeights {
    pub(super) weight: Param<Tensor<4>>,
    pub(super) bias: Param<Tensor<1>>,
}

/// The two convolutions of a residual block.
#[derive(Module, Debug)]
pub struct ResBlockWeights {
    pub(super) conv1: ConvolutionWeights,
    pub(super) conv2: ConvolutionWeights,
}

/// The last two layers of a filter generator: 1 × 1 convolution and the slope of its PReLU.
#[derive(Module, Debug)]
pub struct FilterHead {
    pub(super) conv: ConvolutionWeights,
    pub(super) slope: Param<Tensor<1>>,
}

/// The non-linearity after a convolution.
#[derive(Clone, Copy, Debug)]
pub enum Activation<'a> {
    /// None: the sums themselves.
    None,
    /// ReLU.
    Relu,
    /// LeakyReLU of slope 0.2.
    LeakyRelu,
    /// PReLU with one learned slope.
    PRelu(&'a Param<Tensor<1>>),
}

/// Brings a batch `[item, channel, height, width]` into the layout that the operations compute in,
/// `[item, height, width, channel]`, and into numbers of the precision, which the operations keep.
pub fn to_layout(batch: Tensor<4>, precision: Precision) -> Tensor<4> {
    batch.permute([0, 2, 3, 1]).cast(precision.dtype())
}

/// Features as 32-bit floats: what a network's last layer adds to an image is not to be rounded, nor the image.
pub fn widened(x: Tensor<4>) -> Tensor<4> {
    x.cast(Precision::F32.dtype())
}

/// Brings a tensor in the operations' layout back to `[item, channel, height, width]`.
pub fn from_layout(tensor: Tensor<4>) -> Tensor<4> {
    tensor.permute([0, 3, 1, 2])
}

/// Convolves with `stride` and applies a non-linearity.
///
/// # Shapes
/// `inputs` × height × width to `outputs` × ⌈height/stride⌉ × ⌈width/stride⌉.
pub fn convolution(
    x: Tensor<4>,
    layer: &ConvolutionWeights,
    stride: usize,
    activation: Activation<'_>,
) -> Tensor<4> {
    if !uses_kernels(&x) {
        return plain::convolution(x, layer, stride, activation);
    }
    let (x, weight, bias) = (x.into_dispatch(), primitive(&layer.weight), primitive(&layer.bias));
    let leaky =
        |slope: f32| Dispatch::leaky_convolution(x.clone(), weight.clone(), bias.clone(), stride, slope);
    Tensor::from_dispatch(match activation {
        Activation::None => leaky(1.0),
        Activation::Relu => leaky(0.0),
        Activation::LeakyRelu => leaky(LEAKY_SLOPE),
        Activation::PRelu(slope) => Dispatch::prelu_convolution(x, weight, bias, primitive(slope), stride),
    })
}

/// Adds to `x` what two convolutions with a LeakyReLU between them make of it.
///
/// # Equation
/// `Res(x) = x + conv2(LeakyReLU(conv1(x)))`.
pub fn res_block(x: Tensor<4>, block: &ResBlockWeights) -> Tensor<4> {
    if !uses_kernels(&x) {
        return plain::res_block(x, block);
    }
    let [conv1, conv2] = [&block.conv1, &block.conv2].map(|c| (primitive(&c.weight), primitive(&c.bias)));
    Tensor::from_dispatch(Dispatch::residual_block(x.into_dispatch(), conv1.0, conv1.1, conv2.0, conv2.1))
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
    if !uses_kernels(&features) {
        return plain::dynamic_filter(condition, features, head, filter_size);
    }
    let (condition, features) = (condition.clone().into_dispatch(), features.into_dispatch());
    let (weight, bias) = (primitive(&head.conv.weight), primitive(&head.conv.bias));
    let slope = primitive(&head.slope);
    Tensor::from_dispatch(Dispatch::predicted_filter(condition, features, weight, bias, slope, filter_size))
}

/// Convolves to four times the channels, spreads them over twice the sides, and adds the skip connection
/// after the LeakyReLU of slope `slope` (1 for none).
pub fn up_convolution(x: Tensor<4>, layer: &ConvolutionWeights, slope: f32, skip: Tensor<4>) -> Tensor<4> {
    if !uses_kernels(&x) {
        return plain::up_convolution(x, layer, slope, skip);
    }
    let (weight, bias) = (primitive(&layer.weight), primitive(&layer.bias));
    Tensor::from_dispatch(Dispatch::leaky_up_convolution(x.into_dispatch(), weight, bias, slope)) + skip
}

/// Doubles the sides by repetition, convolves with 3 × 3 taps, and adds the skip connection after the LeakyReLU.
///
/// # Shapes
/// `inputs` × height × width to `outputs` × 2·height × 2·width, as `skip` has.
pub fn enlarged_convolution(x: Tensor<4>, layer: &ConvolutionWeights, skip: Tensor<4>) -> Tensor<4> {
    if !uses_kernels(&x) {
        return plain::enlarged_convolution(x, layer, skip);
    }
    let (weight, bias) = enlarging_tensors(layer);
    let (x, weight, bias) = (x.into_dispatch(), weight.into_dispatch(), bias.into_dispatch());
    Tensor::from_dispatch(Dispatch::leaky_up_convolution(x, weight, bias, LEAKY_SLOPE)) + skip
}

/// A spatial feature transform of `x` by a map: `x · σ(scale) + offset`, both computed of the two side by side by
/// two convolutions with a LeakyReLU between them, then another LeakyReLU of the given slope.
///
/// # Shapes
/// `x` and the result have as many channels as the branches' last convolutions, `map` the same sides.
pub fn modulation(
    x: Tensor<4>,
    map: &Tensor<4>,
    [scale, offset]: [[&ConvolutionWeights; 2]; 2],
    slope: f32,
) -> Tensor<4> {
    if !uses_kernels(&x) {
        return plain::modulation(x, map, [scale, offset], slope);
    }
    let parameters = |[first, second]: [&ConvolutionWeights; 2]| {
        [primitive(&first.weight), primitive(&first.bias), primitive(&second.weight), primitive(&second.bias)]
    };
    let ([a, b, c, d], [e, f, g, h]) = (parameters(scale), parameters(offset));
    let (x, map) = (x.into_dispatch(), map.clone().into_dispatch());
    Tensor::from_dispatch(Dispatch::modulation(x, map, a, b, c, d, e, f, g, h, slope))
}

/// A parameter as the custom operations take it.
fn primitive<const D: usize>(parameter: &Param<Tensor<D>>) -> FloatTensor<Dispatch> {
    parameter.val().into_dispatch()
}

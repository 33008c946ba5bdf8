//! The operations of this module of Burn's own: for devices without the kernels, and to test these against. They compute with
//! numbers like those of the features they are given, to which weights are rounded; sums of many are of 32 bits.

use burn::module::Param;
use burn::tensor::activation::{leaky_relu, sigmoid};
use burn::tensor::module::conv2d;
use burn::tensor::ops::{ConvOptions, PadMode};
use burn::tensor::{DType, Tensor, s};

use super::{Activation, ConvolutionWeights, FilterHead, LEAKY_SLOPE, ResBlockWeights, from_layout};

/// The axes of a batch `[item, channel, height, width]` in the order of the operations.
const CHANNELS_LAST: [usize; 4] = [0, 2, 3, 1];

/// That of [`convolution`](super::convolution).
pub(super) fn convolution(
    x: Tensor<4>,
    layer: &ConvolutionWeights,
    stride: usize,
    activation: Activation<'_>,
) -> Tensor<4> {
    let sums = convolve(x, layer, stride);
    match activation {
        Activation::None => sums,
        Activation::Relu => leak(sums, 0.0),
        Activation::LeakyRelu => leak(sums, LEAKY_SLOPE),
        Activation::PRelu(slope) => {
            let slope = rounded(slope, &sums);
            prelu(sums, slope)
        }
    }
}

/// That of [`res_block`](super::res_block).
pub(super) fn res_block(x: Tensor<4>, block: &ResBlockWeights) -> Tensor<4> {
    let inner = leak(convolve(x.clone(), &block.conv1, 1), LEAKY_SLOPE);
    x + convolve(inner, &block.conv2, 1)
}

/// That of [`dynamic_filter`](super::dynamic_filter), tap by tap: the filters of one tap exist at a time, unless gradients need
/// them.
pub(super) fn dynamic_filter(
    condition: &Tensor<4>,
    features: Tensor<4>,
    head: &FilterHead,
    filter_size: usize,
) -> Tensor<4> {
    let [items, height, width, channels] = features.dims();
    let inputs = condition.dims()[3];
    let (taps, pixels) = (filter_size * filter_size, items * height * width);
    let weight = rounded(&head.conv.weight, &features).reshape([channels, taps, inputs]);
    let bias = rounded(&head.conv.bias, &features).reshape([channels, taps]);
    let (slope, number) = (rounded(&head.slope, &features), features.dtype());
    let condition = condition.clone().reshape([pixels, inputs]);
    let border = filter_size / 2;
    // Only the last two axes are padded.
    let padded = from_layout(features).pad([(border, border), (border, border)], PadMode::Edge);
    let features = padded.permute(CHANNELS_LAST);
    let terms = (0..taps).map(|tap| {
        let weight = weight.clone().slice(s![0..channels, tap..tap + 1, 0..inputs]);
        let bias = bias.clone().slice(s![0..channels, tap..tap + 1]).reshape([1, channels]);
        let sums = condition.clone().matmul(weight.reshape([channels, inputs]).transpose()) + bias;
        let filter = prelu(sums.reshape([items, height, width, channels]), slope.clone());
        let (top, left) = (tap / filter_size, tap % filter_size);
        let window = s![0..items, top..top + height, left..left + width, 0..channels];
        (filter * features.clone().slice(window)).cast(DType::F32)
    });
    terms.reduce(|sum, term| sum + term).expect("filters have taps").cast(number)
}

/// That of [`up_convolution`](super::up_convolution): channel `4·c + 2·dy + dx` is pixel (dy, dx) of channel c.
pub(super) fn up_convolution(
    x: Tensor<4>,
    layer: &ConvolutionWeights,
    slope: f32,
    skip: Tensor<4>,
) -> Tensor<4> {
    let sums = convolve(x, layer, 1);
    let [items, height, width, channels] = sums.dims();
    let spread = sums
        .reshape([items, height, width, channels / 4, 2, 2])
        .permute([0, 1, 4, 2, 5, 3])
        .reshape([items, 2 * height, 2 * width, channels / 4]);
    leak(spread, slope) + skip
}

/// That of [`enlarged_convolution`](super::enlarged_convolution).
pub(super) fn enlarged_convolution(x: Tensor<4>, layer: &ConvolutionWeights, skip: Tensor<4>) -> Tensor<4> {
    let [items, height, width, channels] = x.dims();
    let large = x
        .reshape([items, height, 1, width, 1, channels])
        .expand([items, height, 2, width, 2, channels])
        .reshape([items, 2 * height, 2 * width, channels]);
    leak(convolve(large, layer, 1), LEAKY_SLOPE) + skip
}

/// That of [`modulation`](super::modulation).
pub(super) fn modulation(
    x: Tensor<4>,
    map: &Tensor<4>,
    branches: [[&ConvolutionWeights; 2]; 2],
    slope: f32,
) -> Tensor<4> {
    let joined = Tensor::cat(vec![x.clone(), map.clone()], 3);
    let [scale, offset] = branches
        .map(|[first, second]| convolve(leak(convolve(joined.clone(), first, 1), LEAKY_SLOPE), second, 1));
    leak(x * sigmoid(scale) + offset, slope)
}

/// Convolution with zero padding of half the filter's size.
fn convolve(x: Tensor<4>, layer: &ConvolutionWeights, stride: usize) -> Tensor<4> {
    let (weight, bias) = (rounded(&layer.weight, &x), rounded(&layer.bias, &x));
    let border = weight.dims()[2] / 2;
    let options = ConvOptions::new([stride, stride], [border, border], [1, 1], 1);
    conv2d(from_layout(x), weight, Some(bias), options).permute(CHANNELS_LAST)
}

/// A parameter in numbers like those of features; its gradient stays of 32-bit floats.
fn rounded<const D: usize>(parameter: &Param<Tensor<D>>, features: &Tensor<4>) -> Tensor<D> {
    parameter.val().cast(features.dtype())
}

/// LeakyReLU: 0 for ReLU, 1 for nothing.
fn leak(x: Tensor<4>, slope: f32) -> Tensor<4> {
    leaky_relu(x, slope.into())
}

/// PReLU of one slope for all channels, which may be negative.
fn prelu(x: Tensor<4>, slope: Tensor<1>) -> Tensor<4> {
    x.clone().clamp_min(0.0) + x.clamp_max(0.0) * slope.reshape([1, 1, 1, 1])
}

#[cfg(test)]
mod tests {
    use super::super as kernels;
    use super::*;
    use crate::network::Backend;
    use burn::module::ParamId;
    use burn::tensor::{Device, TensorData};
    use std::cell::RefCell;

    /// Sides that are odd, and no multiple of any vector or of Winograd's tiles.
    const ITEMS: usize = 2;
    const HEIGHT: usize = 9;
    const WIDTH: usize = 11;

    /// The numbers that an operation is given, each array flat, in the order in which it asks for them.
    struct Given {
        device: Device,
        arrays: RefCell<Vec<Tensor<1>>>,
    }

    impl Given {
        fn tensor<const D: usize>(&self, shape: [usize; D], scale: f32) -> Tensor<D> {
            let count = shape.iter().product();
            let mut arrays = self.arrays.borrow_mut();
            let first = 7919 * (arrays.len() + 1);
            let value = |i: usize| scale * (((first + i) * 2_654_435_761 % 2003) as f32 / 1001.0 - 1.0);
            let data = TensorData::new((0..count).map(value).collect::<Vec<_>>(), [count]);
            let array = Tensor::<1>::from_data(data, &self.device).require_grad();
            arrays.push(array.clone());
            array.reshape(shape)
        }

        fn batch(&self, channels: usize) -> Tensor<4> {
            self.tensor([ITEMS, HEIGHT, WIDTH, channels], 1.0)
        }

        fn large(&self, channels: usize) -> Tensor<4> {
            self.tensor([ITEMS, 2 * HEIGHT, 2 * WIDTH, channels], 1.0)
        }

        fn parameter<const D: usize>(&self, shape: [usize; D], scale: f32) -> Param<Tensor<D>> {
            Param::initialized(ParamId::new(), self.tensor(shape, scale))
        }

        /// A convolution that keeps the size of what it is given.
        fn layer(&self, inputs: usize, outputs: usize, side: usize) -> ConvolutionWeights {
            let scale = (3.0 / (inputs * side * side) as f32).sqrt();
            ConvolutionWeights {
                weight: self.parameter([outputs, inputs, side, side], scale),
                bias: self.parameter([outputs], 0.3),
            }
        }
    }

    /// The output of an operation, and the gradients of a sum of it to all that it was given.
    fn run(operation: impl Fn(&Given) -> Tensor<4>) -> Vec<Vec<f32>> {
        let given = Given { device: Backend::default().device().autodiff(), arrays: RefCell::default() };
        let output = operation(&given);
        let gradients = (output.clone() * given.tensor(output.dims(), 1.0)).sum().backward();
        let arrays = given.arrays.into_inner();
        let gradients = arrays.iter().map(|array| array.grad(&gradients).expect("it is used"));
        let mut found = vec![output.try_into_vec_as::<f32>().unwrap()];
        found.extend(gradients.map(|gradient| gradient.try_into_vec_as::<f32>().unwrap()));
        found
    }

    /// Sums of some thousand 32-bit floats in another order; Winograd's transforms round a few times more.
    fn assert_close(what: &str, kernels: &[Vec<f32>], plain: &[Vec<f32>]) {
        assert_eq!(kernels.len(), plain.len());
        for (index, (a, b)) in kernels.iter().zip(plain).enumerate() {
            assert_eq!(a.len(), b.len(), "{what}, array {index}");
            let largest = b.iter().fold(0.0f32, |m, v| m.max(v.abs()));
            let error = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(
                largest > 0.0 && error <= 2e-5 * largest,
                "{what}, array {index}: {error:e} of {largest}"
            );
        }
    }

    /// Compares the kernels' operation with the plain one of its name, both given the same.
    macro_rules! compare {
        ($operation:ident, |$given:ident| $($argument:expr),+) => {
            assert_close(
                concat!(stringify!($operation), stringify!(($($argument),+))),
                &run(|$given| kernels::$operation($($argument),+)),
                &run(|$given| $operation($($argument),+)),
            )
        };
    }

    #[test]
    fn convolutions_are_those_of_the_kernels() {
        compare!(convolution, |g| g.batch(3), &g.layer(3, 5, 3), 1, Activation::None);
        compare!(convolution, |g| g.batch(4), &g.layer(4, 4, 3), 2, Activation::LeakyRelu);
        compare!(convolution, |g| g.batch(5), &g.layer(5, 3, 1), 1, Activation::Relu);
        compare!(convolution, |g| g.batch(4), &g.layer(4, 3, 9), 1, Activation::None);
        compare!(
            convolution,
            |g| g.batch(4),
            &g.layer(4, 6, 3),
            1,
            Activation::PRelu(&g.parameter([1], -0.4))
        );
        compare!(
            res_block,
            |g| g.batch(6),
            &ResBlockWeights { conv1: g.layer(6, 6, 3), conv2: g.layer(6, 6, 3) }
        );
    }

    #[test]
    fn dynamic_filters_are_those_of_the_kernels() {
        let head = |g: &Given, size: usize| FilterHead {
            conv: g.layer(4, 4 * size * size, 1),
            slope: g.parameter([1], 0.3),
        };
        compare!(dynamic_filter, |g| &g.batch(4), g.batch(4), &head(g, 3), 3);
        compare!(dynamic_filter, |g| &g.batch(4), g.batch(4), &head(g, 5), 5);
    }

    #[test]
    fn enlarging_convolutions_are_those_of_the_kernels() {
        for slope in [0.2, 1.0] {
            compare!(up_convolution, |g| g.batch(6), &g.layer(6, 12, 3), slope, g.large(3));
        }
        compare!(enlarged_convolution, |g| g.batch(6), &g.layer(6, 3, 3), g.large(3));
    }

    #[test]
    fn modulations_are_those_of_the_kernels() {
        let layers = |g: &Given| [g.layer(6, 2, 3), g.layer(2, 4, 3), g.layer(6, 2, 3), g.layer(2, 4, 3)];
        fn branches([a, b, c, d]: &[ConvolutionWeights; 4]) -> [[&ConvolutionWeights; 2]; 2] {
            [[a, b], [c, d]]
        }
        for slope in [0.0, 0.2, 1.0] {
            compare!(modulation, |g| g.batch(4), &g.batch(2), branches(&layers(g)), slope);
        }
    }
}

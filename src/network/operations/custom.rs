//! The heavy operations as Burn custom operations over the kernels: what each computes, what it keeps, and
//! how its gradient is taken.
#![expect(clippy::too_many_arguments, reason = "Burn routes operations by arguments that are tensors")]

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::flex::Flex;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, backend_extension};

use rayon::prelude::*;

use super::LEAKY_SLOPE;
use super::host::{Computed, Host, HostOperation, Passed, View, run, run_tracked};
use crate::kernels::gradient::{ConvolutionParameters, input_gradient, weight_gradient};
use crate::kernels::modulation::{Branch, Kept, Modulation, ModulationGradients};
use crate::kernels::res_block::{ResBlock, ResBlockGradients};
use crate::kernels::sums::gate;
use crate::kernels::up_convolution::UpConvolution;
use crate::kernels::{self, DynamicFilter, Epilogue, Geometry, Isa, Shape};

/// The operations that a backend must have; batches are `[item, height, width, channel]`, parameters as in
/// PyTorch.
#[backend_extension(Autodiff, Flex, NdArray: cfg(feature = "ndarray-backend"))]
pub(super) trait NetworkOperations: Backend {
    /// Convolution with zero padding, then LeakyReLU of a given slope: 0 for ReLU, 1 for nothing.
    fn leaky_convolution(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        stride: usize,
        slope: f32,
    ) -> FloatTensor<Self>;

    /// 3 × 3 convolution with zero padding, then PReLU of one slope.
    fn prelu_convolution(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        slope: FloatTensor<Self>,
        stride: usize,
    ) -> FloatTensor<Self>;

    /// `x + conv2(LeakyReLU(conv1(x)))`.
    fn residual_block(
        x: FloatTensor<Self>,
        weight1: FloatTensor<Self>,
        bias1: FloatTensor<Self>,
        weight2: FloatTensor<Self>,
        bias2: FloatTensor<Self>,
    ) -> FloatTensor<Self>;

    /// Convolution to four times the channels, pixel shuffle, LeakyReLU of a given slope: 1 for nothing.
    fn leaky_up_convolution(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        slope: f32,
    ) -> FloatTensor<Self>;

    /// Filters predicted from `condition` and applied to `features`.
    fn predicted_filter(
        condition: FloatTensor<Self>,
        features: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        slope: FloatTensor<Self>,
        size: usize,
    ) -> FloatTensor<Self>;

    /// A spatial feature transform, then LeakyReLU of a given slope: 0 for ReLU, 1 for nothing.
    fn modulation(
        x: FloatTensor<Self>,
        map: FloatTensor<Self>,
        scale_weight1: FloatTensor<Self>,
        scale_bias1: FloatTensor<Self>,
        scale_weight2: FloatTensor<Self>,
        scale_bias2: FloatTensor<Self>,
        offset_weight1: FloatTensor<Self>,
        offset_bias1: FloatTensor<Self>,
        offset_weight2: FloatTensor<Self>,
        offset_bias2: FloatTensor<Self>,
        slope: f32,
    ) -> FloatTensor<Self>;
}

/// Implements the operations through `run`, which takes an operation on slices and its inputs.
macro_rules! operations {
    ($($run:tt)+) => {
        fn leaky_convolution(
            x: FloatTensor<Self>,
            weight: FloatTensor<Self>,
            bias: FloatTensor<Self>,
            stride: usize,
            slope: f32,
        ) -> FloatTensor<Self> {
            $($run)+(LeakyConvolution { stride, slope }, [x, weight, bias])
        }

        fn prelu_convolution(
            x: FloatTensor<Self>,
            weight: FloatTensor<Self>,
            bias: FloatTensor<Self>,
            slope: FloatTensor<Self>,
            stride: usize,
        ) -> FloatTensor<Self> {
            $($run)+(PReluConvolution { stride }, [x, weight, bias, slope])
        }

        fn residual_block(
            x: FloatTensor<Self>,
            weight1: FloatTensor<Self>,
            bias1: FloatTensor<Self>,
            weight2: FloatTensor<Self>,
            bias2: FloatTensor<Self>,
        ) -> FloatTensor<Self> {
            $($run)+(ResidualBlock, [x, weight1, bias1, weight2, bias2])
        }

        fn leaky_up_convolution(
            x: FloatTensor<Self>,
            weight: FloatTensor<Self>,
            bias: FloatTensor<Self>,
            slope: f32,
        ) -> FloatTensor<Self> {
            $($run)+(LeakyUpConvolution { slope }, [x, weight, bias])
        }

        fn predicted_filter(
            condition: FloatTensor<Self>,
            features: FloatTensor<Self>,
            weight: FloatTensor<Self>,
            bias: FloatTensor<Self>,
            slope: FloatTensor<Self>,
            size: usize,
        ) -> FloatTensor<Self> {
            $($run)+(PredictedFilter { size }, [condition, features, weight, bias, slope])
        }

        fn modulation(
            x: FloatTensor<Self>,
            map: FloatTensor<Self>,
            scale_weight1: FloatTensor<Self>,
            scale_bias1: FloatTensor<Self>,
            scale_weight2: FloatTensor<Self>,
            scale_bias2: FloatTensor<Self>,
            offset_weight1: FloatTensor<Self>,
            offset_bias1: FloatTensor<Self>,
            offset_weight2: FloatTensor<Self>,
            offset_bias2: FloatTensor<Self>,
            slope: f32,
        ) -> FloatTensor<Self> {
            $($run)+(
                Modulate { slope },
                [x, map, scale_weight1, scale_bias1, scale_weight2, scale_bias2,
                    offset_weight1, offset_bias1, offset_weight2, offset_bias2],
            )
        }
    };
}

impl NetworkOperations for Flex {
    operations!(run::<Self, _>);
}

#[cfg(feature = "ndarray-backend")]
#[expect(deprecated, reason = "burn-flex succeeds it; it is kept for comparison")]
impl NetworkOperations for burn::backend::NdArray {
    operations!(run::<Self, _>);
}

impl<B: Host + NetworkOperations, C: CheckpointStrategy> NetworkOperations for Autodiff<B, C> {
    operations!(run_tracked::<B, C, _, _>);
}

/// Shapes of a convolution from its tensors.
fn geometry(weight: &View<'_>, stride: usize) -> Geometry {
    Geometry { inputs: weight.side(1), outputs: weight.side(0), side: weight.side(2), stride }
}

fn convolve(x: View<'_>, weight: View<'_>, bias: View<'_>, stride: usize, slope: f32) -> (Vec<f32>, Shape) {
    let convolution = kernels::Convolution::new(geometry(&weight, stride), weight.floats, bias.floats);
    let shape = convolution.output_shape(x.batch());
    (convolution.apply(x.floats, x.batch(), Epilogue::Leak(slope)), shape)
}

/// The gradients of a convolution's inputs, or nothing where they are not wanted, and of its weights.
fn convolution_gradients(
    wanted: bool,
    geometry: Geometry,
    (x, weight): (View<'_>, View<'_>),
    gradient: &[f32],
) -> (Vec<f32>, Vec<f32>) {
    rayon::join(
        || match wanted {
            true => input_gradient(geometry, weight.floats, gradient, x.batch(), Epilogue::Leak(1.0)),
            false => Vec::new(),
        },
        || weight_gradient(geometry, x.floats, x.batch(), gradient),
    )
}

#[derive(Clone, Copy, Debug)]
struct LeakyConvolution {
    stride: usize,
    slope: f32,
}

impl HostOperation<3> for LeakyConvolution {
    fn forward(&self, [x, weight, bias]: [View<'_>; 3]) -> Computed {
        let (output, shape) = convolve(x, weight, bias, self.stride, self.slope);
        Computed { output, shape, kept: Vec::new() }
    }

    // The output's sign is that of what the rectifier was given.
    fn backward(&self, [x, weight, _]: [View<'_>; 3], passed: Passed<'_, 3>) -> [Vec<f32>; 3] {
        let geometry = geometry(&weight, self.stride);
        let gated = gate(passed.gradient, passed.output, self.slope, geometry.outputs);
        let (x, weight) = convolution_gradients(passed.wanted[0], geometry, (x, weight), &gated.gradient);
        [x, weight, gated.bias]
    }
}

#[derive(Clone, Copy, Debug)]
struct PReluConvolution {
    stride: usize,
}

impl HostOperation<4> for PReluConvolution {
    // A learned slope may be negative, so that the output does not tell the sign: the sums are kept.
    fn forward(&self, [x, weight, bias, slope]: [View<'_>; 4]) -> Computed {
        let (sums, shape) = convolve(x, weight, bias, self.stride, 1.0);
        let slope = slope.floats[0];
        let output = sums.par_iter().map(|&v| if v > 0.0 { v } else { slope * v }).collect();
        Computed { output, shape, kept: vec![sums] }
    }

    fn backward(&self, [x, weight, _, slope]: [View<'_>; 4], passed: Passed<'_, 4>) -> [Vec<f32>; 4] {
        let geometry = geometry(&weight, self.stride);
        let gated = gate(passed.gradient, &passed.kept[0], slope.floats[0], geometry.outputs);
        let (x, weight) = convolution_gradients(passed.wanted[0], geometry, (x, weight), &gated.gradient);
        [x, weight, gated.bias, vec![gated.slope]]
    }
}

#[derive(Clone, Copy, Debug)]
struct ResidualBlock;

fn res_block<'a>([_, weight1, bias1, weight2, bias2]: &[View<'a>; 5]) -> ResBlock<'a> {
    ResBlock {
        weights: [weight1.floats, weight2.floats],
        biases: [bias1.floats, bias2.floats],
        slope: LEAKY_SLOPE,
    }
}

impl HostOperation<5> for ResidualBlock {
    fn forward(&self, inputs: [View<'_>; 5]) -> Computed {
        let shape = inputs[0].batch();
        let (kept, output) = res_block(&inputs).forward(inputs[0].floats, shape);
        Computed { output, shape, kept: vec![kept] }
    }

    fn backward(&self, inputs: [View<'_>; 5], passed: Passed<'_, 5>) -> [Vec<f32>; 5] {
        let [x, ..] = inputs;
        let ResBlockGradients { input, parameters: [first, second] } =
            res_block(&inputs).backward(x.floats, &passed.kept[0], passed.gradient, x.batch());
        [input, first.weight, first.bias, second.weight, second.bias]
    }
}

#[derive(Clone, Copy, Debug)]
struct LeakyUpConvolution {
    slope: f32,
}

impl LeakyUpConvolution {
    fn with_parameters<'a>(self, weight: View<'a>, bias: View<'a>) -> UpConvolution<'a> {
        UpConvolution { weight: weight.floats, bias: bias.floats, slope: self.slope }
    }
}

impl HostOperation<3> for LeakyUpConvolution {
    fn forward(&self, [x, weight, bias]: [View<'_>; 3]) -> Computed {
        let batch = x.batch();
        let output = self.with_parameters(weight, bias).forward(x.floats, batch);
        let shape = Shape::new(batch.images, 2 * batch.height, 2 * batch.width, bias.side(0) / 4);
        Computed { output, shape, kept: Vec::new() }
    }

    fn backward(&self, [x, weight, bias]: [View<'_>; 3], passed: Passed<'_, 3>) -> [Vec<f32>; 3] {
        let up = self.with_parameters(weight, bias);
        let (input, parameters) = up.backward(x.floats, x.batch(), passed.output, passed.gradient);
        [input, parameters.weight, parameters.bias]
    }
}

#[derive(Clone, Copy, Debug)]
struct PredictedFilter {
    size: usize,
}

impl PredictedFilter {
    fn pack(self, weight: View<'_>, bias: View<'_>, slope: View<'_>) -> DynamicFilter {
        DynamicFilter::new(Isa::current(), self.size, weight.floats, bias.floats, slope.floats[0])
    }
}

impl HostOperation<5> for PredictedFilter {
    fn forward(&self, [condition, features, weight, bias, slope]: [View<'_>; 5]) -> Computed {
        let shape = features.batch();
        let mut output = kernels::zeros(shape.len());
        let filter = self.pack(weight, bias, slope);
        filter.forward(condition.floats, features.floats, shape, &mut output);
        Computed { output, shape, kept: Vec::new() }
    }

    fn backward(
        &self,
        [condition, features, weight, bias, slope]: [View<'_>; 5],
        passed: Passed<'_, 5>,
    ) -> [Vec<f32>; 5] {
        let filter = self.pack(weight, bias, slope);
        let g = filter.backward(condition.floats, features.floats, features.batch(), passed.gradient);
        [g.condition, g.features, g.weight, g.bias, vec![g.slope]]
    }
}

#[derive(Clone, Copy, Debug)]
struct Modulate {
    slope: f32,
}

impl Modulate {
    fn with_parameters<'a>(self, [_, _, parameters @ ..]: &[View<'a>; 10]) -> Modulation<'a> {
        let [scale, offset] = [0, 4].map(|first| {
            let [w1, b1, w2, b2] = std::array::from_fn(|i| parameters[first + i].floats);
            Branch { weights: [w1, w2], biases: [b1, b2] }
        });
        Modulation { scale, offset, inner_slope: LEAKY_SLOPE, slope: self.slope }
    }
}

impl HostOperation<10> for Modulate {
    fn forward(&self, inputs: [View<'_>; 10]) -> Computed {
        let [x, map, ..] = inputs;
        let shape = x.batch();
        let modulation = self.with_parameters(&inputs);
        let (Kept { joined, inner: [scale, offset], share }, output) =
            modulation.forward(x.floats, map.floats, shape);
        Computed { output, shape, kept: vec![joined, scale, offset, share] }
    }

    fn backward(&self, inputs: [View<'_>; 10], passed: Passed<'_, 10>) -> [Vec<f32>; 10] {
        let [x, ..] = inputs;
        let [joined, scale, offset, share] = passed.kept else { unreachable!("what was kept") };
        let kept = Kept { joined, inner: [scale, offset], share };
        let modulation = self.with_parameters(&inputs);
        let ModulationGradients { x, map, parameters: [scale, offset] } =
            modulation.backward(x.floats, kept, (passed.output, passed.gradient), x.batch());
        let of = |[first, second]: [ConvolutionParameters; 2]| {
            [first.weight, first.bias, second.weight, second.bias]
        };
        let ([a, b, c, d], [e, f, g, h]) = (of(scale), of(offset));
        [x, map, a, b, c, d, e, f, g, h]
    }
}

//! The residual block `x + second(leak(first(x)))` of two 3 × 3 convolutions, for training.
//!
//! Besides its input, what lies between the convolutions is kept for the backward pass; its sign is that of
//! what the rectifier was given, as long as the slope is positive. (For inference the two convolutions are
//! steps of a [`stream`](super::stream), where what lies between them is a few rows in the cache.)

use super::convolution::Convolution;
use super::direct::forward::Geometry;
use super::epilogue::Epilogue;
use super::gradient::{ConvolutionParameters, input_gradient};
use super::shape::Shape;

/// A residual block with its parameters.
#[derive(Clone, Copy, Debug)]
pub struct ResBlock<'a> {
    /// Weights of the two convolutions, `[channels, channels, 3, 3]`.
    pub weights: [&'a [f32]; 2],
    /// Their biases, `[channels]`.
    pub biases: [&'a [f32]; 2],
    /// The slope between them, positive.
    pub slope: f32,
}

/// The gradients that a residual block hands back.
#[derive(Debug)]
pub struct ResBlockGradients {
    /// Of its input.
    pub input: Vec<f32>,
    /// Of the two convolutions' parameters.
    pub parameters: [ConvolutionParameters; 2],
}

impl ResBlock<'_> {
    /// Computes what lies between the convolutions, and the result.
    ///
    /// # Panics
    /// When a slice's length, or that of a parameter, is not that of the shape.
    pub fn forward(&self, x: &[f32], shape: Shape) -> (Vec<f32>, Vec<f32>) {
        let geometry = Geometry::three_by_three(shape.channels, shape.channels);
        let convolution = |i: usize| Convolution::new(geometry, self.weights[i], self.biases[i]);
        let inner = convolution(0).apply(x, shape, Epilogue::Leak(self.slope));
        let output = convolution(1).apply(&inner, shape, Epilogue::LeakThenAdd(1.0, x));
        (inner, output)
    }

    /// Takes the gradient of the result back, given the input and what lay between the convolutions.
    ///
    /// # Panics
    /// As [`ResBlock::forward`].
    pub fn backward(&self, x: &[f32], inner: &[f32], gradient: &[f32], shape: Shape) -> ResBlockGradients {
        let lengths = (x.len(), inner.len(), gradient.len());
        assert_eq!(lengths, (shape.len(), shape.len(), shape.len()), "floats of {shape:?}");
        let geometry = Geometry::three_by_three(shape.channels, shape.channels);
        let gate = Epilogue::Gate(self.slope, inner);
        let inner_gradient = input_gradient(geometry, self.weights[1], gradient, shape, gate);
        let add = Epilogue::LeakThenAdd(1.0, gradient);
        let ((first, second), input) = rayon::join(
            || {
                rayon::join(
                    || ConvolutionParameters::gradients(geometry, x, shape, &inner_gradient),
                    || ConvolutionParameters::gradients(geometry, inner, shape, gradient),
                )
            },
            || input_gradient(geometry, self.weights[0], &inner_gradient, shape, add),
        );
        ResBlockGradients { input, parameters: [first, second] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::Isa;
    use crate::kernels::testing::{Values, assert_close, check_gradients, dot, naive, on_every_isa};

    fn naive_block(parameters: &[Vec<f32>], shape: Shape) -> Vec<f64> {
        let geometry = Geometry::three_by_three(shape.channels, shape.channels);
        let [x, w1, b1, w2, b2] = parameters else { panic!("five tensors") };
        let inner = naive::epilogue(Epilogue::Leak(0.2), &naive::convolution(geometry, w1, b1, x, shape));
        let sums = naive::convolution(geometry, w2, b2, &inner, shape);
        sums.iter().zip(x).map(|(s, x)| s + f64::from(*x)).collect()
    }

    #[test]
    fn result_and_gradients_agree_with_the_equation() {
        for (images, height, width, channels) in
            [(1, 1, 1, 3), (2, 6, 5, 4), (2, 9, 7, 16), (1, 5, 9, 32), (1, 6, 7, 20)]
        {
            let shape = Shape::new(images, height, width, channels);
            let mut values = Values::new(9);
            let x = values.take(shape.len());
            let weights: Vec<_> =
                (0..2).map(|_| values.take_scaled(9 * channels * channels, 9 * channels)).collect();
            let biases: Vec<_> = (0..2).map(|_| values.take(channels)).collect();
            let gradient = values.take(shape.len());
            let block = ResBlock {
                weights: [&weights[0], &weights[1]],
                biases: [&biases[0], &biases[1]],
                slope: 0.2,
            };
            let tensors =
                vec![x.clone(), weights[0].clone(), biases[0].clone(), weights[1].clone(), biases[1].clone()];
            let expected = naive_block(&tensors, shape);
            let found = on_every_isa(|| {
                let (inner, output) = block.forward(&x, shape);
                assert_close(&output, &expected, 4e-6, Isa::current().name());
                let ResBlockGradients { input, parameters: [first, second] } =
                    block.backward(&x, &inner, &gradient, shape);
                vec![input, first.weight, first.bias, second.weight, second.bias]
            });
            let loss = |tensors: &[Vec<f32>]| dot(&naive_block(tensors, shape), &gradient);
            check_gradients(tensors, &found, loss);
        }
    }
}

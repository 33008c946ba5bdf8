//! Convolution to four times the channels, pixel shuffle to twice the sides, leaky rectifier: for training.
//!
//! Forward, the shuffle is only a matter of where outputs are stored ([`Convolution::up`]). Backward, the
//! gradient is gathered into the order in which the outputs were computed, sub-pixel before channel, and the
//! parameters' gradients are put back into PyTorch's, channel before sub-pixel.

use super::convolution::{Convolution, shuffled_output};
use super::direct::forward::Geometry;
use super::epilogue::Epilogue;
use super::gradient::{ConvolutionParameters, input_gradient};
use super::scratch::by_chunks;
use super::shape::Shape;
use super::simd::Isa;
use super::sums::gate;

/// An up-convolution with its parameters.
#[derive(Clone, Copy, Debug)]
pub struct UpConvolution<'a> {
    /// `[4·channels, inputs, 3, 3]`.
    pub weight: &'a [f32],
    /// `[4·channels]`.
    pub bias: &'a [f32],
    /// The slope of the rectifier, positive.
    pub slope: f32,
}

impl UpConvolution<'_> {
    /// Computes `leak(shuffle(convolution(x)))`.
    ///
    /// # Panics
    /// When a slice's length, or that of a parameter, is not that of the shape.
    pub fn forward(&self, x: &[f32], shape: Shape) -> Vec<f32> {
        let up = Convolution::up(Isa::current(), shape.channels, self.weight, self.bias);
        up.apply(x, shape, Epilogue::Leak(self.slope))
    }

    /// Takes the gradient of the result back to that of `x` and of the parameters, given the result.
    ///
    /// # Panics
    /// As [`UpConvolution::forward`].
    pub fn backward(
        &self,
        x: &[f32],
        shape: Shape,
        output: &[f32],
        gradient: &[f32],
    ) -> (Vec<f32>, ConvolutionParameters) {
        let outputs = self.bias.len();
        let channels = outputs / 4;
        assert!(outputs.is_multiple_of(4), "{outputs} outputs to shuffle");
        let geometry = Geometry::three_by_three(shape.channels, outputs);
        let fine = shape.with_channels(outputs).len();
        assert_eq!((output.len(), gradient.len()), (fine, fine), "floats of what {shape:?} becomes");
        geometry.check_gradient(Some(self.weight), shape, gradient);
        let gated = gather(&gate(gradient, output, self.slope, channels).gradient, shape, channels);
        let row_len = shape.channels * 9;
        let rows: Vec<&[f32]> =
            (0..outputs).map(|o| &self.weight[shuffled_output(o, channels) * row_len..][..row_len]).collect();
        let weight = rows.concat();
        let (input, sums) = rayon::join(
            || input_gradient(geometry, &weight, &gated, shape, Epilogue::Leak(1.0)),
            || ConvolutionParameters::gradients(geometry, x, shape, &gated),
        );
        let mut parameters =
            ConvolutionParameters { weight: vec![0.0; weight.len()], bias: vec![0.0; outputs] };
        for o in 0..outputs {
            let place = shuffled_output(o, channels);
            parameters.bias[place] = sums.bias[o];
            parameters.weight[place * row_len..][..row_len]
                .copy_from_slice(&sums.weight[o * row_len..][..row_len]);
        }
        (input, parameters)
    }
}

/// Gathers 2 × 2 pixels of `channels` into one of four groups: the shuffle turned around.
fn gather(fine: &[f32], shape: Shape, channels: usize) -> Vec<f32> {
    let outputs = 4 * channels;
    let row_len = shape.width * outputs;
    let (coarse, _) = by_chunks(shape.pixels() * outputs, row_len, |row, to| {
        for (x, to) in to.chunks_exact_mut(outputs).enumerate() {
            for (i, to) in to.chunks_exact_mut(2 * channels).enumerate() {
                let from = ((2 * row + i) * 2 * shape.width + 2 * x) * channels;
                to.copy_from_slice(&fine[from..from + 2 * channels]);
            }
        }
    });
    coarse
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::testing::{Values, check_gradients, dot, naive, on_every_isa};

    #[test]
    fn gradients_agree_with_the_equation() {
        for (images, height, width, inputs, channels) in
            [(1, 1, 1, 2, 1), (2, 5, 6, 32, 16), (1, 3, 4, 8, 4), (1, 4, 5, 20, 7)]
        {
            let shape = Shape::new(images, height, width, inputs);
            let mut values = Values::new(4);
            let x = values.take(shape.len());
            let weight = values.take_scaled(4 * channels * inputs * 9, 9 * inputs);
            let bias = values.take(4 * channels);
            let gradient = values.take(4 * shape.pixels() * channels);
            let up = UpConvolution { weight: &weight, bias: &bias, slope: 0.2 };
            let found = on_every_isa(|| {
                let output = up.forward(&x, shape);
                let (input, parameters) = up.backward(&x, shape, &output, &gradient);
                vec![input, parameters.weight, parameters.bias]
            });
            let geometry = Geometry::three_by_three(inputs, 4 * channels);
            let loss = |tensors: &[Vec<f32>]| {
                let sums = naive::convolution(geometry, &tensors[1], &tensors[2], &tensors[0], shape);
                let shuffled = naive::pixel_shuffle(&sums, shape.with_channels(4 * channels));
                dot(&naive::epilogue(Epilogue::Leak(0.2), &shuffled), &gradient)
            };
            check_gradients(vec![x.clone(), weight.clone(), bias.clone()], &found, loss);
        }
    }
}

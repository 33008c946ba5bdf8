//! A frozen convolution of a recognition network, and the images that it reads.

use crate::core::image::CHANNELS;
use crate::kernels::{Convolution, Epilogue, Geometry, Isa, Shape};

/// Numbers with their extent, `[image, row, column, channel]`.
#[derive(Clone, Debug)]
pub(super) struct Features {
    pub(super) values: Vec<f32>,
    pub(super) shape: Shape,
}

impl Features {
    /// Turns planes `[image, channel, row, column]` into pixels, each value first scaled and shifted:
    /// `value · scale[channel] + shift[channel]`.
    pub(super) fn of_planes(planes: &[f32], shape: Shape, scale: [f32; 3], shift: [f32; 3]) -> Self {
        assert_eq!((planes.len(), shape.channels), (shape.len(), CHANNELS), "planes of {shape:?}");
        let per_plane = shape.height * shape.width;
        let mut values = vec![0.0; planes.len()];
        for (n, image) in planes.chunks_exact(CHANNELS * per_plane).enumerate() {
            for (c, plane) in image.chunks_exact(per_plane).enumerate() {
                let to = values[n * shape.image_len()..].iter_mut().skip(c).step_by(CHANNELS);
                to.zip(plane).for_each(|(to, value)| *to = value * scale[c] + shift[c]);
            }
        }
        Self { values, shape }
    }

    /// The planes of pixels' values, each scaled: where a gradient goes back to.
    pub(super) fn to_planes(&self, scale: [f32; 3]) -> Vec<f32> {
        let per_plane = self.shape.height * self.shape.width;
        let mut planes = vec![0.0; self.values.len()];
        for (n, image) in planes.chunks_exact_mut(CHANNELS * per_plane).enumerate() {
            for (c, plane) in image.chunks_exact_mut(per_plane).enumerate() {
                let from = self.values[n * self.shape.image_len()..].iter().skip(c).step_by(CHANNELS);
                plane.iter_mut().zip(from).for_each(|(to, value)| *to = value * scale[c]);
            }
        }
        planes
    }

    /// Applies a convolution, then a leaky rectifier: slope 0 for ReLU, 1 for nothing.
    pub(super) fn convolve(&self, convolution: &Convolution, slope: f32) -> Self {
        let shape = convolution.output_shape(self.shape);
        let mut values = vec![0.0; shape.len()];
        convolution.forward(&self.values, self.shape, Epilogue::Leak(slope), &mut values);
        Self { values, shape }
    }
}

/// A 3 × 3 convolution packed to be applied, and to take gradients back.
pub(super) struct Frozen {
    pub(super) forward: Convolution,
    backward: Convolution,
}

impl Frozen {
    /// Packs weights `[outputs, inputs, 3, 3]` and bias `[outputs]`.
    pub(super) fn new(weight: &[f32], bias: &[f32]) -> Self {
        let geometry = Geometry::three_by_three(weight.len() / bias.len() / 9, bias.len());
        Self {
            forward: Convolution::new(geometry, weight, bias),
            backward: Convolution::transposed(Isa::current(), geometry, weight),
        }
    }

    /// Takes the gradient of the outputs to that of the inputs.
    pub(super) fn take_back(&self, gradient: &Features) -> Features {
        gradient.convolve(&self.backward, 1.0)
    }
}

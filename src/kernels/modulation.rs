//! The spatial feature transform `leak(x · σ(scale) + offset)`, whose scale and offset are computed, by two
//! convolutions each, of the features followed by a map: for training.
//!
//! Kept for the backward pass: features and map side by side, what lies between the convolutions of either
//! branch, and σ(scale).

use rayon::prelude::*;

use super::convolution::Convolution;
use super::direct::forward::Geometry;
use super::epilogue::Epilogue;
use super::gradient::{ConvolutionParameters, input_gradient};
use super::scratch::{by_chunks, zeros};
use super::shape::Shape;

/// Pixels that one task looks at.
const CHUNK: usize = 1024;

/// Two 3 × 3 convolutions with a leaky rectifier between them.
#[derive(Clone, Copy, Debug)]
pub struct Branch<'a> {
    /// `[inner, channels + map channels, 3, 3]` and `[channels, inner, 3, 3]`.
    pub weights: [&'a [f32]; 2],
    /// `[inner]` and `[channels]`.
    pub biases: [&'a [f32]; 2],
}

/// A spatial feature transform with its parameters.
#[derive(Clone, Copy, Debug)]
pub struct Modulation<'a> {
    /// What the scale's sigmoid is given.
    pub scale: Branch<'a>,
    /// What is added.
    pub offset: Branch<'a>,
    /// The slope between a branch's convolutions, positive.
    pub inner_slope: f32,
    /// The slope of the rectifier at the end: 0 for ReLU, 1 for none.
    pub slope: f32,
}

/// What the backward pass needs besides what the forward pass was given: tensors, or views of them.
#[derive(Clone, Copy, Debug)]
pub struct Kept<T> {
    /// `[…, channels + map channels]`.
    pub joined: T,
    /// Between the convolutions of the scale's and of the offset's branch, `[…, inner]`.
    pub inner: [T; 2],
    /// σ(scale), `[…, channels]`.
    pub share: T,
}

/// The gradients that a modulation hands back.
#[derive(Debug)]
pub struct ModulationGradients {
    /// Of the features.
    pub x: Vec<f32>,
    /// Of the map.
    pub map: Vec<f32>,
    /// Of the convolutions of the scale's and of the offset's branch.
    pub parameters: [[ConvolutionParameters; 2]; 2],
}

impl Branch<'_> {
    /// The extents of both convolutions.
    fn geometries(&self, joined: usize) -> [Geometry; 2] {
        let [inner, channels] = self.biases.map(<[f32]>::len);
        [Geometry::three_by_three(joined, inner), Geometry::three_by_three(inner, channels)]
    }

    /// What lies between the convolutions, and the result.
    fn forward(&self, joined: &[f32], shape: Shape, slope: f32) -> (Vec<f32>, Vec<f32>) {
        let [first, second] = self.geometries(shape.channels);
        let convolve = |geometry, i: usize, x: &[f32], slope: f32| {
            let convolution = Convolution::new(geometry, self.weights[i], self.biases[i]);
            let shape = shape.with_channels(geometry.inputs);
            convolution.apply(x, shape, Epilogue::Leak(slope))
        };
        let inner = convolve(first, 0, joined, slope);
        let output = convolve(second, 1, &inner, 1.0);
        (inner, output)
    }

    /// Takes the gradient of the result back to the parameters and, finished, to what was joined.
    fn backward(
        &self,
        (joined, inner): (&[f32], &[f32]),
        gradient: &[f32],
        (shape, slope): (Shape, f32),
        epilogue: Epilogue<'_>,
    ) -> (Vec<f32>, [ConvolutionParameters; 2]) {
        let [first, second] = self.geometries(shape.channels);
        let inner_shape = shape.with_channels(second.inputs);
        let gate = Epilogue::Gate(slope, inner);
        let inner_gradient = input_gradient(second, self.weights[1], gradient, inner_shape, gate);
        let ((first_gradients, second_gradients), input) = rayon::join(
            || {
                rayon::join(
                    || ConvolutionParameters::gradients(first, joined, shape, &inner_gradient),
                    || ConvolutionParameters::gradients(second, inner, inner_shape, gradient),
                )
            },
            || input_gradient(first, self.weights[0], &inner_gradient, shape, epilogue),
        );
        (input, [first_gradients, second_gradients])
    }
}

impl Modulation<'_> {
    /// Asserts that both branches end in as many channels as are modulated.
    fn check(&self, shape: Shape) {
        for branch in [&self.scale, &self.offset] {
            let channels = branch.biases[1].len();
            assert_eq!(channels, shape.channels, "channels of a branch and those that it modulates");
        }
    }

    /// Computes the transform of `x` by `map`, which have so many channels, and what the backward pass needs.
    ///
    /// # Shapes
    /// `x` and the result have `shape`; `map` has the same with its own channels.
    ///
    /// # Panics
    /// When a slice's length, or that of a parameter, is not that of the shape.
    pub fn forward(&self, x: &[f32], map: &[f32], shape: Shape) -> (Kept<Vec<f32>>, Vec<f32>) {
        assert_eq!(x.len(), shape.len(), "floats of {shape:?}");
        let joined_shape = shape.with_channels(shape.channels + channels_of(map, shape));
        self.check(shape);
        let joined = join(x, map, shape, joined_shape);
        let (inner_scale, mut share) = self.scale.forward(&joined, joined_shape, self.inner_slope);
        let (inner_offset, mut output) = self.offset.forward(&joined, joined_shape, self.inner_slope);
        let len = CHUNK * shape.channels;
        let chunks = output.par_chunks_mut(len).zip(share.par_chunks_mut(len)).zip(x.par_chunks(len));
        chunks.for_each(|((output, share), x)| {
            for ((output, share), x) in output.iter_mut().zip(share).zip(x) {
                *share = 1.0 / (1.0 + (-*share).exp());
                let value = x * *share + *output;
                *output = if value > 0.0 { value } else { self.slope * value };
            }
        });
        (Kept { joined, inner: [inner_scale, inner_offset], share }, output)
    }

    /// Takes the gradient of the result back, given the input, what was kept, and the result itself.
    ///
    /// # Equation
    /// With s = σ(scale) and g the gradient through the last rectifier: offset `g`, scale `g·x·s·(1−s)`, x
    /// `g·s` besides what comes through the branches.
    ///
    /// # Panics
    /// As [`Modulation::forward`].
    pub fn backward(
        &self,
        x: &[f32],
        kept: Kept<&Vec<f32>>,
        (output, gradient): (&[f32], &[f32]),
        shape: Shape,
    ) -> ModulationGradients {
        let Kept { joined, inner, share } = kept;
        let joined_shape = shape.with_channels(channels_of(joined, shape));
        assert!(joined_shape.channels > shape.channels, "{joined_shape:?} of {shape:?} and a map");
        self.check(shape);
        for values in [x, share, output, gradient] {
            assert_eq!(values.len(), shape.len(), "floats of {shape:?}");
        }
        for (inner, branch) in inner.iter().zip([&self.scale, &self.offset]) {
            let shape = shape.with_channels(branch.biases[0].len());
            assert_eq!(inner.len(), shape.len(), "floats of {shape:?}");
        }
        let [mut direct, mut scale, mut offset] = [(); 3].map(|()| zeros(shape.len()));
        let len = CHUNK * shape.channels;
        let targets =
            direct.par_chunks_mut(len).zip(scale.par_chunks_mut(len)).zip(offset.par_chunks_mut(len));
        targets.enumerate().for_each(|(chunk, ((direct, scale), offset))| {
            let sources = [gradient, output, x, share].map(|values| &values[chunk * len..][..direct.len()]);
            let [gradient, output, x, share] = sources;
            for i in 0..direct.len() {
                let g = if output[i] > 0.0 { gradient[i] } else { self.slope * gradient[i] };
                direct[i] = g * share[i];
                scale[i] = g * x[i] * share[i] * (1.0 - share[i]);
                offset[i] = g;
            }
        });
        let extent = (joined_shape, self.inner_slope);
        let (joined_gradient, of_scale) =
            self.scale.backward((joined, inner[0]), &scale, extent, Epilogue::Leak(1.0));
        let add = Epilogue::LeakThenAdd(1.0, &joined_gradient);
        let (joined_gradient, of_offset) = self.offset.backward((joined, inner[1]), &offset, extent, add);
        let map = split(&joined_gradient, shape, joined_shape, &mut direct);
        ModulationGradients { x: direct, map, parameters: [of_scale, of_offset] }
    }
}

/// The channels of a map with the sides of `shape`.
fn channels_of(map: &[f32], shape: Shape) -> usize {
    let pixels = shape.pixels();
    let is_whole = pixels > 0 && !map.is_empty() && map.len().is_multiple_of(pixels);
    assert!(is_whole, "{} floats of a map for {pixels} pixels", map.len());
    map.len() / pixels
}

/// Sets the channels of two tensors side by side.
fn join(x: &[f32], map: &[f32], shape: Shape, joined_shape: Shape) -> Vec<f32> {
    let (channels, joined_channels) = (shape.channels, joined_shape.channels);
    let map_channels = joined_channels - channels;
    let (joined, _) = by_chunks(joined_shape.len(), CHUNK * joined_channels, |chunk, to| {
        let (x, map) = (&x[chunk * CHUNK * channels..], &map[chunk * CHUNK * map_channels..]);
        let pixels = x.chunks_exact(channels).zip(map.chunks_exact(map_channels));
        for (to, (x, map)) in to.chunks_exact_mut(joined_channels).zip(pixels) {
            to[..channels].copy_from_slice(x);
            to[channels..].copy_from_slice(map);
        }
    });
    joined
}

/// Adds the first channels to `x` and returns the others: [`join`] turned around.
fn split(joined: &[f32], shape: Shape, joined_shape: Shape, x: &mut [f32]) -> Vec<f32> {
    let (channels, joined_channels) = (shape.channels, joined_shape.channels);
    let map_channels = joined_channels - channels;
    let mut map = zeros(shape.pixels() * map_channels);
    let targets = x.par_chunks_mut(CHUNK * channels).zip(map.par_chunks_mut(CHUNK * map_channels));
    joined.par_chunks(CHUNK * joined_channels).zip(targets).for_each(|(joined, (x, map))| {
        let pixels = x.chunks_exact_mut(channels).zip(map.chunks_exact_mut(map_channels));
        for (joined, (x, map)) in joined.chunks_exact(joined_channels).zip(pixels) {
            x.iter_mut().zip(joined).for_each(|(x, joined)| *x += joined);
            map.copy_from_slice(&joined[channels..]);
        }
    });
    map
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::Isa;
    use crate::kernels::testing::{Values, assert_close, check_gradients, dot, naive, on_every_isa};

    fn naive_modulation(tensors: &[Vec<f32>], shape: Shape, slope: f32) -> Vec<f64> {
        let [x, map, parameters @ ..] = tensors else { panic!("ten tensors") };
        let joined_channels = shape.channels + map.len() / shape.pixels();
        let joined = join(x, map, shape, shape.with_channels(joined_channels));
        let branch = |parameters: &[Vec<f32>]| {
            let [w1, b1, w2, b2] = parameters else { panic!("four tensors") };
            let first = Geometry::three_by_three(joined_channels, b1.len());
            let joined_shape = shape.with_channels(joined_channels);
            let inner = naive::epilogue(
                Epilogue::Leak(0.2),
                &naive::convolution(first, w1, b1, &joined, joined_shape),
            );
            let second = Geometry::three_by_three(b1.len(), b2.len());
            naive::convolution(second, w2, b2, &inner, shape.with_channels(b1.len()))
        };
        let (scale, offset) = (branch(&parameters[..4]), branch(&parameters[4..]));
        let values = x.iter().zip(scale).zip(offset);
        let sums: Vec<f64> =
            values.map(|((x, scale), offset)| f64::from(*x) / (1.0 + (-scale).exp()) + offset).collect();
        naive::epilogue(Epilogue::Leak(slope), &sums)
    }

    #[test]
    fn result_and_gradients_agree_with_the_equation() {
        for (images, sides, channels, map_channels, inner, slope) in
            [(1, [1, 1], 2, 1, 1, 0.0), (2, [6, 5], 16, 5, 8, 0.0), (1, [5, 9], 20, 3, 10, 1.0)]
        {
            let shape = Shape::new(images, sides[0], sides[1], channels);
            let mut values = Values::new(12);
            let mut tensors = vec![values.take(shape.len()), values.take(shape.pixels() * map_channels)];
            for _ in 0..2 {
                let joined = channels + map_channels;
                tensors.push(values.take_scaled(inner * joined * 9, joined * 9));
                tensors.push(values.take(inner));
                tensors.push(values.take_scaled(channels * inner * 9, inner * 9));
                tensors.push(values.take(channels));
            }
            let gradient = values.take(shape.len());
            let (scale, offset) = (tensors[2..6].to_vec(), tensors[6..].to_vec());
            let modulation = Modulation {
                scale: Branch { weights: [&scale[0], &scale[2]], biases: [&scale[1], &scale[3]] },
                offset: Branch { weights: [&offset[0], &offset[2]], biases: [&offset[1], &offset[3]] },
                inner_slope: 0.2,
                slope,
            };
            let expected = naive_modulation(&tensors, shape, slope);
            let found = on_every_isa(|| {
                let (kept, output) = modulation.forward(&tensors[0], &tensors[1], shape);
                assert_close(&output, &expected, 4e-6, Isa::current().name());
                let Kept { joined, inner: [scale, offset], share } = &kept;
                let kept = Kept { joined, inner: [scale, offset], share };
                let gradients = modulation.backward(&tensors[0], kept, (&output, &gradient), shape);
                let mut found = vec![gradients.x, gradients.map];
                for ConvolutionParameters { weight, bias } in gradients.parameters.into_iter().flatten() {
                    found.extend([weight, bias]);
                }
                found
            });
            let loss = |tensors: &[Vec<f32>]| dot(&naive_modulation(tensors, shape, slope), &gradient);
            check_gradients(tensors, &found, loss);
        }
    }
}

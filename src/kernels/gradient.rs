//! Gradients of convolutions: to the inputs and to the weights, in the parameters' own layout.
//!
//! Gradients that do not depend on each other are computed side by side (`rayon::join`): at the end of each, a thread
//! that has nothing left of one finds work in the other.

use rayon::prelude::*;

use super::convolution::Convolution;
use super::direct::forward::Geometry;
use super::direct::input_gradient::{InputRows, Weights as TransposedWeights};
use super::direct::weight_gradient::{AddOutputRow, SumsLayout};
use super::epilogue::Epilogue;
use super::rows::Rows;
use super::scratch::{AlignedBuffer, zeros};
use super::shape::Shape;
use super::simd::Isa;
use super::{sums, winograd};

/// Input rows per task of a transposed convolution.
const TASK_ROWS: usize = 4;

/// Output pixels that are worth a group of sums of their own.
const PIXELS_PER_GROUP: usize = 4096;

/// The most groups of sums.
const MOST_GROUPS: usize = 16;

/// Weight and bias of a convolution, or their gradients, as PyTorch lays them out.
#[derive(Clone, Debug, PartialEq)]
pub struct ConvolutionParameters {
    /// `[outputs, inputs, side, side]`.
    pub weight: Vec<f32>,
    /// `[outputs]`.
    pub bias: Vec<f32>,
}

impl ConvolutionParameters {
    /// Computes the gradients of a convolution's weight and bias from its input, of shape `shape`, and the gradient of its
    /// outputs.
    ///
    /// # Panics
    /// When a slice's length is not that of its shape.
    pub fn gradients(geometry: Geometry, input: &[f32], shape: Shape, gradient: &[f32]) -> Self {
        let (weight, bias) = rayon::join(
            || weight_gradient(geometry, input, shape, gradient),
            || sums::per_channel(gradient, geometry.outputs),
        );
        Self { weight, bias }
    }
}

/// Takes the gradient of a convolution's outputs to that of its inputs, of shape `shape`, and finishes it
/// (convolutions of stride 2 know [`Epilogue::Leak`] of slope 1 only).
///
/// # Panics
/// When a slice's length is not that of its shape, or a convolution of stride 2 is to be finished by anything but slope 1.
pub fn input_gradient(
    geometry: Geometry,
    weight: &[f32],
    gradient: &[f32],
    shape: Shape,
    epilogue: Epilogue<'_>,
) -> Vec<f32> {
    geometry.check_gradient(Some(weight), shape, gradient);
    let isa = Isa::current();
    if geometry.stride == 1 {
        let out = shape.with_channels(geometry.outputs);
        return Convolution::transposed(isa, geometry, weight).apply(gradient, out, epilogue);
    }
    assert!(
        matches!(epilogue, Epilogue::Leak(1.0)),
        "{epilogue:?} after a transposed convolution of stride 2"
    );
    if shape.is_empty() {
        return Vec::new();
    }
    let mut to = zeros(shape.len());
    let weights = TransposedWeights::pack(isa, geometry, weight);
    let height = geometry.output_extent(shape.height);
    let output_len = height * geometry.output_extent(shape.width) * geometry.outputs;
    let images = to.par_chunks_mut(shape.image_len()).zip(gradient.par_chunks(output_len));
    images.for_each(|(image, gradient)| {
        let output_gradient = Rows::whole(gradient, height);
        image.par_chunks_mut(TASK_ROWS * shape.row_len()).enumerate().for_each(|(task, to)| {
            let (weights, width) = (&weights, shape.width);
            isa.run(InputRows { weights, output_gradient, width, first: task * TASK_ROWS, to });
        });
    });
    to
}

/// Computes the gradient of a convolution's weights from its input and the gradient of its outputs.
///
/// # Panics
/// When a slice's length is not that of its shape.
pub fn weight_gradient(geometry: Geometry, input: &[f32], shape: Shape, gradient: &[f32]) -> Vec<f32> {
    geometry.check_gradient(None, shape, gradient);
    assert_eq!(input.len(), shape.len(), "floats of an input {shape:?}");
    if shape.is_empty() {
        return vec![0.0; geometry.weight_len()];
    }
    let isa = Isa::current();
    let Geometry { inputs, outputs, side, stride } = geometry;
    if (side, stride) == (3, 1) && winograd::weights::applies(isa, inputs, outputs) {
        return winograd::gradient::weight_gradient(isa, input, shape, gradient, outputs);
    }
    let layout = SumsLayout::new(isa, geometry);
    let height = geometry.output_extent(shape.height);
    let row_len = geometry.output_extent(shape.width) * outputs;
    let rows = shape.images * height;
    let groups = groups(shape.images, geometry.output_extent(shape.width) * height);
    let per_group = rows.div_ceil(groups);
    let mut buffer = AlignedBuffer::zeros(groups * layout.len());
    buffer.as_mut_slice().par_chunks_mut(layout.len()).enumerate().for_each(|(group, sums)| {
        for row in group * per_group..((group + 1) * per_group).min(rows) {
            let (image, y) = (row / height, row % height);
            let input = Rows::whole(&input[image * shape.image_len()..][..shape.image_len()], shape.height);
            let gradient = &gradient[row * row_len..][..row_len];
            isa.run(AddOutputRow { layout, input, row: y, gradient, sums: &mut *sums });
        }
    });
    let parts: Vec<&[f32]> = buffer.as_slice().chunks_exact(layout.len()).collect();
    let totals = sums::add_up(&parts, layout.len());
    let taps = side * side;
    let weight = |i: usize| totals[layout.at(i / taps / inputs, i / taps % inputs, i % taps)];
    (0..geometry.weight_len()).into_par_iter().with_min_len(1 << 12).map(weight).collect()
}

/// How many groups of sums the direct method makes for images of so many output pixels.
fn groups(images: usize, pixels: usize) -> usize {
    (images * pixels / PIXELS_PER_GROUP).clamp(1, MOST_GROUPS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::testing::{Values, assert_close, check_gradients, dot, naive, on_every_isa};

    #[test]
    fn gradients_agree_with_the_equation() {
        let cases = [
            (3, 5, 3, 1, 2, 5, 6),
            (1, 1, 3, 1, 1, 1, 1),
            (16, 16, 3, 1, 2, 9, 7),
            (32, 48, 3, 1, 1, 6, 70),
            (8, 32, 3, 1, 2, 4, 5),
            (21, 8, 3, 1, 2, 6, 9),
            (19, 37, 3, 1, 1, 5, 6),
            (32, 3, 3, 1, 1, 7, 9),
            (4, 8, 3, 2, 2, 7, 6),
            (16, 32, 3, 2, 1, 8, 29),
            (7, 20, 3, 2, 2, 5, 8),
            (8, 16, 3, 2, 1, 3, 57),
            (2, 1, 3, 2, 1, 1, 1),
            (5, 7, 1, 1, 2, 3, 4),
            (4, 3, 9, 1, 1, 6, 11),
        ];
        for (inputs, outputs, side, stride, images, height, width) in cases {
            let geometry = Geometry { inputs, outputs, side, stride };
            let shape = Shape::new(images, height, width, inputs);
            let mut values = Values::new(8);
            let x = values.take(shape.len());
            let weight = values.take_scaled(geometry.weight_len(), side * inputs);
            let bias = vec![0.0; outputs];
            let pixels = images * geometry.output_extent(height) * geometry.output_extent(width);
            let gradient = values.take(pixels * outputs);
            let found = on_every_isa(|| {
                vec![
                    input_gradient(geometry, &weight, &gradient, shape, Epilogue::Leak(1.0)),
                    weight_gradient(geometry, &x, shape, &gradient),
                    sums::per_channel(&gradient, outputs),
                ]
            });
            let loss = |tensors: &[Vec<f32>]| {
                dot(&naive::convolution(geometry, &tensors[1], &tensors[2], &tensors[0], shape), &gradient)
            };
            check_gradients(vec![x.clone(), weight.clone(), bias], &found, loss);
        }
    }

    /// Every set adds the same products, some of them in another order and rounded once instead of twice.
    #[test]
    fn instruction_sets_differ_by_rounding_only() {
        for (inputs, outputs, stride) in [(32, 64, 1), (69, 32, 1), (8, 32, 1), (32, 3, 1), (32, 64, 2)] {
            let geometry = Geometry { inputs, outputs, side: 3, stride };
            let shape = Shape::new(2, 18, 21, inputs);
            let mut values = Values::new(10);
            let (x, weight) =
                (values.take(shape.len()), values.take_scaled(geometry.weight_len(), 9 * inputs));
            let pixels = 2 * geometry.output_extent(18) * geometry.output_extent(21);
            let gradient = values.take(pixels * outputs);
            let found = on_every_isa(|| {
                [
                    input_gradient(geometry, &weight, &gradient, shape, Epilogue::Leak(1.0)),
                    weight_gradient(geometry, &x, shape, &gradient),
                ]
            });
            let (_, portable) = found.last().expect("the portable set");
            for (isa, gradients) in &found {
                for (found, expected) in gradients.iter().zip(portable) {
                    let expected: Vec<f64> = expected.iter().map(|v| f64::from(*v)).collect();
                    assert_close(found, &expected, 8e-6, &format!("{} {geometry:?}", isa.name()));
                }
            }
        }
    }

    #[test]
    fn weight_gradients_do_not_depend_on_the_threads() {
        let shape = Shape::new(3, 112, 104, 16);
        let mut values = Values::new(2);
        let (x, gradient) = (values.take(shape.len()), values.take(shape.len()));
        assert_eq!(winograd::gradient::groups(3 * 28 * 26, 16 * 16), 4, "groups of stride 1");
        assert_eq!(groups(3, 56 * 52), 2, "groups of stride 2");
        for stride in [1, 2] {
            let geometry = Geometry { inputs: 16, outputs: 16, side: 3, stride };
            let pixels = 3 * geometry.output_extent(112) * geometry.output_extent(104);
            let run = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| weight_gradient(geometry, &x, shape, &gradient[..pixels * 16]))
            };
            assert!(run(1) == run(3), "stride {stride}");
        }
    }
}

//! The operations at the sizes that the published network has, against their equations in f64: sums in several groups,
//! rows of more than one batch of tiles, filters within an image.

use super::gradient::{ConvolutionParameters, input_gradient};
use super::testing::{Values, assert_close, naive, on_every_isa};
use super::winograd;
use super::{Convolution, DynamicFilter, Epilogue, Geometry, Isa, Shape};

/// Sums of up to 70,000 products round to some 1e-6 of the largest; a group that is left out is a tenth of it.
#[test]
fn weight_gradients_of_several_groups_agree_with_the_sum_written_down() {
    assert_eq!(winograd::gradient::groups(2 * 23 * 33, 32 * 32), 2, "of the first case");
    assert_eq!(winograd::gradient::groups(4 * 32 * 32, 16 * 16), 8, "of the second");
    let cases = [
        // Tiles in groups of uneven numbers of rows, in as many as there are, and in rows longer than a product.
        (32, 32, 3, 1, [2, 90, 130]),
        (16, 8, 3, 1, [4, 128, 128]),
        (8, 16, 3, 1, [1, 130, 270]),
        // Pixels in two to four groups.
        (32, 64, 3, 2, [4, 128, 128]),
        (3, 5, 3, 1, [1, 100, 130]),
        (4, 6, 5, 1, [1, 96, 96]),
    ];
    for (inputs, outputs, side, stride, [images, height, width]) in cases {
        let geometry = Geometry { inputs, outputs, side, stride };
        let shape = Shape::new(images, height, width, inputs);
        let mut values = Values::new(31);
        let input = values.take(shape.len());
        let gradient = values.take(geometry.output_shape(shape).len());
        let expected = naive::weight_gradient(geometry, &input, shape, &gradient);
        let sum = |o: usize| gradient.iter().skip(o).step_by(outputs).map(|g| f64::from(*g)).sum();
        let biases: Vec<f64> = (0..outputs).map(sum).collect();
        for (isa, found) in
            on_every_isa(|| ConvolutionParameters::gradients(geometry, &input, shape, &gradient))
        {
            let what = format!("{} {geometry:?} {shape:?}", isa.name());
            assert_close(&found.weight, &expected, 1e-5, &what);
            assert_close(&found.bias, &biases, 1e-5, &what);
        }
    }
}

#[test]
fn input_gradients_of_wide_images_agree_with_the_sum_written_down() {
    for (inputs, outputs, stride, [images, height, width]) in
        [(32, 32, 1, [2, 6, 150]), (32, 64, 2, [2, 12, 130]), (64, 128, 2, [1, 7, 67])]
    {
        let geometry = Geometry { inputs, outputs, side: 3, stride };
        let shape = Shape::new(images, height, width, inputs);
        let mut values = Values::new(32);
        let weight = values.take_scaled(geometry.weight_len(), 9 * inputs);
        let gradient = values.take(geometry.output_shape(shape).len());
        let expected = naive::input_gradient(geometry, &weight, &gradient, shape);
        let found = on_every_isa(|| input_gradient(geometry, &weight, &gradient, shape, Epilogue::Leak(1.0)));
        for (isa, found) in found {
            assert_close(&found, &expected, 4e-6, &format!("{} {geometry:?} {shape:?}", isa.name()));
        }
    }
}

/// The batches of a row wider than 36 tiles, 144 pixels, and of shuffled rows, with and without something to finish with.
#[test]
fn rows_of_several_batches_of_tiles_agree_with_the_sum_written_down() {
    for (inputs, outputs, [images, height, width], is_up) in [
        (32, 32, [2, 5, 150], false),
        (8, 32, [1, 9, 301], false),
        (64, 64, [1, 4, 290], false),
        (32, 64, [1, 5, 150], true),
    ] {
        let geometry = Geometry::three_by_three(inputs, outputs);
        let shape = Shape::new(images, height, width, inputs);
        let mut values = Values::new(33);
        let input = values.take(shape.len());
        let weight = values.take_scaled(geometry.weight_len(), 3 * inputs);
        let bias = values.take(outputs);
        let mut sums = naive::convolution(geometry, &weight, &bias, &input, shape);
        if is_up {
            sums = naive::pixel_shuffle(&sums, shape.with_channels(outputs));
        }
        let other = values.take(sums.len());
        for isa in Isa::available() {
            let convolution = if is_up {
                Convolution::up(isa, inputs, &weight, &bias)
            } else {
                Convolution::for_isa(isa, geometry, &weight, &bias)
            };
            for epilogue in
                [Epilogue::Leak(0.2), Epilogue::LeakThenAdd(0.2, &other), Epilogue::Gate(0.3, &other)]
            {
                let found = convolution.apply(&input, shape, epilogue);
                let expected = naive::epilogue(epilogue, &sums);
                assert_close(&found, &expected, 4e-6, &format!("{} {geometry:?} {shape:?}", isa.name()));
            }
        }
    }
}

/// Numbers of 8 bits err by 2e-3, which the transforms make up to 1.7e-2 of the largest output of noise.
#[test]
fn rows_of_several_batches_are_rounded_to_bfloat16_and_no_more() {
    for isa in Isa::available().into_iter().filter_map(Isa::with_bf16_products) {
        let (geometry, shape) = (Geometry::three_by_three(32, 32), Shape::new(1, 6, 150, 32));
        let mut values = Values::new(34);
        let input = values.take(shape.len());
        let weight = values.take_scaled(geometry.weight_len(), 9 * 32);
        let bias = values.take(32);
        let found =
            Convolution::for_isa(isa, geometry, &weight, &bias).apply(&input, shape, Epilogue::Leak(1.0));
        let expected = naive::convolution(geometry, &weight, &bias, &input, shape);
        assert_close(&found, &expected, 2e-2, isa.name());
    }
}

/// A filter of published size with an image in which some tiles are inside: those lie two pixels from either end, and
/// have 48, 24 and 96 pixels of 32, 64 and 128 channels.
struct FilterCase {
    shape: Shape,
    weight: Vec<f32>,
    bias: Vec<f32>,
    condition: Vec<f32>,
    features: Vec<f32>,
    gradient: Vec<f32>,
}

impl FilterCase {
    const SIZE: usize = 5;
    const SLOPE: f32 = 0.3;

    fn new(shape: Shape) -> Self {
        let (channels, taps) = (shape.channels, Self::SIZE * Self::SIZE);
        let mut values = Values::new(35);
        Self {
            shape,
            weight: values.take_scaled(taps * channels * channels, channels),
            bias: values.take(taps * channels),
            condition: values.take(shape.len()),
            features: values.take(shape.len()),
            gradient: values.take(shape.len()),
        }
    }

    fn filter(&self) -> DynamicFilter {
        DynamicFilter::new(Isa::current(), Self::SIZE, &self.weight, &self.bias, Self::SLOPE)
    }

    fn head(&self) -> naive::FilterHead<'_> {
        naive::FilterHead { size: Self::SIZE, weight: &self.weight, bias: &self.bias, slope: Self::SLOPE }
    }
}

#[test]
fn dynamic_filters_inside_an_image_agree_with_the_equation() {
    for [images, height, width, channels] in
        [[1, 6, 110, 32], [2, 3, 200, 32], [1, 3, 80, 64], [1, 1, 220, 128]]
    {
        let case = FilterCase::new(Shape::new(images, height, width, channels));
        let (condition, features, shape) = (&case.condition, &case.features, case.shape);
        let expected = case.head().apply(condition, features, shape);
        let found = on_every_isa(|| {
            let mut output = vec![f32::NAN; shape.len()];
            case.filter().forward(condition, features, shape, &mut output);
            output
        });
        for (isa, found) in found {
            assert_close(&found, &expected, 3e-6, &format!("{} {shape:?}", isa.name()));
        }
    }
}

#[test]
fn gradients_of_dynamic_filters_inside_an_image_agree_with_the_equation() {
    for [images, height, width, channels] in [[1, 4, 110, 32], [3, 5, 160, 32], [1, 2, 80, 64]] {
        let case = FilterCase::new(Shape::new(images, height, width, channels));
        let (condition, features, shape, gradient) =
            (&case.condition, &case.features, case.shape, &case.gradient);
        let expected = case.head().gradients(condition, features, shape, gradient);
        for (isa, g) in on_every_isa(|| case.filter().backward(condition, features, shape, gradient)) {
            let found = [g.condition, g.features, g.weight, g.bias, vec![g.slope]];
            for (t, (found, expected)) in found.iter().zip(&expected).enumerate() {
                assert_close(found, expected, 2e-5, &format!("{} {shape:?} tensor {t}", isa.name()));
            }
        }
    }
}

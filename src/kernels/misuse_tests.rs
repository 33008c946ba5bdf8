//! Every public operation refuses slices of another size than their shapes say, before anything is read unchecked.

use std::panic::{AssertUnwindSafe, catch_unwind};

use super::gradient::{ConvolutionParameters, input_gradient, weight_gradient};
use super::modulation::{Branch, Kept, Modulation};
use super::res_block::ResBlock;
use super::stream::{Arena, Graph, Plan, Source};
use super::up_convolution::UpConvolution;
use super::{Convolution, DynamicFilter, Epilogue, Geometry, Isa, Shape, sums};

/// A call that must end in a panic that says this.
type Case<'a> = (&'a str, Box<dyn Fn() + 'a>);

fn case<'a, T>(says: &'a str, call: impl Fn() -> T + 'a) -> Case<'a> {
    (
        says,
        Box::new(move || {
            call();
        }),
    )
}

fn assert_refused(cases: Vec<Case<'_>>) {
    for (number, (says, call)) in cases.into_iter().enumerate() {
        let panic = catch_unwind(AssertUnwindSafe(call)).expect_err(&format!("case {number}, {says}"));
        let said = match panic.downcast::<String>() {
            Ok(said) => *said,
            Err(other) => other.downcast::<&str>().expect("a message").to_string(),
        };
        assert!(said.contains(says), "case {number} says {said:?}, not {says:?}");
    }
}

const SHAPE: Shape = Shape { images: 2, height: 6, width: 4, channels: 8 };

fn strided() -> Geometry {
    Geometry { inputs: 8, outputs: 4, side: 3, stride: 2 }
}

/// Numbers for as many floats as are asked for.
fn floats(len: usize) -> Vec<f32> {
    vec![0.5; len]
}

fn convolution(inputs: usize, outputs: usize, stride: usize) -> Convolution {
    let geometry = Geometry { inputs, outputs, side: 3, stride };
    Convolution::new(geometry, &floats(geometry.weight_len()), &floats(outputs))
}

fn filter(channels: usize) -> DynamicFilter {
    DynamicFilter::new(Isa::current(), 3, &floats(9 * channels * channels), &floats(9 * channels), 0.2)
}

/// The gradient of a stride-2 convolution's inputs was read past its end.
#[test]
fn gradients_of_another_size_are_refused() {
    let geometry = strided();
    let plain = Geometry { stride: 1, ..geometry };
    let (weight, input) = (floats(geometry.weight_len()), floats(SHAPE.len()));
    let out = geometry.output_shape(SHAPE).len();
    let none = Epilogue::Leak(1.0);
    let short = floats(out - 1);
    assert_refused(vec![
        case("floats of a gradient", || input_gradient(geometry, &weight, &short, SHAPE, none)),
        case("floats of a gradient", || input_gradient(geometry, &weight, &[], SHAPE, none)),
        case("floats of a gradient", || input_gradient(plain, &weight, &short, SHAPE, none)),
        case("weights of", || input_gradient(geometry, &weight[1..], &floats(out), SHAPE, none)),
        case("weights of", || input_gradient(plain, &weight[1..], &floats(4 * 48), SHAPE, none)),
        case("channels of", || input_gradient(geometry, &weight, &floats(out), SHAPE.with_channels(7), none)),
        case("tensor that finishes", || {
            input_gradient(plain, &weight, &floats(4 * 48), SHAPE, Epilogue::Gate(0.2, &input[1..]))
        }),
        case("after a transposed convolution", || {
            input_gradient(geometry, &weight, &floats(out), SHAPE, Epilogue::Leak(0.2))
        }),
        case("floats of a gradient", || weight_gradient(geometry, &input, SHAPE, &short)),
        case("floats of a gradient", || weight_gradient(plain, &input, SHAPE, &short)),
        case("floats of an input", || weight_gradient(geometry, &input[1..], SHAPE, &floats(out))),
        case("floats of an input", || {
            ConvolutionParameters::gradients(geometry, &input[1..], SHAPE, &floats(out))
        }),
        case("side 4, stride 2", || {
            weight_gradient(Geometry { side: 4, ..geometry }, &input, SHAPE, &floats(out))
        }),
        case("a gradient and the signs", || sums::gate(&floats(8), &floats(7), 0.2, 4)),
        case("9 floats of a gradient in pixels of 4", || sums::gate(&floats(9), &floats(9), 0.2, 4)),
        case("pixels of 0 channels", || sums::per_channel(&floats(8), 0)),
    ]);
}

#[test]
fn convolutions_of_another_size_are_refused() {
    let geometry = Geometry::three_by_three(8, 4);
    let (weight, bias, input) = (floats(geometry.weight_len()), floats(4), floats(SHAPE.len()));
    let made = convolution(8, 4, 1);
    let apply =
        |input: &[f32], shape: Shape, epilogue: Epilogue<'_>| drop(made.apply(input, shape, epilogue));
    let isa = Isa::current();
    assert_refused(vec![
        case("weights of", || Convolution::new(geometry, &weight[1..], &bias)),
        case("biases of", || Convolution::for_isa(isa, geometry, &weight, &bias[1..])),
        case("side 13, stride 1", || Convolution::new(Geometry { side: 13, ..geometry }, &weight, &bias)),
        case("0 channels to 4", || Convolution::new(Geometry { inputs: 0, ..geometry }, &[], &bias)),
        case("3 outputs to shuffle", || Convolution::up(isa, 8, &floats(3 * 72), &floats(3))),
        case("weights of", || Convolution::up(isa, 8, &weight[1..], &bias)),
        case("weights of", || Convolution::transposed(isa, geometry, &weight[1..])),
        case("stride of a convolution", || Convolution::transposed(isa, strided(), &weight)),
        case("Shape", || apply(&input[1..], SHAPE, Epilogue::Leak(1.0))),
        case("Shape", || apply(&input, SHAPE.with_channels(4), Epilogue::Leak(1.0))),
        case("tensor that finishes", || apply(&input, SHAPE, Epilogue::LeakThenAdd(1.0, &input))),
        case("floats of an output", || {
            made.forward(&input, SHAPE, Epilogue::Leak(1.0), &mut floats(SHAPE.len()));
        }),
        case("more numbers than memory", || {
            apply(&[], Shape { height: 1 << 40, width: 1 << 40, ..SHAPE }, Epilogue::Leak(1.0));
        }),
    ]);
}

#[test]
fn dynamic_filters_of_another_size_are_refused() {
    let (made, input) = (filter(8), floats(SHAPE.len()));
    let isa = Isa::current();
    let forward = |condition: &[f32], features: &[f32], shape: Shape| {
        made.forward(condition, features, shape, &mut floats(SHAPE.len()));
    };
    let backward = |condition: &[f32], features: &[f32], shape: Shape, gradient: &[f32]| {
        made.backward(condition, features, shape, gradient);
    };
    assert_refused(vec![
        case("71 biases", || DynamicFilter::new(isa, 3, &floats(576), &floats(71), 0.2)),
        case("weights for 8 channels", || DynamicFilter::new(isa, 3, &floats(575), &floats(72), 0.2)),
        case("filters of 17 × 17", || DynamicFilter::new(isa, 17, &floats(289), &floats(289), 0.2)),
        case("channels of", || forward(&input, &input, SHAPE.with_channels(4))),
        case("floats of", || forward(&input[1..], &input, SHAPE)),
        case("floats of", || forward(&input, &input[1..], SHAPE)),
        case("channels of", || backward(&input, &input, SHAPE.with_channels(4), &input)),
        case("floats of", || backward(&input[1..], &input, SHAPE, &input)),
        case("floats of", || backward(&input, &input[1..], SHAPE, &input)),
        case("floats of", || backward(&input, &input, SHAPE, &input[1..])),
        case("no pixels", || backward(&[], &[], Shape { images: 0, ..SHAPE }, &[])),
    ]);
}

#[test]
fn blocks_of_another_size_are_refused() {
    let (weight, bias, x) = (floats(9 * 64), floats(8), floats(SHAPE.len()));
    let block = ResBlock { weights: [&weight, &weight], biases: [&bias, &bias], slope: 0.2 };
    let fewer = ResBlock { weights: [&weight, &weight[1..]], ..block };
    let up = UpConvolution { weight: &weight, bias: &bias, slope: 0.2 };
    let shuffled = floats(SHAPE.len());
    let joined = SHAPE.with_channels(11);
    let (first, inner) = (floats(4 * 11 * 9), floats(SHAPE.pixels() * 4));
    let (second, few) = (floats(8 * 4 * 9), floats(4));
    let branch = Branch { weights: [&first, &second], biases: [&few, &bias] };
    let modulation = Modulation { scale: branch, offset: branch, inner_slope: 0.2, slope: 0.0 };
    let narrow = Branch { weights: [&first, &second[..4 * 4 * 9]], biases: [&few, &few] };
    let (map, side_by_side) = (floats(SHAPE.pixels() * 3), floats(joined.len()));
    let back = |joined: &Vec<f32>, inner: &Vec<f32>, gradient: &[f32]| {
        let kept = Kept { joined, inner: [inner, inner], share: &x };
        modulation.backward(&x, kept, (&x, gradient), SHAPE);
    };
    assert_refused(vec![
        case("Shape", || block.forward(&x[1..], SHAPE)),
        case("weights of", || fewer.forward(&x, SHAPE)),
        case("floats of", || block.backward(&x[1..], &x, &x, SHAPE)),
        case("floats of", || block.backward(&x, &x[1..], &x, SHAPE)),
        case("floats of", || block.backward(&x, &x, &x[1..], SHAPE)),
        case("weights of", || fewer.backward(&x, &x, &x, SHAPE)),
        case("Shape", || up.forward(&x[1..], SHAPE)),
        case("floats of", || up.backward(&x, SHAPE, &shuffled[1..], &shuffled)),
        case("floats of", || up.backward(&x, SHAPE, &shuffled, &shuffled[1..])),
        case("floats of", || up.backward(&x[1..], SHAPE, &shuffled, &shuffled)),
        case("floats of", || modulation.forward(&x[1..], &map, SHAPE)),
        case("floats of a map", || modulation.forward(&x, &map[1..], SHAPE)),
        case("channels of a branch", || Modulation { offset: narrow, ..modulation }.forward(&x, &map, SHAPE)),
        case("floats of a map", || back(&floats(joined.len() - 1), &inner, &x)),
        case("floats of", || back(&side_by_side, &floats(inner.len() - 1), &x)),
        case("floats of", || back(&side_by_side, &inner, &x[1..])),
    ]);
}

/// Features with fewer channels than the conditions, and a tensor that is added to a result of other sides, were read past
/// their rows' ends or from other rows.
#[test]
fn steps_of_a_stream_that_do_not_fit_together_are_refused() {
    let build = |append: &dyn Fn(&mut Graph)| append(&mut Graph::default());
    let run = |sources: &[Source<'_>]| {
        let mut network = Graph::default();
        let image = network.input(3);
        network.convolution(image, convolution(3, 4, 1), 0.2, None);
        Plan::new(&network, 8, 8, 2).run(&mut Arena::default(), sources, |_, _| (), |_| Ok::<(), ()>(()))
    };
    assert_refused(vec![
        case("features of a dynamic filter", || {
            build(&|network| {
                let (condition, features) = (network.input(8), network.input(4));
                network.dynamic_filter(condition, features, filter(8));
            });
        }),
        case("features of a dynamic filter", || {
            build(&|network| {
                let condition = network.input(8);
                let features = network.convolution(condition, convolution(8, 8, 2), 0.2, None);
                network.dynamic_filter(condition, features, filter(8));
            });
        }),
        case("what is added to a convolution", || {
            build(&|network| {
                let image = network.input(8);
                network.convolution(image, convolution(8, 4, 1), 0.2, Some(image));
            });
        }),
        case("what is added to a convolution", || {
            build(&|network| {
                let image = network.input(8);
                network.convolution(image, convolution(8, 8, 2), 0.2, Some(image));
            });
        }),
        case("channels that a convolution reads", || {
            build(&|network| {
                let image = network.input(3);
                network.convolution(image, convolution(8, 8, 1), 0.2, None);
            });
        }),
        case("reduced by 1", || {
            build(&|network| {
                let image = network.input(8);
                let up = Convolution::up(Isa::current(), 8, &floats(8 * 72), &floats(8));
                network.convolution(image, up, 0.2, None);
            });
        }),
        case("sides of tensors joined", || {
            build(&|network| {
                let image = network.input(8);
                let coarse = network.convolution(image, convolution(8, 8, 2), 0.2, None);
                network.add(image, coarse);
            });
        }),
        case("sources for the network", || run(&[])),
    ]);
}

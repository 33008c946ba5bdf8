//! The network's operations on the shapes of an 800 × 800 image, forward, and of a batch of four 128 × 128
//! crops, backward: what `udc bench` and `cargo bench` time.

use std::time::{Duration, Instant};

use super::gradient::{input_gradient, weight_gradient};
use super::{Convolution, DynamicFilter, Epilogue, Geometry, Isa, Shape};

/// An operation's best time.
#[derive(Clone, Debug)]
pub struct Timing {
    /// Operation and shape.
    pub name: String,
    /// Floating-point operations of the sum written down, multiplications and additions.
    pub operations: f64,
    /// Wall-clock time.
    pub seconds: f64,
}

/// Times every operation whose name contains `wanted` for about `patience` each, handing each result out, until `stops` says
/// that nobody waits for the rest.
pub fn run(wanted: &str, patience: Duration, stops: &dyn Fn() -> bool, mut report: impl FnMut(Timing)) {
    let mut time = |name: String, operations: f64, prepare: Prepare<'_>| {
        if name.contains(wanted) && !stops() {
            report(Timing { name, operations, seconds: best_time(patience, stops, prepare()) });
        }
    };
    for (channels, side) in [(32, 800), (64, 400), (128, 200)] {
        forward(&mut time, "3×3", Geometry::three_by_three(channels, channels), side);
    }
    forward(&mut time, "3×3 first", Geometry::three_by_three(8, 32), 800);
    forward(&mut time, "3×3 last", Geometry::three_by_three(32, 3), 800);
    for (inputs, side) in [(32, 800), (64, 400)] {
        let geometry = Geometry { inputs, outputs: 2 * inputs, side: 3, stride: 2 };
        forward(&mut time, "3×3 stride 2", geometry, side);
    }
    for (channels, side) in [(64, 200), (32, 400)] {
        up(&mut time, channels, side);
    }
    for (channels, side) in [(32, 800), (64, 400), (128, 200)] {
        filter(&mut time, channels, Shape::new(1, side, side, channels), false);
    }
    for (channels, side) in [(32, 128), (64, 64), (128, 32)] {
        backward(&mut time, Geometry::three_by_three(channels, channels), side);
    }
    backward(&mut time, Geometry { inputs: 32, outputs: 64, side: 3, stride: 2 }, 128);
    backward(&mut time, Geometry::three_by_three(8, 32), 128);
    for (channels, side) in [(32, 128), (64, 64), (128, 32)] {
        filter(&mut time, channels, Shape::new(4, side, side, channels), true);
    }
}

/// The best of several calls, after one that is not counted; of one, once `stops` says so.
pub fn best_time(patience: Duration, stops: &dyn Fn() -> bool, mut call: impl FnMut()) -> f64 {
    call();
    let begun = Instant::now();
    let mut best = f64::INFINITY;
    while (begun.elapsed() < patience && !stops()) || best.is_infinite() {
        let start = Instant::now();
        call();
        best = best.min(start.elapsed().as_secs_f64());
    }
    best
}

/// Makes the tensors of an operation and gives the call to time.
type Prepare<'a> = &'a dyn Fn() -> Box<dyn FnMut()>;

/// Takes a name, operations and what prepares them, which is not run when nobody asked for the name.
type Time<'a> = &'a mut dyn FnMut(String, f64, Prepare<'_>);

/// Numbers between −1/2 and 1/2, scattered.
fn values(len: usize) -> Vec<f32> {
    (0..len).map(|i| (i * 2_654_435_761 % 1000) as f32 / 1000.0 - 0.5).collect()
}

fn forward(time: Time<'_>, name: &str, geometry: Geometry, side: usize) {
    let shape = Shape::new(1, side, side, geometry.inputs);
    let name = format!("{name} {}→{} @{side}²", geometry.inputs, geometry.outputs);
    let pixels = geometry.output_extent(side).pow(2);
    time(name, (2 * geometry.weight_len() * pixels) as f64, &|| {
        let convolution =
            Convolution::new(geometry, &values(geometry.weight_len()), &values(geometry.outputs));
        let (input, mut output) = (values(shape.len()), vec![0.0; pixels * geometry.outputs]);
        Box::new(move || convolution.forward(&input, shape, Epilogue::Leak(0.2), &mut output))
    });
}

fn up(time: Time<'_>, channels: usize, side: usize) {
    let inputs = 2 * channels;
    let shape = Shape::new(1, side, side, inputs);
    let weights = 4 * channels * inputs * 9;
    time(format!("up {inputs}→{channels} @{side}²"), (2 * weights * shape.pixels()) as f64, &|| {
        let up = Convolution::up(Isa::current(), inputs, &values(weights), &values(4 * channels));
        let (input, mut output) = (values(shape.len()), vec![0.0; up.output_shape(shape).len()]);
        let skip = values(output.len());
        Box::new(move || up.forward(&input, shape, Epilogue::LeakThenAdd(0.2, &skip), &mut output))
    });
}

fn filter(time: Time<'_>, channels: usize, shape: Shape, with_gradient: bool) {
    const SIZE: usize = 5;
    let taps = SIZE * SIZE;
    let products = (2 * taps * channels * shape.len()) as f64;
    let tensors = move || {
        let (weight, bias) = (values(taps * channels * channels), values(taps * channels));
        let filter = DynamicFilter::new(Isa::current(), SIZE, &weight, &bias, 0.2);
        (filter, values(shape.len()), values(shape.len()))
    };
    if with_gradient {
        let name = format!("dynamic filter {channels} backward {}×{}²", shape.images, shape.width);
        time(name, 3.0 * products, &|| {
            let (filter, condition, features) = tensors();
            Box::new(move || drop(filter.backward(&condition, &features, shape, &features)))
        });
    } else {
        time(format!("dynamic filter {channels} @{}²", shape.width), products, &|| {
            let ((filter, condition, features), mut output) = (tensors(), vec![0.0; shape.len()]);
            Box::new(move || filter.forward(&condition, &features, shape, &mut output))
        });
    }
}

fn backward(time: Time<'_>, geometry: Geometry, side: usize) {
    const IMAGES: usize = 4;
    let shape = Shape::new(IMAGES, side, side, geometry.inputs);
    let extent = geometry.output_extent(side);
    let pixels = IMAGES * extent * extent;
    let gradient = move || values(pixels * geometry.outputs);
    let operations = (2 * geometry.weight_len() * pixels) as f64;
    let stride = if geometry.stride == 2 { " stride 2" } else { "" };
    let what = format!("{}→{}{stride} {IMAGES}×{side}²", geometry.inputs, geometry.outputs);
    time(format!("3×3 to input {what}"), operations, &|| {
        let (weight, gradient) = (values(geometry.weight_len()), gradient());
        Box::new(move || drop(input_gradient(geometry, &weight, &gradient, shape, Epilogue::Leak(1.0))))
    });
    time(format!("3×3 to weights {what}"), operations, &|| {
        let (input, gradient) = (values(shape.len()), gradient());
        Box::new(move || drop(weight_gradient(geometry, &input, shape, &gradient)))
    });
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    #[test]
    fn what_nobody_waits_for_is_not_timed() {
        let (asked, mut told) = (Cell::new(0), 0);
        let stops = || {
            asked.set(asked.get() + 1);
            asked.get() > 2
        };
        run("3×3 last", Duration::from_secs(3600), &stops, |_| told += 1);
        assert_eq!(told, 1, "the one that was begun");
        run("", Duration::from_secs(3600), &|| true, |timing| panic!("{} was timed", timing.name));
    }
}

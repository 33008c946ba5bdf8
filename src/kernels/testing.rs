//! What the kernels' tests share: reproducible values and the operations written down plainly, in f64.

use std::cell::Cell;

use super::Isa;

thread_local! {
    static ISA: Cell<Option<Isa>> = const { Cell::new(None) };
}

/// The instruction set that [`on_every_isa`] chose for this thread.
pub(crate) fn isa_of_thread() -> Option<Isa> {
    ISA.get()
}

/// Runs operations once with each instruction set of this CPU, in threads whose kernels use no other.
pub(crate) fn on_every_isa<T: Send>(operations: impl Fn() -> T + Sync) -> Vec<(Isa, T)> {
    let run = |isa: Isa| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(2).start_handler(move |_| ISA.set(Some(isa)));
        (isa, pool.build().unwrap().install(&operations))
    };
    Isa::available().into_iter().map(run).collect()
}

/// A stream of pseudo-random numbers, roughly normal, the same on every machine.
pub(crate) struct Values(u64);

impl Values {
    /// Starts a stream.
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    fn uniform(&mut self) -> f32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 40) as f32 / (1u64 << 24) as f32 - 0.5
    }

    /// Takes `len` numbers of standard deviation 1.
    pub(crate) fn take(&mut self, len: usize) -> Vec<f32> {
        (0..len).map(|_| (0..3).map(|_| self.uniform()).sum::<f32>() * 2.0).collect()
    }

    /// Takes `len` numbers of variance `1 / terms`.
    pub(crate) fn take_scaled(&mut self, len: usize, terms: usize) -> Vec<f32> {
        let scale = 1.0 / (terms as f32).sqrt();
        self.take(len).into_iter().map(|v| v * scale).collect()
    }
}

/// Asserts that every value is within `tolerance` of the expected one, relative to the largest expected.
pub(crate) fn assert_close(found: &[f32], expected: &[f64], tolerance: f64, what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}: lengths");
    let largest = expected.iter().fold(1e-3f64, |m, v| m.max(v.abs()));
    for (i, (f, e)) in found.iter().zip(expected).enumerate() {
        let error = (f64::from(*f) - e).abs() / largest;
        assert!(error <= tolerance, "{what}: value {i} is {f}, not {e} (error {error:.1e} of the largest)");
    }
}

/// Σ a·b.
pub(crate) fn dot(a: &[f64], b: &[f32]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| a * f64::from(*b)).sum()
}

/// Asserts that the gradients that each instruction set found are the differences of a loss, at some places of
/// each tensor.
///
/// The loss is evaluated in f64 at two points so close that rectifiers hardly ever switch in between;
/// their distance is exact. What is left is the rounding of the gradients' own sums.
pub(crate) fn check_gradients(
    mut tensors: Vec<Vec<f32>>,
    gradients: &[(Isa, Vec<Vec<f32>>)],
    loss: impl Fn(&[Vec<f32>]) -> f64,
) {
    const STEP: f32 = 1e-5;
    const PLACES: usize = 24;
    for (isa, gradients) in gradients {
        let lengths = |tensors: &[Vec<f32>]| tensors.iter().map(Vec::len).collect::<Vec<_>>();
        assert_eq!(lengths(&tensors), lengths(gradients), "{}", isa.name());
    }
    for t in 0..tensors.len() {
        let apart = tensors[t].len().div_ceil(PLACES);
        for i in (0..tensors[t].len()).step_by(apart) {
            let original = tensors[t][i];
            let mut at = |value: f32| {
                tensors[t][i] = value;
                loss(&tensors)
            };
            let (above, below) = (original + STEP, original - STEP);
            let quotient = (at(above) - at(below)) / f64::from(above - below);
            tensors[t][i] = original;
            for (isa, gradients) in gradients {
                let (name, found) = (isa.name(), gradients[t][i]);
                let largest = gradients[t].iter().fold(1e-3f64, |m, v| m.max(f64::from(v.abs())));
                let error = (f64::from(found) - quotient).abs() / largest;
                assert!(error < 2e-5, "{name}: tensor {t}, place {i}: {found} is not {quotient}");
            }
        }
    }
}

/// The operations as their equations say, in f64.
pub(crate) mod naive {
    use crate::kernels::{Finish, Geometry, Shape};

    fn at<T: Copy + Into<f64>>(input: &[T], shape: Shape, n: usize, (y, x): (isize, isize), c: usize) -> f64 {
        let inside = |v: isize, extent: usize| v >= 0 && v < extent.cast_signed();
        if !inside(y, shape.height) || !inside(x, shape.width) {
            return 0.0;
        }
        let (y, x) = (y.unsigned_abs(), x.unsigned_abs());
        input[((n * shape.height + y) * shape.width + x) * shape.channels + c].into()
    }

    /// A convolution with zero padding, before activation.
    pub(crate) fn convolution<T: Copy + Into<f64>>(
        g: Geometry,
        weight: &[f32],
        bias: &[f32],
        input: &[T],
        shape: Shape,
    ) -> Vec<f64> {
        let (height, width) = (g.output_extent(shape.height), g.output_extent(shape.width));
        let mut output = Vec::new();
        let pad = (g.side / 2).cast_signed();
        for pixel in 0..shape.images * height * width {
            let (n, y, x) = (pixel / width / height, pixel / width % height, pixel % width);
            for o in 0..g.outputs {
                let mut sum = f64::from(bias[o]);
                for tap in 0..g.side * g.side {
                    let row = (y * g.stride + tap / g.side).cast_signed() - pad;
                    let column = (x * g.stride + tap % g.side).cast_signed() - pad;
                    for i in 0..g.inputs {
                        let w = f64::from(weight[(o * g.inputs + i) * g.side * g.side + tap]);
                        sum += w * at(input, shape, n, (row, column), i);
                    }
                }
                output.push(sum);
            }
        }
        output
    }

    /// Bias is in the sums already: activation, addition or gate.
    pub(crate) fn finish(finish: Finish<'_>, sums: &[f64]) -> Vec<f64> {
        let leak =
            |sign: f64, value: f64, slope: f32| if sign > 0.0 { value } else { value * f64::from(slope) };
        let one = |(i, v): (usize, &f64)| match finish {
            Finish::Leak(slope) => leak(*v, *v, slope),
            Finish::LeakThenAdd(slope, other) => leak(*v, *v, slope) + f64::from(other[i]),
            Finish::Gate(slope, sign) => leak(f64::from(sign[i]), *v, slope),
        };
        sums.iter().enumerate().map(one).collect()
    }

    /// PyTorch's `PixelShuffle(2)`, NHWC.
    pub(crate) fn pixel_shuffle(input: &[f64], shape: Shape) -> Vec<f64> {
        let (height, width, channels) = (2 * shape.height, 2 * shape.width, shape.channels / 4);
        let mut output = Vec::new();
        for pixel in 0..shape.images * height * width {
            let (n, y, x) = (pixel / width / height, pixel / width % height, pixel % width);
            for c in 0..channels {
                let from = (n * shape.height + y / 2) * shape.width + x / 2;
                output.push(input[from * shape.channels + c * 4 + y % 2 * 2 + x % 2]);
            }
        }
        output
    }

    /// The last layers of a filter generator.
    pub(crate) struct FilterHead<'a> {
        pub(crate) size: usize,
        pub(crate) weight: &'a [f32],
        pub(crate) bias: &'a [f32],
        pub(crate) slope: f32,
    }

    impl FilterHead<'_> {
        /// Predicts filters and applies them, with replicated borders.
        pub(crate) fn apply(&self, condition: &[f32], features: &[f32], shape: Shape) -> Vec<f64> {
            let taps = self.size * self.size;
            let geometry =
                Geometry { inputs: shape.channels, outputs: shape.channels * taps, side: 1, stride: 1 };
            let filters = convolution(geometry, self.weight, self.bias, condition, shape);
            let filters = finish(Finish::Leak(self.slope), &filters);
            let half = (self.size / 2).cast_signed();
            let nearest = |v: usize, d: usize, extent: usize| {
                (v.cast_signed() + d.cast_signed() - half).clamp(0, extent.cast_signed() - 1)
            };
            let mut output = Vec::new();
            for i in 0..shape.len() {
                let (pixel, c) = (i / shape.channels, i % shape.channels);
                let (n, y, x) = (
                    pixel / shape.width / shape.height,
                    pixel / shape.width % shape.height,
                    pixel % shape.width,
                );
                let tap = |t: usize| {
                    let place =
                        (nearest(y, t / self.size, shape.height), nearest(x, t % self.size, shape.width));
                    filters[(pixel * shape.channels + c) * taps + t] * at(features, shape, n, place, c)
                };
                output.push((0..taps).map(tap).sum());
            }
            output
        }
    }
}

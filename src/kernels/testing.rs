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
    use crate::kernels::{Epilogue, Geometry, Shape};

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

    /// The pairs of an output pixel and an input pixel that weight `tap` multiplies, by their numbers in their batches.
    fn pairs(g: Geometry, shape: Shape, tap: usize) -> impl Iterator<Item = (usize, usize)> {
        let out = g.output_shape(shape);
        let inside = move |v: usize, offset: usize, extent: usize| {
            (v * g.stride + offset).checked_sub(g.side / 2).filter(|v| *v < extent)
        };
        (0..out.pixels()).filter_map(move |pixel| {
            let (n, y, x) =
                (pixel / out.width / out.height, pixel / out.width % out.height, pixel % out.width);
            let (y, x) = (inside(y, tap / g.side, shape.height)?, inside(x, tap % g.side, shape.width)?);
            Some((pixel, (n * shape.height + y) * shape.width + x))
        })
    }

    /// The gradient of a convolution's weights.
    pub(crate) fn weight_gradient(g: Geometry, input: &[f32], shape: Shape, gradient: &[f32]) -> Vec<f64> {
        let taps = g.side * g.side;
        let mut result = vec![0.0; g.weight_len()];
        for tap in 0..taps {
            let mut sums = vec![0.0f64; g.outputs * g.inputs];
            for (to, from) in pairs(g, shape, tap) {
                let seen = &input[from * g.inputs..][..g.inputs];
                let of_output = &gradient[to * g.outputs..][..g.outputs];
                for (sums, d) in sums.chunks_exact_mut(g.inputs).zip(of_output) {
                    let d = f64::from(*d);
                    sums.iter_mut().zip(seen).for_each(|(sum, seen)| *sum += d * f64::from(*seen));
                }
            }
            sums.iter().enumerate().for_each(|(place, sum)| result[place * taps + tap] = *sum);
        }
        result
    }

    /// The gradient of a convolution's inputs.
    pub(crate) fn input_gradient(g: Geometry, weight: &[f32], gradient: &[f32], shape: Shape) -> Vec<f64> {
        let taps = g.side * g.side;
        let mut result = vec![0.0; shape.len()];
        for tap in 0..taps {
            let of_tap: Vec<f64> = weight.iter().skip(tap).step_by(taps).map(|w| f64::from(*w)).collect();
            for (from, to) in pairs(g, shape, tap) {
                let to = &mut result[to * g.inputs..][..g.inputs];
                let of_output = &gradient[from * g.outputs..][..g.outputs];
                for (weights, d) in of_tap.chunks_exact(g.inputs).zip(of_output) {
                    to.iter_mut().zip(weights).for_each(|(to, w)| *to += f64::from(*d) * w);
                }
            }
        }
        result
    }

    /// Bias is in the sums already: activation, addition or gate.
    pub(crate) fn epilogue(epilogue: Epilogue<'_>, sums: &[f64]) -> Vec<f64> {
        let leak =
            |sign: f64, value: f64, slope: f32| if sign > 0.0 { value } else { value * f64::from(slope) };
        let one = |(i, v): (usize, &f64)| match epilogue {
            Epilogue::Leak(slope) => leak(*v, *v, slope),
            Epilogue::LeakThenAdd(slope, other) => leak(*v, *v, slope) + f64::from(other[i]),
            Epilogue::Gate(slope, sign) => leak(f64::from(sign[i]), *v, slope),
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
        pub(crate) fn apply<T: Copy + Into<f64>>(
            &self,
            condition: &[T],
            features: &[T],
            shape: Shape,
        ) -> Vec<f64> {
            let taps = self.size * self.size;
            let filters = epilogue(Epilogue::Leak(self.slope), &self.filters(condition, shape));
            let mut output = Vec::new();
            for i in 0..shape.len() {
                let tap = |t: usize| filters[i * taps + t] * features[self.seen(i, t, shape)].into();
                output.push((0..taps).map(tap).sum());
            }
            output
        }

        /// The filters before their PReLU.
        fn filters<T: Copy + Into<f64>>(&self, condition: &[T], shape: Shape) -> Vec<f64> {
            let outputs = shape.channels * self.size * self.size;
            let geometry = Geometry { inputs: shape.channels, outputs, side: 1, stride: 1 };
            convolution(geometry, self.weight, self.bias, condition, shape)
        }

        /// The place of the feature that a tap of output `i` sees.
        fn seen(&self, i: usize, tap: usize, shape: Shape) -> usize {
            let nearest =
                |v: usize, d: usize, extent: usize| (v + d).saturating_sub(self.size / 2).min(extent - 1);
            let (pixel, c) = (i / shape.channels, i % shape.channels);
            let (row, x) = (pixel / shape.width, pixel % shape.width);
            let (n, y) = (row / shape.height, row % shape.height);
            let y = nearest(y, tap / self.size, shape.height);
            let x = nearest(x, tap % self.size, shape.width);
            ((n * shape.height + y) * shape.width + x) * shape.channels + c
        }

        /// The gradients of conditions, features, weights, biases and slope.
        pub(crate) fn gradients(
            &self,
            condition: &[f32],
            features: &[f32],
            shape: Shape,
            gradient: &[f32],
        ) -> [Vec<f64>; 5] {
            let (channels, taps, slope) = (shape.channels, self.size * self.size, f64::from(self.slope));
            let filters = self.filters(condition, shape);
            let [mut to_condition, mut to_features] = [(); 2].map(|()| vec![0.0; shape.len()]);
            let mut to_weight = vec![0.0; self.weight.len()];
            let mut to_bias = vec![0.0; self.bias.len()];
            let mut to_slope = 0.0;
            for i in 0..shape.len() {
                let (first, c, d) = (i - i % channels, i % channels, f64::from(gradient[i]));
                for t in 0..taps {
                    let (p, seen, output) = (filters[i * taps + t], self.seen(i, t, shape), c * taps + t);
                    let feature = f64::from(features[seen]);
                    to_features[seen] += d * if p > 0.0 { p } else { slope * p };
                    to_slope += d * feature * p.min(0.0);
                    let g = d * feature * if p > 0.0 { 1.0 } else { slope };
                    to_bias[output] += g;
                    for k in 0..channels {
                        to_condition[first + k] += g * f64::from(self.weight[output * channels + k]);
                        to_weight[output * channels + k] += g * f64::from(condition[first + k]);
                    }
                }
            }
            [to_condition, to_features, to_weight, to_bias, vec![to_slope]]
        }
    }
}

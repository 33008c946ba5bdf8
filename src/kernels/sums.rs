//! Passes over gradients that sum as they go: activation derivatives, biases, slopes.

use rayon::prelude::*;

use super::scratch::by_chunks;
use super::simd::{Isa, Kernel, Simd};

/// Pixels summed in f32 before their sum is added in f64. Chunks do not depend on the threads.
const CHUNK: usize = 1024;

/// A gradient taken back through a leaky rectifier.
#[derive(Debug)]
pub struct Gated {
    /// The gradient of what the rectifier was given.
    pub gradient: Vec<f32>,
    /// Its sum over pixels: the gradient of the bias before the rectifier.
    pub bias: Vec<f32>,
    /// The gradient of the slope, when `sign` was what the rectifier was given.
    pub slope: f32,
}

/// Takes the gradient of `leak(sign)` back to that of `sign`, which may be given by anything of its sign when
/// the slope's gradient is not wanted.
///
/// # Equation
/// `gradient · (sign > 0 ? 1 : slope)`; slope: `Σ gradient · min(sign, 0)`.
///
/// # Panics
/// When the slices differ in length, or do not hold whole pixels of so many channels.
pub fn gate(gradient: &[f32], sign: &[f32], slope: f32, channels: usize) -> Gated {
    check_pixels(gradient, channels);
    assert_eq!(gradient.len(), sign.len(), "a gradient and the signs it is gated by");
    let len = CHUNK * channels;
    let (gated, sums) = by_chunks(gradient.len(), len, |chunk, to| {
        let [gradient, sign] = [gradient, sign].map(|values| &values[chunk * len..][..to.len()]);
        Isa::current().run(GateChunk { to, gradient, sign, slope, channels })
    });
    let slope = rounded(sums.iter().map(|(_, slope)| f64::from(*slope)).sum());
    let biases: Vec<&[f32]> = sums.iter().map(|(bias, _)| bias.as_slice()).collect();
    Gated { gradient: gated, bias: add_up(&biases, channels), slope }
}

/// Sums over pixels: the gradient of a bias.
///
/// # Panics
/// When the slice does not hold whole pixels of so many channels.
pub fn per_channel(gradient: &[f32], channels: usize) -> Vec<f32> {
    check_pixels(gradient, channels);
    let chunks = gradient.par_chunks(CHUNK * channels);
    let sums: Vec<Vec<f32>> =
        chunks.map(|chunk| Isa::current().run(SumChunk { gradient: chunk, channels })).collect();
    let sums: Vec<&[f32]> = sums.iter().map(Vec::as_slice).collect();
    add_up(&sums, channels)
}

fn check_pixels(gradient: &[f32], channels: usize) {
    let is_whole = channels > 0 && gradient.len().is_multiple_of(channels);
    assert!(is_whole, "{} floats of a gradient in pixels of {channels} channels", gradient.len());
}

/// Adds the chunks' sums in order, in f64.
pub(crate) fn add_up(sums: &[&[f32]], len: usize) -> Vec<f32> {
    /// Totals that are worth a task of their own.
    const SHARE: usize = 1 << 12;
    let total = |i: usize| rounded(sums.iter().map(|sum| f64::from(sum[i])).sum());
    (0..len).into_par_iter().with_min_len(SHARE).map(total).collect()
}

#[expect(clippy::cast_possible_truncation, reason = "rounds a sum to the gradients' precision")]
fn rounded(sum: f64) -> f32 {
    sum as f32
}

struct GateChunk<'a> {
    to: &'a mut [f32],
    gradient: &'a [f32],
    sign: &'a [f32],
    slope: f32,
    channels: usize,
}

impl Kernel for GateChunk<'_> {
    type Output = (Vec<f32>, f32);

    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) -> (Vec<f32>, f32) {
        let channels = self.channels;
        let mut bias = vec![0.0; channels];
        let mut slopes = vec![0.0; channels];
        let pixels = self.to.chunks_exact_mut(channels).zip(self.gradient.chunks_exact(channels));
        for ((to, gradient), sign) in pixels.zip(self.sign.chunks_exact(channels)) {
            for c in 0..channels {
                let (g, s) = (gradient[c], sign[c]);
                let gated = if s > 0.0 { g } else { g * self.slope };
                to[c] = gated;
                bias[c] += gated;
                slopes[c] += if s > 0.0 { 0.0 } else { g * s };
            }
        }
        (bias, slopes.iter().sum())
    }
}

struct SumChunk<'a> {
    gradient: &'a [f32],
    channels: usize,
}

impl Kernel for SumChunk<'_> {
    type Output = Vec<f32>;

    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) -> Vec<f32> {
        let mut sums = vec![0.0; self.channels];
        for pixel in self.gradient.chunks_exact(self.channels) {
            for (sum, value) in sums.iter_mut().zip(pixel) {
                *sum += value;
            }
        }
        sums
    }
}

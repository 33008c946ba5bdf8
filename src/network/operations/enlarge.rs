//! Nearest-neighbour enlargement followed by a convolution, as a convolution followed by a pixel shuffle.
//!
//! # Method
//! Of the pixels that 3 × 3 taps see in an image enlarged to twice its sides, several are copies of one. Fine row
//! `2y + p + k − 1` (phase p, tap k) is a copy of row `y + ⌊(p + k − 1)/2⌋`, so that each of the four phases is a 3 × 3
//! convolution of the small image whose taps are sums of the given ones (and zeros). Zeros around the one image
//! are zeros around the other. The four are computed at once as an up-convolution.

use burn::tensor::{Tensor, TensorData};

use super::ConvolutionWeights;

/// Taps of the convolution on either side of the identity.
const TAPS: usize = 9;

/// Pixels that one is enlarged to.
const PHASES: usize = 4;

/// The tap on the small image that a tap `k` at phase `p` of the enlarged one falls on.
fn small_tap(p: usize, k: usize) -> usize {
    (p + k).div_ceil(2)
}

/// The place among an up-convolution's four times nine taps to which a tap adds, for each phase.
fn places(tap: usize) -> [usize; PHASES] {
    let (row, column) = (tap / 3, tap % 3);
    std::array::from_fn(|phase| phase * TAPS + small_tap(phase / 2, row) * 3 + small_tap(phase % 2, column))
}

/// Weight `[4·outputs, inputs, 3, 3]` and bias `[4·outputs]` of the up-convolution, of a convolution's
/// `[outputs, inputs, 3, 3]` and `[outputs]`.
pub(in crate::network) fn enlarging_weights(weight: &[f32], bias: &[f32]) -> (Vec<f32>, Vec<f32>) {
    let inputs = weight.len() / bias.len() / TAPS;
    let mut shuffled = vec![0.0; PHASES * weight.len()];
    for (at, value) in weight.iter().enumerate() {
        let (output, input, tap) = (at / TAPS / inputs, at / TAPS % inputs, at % TAPS);
        for place in places(tap) {
            let (phase, small) = (place / TAPS, place % TAPS);
            shuffled[((output * PHASES + phase) * inputs + input) * TAPS + small] += value;
        }
    }
    (shuffled, bias.iter().flat_map(|value| [*value; PHASES]).collect())
}

/// The same for tensors, so that gradients flow back to the convolution's parameters.
pub(super) fn enlarging_tensors(layer: &ConvolutionWeights) -> (Tensor<4>, Tensor<1>) {
    let (weight, bias) = (layer.weight.val(), layer.bias.val());
    let [outputs, inputs, ..] = weight.dims();
    let mut sums = vec![0.0_f32; TAPS * PHASES * TAPS];
    for tap in 0..TAPS {
        places(tap).into_iter().for_each(|place| sums[tap * PHASES * TAPS + place] = 1.0);
    }
    let sums = Tensor::<2>::from_data(TensorData::new(sums, [TAPS, PHASES * TAPS]), &weight.device());
    let weight = weight.reshape([outputs * inputs, TAPS]).matmul(sums);
    let weight = weight.reshape([outputs, inputs, PHASES, TAPS]).permute([0, 2, 1, 3]);
    let bias = bias.reshape([outputs, 1]).expand([outputs, PHASES]);
    (weight.reshape([outputs * PHASES, inputs, 3, 3]), bias.reshape([outputs * PHASES]))
}

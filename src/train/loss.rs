//! Turns a restored batch and its clean one into the number that training makes small.

use burn::tensor::Tensor;

use super::config::LossConfig;

/// Computes the weighted loss of a batch as a tensor of one number.
///
/// Axis by axis: Burn sums many values at once in an order that differs from run to run.
///
/// # Equation
/// `w₁ · mean |restored − clean|` over all values.
pub(super) fn loss(restored: Tensor<4>, clean: Tensor<4>, config: &LossConfig) -> Tensor<1> {
    let difference = (restored - clean).abs();
    let mean = (0..4).rev().fold(difference, |x, axis| x.mean_dim(axis));
    mean.reshape([1]).mul_scalar(config.l1)
}

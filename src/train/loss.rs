//! Turns a restored batch and its clean one into the number that training makes small.

use burn::tensor::Tensor;

use super::config::LossConfig;

/// Computes the weighted loss of a batch as a tensor of one number.
///
/// # Equation
/// `w₁ · mean |restored − clean|` over all values.
pub(super) fn loss(restored: Tensor<4>, clean: Tensor<4>, config: &LossConfig) -> Tensor<1> {
    (restored - clean).abs().mean().mul_scalar(config.l1)
}

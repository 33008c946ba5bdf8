//! What tells the data of one training from those of another.

use crate::core::tone::ToneCurve;

/// What tells the data of one training from those of another, without a look at the images.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DataIdentity {
    /// SHA-256 of the kernel bank behind the codes, where there is one.
    pub kernel_bank_sha256: Option<String>,
    /// φ∘C of the images.
    pub tone_curve: ToneCurve,
}

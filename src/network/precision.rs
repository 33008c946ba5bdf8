//! What the numbers are that a network computes with.

use burn::tensor::FloatDType;
use serde::{Deserialize, Serialize};

/// The precision of a network's products, and on a device of its features; sums are of 32 bits always, as are weights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// 32-bit floats.
    #[default]
    F32,
    /// Rounded to bfloat16, where what computes can do that.
    Bf16,
}

impl Precision {
    /// The name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::Bf16 => "bf16",
        }
    }

    /// The name of a model in tables, where several precisions of it may be.
    pub fn name_of(self, model: &str) -> String {
        match self {
            Self::F32 => model.to_owned(),
            Self::Bf16 => format!("{model}, bf16"),
        }
    }

    /// The type of tensors of such numbers.
    pub(super) fn dtype(self) -> FloatDType {
        match self {
            Self::F32 => FloatDType::F32,
            Self::Bf16 => FloatDType::BF16,
        }
    }
}

//! What the numbers are that a network multiplies.

use super::Notice;
use crate::network::Model;

/// The precision of a network's products; sums are of 32 bits always.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// 32-bit floats.
    #[default]
    F32,
    /// Rounded to bfloat16, where the CPU has instructions for it.
    Bf16,
}

impl Precision {
    /// Makes a network multiply such numbers; says so where this CPU cannot.
    pub fn apply(self, model: Model) -> (Model, Option<Notice>) {
        if self == Self::F32 {
            return (model, None);
        }
        match model.with_bf16_products() {
            Some(model) => (model, None),
            None => {
                let reason =
                    "this CPU has no products in bfloat16: --precision f32 is used, which is more exact";
                (model, Some(Notice::Warning(reason.to_owned())))
            }
        }
    }

    /// The precision of a network's products.
    pub(super) fn of(model: &Model) -> Self {
        if model.has_bf16_products() { Self::Bf16 } else { Self::F32 }
    }

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
}

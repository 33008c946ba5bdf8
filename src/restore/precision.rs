//! Makes a network compute in another precision, where it can.

use super::Notice;
use crate::network::{Model, Precision};

/// Makes a network compute with such numbers; says so where that cannot be.
pub fn in_precision(model: Model, precision: Precision) -> (Model, Option<Notice>) {
    if precision == Precision::F32 {
        return (model, None);
    }
    match model.with_bf16_products() {
        Some(model) => (model, None),
        None => {
            let reason = format!(
                "{} has no products in bfloat16: --precision f32 is used, which is more exact",
                if model.backend().is_cpu() { "this CPU".to_owned() } else { model.backend().to_string() }
            );
            (model, Some(Notice::Warning(reason)))
        }
    }
}

/// The precision that a network computes in.
pub(super) fn precision_of(model: &Model) -> Precision {
    if model.has_bf16_products() { Precision::Bf16 } else { Precision::F32 }
}

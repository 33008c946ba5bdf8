//! The flag that says how a network multiplies, shared by the commands that run one.

use std::path::Path;

use clap::ValueEnum;

use udc::core::error::Result;
use udc::network::Model;

use super::Session;

/// What the numbers are that a network multiplies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum PrecisionArg {
    /// 32-bit floats
    #[default]
    F32,
    /// Rounded to bfloat16 and added up in 32 bits: faster where the CPU has instructions for it (AVX-512 BF16), and off
    /// by up to 0.3 % of white; elsewhere as f32
    Bf16,
}

impl PrecisionArg {
    /// Reads a model that multiplies such numbers.
    pub(crate) fn load(self, path: &Path, session: &Session) -> Result<Model> {
        Ok(self.apply(Model::load(path)?, session))
    }

    /// Makes a network multiply such numbers; says so where this CPU cannot.
    pub(crate) fn apply(self, model: Model, session: &Session) -> Model {
        if self == Self::F32 {
            return model;
        }
        model.with_bf16_products().unwrap_or_else(|| {
            session
                .warn("this CPU has no products in bfloat16: --precision f32 is used, which is more exact");
            model
        })
    }

    /// The name of a table's row, where it is not the usual precision's.
    pub(crate) fn name_of(self, name: &str) -> String {
        match self {
            Self::F32 => name.to_owned(),
            Self::Bf16 => format!("{name}, bf16"),
        }
    }
}

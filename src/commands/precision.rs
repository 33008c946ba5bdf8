//! The flag that says how a network multiplies, shared by the commands that run one.

use clap::ValueEnum;

use udc::network::Model;
use udc::restore::Precision;

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
    /// Makes a network multiply such numbers; says so where this CPU cannot.
    pub(crate) fn apply(self, model: Model, session: &Session) -> Model {
        let (model, notice) = Precision::from(self).apply(model);
        notice.iter().for_each(|notice| session.notice(notice));
        model
    }

    /// The name of a table's row, where it is not the usual precision's.
    pub(crate) fn name_of(self, name: &str) -> String {
        match self {
            Self::F32 => name.to_owned(),
            Self::Bf16 => format!("{name}, bf16"),
        }
    }
}

impl From<PrecisionArg> for Precision {
    fn from(precision: PrecisionArg) -> Self {
        match precision {
            PrecisionArg::F32 => Self::F32,
            PrecisionArg::Bf16 => Self::Bf16,
        }
    }
}

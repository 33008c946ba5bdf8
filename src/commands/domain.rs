//! `--domain`: what the values of images are.

use clap::ValueEnum;

use udc::core::io::DomainTag;

/// What the values of an image are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum DomainArg {
    Linear,
    ToneMapped,
}

impl DomainArg {
    /// The name that files and flags have for it.
    pub(super) fn name(self) -> &'static str {
        DomainTag::from(self).name()
    }
}

impl From<DomainArg> for DomainTag {
    fn from(domain: DomainArg) -> Self {
        match domain {
            DomainArg::Linear => Self::Linear,
            DomainArg::ToneMapped => Self::ToneMapped,
        }
    }
}

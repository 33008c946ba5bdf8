//! `--domain`: what the values of images are.

use clap::ValueEnum;

use udc::core::io::DomainTag;

/// What the values of an image are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum DomainArg {
    Linear,
    ToneMapped,
}

impl From<DomainArg> for DomainTag {
    fn from(domain: DomainArg) -> Self {
        match domain {
            DomainArg::Linear => Self::Linear,
            DomainArg::ToneMapped => Self::ToneMapped,
        }
    }
}

impl From<DomainTag> for DomainArg {
    fn from(domain: DomainTag) -> Self {
        match domain {
            DomainTag::Linear => Self::Linear,
            DomainTag::ToneMapped => Self::ToneMapped,
        }
    }
}

//! `--domain`: what the values of images are.

use clap::{Args, ValueEnum};

use udc::io::DomainTag;

/// What the values of an image are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum DomainArg {
    /// Proportional to light
    Linear,
    /// After the tone mapping φ, as `udc restore` and `udc tonemap` write it
    ToneMapped,
    /// Encoded by the curve of sRGB, as the pictures of most cameras and programs; decoded to linear light
    Srgb,
}

/// What the values of an image are, in commands that need linear light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum LightDomainArg {
    /// Proportional to light
    Linear,
    /// Encoded by the curve of sRGB, as the pictures of most cameras and programs; decoded to linear light
    Srgb,
}

/// What is written: the domains of light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum OutputDomainArg {
    Linear,
    ToneMapped,
}

/// The flag of commands that need linear light.
#[derive(Args, Debug)]
pub(super) struct SceneDomainArgs {
    /// What the images hold: srgb is decoded to linear light; pictures of integers must be told [default: what the file
    /// says, else linear]
    ///
    /// Tone-mapped images become linear by `udc tonemap --inverse`.
    #[arg(long, value_enum, value_name = "DOMAIN")]
    pub(super) domain: Option<LightDomainArg>,
}

impl SceneDomainArgs {
    pub(super) fn told(&self) -> Option<DomainTag> {
        self.domain.map(DomainTag::from)
    }
}

impl DomainArg {
    /// The name that files and flags have for it.
    pub(super) fn name(self) -> &'static str {
        DomainTag::from(self).name()
    }
}

impl LightDomainArg {
    /// The name that files and flags have for it.
    pub(super) fn name(self) -> &'static str {
        DomainTag::from(self).name()
    }
}

impl OutputDomainArg {
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
            DomainArg::Srgb => Self::Srgb,
        }
    }
}

impl From<LightDomainArg> for DomainTag {
    fn from(domain: LightDomainArg) -> Self {
        match domain {
            LightDomainArg::Linear => Self::Linear,
            LightDomainArg::Srgb => Self::Srgb,
        }
    }
}

impl From<OutputDomainArg> for DomainTag {
    fn from(domain: OutputDomainArg) -> Self {
        match domain {
            OutputDomainArg::Linear => Self::Linear,
            OutputDomainArg::ToneMapped => Self::ToneMapped,
        }
    }
}

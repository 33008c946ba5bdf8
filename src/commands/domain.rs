//! `--domain` of commands that need linear light.

use clap::Args;

use udc::io::DomainTag;

use super::choices::LIGHT_DOMAINS;

/// What the values of images are.
#[derive(Args, Debug)]
pub(super) struct SceneDomainArgs {
    /// What the images hold: srgb is decoded to linear light; required for 8- and 16-bit files that do not say it
    /// [default: what the file says, else linear]
    ///
    /// Tone-mapped images become linear by `udc tonemap --inverse`.
    #[arg(long, value_name = "DOMAIN", value_parser = LIGHT_DOMAINS)]
    pub(super) domain: Option<DomainTag>,
}

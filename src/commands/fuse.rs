//! `udc fuse`.

use anyhow::Result;
use clap::Args;

use super::Session;

/// Fuse a bracket of exposures to one linear HDR image or PSF
#[derive(Args, Debug)]
pub(crate) struct FuseArgs {}

impl FuseArgs {
    pub(crate) fn run(self, _session: &Session) -> Result<()> {
        todo!()
    }
}

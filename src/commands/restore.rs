//! `udc restore`.

use anyhow::Result;
use clap::Args;

use super::Session;

/// Restore degraded images
#[derive(Args, Debug)]
pub(crate) struct RestoreArgs {}

impl RestoreArgs {
    pub(crate) fn run(self, _session: &Session) -> Result<()> {
        todo!()
    }
}

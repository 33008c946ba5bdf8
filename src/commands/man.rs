//! `udc man`.

use anyhow::Result;
use clap::Args;

use super::Session;

/// Print the manual page
#[derive(Args, Debug)]
pub(crate) struct ManArgs {}

impl ManArgs {
    pub(crate) fn run(self, _session: &Session) -> Result<()> {
        todo!()
    }
}

//! `udc report`.

use anyhow::Result;
use clap::Args;

use super::Session;

/// Gather results in one self-contained page
#[derive(Args, Debug)]
pub(crate) struct ReportArgs {}

impl ReportArgs {
    pub(crate) fn run(self, _session: &Session) -> Result<()> {
        todo!()
    }
}

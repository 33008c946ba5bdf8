//! `udc convert`.

use anyhow::Result;
use clap::Args;

use super::Session;

/// Convert a file to another format
#[derive(Args, Debug)]
pub(crate) struct ConvertArgs {}

impl ConvertArgs {
    pub(crate) fn run(self, _session: &Session) -> Result<()> {
        todo!()
    }
}

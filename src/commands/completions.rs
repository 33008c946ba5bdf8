//! `udc completions`.

use anyhow::Result;
use clap::Args;

use super::Session;

/// Print shell completions
#[derive(Args, Debug)]
pub(crate) struct CompletionsArgs {}

impl CompletionsArgs {
    pub(crate) fn run(self, _session: &Session) -> Result<()> {
        todo!()
    }
}

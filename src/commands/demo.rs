//! `udc demo`.

use anyhow::Result;
use clap::Args;

use super::Session;

/// Run the whole pipeline on built-in scenes and write a page of results
#[derive(Args, Debug)]
pub(crate) struct DemoArgs {}

impl DemoArgs {
    pub(crate) fn run(self, _session: &Session) -> Result<()> {
        todo!()
    }
}

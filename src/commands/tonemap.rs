//! `udc tonemap`.

use anyhow::Result;
use clap::Args;

use super::Session;

/// Apply the tone mapping or its inverse
#[derive(Args, Debug)]
pub(crate) struct TonemapArgs {}

impl TonemapArgs {
    pub(crate) fn run(self, _session: &Session) -> Result<()> {
        todo!()
    }
}

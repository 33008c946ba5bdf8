//! `udc synth`.

use anyhow::Result;
use clap::Args;

use super::Session;

/// Synthesise degraded images of clean scenes by the image formation model
#[derive(Args, Debug)]
pub(crate) struct SynthArgs {}

impl SynthArgs {
    pub(crate) fn run(self, _session: &Session) -> Result<()> {
        todo!()
    }
}

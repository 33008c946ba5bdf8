//! `udc eval`.

use anyhow::Result;
use clap::Args;

use super::Session;

/// Measure restored images against ground truth
#[derive(Args, Debug)]
pub(crate) struct EvalArgs {}

impl EvalArgs {
    pub(crate) fn run(self, _session: &Session) -> Result<()> {
        todo!()
    }
}

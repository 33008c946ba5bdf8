//! `udc train`.

use anyhow::Result;
use clap::Args;

use super::Session;

/// Train a restoration network
#[derive(Args, Debug)]
pub(crate) struct TrainArgs {}

impl TrainArgs {
    pub(crate) fn run(self, _session: &Session) -> Result<()> {
        todo!()
    }
}

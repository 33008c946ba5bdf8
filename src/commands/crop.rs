//! `udc crop`.

use anyhow::Result;
use clap::Args;

use super::Session;

/// Cut perspective views out of HDR panoramas
#[derive(Args, Debug)]
pub(crate) struct CropArgs {}

impl CropArgs {
    pub(crate) fn run(self, _session: &Session) -> Result<()> {
        todo!()
    }
}

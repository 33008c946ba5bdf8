//! `udc info`.

use anyhow::Result;
use clap::Args;

use super::Session;

/// Describe a file: image, PSF, kernel bank, model, dataset
#[derive(Args, Debug)]
pub(crate) struct InfoArgs {}

impl InfoArgs {
    pub(crate) fn run(self, _session: &Session) -> Result<()> {
        todo!()
    }
}

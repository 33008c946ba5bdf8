//! `udc codes`.

use anyhow::Result;
use clap::Args;

use super::Session;

/// Make kernel codes: rotate a PSF, find its PCA basis, store both as a kernel bank
#[derive(Args, Debug)]
pub(crate) struct CodesArgs {}

impl CodesArgs {
    pub(crate) fn run(self, _session: &Session) -> Result<()> {
        todo!()
    }
}

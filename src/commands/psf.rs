//! `udc psf`.

use anyhow::Result;
use clap::Args;

use super::Session;

/// Simulate a PSF from a display layout by light propagation
#[derive(Args, Debug)]
pub(crate) struct PsfArgs {}

impl PsfArgs {
    pub(crate) fn run(self, _session: &Session) -> Result<()> {
        todo!()
    }
}

//! `udc completions`.

use std::io::Write;

use anyhow::Result;
use clap::{Args, CommandFactory};
use clap_complete::Shell;

use super::{Cli, Session};

/// Print shell completions
#[derive(Args, Debug)]
#[command(after_help = "Example: udc completions bash > ~/.local/share/bash-completion/completions/udc")]
pub(crate) struct CompletionsArgs {
    /// Shell to complete for
    #[arg(value_enum)]
    shell: Shell,
}

impl CompletionsArgs {
    pub(crate) fn run(self, _session: &Session) -> Result<()> {
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut Cli::command(), "udc", &mut script);
        std::io::stdout().lock().write_all(&script)?;
        Ok(())
    }
}

//! `udc man`.

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use clap::{Args, Command};
use clap_mangen::Man;

use super::{Session, definition};
use udc::io::write_atomically;

/// Print the manual page
#[derive(Args, Debug)]
#[command(after_help = "Example: udc man fuse | man -l -\n         udc man -o ~/.local/share/man/man1")]
pub(crate) struct ManArgs {
    /// Subcommand to describe instead of the whole program
    #[arg(value_name = "COMMAND")]
    command: Option<String>,
    /// Write the pages of the program and of all subcommands to this folder
    #[arg(short, long, value_name = "DIR", conflicts_with = "command")]
    output: Option<PathBuf>,
}

impl ManArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let mut program = definition().disable_help_subcommand(true);
        // Building hands the global flags and the version down to the subcommands.
        program.build();
        if let Some(folder) = &self.output {
            std::fs::create_dir_all(folder)
                .with_context(|| format!("creating the folder {}", folder.display()))?;
            for command in std::iter::once(&program).chain(program.get_subcommands()) {
                let page = page_of(command)?;
                let file = folder.join(format!("{}.1", page_name(command)));
                write_atomically(&file, session.overwrite, |writer| writer.write_all(&page))?;
            }
            return session.say(folder.display());
        }
        let command = match &self.command {
            None => &program,
            Some(name) => match program.find_subcommand(name) {
                Some(command) => command,
                None => bail!("there is no command `{name}`; `udc --help` lists them"),
            },
        };
        std::io::stdout().lock().write_all(&page_of(command)?)?;
        Ok(())
    }
}

fn page_name(command: &Command) -> String {
    command.get_display_name().unwrap_or(command.get_name()).to_owned()
}

fn page_of(command: &Command) -> Result<Vec<u8>> {
    let mut page = Vec::new();
    let name = page_name(command);
    Man::new(command.clone()).title(name).render(&mut page)?;
    Ok(with_examples(&String::from_utf8(page)?).into_bytes())
}

/// Names the section of examples, and keeps their lines as they are.
fn with_examples(page: &str) -> String {
    const SECTION: &str = ".SH EXTRA\n";
    let Some((before, rest)) = page.split_once(SECTION) else { return page.to_owned() };
    let end = rest.find("\n.SH ").map_or(rest.len(), |at| at + 1);
    let (examples, after) = rest.split_at(end);
    format!("{before}.SH EXAMPLES\n.nf\n.nh\n{}\n.fi\n{after}", examples.trim_end())
}

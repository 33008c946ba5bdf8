//! Parses the command line, runs one command, reports its error and sets the exit code.

mod commands;

use std::process::ExitCode;

use clap::Parser;

#[expect(clippy::print_stderr, reason = "errors are reported here and nowhere else")]
fn main() -> ExitCode {
    let cli = commands::Cli::parse();
    match cli.run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if commands::is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) if error.is::<clap::Error>() => {
            eprintln!("{error}");
            ExitCode::from(2)
        }
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

//! Parses the command line, runs one command, reports its error and sets the exit code.

mod commands;

use std::process::ExitCode;

#[cfg(target_os = "linux")]
#[global_allocator]
static ALLOCATOR: udc::kernels::LargePages = udc::kernels::LargePages;

fn main() -> ExitCode {
    let cli = commands::Cli::from_arguments();
    match cli.run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if commands::is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            match error.is::<clap::Error>() {
                true => commands::print_error(format_args!("{error}")),
                false => commands::print_error(format_args!("error: {error:#}")),
            }
            ExitCode::from(commands::exit_code(&error))
        }
    }
}

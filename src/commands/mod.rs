//! The command line: global flags, one file per subcommand, and what all of them share.

mod bars;
mod bench;
mod bracket;
mod browser;
mod choices;
mod codes;
mod completions;
mod convert;
mod crop;
mod demo;
mod domain;
mod eval;
mod examples;
mod finish;
mod fuse;
mod info;
mod man;
mod metrics;
mod pose;
mod psf;
mod psf_file;
mod report;
mod restore;
mod scenes;
mod sweep;
mod synth;
mod tonemap;
mod train;
mod view;

use std::fmt::Display;
use std::io::{IsTerminal, Write as _};
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};
use std::time::Instant;

use anyhow::{Context as _, Result};
use clap::error::ErrorKind;
use clap::{ArgAction, Args, CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use udc::batch::{Watcher, timed};
use udc::core::progress::Progress;
use udc::kernels::Isa;

use choices::Choices;
use udc::restore::Notice;

use self::bars::StderrBars;

/// Under-display camera imaging: from a measured panel to a restored photograph
#[derive(Parser, Debug)]
#[command(name = "udc", version, propagate_version = true, max_term_width = 100)]
#[command(
    after_help = "Start with `udc demo`: the whole pipeline on built-in scenes, ending in a page of results"
)]
pub(crate) struct Cli {
    #[command(flatten)]
    global: GlobalArgs,
    #[command(subcommand)]
    command: Command,
}

/// The heading of the flags of every command.
const GLOBAL: &str = "Options of every command";

#[derive(Args, Debug)]
struct GlobalArgs {
    /// Say less: errors only
    #[arg(short, long, global = true, help_heading = GLOBAL, conflicts_with = "verbose")]
    quiet: bool,
    /// Say more: the time of each step, and the peak memory
    #[arg(short, long, global = true, help_heading = GLOBAL, action = ArgAction::Count)]
    verbose: u8,
    /// Number of threads (default: all cores)
    #[arg(long, global = true, help_heading = GLOBAL, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    threads: Option<u16>,
    /// When to draw progress bars on stderr
    #[arg(long, global = true, help_heading = GLOBAL, value_parser = PROGRESS, default_value = "auto", value_name = "WHEN")]
    progress: ProgressMode,
    /// Replace existing outputs
    #[arg(long, global = true, help_heading = GLOBAL)]
    overwrite: bool,
}

#[derive(Clone, Copy, Debug)]
enum ProgressMode {
    Auto,
    Always,
    Never,
}

const PROGRESS: Choices<ProgressMode> = Choices(&[
    ("auto", ProgressMode::Auto, "Where stderr is a terminal"),
    ("always", ProgressMode::Always, ""),
    ("never", ProgressMode::Never, ""),
]);

#[derive(Subcommand, Debug)]
enum Command {
    Demo(demo::DemoArgs),
    Fuse(fuse::FuseArgs),
    Psf(psf::PsfArgs),
    Codes(codes::CodesArgs),
    Crop(crop::CropArgs),
    Scenes(scenes::ScenesArgs),
    Synth(synth::SynthArgs),
    Examples(examples::ExamplesArgs),
    Tonemap(tonemap::TonemapArgs),
    Train(train::TrainArgs),
    Sweep(sweep::SweepArgs),
    Pose(pose::PoseArgs),
    Restore(restore::RestoreArgs),
    Eval(eval::EvalArgs),
    Finish(finish::FinishArgs),
    Report(report::ReportArgs),
    View(view::ViewArgs),
    Bench(bench::BenchArgs),
    Info(info::InfoArgs),
    Convert(convert::ConvertArgs),
    Completions(completions::CompletionsArgs),
    Man(man::ManArgs),
}

/// What every command needs to know beside its own flags.
pub(crate) struct Session {
    /// 0 quiet, 1 normal, 2 and more verbose.
    verbosity: u8,
    /// Where stages report, and the flag that Ctrl-C sets.
    pub(crate) progress: Progress,
    /// Whether existing outputs may be replaced.
    pub(crate) overwrite: bool,
    /// Why stdout took no more of what [`Session::tell`] told.
    unheard: OnceLock<std::io::Error>,
}

impl Session {
    /// Tells the user a result on stdout, unless `--quiet`: one that is nothing but this text.
    ///
    /// # Errors
    /// When stdout is closed, which ends the program quietly, or takes no more.
    pub(crate) fn say(&self, text: impl Display) -> Result<()> {
        if self.verbosity > 0 {
            writeln!(std::io::stdout().lock(), "{text}").context(WRITING_TO_STDOUT)?;
        }
        Ok(())
    }

    /// Tells the user on stdout, unless `--quiet`, of work whose results are files.
    ///
    /// A stdout that takes no more stops the telling and not the work; the run reports it at its end.
    pub(crate) fn tell(&self, text: impl Display) {
        if self.verbosity > 0
            && self.unheard.get().is_none()
            && let Err(error) = writeln!(std::io::stdout().lock(), "{text}")
        {
            // Whichever thread is first says why.
            let _ = self.unheard.set(error);
        }
    }

    /// Warns on stderr, unless `--quiet`.
    pub(crate) fn warn(&self, text: impl Display) {
        self.note(format_args!("warning: {text}"));
    }

    /// Tells on stderr what the user should know beforehand, unless `--quiet`.
    pub(crate) fn note(&self, text: impl Display) {
        if self.verbosity > 0 {
            print_error(text);
        }
    }

    /// Tells details on stderr with `--verbose`.
    pub(crate) fn detail(&self, text: impl Display) {
        if self.verbosity > 1 {
            print_error(text);
        }
    }

    /// Tells on stderr what a stage has to tell, by how much it matters.
    pub(crate) fn notice(&self, notice: &Notice) {
        match notice {
            Notice::Detail(text) => self.detail(text),
            Notice::Note(text) => self.note(text),
            Notice::Warning(text) => self.warn(text),
        }
    }

    /// Does a step of the work, and tells with `--verbose` how long it took.
    pub(crate) fn timed<T, E>(
        &self,
        doing: impl Display,
        step: impl FnOnce() -> Result<T, E>,
    ) -> Result<T, E> {
        timed(self, doing, step)
    }
}

impl Watcher for Session {
    fn progress(&self) -> &Progress {
        &self.progress
    }

    fn tell(&self, text: &dyn Display) {
        self.tell(text);
    }

    fn warn(&self, text: &dyn Display) {
        self.warn(text);
    }

    fn note(&self, text: &dyn Display) {
        self.note(text);
    }

    fn detail(&self, text: &dyn Display) {
        self.detail(text);
    }
}

/// Columns that examples are written in.
const EXAMPLE_WIDTH: usize = 78;

/// The command line's definition, examples that are too long for a terminal broken as a shell reads them.
pub(crate) fn definition() -> clap::Command {
    Cli::command().mut_subcommands(|command| match command.get_after_help().map(ToString::to_string) {
        Some(help) => command.after_help(help.lines().map(break_example).collect::<Vec<_>>().join("\n")),
        None => command,
    })
}

/// Breaks a line that begins with a call of the program at its flags, with a backslash before each break.
fn break_example(line: &str) -> String {
    let trimmed = line.trim_start();
    if line.len() <= EXAMPLE_WIDTH || !(trimmed.starts_with("udc ") || trimmed.starts_with("Example: udc ")) {
        return line.to_owned();
    }
    let indent = " ".repeat(line.len() - trimmed.len() + 4);
    let mut lines = vec![line[..line.len() - trimmed.len()].to_owned()];
    // A flag stays with its values.
    for part in trimmed.replace(" -", "\n-").lines() {
        let last = lines.last_mut().expect("there is a first line");
        if !last.trim().is_empty() && last.len() + part.len() + 3 > EXAMPLE_WIDTH {
            lines.push(format!("{indent}{part}"));
        } else {
            if !last.trim().is_empty() {
                last.push(' ');
            }
            last.push_str(part);
        }
    }
    lines.join(" \\\n")
}

impl Cli {
    /// Reads the command line; ends the process where it asks for help or is wrong.
    pub(crate) fn from_arguments() -> Self {
        Self::from_arg_matches(&definition().get_matches()).unwrap_or_else(|error| error.exit())
    }

    /// Runs the command that was asked for.
    ///
    /// # Errors
    /// Whatever the command failed of, with what was being done.
    pub(crate) fn run(self) -> Result<()> {
        let session = self.global.start()?;
        let start = Instant::now();
        self.command.run(&session)?;
        let memory =
            peak_memory_bytes().map_or(String::new(), |bytes| format!(", peak memory {}", mebibytes(bytes)));
        session.detail(format_args!("finished in {:.2} s{memory}", start.elapsed().as_secs_f64()));
        session.unheard.into_inner().map_or(Ok(()), |error| Err(error).context(WRITING_TO_STDOUT))
    }
}

impl Command {
    fn run(self, session: &Session) -> Result<()> {
        match self {
            Self::Demo(args) => args.run(session),
            Self::Fuse(args) => args.run(session),
            Self::Psf(args) => args.run(session),
            Self::Codes(args) => args.run(session),
            Self::Crop(args) => args.run(session),
            Self::Scenes(args) => args.run(session),
            Self::Synth(args) => args.run(session),
            Self::Examples(args) => args.run(session),
            Self::Tonemap(args) => args.run(session),
            Self::Train(args) => args.run(session),
            Self::Sweep(args) => args.run(session),
            Self::Pose(args) => args.run(session),
            Self::Restore(args) => args.run(session),
            Self::Eval(args) => args.run(session),
            Self::Finish(args) => args.run(session),
            Self::Report(args) => args.run(session),
            Self::View(args) => args.run(session),
            Self::Bench(args) => args.run(session),
            Self::Info(args) => args.run(session),
            Self::Convert(args) => args.run(session),
            Self::Completions(args) => args.run(session),
            Self::Man(args) => args.run(session),
        }
    }
}

impl GlobalArgs {
    fn start(&self) -> Result<Session> {
        // Whatever the command: results must not come from another instruction set than was asked for.
        Isa::forced().map_err(|reason| Cli::command().error(ErrorKind::InvalidValue, reason))?;
        udc::kernels::share_freed_memory();
        let threads = self.threads.map_or(0, usize::from);
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build_global()
            .context("starting the thread pool")?;
        let interrupted = Arc::new(AtomicBool::new(false));
        for signal in [SIGINT, SIGTERM] {
            // The first one asks to stop, and the second one ends the process.
            flag::register_conditional_shutdown(signal, 128 + signal, Arc::clone(&interrupted))
                .and_then(|_| flag::register(signal, Arc::clone(&interrupted)))
                .context("installing the handler of Ctrl-C")?;
        }
        // A file that grows past the limit of the shell is then an error to report, and does not end the process.
        #[cfg(unix)]
        flag::register(signal_hook::consts::SIGXFSZ, Arc::default())
            .context("installing the handler of file size limits")?;
        let visible = match self.progress {
            ProgressMode::Auto => !self.quiet && std::io::stderr().is_terminal(),
            ProgressMode::Always => true,
            ProgressMode::Never => false,
        };
        let reporter = visible.then(|| Arc::new(StderrBars) as _);
        Ok(Session {
            verbosity: if self.quiet { 0 } else { 1 + self.verbose },
            progress: Progress::new(reporter, interrupted),
            overwrite: self.overwrite,
            unheard: OnceLock::new(),
        })
    }
}

/// What is being done when stdout takes no more.
const WRITING_TO_STDOUT: &str = "writing to stdout";

/// Prints a line on stderr, if anybody reads it.
pub(crate) fn print_error(text: impl Display) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// The text of a path, whatever its bytes, for provenance and messages.
fn text_of(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}

/// The error of flags that contradict each other where clap cannot see it, with the usage of `subcommand`.
fn misuse(subcommand: &str, reason: &str) -> anyhow::Error {
    let mut cli = Cli::command();
    cli.build();
    let command = cli.find_subcommand_mut(subcommand).expect("named by the subcommand itself");
    command.error(ErrorKind::ArgumentConflict, reason).into()
}

/// Whether the reader of our output went away, which is no failure.
pub(crate) fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        cause.downcast_ref::<std::io::Error>().is_some_and(|io| io.kind() == std::io::ErrorKind::BrokenPipe)
    })
}

/// The most memory that this process has held at once, where the system tells.
fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kibibytes: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kibibytes * 1024)
}

fn mebibytes(bytes: u64) -> String {
    format!("{} MiB", bytes / (1 << 20))
}

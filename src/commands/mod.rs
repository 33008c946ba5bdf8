//! The command line: global flags, one file per subcommand, and what all of them share.

mod bench;
mod bracket;
mod browser;
mod choices;
mod codes;
mod completions;
mod convert;
mod crop;
mod demo;
mod device;
mod doctor;
mod domain;
mod dry_run;
mod eval;
mod events;
mod examples;
mod finish;
mod fuse;
mod info;
mod layer;
mod live;
mod man;
mod metrics;
mod plan;
mod pose;
mod psf;
mod psf_file;
mod report;
mod restore;
mod scenes;
mod session;
mod sweep;
mod synth;
mod tonemap;
mod train;
mod view;

use std::fmt::Display;
use std::io::{IsTerminal, Write as _};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use clap::error::ErrorKind;
use clap::{ArgAction, ArgMatches, Args, CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
use serde_json::{Map, Value};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use udc::core::event::{Event, SCHEMA};
use udc::io::peak_memory_bytes;
use udc::kernels::Isa;

use choices::Choices;

use events::{EndOfEvents, Events};
use live::{Live, View};
use session::Session;

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
    /// The subcommand's name, and the values of its flags.
    #[arg(skip)]
    called: (String, Map<String, Value>),
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
    /// When to show on stderr how far work is, how fast it goes and how long the rest takes
    #[arg(long, global = true, help_heading = GLOBAL, value_parser = PROGRESS, default_value = "auto", value_name = "WHEN")]
    progress: ProgressMode,
    /// Write events to stdout, one JSON object a line, and what people read to stderr; `info`, `doctor` and `plan` write what they
    /// find
    ///
    /// Events are `started`, `configured`, `stage`, `progress`, `item` (a file was written), `found`, `warning`, and in the end
    /// `finished`, `interrupted` or `failed`. The library's documentation of udc::core::event lists their keys.
    #[arg(long, global = true, help_heading = GLOBAL)]
    json: bool,
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
    (
        "auto",
        ProgressMode::Auto,
        "As bars where stderr is a terminal, else as lines of work that takes longer than ten seconds",
    ),
    ("always", ProgressMode::Always, "As bars where stderr is a terminal, else as lines from the beginning"),
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
    Plan(plan::PlanArgs),
    Pose(pose::PoseArgs),
    Restore(restore::RestoreArgs),
    Eval(eval::EvalArgs),
    Finish(finish::FinishArgs),
    Report(report::ReportArgs),
    View(view::ViewArgs),
    Bench(bench::BenchArgs),
    Info(info::InfoArgs),
    Doctor(doctor::DoctorArgs),
    Convert(convert::ConvertArgs),
    Completions(completions::CompletionsArgs),
    Man(man::ManArgs),
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
        let mut definition = definition();
        let matches = definition.try_get_matches_from_mut(std::env::args_os());
        let parsed = matches.and_then(|matches| Ok((Self::from_arg_matches(&matches)?, matches)));
        let (mut cli, matches) = parsed.unwrap_or_else(|error| {
            events::tell_of_misuse(&error);
            error.exit()
        });
        cli.called = called(&definition, &matches);
        cli
    }

    /// Runs the command that was asked for.
    ///
    /// # Errors
    /// Whatever the command failed of, with what was being done.
    pub(crate) fn run(self) -> Result<()> {
        if let (true, name @ ("completions" | "man")) = (self.global.json, self.called.0.as_str()) {
            return Err(misuse(name, "--json is for commands that work on files: leave it out"));
        }
        let (name, flags) = &self.called;
        // What a dry run says is one JSON object.
        let is_dry = flags.get("dry-run").is_some_and(|value| *value == Value::Bool(true));
        let tells_events = self.global.json && !is_dry && !WITHOUT_EVENTS.contains(&name.as_str());
        let events = tells_events.then(|| Arc::new(Events::new()));
        let _end = events.clone().map(EndOfEvents);
        let outcome = self.run_told(events.as_ref());
        let Some(events) = events else { return outcome.map(|_| ()) };
        events.end(&outcome);
        outcome?;
        events.unheard().map_or(Ok(()), |error| Err(error).context(WRITING_TO_STDOUT))
    }

    /// Runs the command, and returns what is told of its results.
    fn run_told(self, events: Option<&Arc<Events>>) -> Result<Map<String, Value>> {
        let session = self.global.start(events)?;
        if let Some(events) = events {
            let (command, configuration) = self.called;
            events.tell(Event::Started {
                command: &command,
                version: env!("CARGO_PKG_VERSION"),
                schema: SCHEMA,
                threads: rayon::current_num_threads(),
                instruction_set: Isa::current().name(),
                configuration,
            });
        }
        let start = Instant::now();
        self.command.run(&session)?;
        let memory =
            peak_memory_bytes().map_or(String::new(), |bytes| format!(", peak memory {}", mebibytes(bytes)));
        session.detail(format_args!("finished in {:.2} s{memory}", start.elapsed().as_secs_f64()));
        session.end()
    }
}

/// Commands that tell no events with `--json`: what they find is JSON itself, or they write a text for other programs.
const WITHOUT_EVENTS: [&str; 5] = ["info", "doctor", "plan", "completions", "man"];

/// The name of the subcommand, and the values of its flags.
fn called(definition: &clap::Command, matches: &ArgMatches) -> (String, Map<String, Value>) {
    let Some((name, matches)) = matches.subcommand() else { return Default::default() };
    let command = definition.find_subcommand(name).expect("clap found it");
    (name.to_owned(), events::configuration(command, matches))
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
            Self::Plan(args) => args.run(session),
            Self::Pose(args) => args.run(session),
            Self::Restore(args) => args.run(session),
            Self::Eval(args) => args.run(session),
            Self::Finish(args) => args.run(session),
            Self::Report(args) => args.run(session),
            Self::View(args) => args.run(session),
            Self::Bench(args) => args.run(session),
            Self::Info(args) => args.run(session),
            Self::Doctor(args) => args.run(session),
            Self::Convert(args) => args.run(session),
            Self::Completions(args) => args.run(session),
            Self::Man(args) => args.run(session),
        }
    }
}

impl GlobalArgs {
    fn start(&self, events: Option<&Arc<Events>>) -> Result<Session> {
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
        let live = Arc::new(Live::new(&self.view(), events.cloned()));
        if let Some(events) = events.cloned() {
            let live = Arc::clone(&live);
            udc::io::tell_of_files(move |path| live.beside(|| events.tell_of_file(path)));
        }
        let verbosity = if self.quiet { 0 } else { 1 + self.verbose };
        Ok(Session::new(verbosity, self.overwrite, self.json, (live, interrupted), events.cloned()))
    }

    /// Where people see how far work is.
    fn view(&self) -> View {
        let is_dumb = std::env::var_os("TERM").is_some_and(|terminal| terminal == "dumb");
        let is_terminal = std::io::stderr().is_terminal() && !is_dumb;
        // Lines of events on the same terminal tell it already.
        let is_told = self.json && std::io::stdout().is_terminal();
        match self.progress {
            ProgressMode::Never => View::None,
            ProgressMode::Auto if self.quiet || is_told => View::None,
            ProgressMode::Always | ProgressMode::Auto if is_terminal => View::Terminal,
            ProgressMode::Auto => View::Log(LOG_DELAY),
            ProgressMode::Always => View::Log(Duration::ZERO),
        }
    }
}

/// What is done sooner is not told of in a log, unless it is asked for.
const LOG_DELAY: Duration = Duration::from_secs(10);

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

/// The exit code of what was misunderstood, and of what failed.
const MISUSE: u8 = 2;
const FAILURE: u8 = 1;

/// The exit code that an error ends the process with.
pub(crate) fn exit_code(error: &anyhow::Error) -> u8 {
    if error.is::<clap::Error>() { MISUSE } else { FAILURE }
}

/// Whether the reader of our output went away, which is no failure.
pub(crate) fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        cause.downcast_ref::<std::io::Error>().is_some_and(|io| io.kind() == std::io::ErrorKind::BrokenPipe)
    })
}

fn mebibytes(bytes: u64) -> String {
    format!("{} MiB", bytes / (1 << 20))
}

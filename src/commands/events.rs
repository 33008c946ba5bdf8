//! Writes events to stdout, line by line, for scripts.

use std::io::{self, Write as _};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use anyhow::Result;
use clap::{ArgAction, ArgMatches};
use serde_json::{Map, Value};

use udc::core::error::Error;
use udc::core::event::{Event, Line};

/// The events of a run, as they are written to stdout.
#[derive(Debug)]
pub(crate) struct Events {
    begun: Instant,
    items: AtomicU64,
    warnings: AtomicU64,
    has_ended: AtomicBool,
    /// Why stdout took no more.
    unheard: Mutex<Option<io::Error>>,
}

impl Events {
    pub(crate) fn new() -> Self {
        Self {
            begun: Instant::now(),
            items: AtomicU64::new(0),
            warnings: AtomicU64::new(0),
            has_ended: AtomicBool::new(false),
            unheard: Mutex::default(),
        }
    }

    /// Writes an event. A stdout that takes no more stops the telling and not the work; [`unheard`](Self::unheard) says why.
    pub(crate) fn tell(&self, event: Event<'_>) {
        if let Event::Warning { .. } = event {
            self.warnings.fetch_add(1, Ordering::Relaxed);
        }
        let mut unheard = self.unheard.lock().unwrap_or_else(PoisonError::into_inner);
        if unheard.is_some() {
            return;
        }
        // Under the lock, so that lines are in the order of their times.
        let line = Line { event, seconds: self.begun.elapsed().as_secs_f64() }.to_json();
        let mut out = io::stdout().lock();
        if let Err(error) = writeln!(out, "{line}").and_then(|()| out.flush()) {
            *unheard = Some(error);
        }
    }

    /// Tells of a file that was written.
    pub(crate) fn tell_of_file(&self, path: &Path) {
        self.items.fetch_add(1, Ordering::Relaxed);
        self.tell(Event::Item { path });
    }

    /// Why stdout took no more.
    pub(crate) fn unheard(&self) -> Option<io::Error> {
        self.unheard.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    /// Tells how the run ended, and with which code the process will.
    pub(crate) fn end(&self, outcome: &Result<Map<String, Value>>) {
        self.has_ended.store(true, Ordering::Relaxed);
        let items = self.items.load(Ordering::Relaxed);
        match outcome {
            Ok(results) => self.tell(Event::Finished {
                items,
                warnings: self.warnings.load(Ordering::Relaxed),
                peak_memory_bytes: super::peak_memory_bytes(),
                results: results.clone(),
            }),
            Err(error) => {
                let (message, exit_code) = (format!("{error:#}"), super::exit_code(error));
                let message = message.as_str();
                self.tell(if is_interrupt(error) {
                    Event::Interrupted { message, items, exit_code }
                } else {
                    let causes = error.chain().map(ToString::to_string).collect();
                    Event::Failed { message, causes, items, exit_code }
                });
            }
        }
    }
}

/// Tells that a run failed where it ends by a panic.
pub(crate) struct EndOfEvents(pub(crate) Arc<Events>);

impl Drop for EndOfEvents {
    fn drop(&mut self) {
        if !self.0.has_ended.load(Ordering::Relaxed) {
            let message = "the program panicked, as stderr tells; please report it with the command";
            let (causes, items) = (vec![message.to_owned()], self.0.items.load(Ordering::Relaxed));
            self.0.tell(Event::Failed { message, causes, items, exit_code: PANIC });
        }
    }
}

/// The exit code of a process whose main thread panics.
const PANIC: u8 = 101;

/// The end of work that can be gone on with, because the user asked for it.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Stopped(pub(crate) String);

/// Whether the work ended because the user asked for it.
fn is_interrupt(error: &anyhow::Error) -> bool {
    let asked = |cause: &(dyn std::error::Error + 'static)| {
        cause.is::<Stopped>() || matches!(cause.downcast_ref(), Some(Error::Interrupted))
    };
    error.chain().any(asked)
}

/// What decides nothing, and is no part of a configuration.
const ABOUT_TELLING: [&str; 6] = ["help", "version", "json", "progress", "quiet", "verbose"];

/// Every flag and argument of a command with its value, as the command line or a default gives it.
pub(crate) fn configuration(command: &clap::Command, matches: &ArgMatches) -> Map<String, Value> {
    let arguments =
        command.get_arguments().filter(|argument| !ABOUT_TELLING.contains(&argument.get_id().as_str()));
    let named = arguments.filter_map(|argument| {
        let id = argument.get_id().as_str();
        let name = match argument.get_long() {
            Some(long) => long.to_owned(),
            None => argument
                .get_value_names()
                .and_then(|names| names.first())
                .map_or(id, |name| name)
                .to_lowercase(),
        };
        let values: Vec<String> = matches
            .try_get_raw(id)
            .ok()
            .flatten()?
            .map(|value| value.to_string_lossy().into_owned())
            .collect();
        let takes_several = argument.get_num_args().is_some_and(|count| count.max_values() > 1)
            || matches!(argument.get_action(), ArgAction::Append)
            || argument.get_value_delimiter().is_some();
        let value = match argument.get_action() {
            ArgAction::SetTrue => (values.first().map(String::as_str) == Some("true")).into(),
            _ if takes_several => values.into(),
            _ => values.into_iter().next()?.into(),
        };
        Some((name, value))
    });
    named.collect()
}

/// Tells a script of a command line that cannot be understood, where it asks for events.
pub(crate) fn tell_of_misuse(error: &clap::Error) {
    let arguments: Vec<_> = std::env::args_os().skip(1).collect();
    let asks = arguments.iter().take_while(|argument| *argument != "--").any(|argument| argument == "--json");
    let command = arguments.iter().find(|argument| !argument.to_string_lossy().starts_with('-'));
    let tells = command.is_none_or(|command| !super::WITHOUT_EVENTS.iter().any(|name| command == name));
    if asks && tells && error.use_stderr() {
        let error = anyhow::Error::msg(error.render().to_string().trim_end().to_owned());
        let (message, causes) = (format!("{error}"), vec![format!("{error}")]);
        Events::new().tell(Event::Failed { message: &message, causes, items: 0, exit_code: super::MISUSE });
    }
}

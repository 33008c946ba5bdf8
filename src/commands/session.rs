//! What every command is given beside its own flags: whom to tell of its work, and how it is to be stopped.

use std::fmt::Display;
use std::io::Write as _;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use anyhow::{Context as _, Result, bail};
use serde::Serialize;
use serde_json::{Map, Value};

use udc::batch::{Watcher, timed};
use udc::core::event::Event;
use udc::core::progress::{Progress, Reporter};
use udc::dataset::Dataset;
use udc::restore::Notice;

use super::events::Events;
use super::live::Live;
use super::{WRITING_TO_STDOUT, print_error};

/// What every command needs to know beside its own flags.
pub(crate) struct Session {
    /// 0 quiet, 1 normal, 2 and more verbose.
    verbosity: u8,
    /// Where stages report, and the flag that Ctrl-C sets.
    pub(crate) progress: Progress,
    /// Whether existing outputs may be replaced.
    pub(crate) overwrite: bool,
    /// Whether results are for scripts.
    pub(crate) is_json: bool,
    /// Shows how far work is, and makes room for what is printed.
    live: Arc<Live>,
    /// Who is told of the work, where a script asks for it.
    events: Option<Arc<Events>>,
    /// What came out, by its key.
    results: Mutex<Map<String, Value>>,
    /// Why stdout took no more of what [`Session::tell`] told.
    unheard: OnceLock<std::io::Error>,
}

impl Session {
    /// A session that shows its work in `live` and stops when the flag is set.
    pub(super) fn new(
        verbosity: u8,
        overwrite: bool,
        is_json: bool,
        (live, interrupted): (Arc<Live>, Arc<AtomicBool>),
        events: Option<Arc<Events>>,
    ) -> Self {
        let reporter = live.is_seen().then(|| Arc::clone(&live) as Arc<dyn Reporter>);
        Self {
            verbosity,
            progress: Progress::new(reporter, interrupted),
            overwrite,
            is_json,
            live,
            events,
            results: Mutex::default(),
            unheard: OnceLock::new(),
        }
    }

    /// Refuses to keep what is there and to replace it.
    pub(crate) fn check_resume(&self, resume: bool) -> Result<()> {
        if resume && self.overwrite {
            bail!("--resume keeps what --overwrite replaces; pass one of them");
        }
        Ok(())
    }

    /// What came out; an error where stdout took no more of what was told.
    pub(super) fn end(self) -> Result<Map<String, Value>> {
        let results = self.results.into_inner().unwrap_or_else(PoisonError::into_inner);
        match self.unheard.into_inner() {
            None => Ok(results),
            Some(error) => Err(error).context(WRITING_TO_STDOUT),
        }
    }

    /// Keeps a result for scripts, which are told of all in the end.
    pub(crate) fn result(&self, key: &str, value: impl Into<Value>) {
        self.results().insert(key.to_owned(), value.into());
    }

    /// Keeps the entries of an object as results.
    pub(crate) fn results_of(&self, object: Value) {
        if let Value::Object(entries) = object {
            self.results().extend(entries);
        }
    }

    /// Tells scripts what was found out about one of several inputs.
    pub(crate) fn found(&self, of: &str, values: Value) {
        if let (Some(events), Value::Object(values)) = (&self.events, values) {
            self.live.beside(|| events.tell(Event::Found { of, values }));
        }
    }

    /// Tells scripts the configuration that was read.
    pub(crate) fn configured(&self, configuration: &impl Serialize) {
        if let Some(events) = &self.events {
            let configuration = serde_json::to_value(configuration).unwrap_or_default();
            self.live.beside(|| events.tell(Event::Configured { configuration }));
        }
    }

    /// Tells scripts that a part of the work begins, which is shown to people otherwise.
    pub(crate) fn stage(&self, what: &str) {
        if let Some(events) = &self.events {
            self.live.beside(|| events.tell(Event::Stage { what }));
        }
    }

    /// Does work whose results are no results of this session.
    pub(crate) fn within<T>(&self, work: impl FnOnce() -> T) -> T {
        let own = std::mem::take(&mut *self.results());
        let done = work();
        *self.results() = own;
        done
    }

    fn results(&self) -> MutexGuard<'_, Map<String, Value>> {
        self.results.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells the user a result, unless `--quiet`: one that is nothing but this text. It goes to stdout, and to stderr where
    /// scripts read events on stdout.
    ///
    /// # Errors
    /// When stdout is closed, which ends the program quietly, or takes no more.
    pub(crate) fn say(&self, text: impl Display) -> Result<()> {
        if self.events.is_some() {
            self.note(text);
        } else if self.verbosity > 0 {
            let write = || writeln!(std::io::stdout().lock(), "{text}");
            self.live.beside(write).context(WRITING_TO_STDOUT)?;
        }
        Ok(())
    }

    /// Tells the user, unless `--quiet`, of work whose results are files; as [`say`](Self::say) does.
    ///
    /// A stdout that takes no more stops the telling and not the work; the run reports it at its end.
    pub(crate) fn tell(&self, text: impl Display) {
        if self.events.is_some() {
            return self.note(text);
        }
        let write = || writeln!(std::io::stdout().lock(), "{text}");
        if self.verbosity > 0
            && self.unheard.get().is_none()
            && let Err(error) = self.live.beside(write)
        {
            // Whichever thread is first says why.
            let _ = self.unheard.set(error);
        }
    }

    /// Warns of a dataset whose synthesis did not come to its end, and of images that are left out.
    pub(crate) fn warn_of_unfinished(&self, dataset: &Dataset) -> Result<()> {
        if let Some(what) = dataset.unfinished()? {
            self.warn(format_args!("{what}; finish it with the flags of its `udc synth` and --resume"));
        }
        dataset.left_out()?.iter().for_each(|left| self.warn(left));
        Ok(())
    }

    /// Warns on stderr, unless `--quiet`, and tells scripts.
    pub(crate) fn warn(&self, text: impl Display) {
        if let Some(events) = &self.events {
            let message = text.to_string();
            self.live.beside(|| events.tell(Event::Warning { message: &message }));
        }
        self.note(format_args!("warning: {text}"));
    }

    /// Tells on stderr what the user should know beforehand, unless `--quiet`.
    pub(crate) fn note(&self, text: impl Display) {
        if self.verbosity > 0 {
            self.live.beside(|| print_error(text));
        }
    }

    /// Tells details on stderr with `--verbose`.
    pub(crate) fn detail(&self, text: impl Display) {
        if self.verbosity > 1 {
            self.live.beside(|| print_error(text));
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

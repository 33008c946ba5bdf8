//! Shows how far work is: as a bar on a terminal, as lines in a log, as events to scripts.

mod pace;
mod terminal;
mod words;

use std::fmt;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use udc::core::event::Event;
use udc::core::progress::{Bar, Reporter, Status, Task};

use super::events::Events;
use super::print_error;
use pace::Pace;
use terminal::{Screen, ShownBar, ShownTask};

/// Where people see how far work is.
#[derive(Debug)]
pub(crate) enum View {
    /// Nowhere.
    None,
    /// On a terminal, as bars that move.
    Terminal,
    /// In a log, as lines: the first one when work has taken so long.
    Log(Duration),
}

/// Events of progress are at least this far apart.
const EVENT_INTERVAL: Duration = Duration::from_millis(500);

/// Lines of a log are at least this far apart.
const LINE_INTERVAL: Duration = Duration::from_secs(1);

/// Later lines are as far apart as this share of the time that the work has taken, up to [`LONGEST_INTERVAL`]: hundreds of
/// lines tell of a week.
const LINE_SHARE: u32 = 20;
const LONGEST_INTERVAL: Duration = Duration::from_secs(600);

/// Shows work to people and scripts; of work within work only the outer one.
#[derive(Debug)]
pub(crate) struct Live {
    screen: Option<Screen>,
    log: Option<Duration>,
    events: Option<Arc<Events>>,
    /// Number of bars that there are.
    bars: Arc<AtomicUsize>,
}

impl Live {
    /// Shows work in `view`, and tells `events` of it.
    pub(crate) fn new(view: &View, events: Option<Arc<Events>>) -> Self {
        let screen = matches!(view, View::Terminal).then(Screen::default);
        let log = if let View::Log(delay) = view { Some(*delay) } else { None };
        Self { screen, log, events, bars: Arc::default() }
    }

    /// Whether anybody sees or hears anything.
    pub(crate) fn is_seen(&self) -> bool {
        self.screen.is_some() || self.log.is_some() || self.events.is_some()
    }

    /// Prints something beside the bars, which make room for it.
    pub(crate) fn beside<T>(&self, print: impl FnOnce() -> T) -> T {
        match &self.screen {
            Some(screen) => screen.beside(print),
            None => print(),
        }
    }
}

impl Reporter for Live {
    fn bar(&self, length: u64, unit: &'static str) -> Box<dyn Bar> {
        let work = Arc::new(Work {
            unit,
            total: length,
            begun: Instant::now(),
            state: Mutex::default(),
            log: self.log,
            events: self.events.clone(),
            is_outer: self.bars.fetch_add(1, Ordering::Relaxed) == 0,
        });
        let shown = self.screen.as_ref().filter(|_| work.is_outer).map(|screen| screen.bar(&work));
        work.tell(&mut work.state());
        Box::new(LiveBar {
            work,
            shown: Mutex::new(shown),
            is_over: AtomicBool::new(false),
            bars: Arc::clone(&self.bars),
        })
    }

    fn task(&self, what: String) -> Box<dyn Task> {
        if self.bars.load(Ordering::Relaxed) == 0
            && let Some(events) = &self.events
        {
            events.tell(Event::Stage { what: &what });
        }
        Box::new(LiveTask { _shown: self.screen.as_ref().map(|screen| screen.task(what, &self.bars)) })
    }
}

/// Work that tells how far it is.
struct Work {
    unit: &'static str,
    total: u64,
    begun: Instant,
    state: Mutex<State>,
    log: Option<Duration>,
    events: Option<Arc<Events>>,
    is_outer: bool,
}

#[derive(Default)]
struct State {
    done: u64,
    pace: Pace,
    status: Status,
    last_event: Option<Instant>,
    last_line: Option<Instant>,
}

impl Work {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn seconds(&self) -> f64 {
        self.begun.elapsed().as_secs_f64()
    }

    /// How many are done in a second, and how many seconds the others take.
    fn rate(&self, state: &State) -> (Option<f64>, Option<f64>) {
        let now = self.seconds();
        (state.pace.per_second(now), state.pace.seconds_left(now, self.total))
    }

    /// How many are done, and at what rate.
    fn in_words(&self, state: &State) -> (String, String) {
        let (per_second, left) = self.rate(state);
        (words::count(self.unit, state.done, self.total), words::rate(self.unit, per_second, left))
    }

    fn tell(&self, state: &mut State) {
        if !self.is_outer {
            return;
        }
        let now = Instant::now();
        let is_done = state.done >= self.total;
        let since = |last: Option<Instant>| last.map(|last| now.duration_since(last));
        if let Some(events) = &self.events
            && since(state.last_event).is_none_or(|since| is_done || since >= EVENT_INTERVAL)
        {
            state.last_event = Some(now);
            let (per_second, eta_seconds) = self.rate(state);
            let State { done, status: Status { values, .. }, .. } = state;
            let (unit, done, total) = (self.unit, *done, self.total);
            events.tell(Event::Progress { unit, done, total, per_second, eta_seconds, values });
        }
        let Some(delay) = self.log else { return };
        let interval = (self.begun.elapsed() / LINE_SHARE).clamp(delay.max(LINE_INTERVAL), LONGEST_INTERVAL);
        let is_due = match since(state.last_line) {
            None => self.begun.elapsed() >= delay,
            Some(since) => is_done || since >= interval,
        };
        if is_due {
            state.last_line = Some(now);
            let (count, rate) = self.in_words(state);
            let parts = [count, rate, state.status.text.clone()];
            let parts: Vec<String> = parts.into_iter().filter(|part| !part.is_empty()).collect();
            print_error(parts.join(", "));
        }
    }
}

/// A bar as its stage holds it.
struct LiveBar {
    work: Arc<Work>,
    shown: Mutex<Option<ShownBar>>,
    is_over: AtomicBool,
    bars: Arc<AtomicUsize>,
}

impl Bar for LiveBar {
    fn inc(&self, steps: u64) {
        let mut state = self.work.state();
        state.done += steps;
        let done = state.done;
        state.pace.note(self.work.seconds(), done);
        self.work.tell(&mut state);
    }

    fn start_at(&self, position: u64) {
        let mut state = self.work.state();
        state.done = position;
        state.pace = Pace::from(self.work.seconds(), position);
        self.work.tell(&mut state);
    }

    fn show(&self, status: Status) {
        self.work.state().status = status;
    }

    fn finish_and_clear(&self) {
        self.shown.lock().unwrap_or_else(PoisonError::into_inner).take();
        if !self.is_over.swap(true, Ordering::Relaxed) {
            self.bars.fetch_sub(1, Ordering::Relaxed);
        }
    }
}

impl Drop for LiveBar {
    fn drop(&mut self) {
        self.finish_and_clear();
    }
}

/// A task as its stage holds it.
struct LiveTask {
    _shown: Option<ShownTask>,
}

impl Task for LiveTask {}

impl fmt::Debug for Work {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Work").field("unit", &self.unit).field("total", &self.total).finish_non_exhaustive()
    }
}

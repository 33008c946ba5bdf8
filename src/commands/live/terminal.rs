//! Draws bars on the terminal that stderr is.

use std::fmt;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::{Work, words};

/// What is done sooner is not worth a bar.
const DELAY: Duration = Duration::from_millis(400);

/// How often bars are drawn anew, whether a step ends or not.
const TICK: Duration = Duration::from_millis(200);

/// The terminal with what is drawn on it.
#[derive(Debug)]
pub(super) struct Screen {
    bars: MultiProgress,
    /// The task that began last, of those that there are.
    tasks: Arc<Mutex<Vec<u64>>>,
    begun_tasks: AtomicU64,
}

impl Default for Screen {
    fn default() -> Self {
        let bars = MultiProgress::with_draw_target(ProgressDrawTarget::stderr());
        Self { bars, tasks: Arc::default(), begun_tasks: AtomicU64::new(0) }
    }
}

impl Screen {
    /// Prints while nothing is drawn.
    pub(super) fn beside<T>(&self, print: impl FnOnce() -> T) -> T {
        self.bars.suspend(print)
    }

    /// Draws how far work is.
    pub(super) fn bar(&self, work: &Arc<Work>) -> ShownBar {
        let (work, mut drawing) = (Arc::clone(work), Drawing::new(&self.bars));
        let draw = move || {
            let state = work.state();
            let (count, rate) = work.in_words(&state);
            let (done, below) = (state.done, state.status.text.clone());
            drop(state);
            let style = if below.is_empty() { BAR } else { BAR_AND_STATUS };
            let bar = drawing.on(style, Some(work.total));
            bar.set_prefix(count);
            bar.set_message(rate);
            if !below.is_empty() {
                bar.set_style(style_of(&BAR_AND_STATUS.replace("{status}", &escaped(&below))));
            }
            bar.set_position(done);
            bar.tick();
        };
        ShownBar { _ticker: Ticker::new(draw) }
    }

    /// Draws that something is done, while there are no `bars` and no younger task.
    pub(super) fn task(&self, what: String, bars: &Arc<AtomicUsize>) -> ShownTask {
        let number = self.begun_tasks.fetch_add(1, Ordering::Relaxed);
        let tasks = Arc::clone(&self.tasks);
        tasks.lock().unwrap_or_else(PoisonError::into_inner).push(number);
        let (others, bars, begun) = (Arc::clone(&tasks), Arc::clone(bars), Instant::now());
        let mut drawing = Drawing::new(&self.bars);
        let draw = move || {
            let youngest = others.lock().unwrap_or_else(PoisonError::into_inner).last().copied();
            if bars.load(Ordering::Relaxed) > 0 || youngest != Some(number) {
                return drawing.clear();
            }
            let bar = drawing.on(TASK, None);
            bar.set_message(format!("{what}, {}", words::duration(begun.elapsed().as_secs_f64())));
            bar.tick();
        };
        ShownTask { number, tasks, _ticker: Ticker::new(draw) }
    }
}

/// A bar that is drawn until this is dropped.
#[derive(Debug)]
pub(super) struct ShownBar {
    _ticker: Ticker,
}

/// A task that is drawn until this is dropped.
#[derive(Debug)]
pub(super) struct ShownTask {
    number: u64,
    tasks: Arc<Mutex<Vec<u64>>>,
    _ticker: Ticker,
}

impl Drop for ShownTask {
    fn drop(&mut self) {
        self.tasks.lock().unwrap_or_else(PoisonError::into_inner).retain(|task| *task != self.number);
    }
}

const BAR: &str = "{prefix} {wide_bar} {msg}";
const BAR_AND_STATUS: &str = "{prefix} {wide_bar} {msg}\n  {status}";
const TASK: &str = "{spinner} {msg}";

fn style_of(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())
}

/// A text as it stands in a template.
fn escaped(text: &str) -> String {
    text.replace('{', "{{").replace('}', "}}")
}

/// What is drawn of one piece of work, if anything is.
struct Drawing {
    bars: MultiProgress,
    drawn: Option<ProgressBar>,
}

impl Drawing {
    fn new(bars: &MultiProgress) -> Self {
        Self { bars: bars.clone(), drawn: None }
    }

    fn on(&mut self, style: &str, length: Option<u64>) -> &ProgressBar {
        self.drawn.get_or_insert_with(|| {
            let bar = ProgressBar::with_draw_target(length, ProgressDrawTarget::hidden());
            self.bars.add(bar.with_style(style_of(&style.replace("{status}", ""))))
        })
    }

    fn clear(&mut self) {
        if let Some(bar) = self.drawn.take() {
            bar.finish_and_clear();
            self.bars.remove(&bar);
        }
    }
}

impl Drop for Drawing {
    fn drop(&mut self) {
        self.clear();
    }
}

/// A thread that draws again and again until this is dropped.
struct Ticker {
    stop: Arc<(Mutex<bool>, Condvar)>,
    thread: Option<JoinHandle<()>>,
}

impl Ticker {
    fn new(mut draw: impl FnMut() + Send + 'static) -> Self {
        let stop = Arc::new((Mutex::new(false), Condvar::new()));
        let heard = Arc::clone(&stop);
        let tick = move || {
            let (stopped, changed) = &*heard;
            let mut wait = DELAY;
            loop {
                let stopped = stopped.lock().unwrap_or_else(PoisonError::into_inner);
                let waited = changed.wait_timeout_while(stopped, wait, |stopped| !*stopped);
                let (stopped, _) = waited.unwrap_or_else(PoisonError::into_inner);
                if *stopped {
                    return;
                }
                drop(stopped);
                draw();
                wait = TICK;
            }
        };
        // Without a thread nothing is drawn, and the work goes on.
        let thread = std::thread::Builder::new().name("progress".to_owned()).spawn(tick).ok();
        Self { stop, thread }
    }
}

impl Drop for Ticker {
    fn drop(&mut self) {
        *self.stop.0.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.stop.1.notify_all();
        if let Some(thread) = self.thread.take() {
            // What it drew is cleared when it ends.
            let _ = thread.join();
        }
    }
}

impl fmt::Debug for Ticker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Ticker").finish_non_exhaustive()
    }
}

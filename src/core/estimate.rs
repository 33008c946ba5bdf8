//! What a run will take, said before it begins: from sizes, and from a short sample of the work itself.

use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use serde::Serialize;

use super::bytes::format_bytes;
use super::progress::{Bar, Progress, Reporter};

/// What an image's file has beside its pixels at most: headers of EXR and NumPy stay below.
pub const HEADER_BYTES: u64 = 1 << 14;

/// The program's code and data, stacks of threads, and the tables of transforms.
pub const PROCESS_BYTES: u64 = 32 << 20;

/// What a run will take.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct Estimate {
    /// How many things it makes.
    pub items: u64,
    /// What these are: `images`, `steps`.
    pub unit: &'static str,
    /// Bytes on disk at most.
    pub disk_bytes: u64,
    /// Bytes of memory at most.
    pub memory_bytes: u64,
    /// Time on this machine, with as many threads as the run has, if it has them for itself.
    pub seconds: f64,
    /// Threads that the time is meant for.
    pub threads: usize,
    /// What was timed.
    pub measured: String,
}

impl fmt::Display for Estimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { items, unit, disk_bytes, memory_bytes, seconds, threads, measured } = self;
        let (disk, memory, time) = (format_bytes(*disk_bytes), format_bytes(*memory_bytes), Span(*seconds));
        write!(
            f,
            "{items} {unit}, at most {disk} on disk and {memory} of memory, about {time} with {threads} threads (timed: \
             {measured})"
        )
    }
}

/// Seconds, shown in the unit that suits them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span(pub f64);

impl fmt::Display for Span {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(seconds) = *self;
        match seconds {
            _ if seconds >= 172_800.0 => write!(f, "{:.1} d", seconds / 86_400.0),
            _ if seconds >= 7200.0 => write!(f, "{:.1} h", seconds / 3600.0),
            _ if seconds >= 120.0 => write!(f, "{:.1} min", seconds / 60.0),
            _ if seconds >= 10.0 => write!(f, "{seconds:.0} s"),
            _ => write!(f, "{seconds:.1} s"),
        }
    }
}

/// Time that goes with the amount of work: so much at the beginning, and so much for each unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinearTime {
    /// Seconds that any amount takes.
    pub fixed: f64,
    /// Seconds that each unit takes.
    pub each: f64,
}

impl LinearTime {
    /// The line through two measurements of an amount and its seconds; what noise would make negative is none.
    ///
    /// # Panics
    /// When both are of one amount: a broken invariant of the caller.
    pub fn through((less, sooner): (f64, f64), (more, later): (f64, f64)) -> Self {
        assert!(less < more, "two amounts, found {less} and {more}");
        let each = ((later - sooner) / (more - less)).max(0.0);
        // Where more work took less time, nothing but noise was measured, and the mean is as good.
        if each <= 0.0 {
            return Self { fixed: 0.0, each: later.max(sooner) / more };
        }
        Self { fixed: (sooner - each * less).max(0.0), each }
    }

    /// The seconds of an amount.
    pub fn of(&self, amount: f64) -> f64 {
        self.fixed + self.each * amount
    }
}

/// Does a piece of work as long as it takes to see how fast it goes, by the steps that it reports.
#[derive(Clone, Debug)]
pub struct Sampler {
    seen: Arc<Mutex<Seen>>,
    stop: Arc<AtomicBool>,
    patience: Duration,
}

/// The steps that were seen.
#[derive(Debug)]
struct Seen {
    begun: Instant,
    steps: u64,
    /// Seconds and steps after the first report, and after the last one.
    first: Option<(f64, u64)>,
    last: Option<(f64, u64)>,
}

impl Sampler {
    /// Begins now; the work is asked to stop after about `patience`.
    pub fn new(patience: Duration) -> Self {
        let seen = Seen { begun: Instant::now(), steps: 0, first: None, last: None };
        Self { seen: Arc::new(Mutex::new(seen)), stop: Arc::default(), patience }
    }

    /// Where the work is to report.
    pub fn progress(&self) -> Progress {
        Progress::new(Some(Arc::new(self.clone())), Arc::clone(&self.stop))
    }

    /// How many steps were seen.
    pub fn steps(&self) -> u64 {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner).steps
    }

    /// The time of so many steps; none when none was seen.
    pub fn time(&self) -> Option<LinearTime> {
        let seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        let ((sooner, less), (later, more)) = (seen.first?, seen.last?);
        if less == more {
            return Some(LinearTime { fixed: 0.0, each: later / more as f64 });
        }
        Some(LinearTime::through((less as f64, sooner), (more as f64, later)))
    }
}

impl Reporter for Sampler {
    fn bar(&self, _: u64, _: &'static str) -> Box<dyn Bar> {
        Box::new(self.clone())
    }
}

impl Bar for Sampler {
    fn inc(&self, steps: u64) {
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        // Steps that were done before take no time.
        if steps == 0 {
            return;
        }
        seen.steps += steps;
        let elapsed = seen.begun.elapsed();
        let now = Some((elapsed.as_secs_f64(), seen.steps));
        seen.first = seen.first.or(now);
        seen.last = now;
        if elapsed > self.patience {
            self.stop.store(true, Ordering::Relaxed);
        }
    }

    fn start_at(&self, _: u64) {}

    fn set_message(&self, _: String) {}

    fn finish_and_clear(&self) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_is_shown_in_the_unit_that_suits_it() {
        let shown = |seconds| Span(seconds).to_string();
        assert_eq!([shown(0.04), shown(3.25), shown(119.0)], ["0.0 s", "3.2 s", "119 s"]);
        assert_eq!([shown(150.0), shown(7200.0), shown(864_000.0)], ["2.5 min", "2.0 h", "10.0 d"]);
    }

    #[test]
    fn a_line_goes_through_two_measurements_and_never_down() {
        let time = LinearTime::through((1.0, 3.0), (3.0, 4.0));
        assert_eq!((time, time.of(10.0)), (LinearTime { fixed: 2.5, each: 0.5 }, 7.5));
        assert_eq!(LinearTime::through((2.0, 1.0), (4.0, 4.0)), LinearTime { fixed: 0.0, each: 1.5 });
        assert_eq!(LinearTime::through((1.0, 4.0), (2.0, 3.0)), LinearTime { fixed: 0.0, each: 2.0 });
    }

    #[test]
    fn work_is_stopped_when_enough_was_seen_of_it() {
        let sampler = Sampler::new(Duration::from_millis(20));
        let progress = sampler.progress();
        assert_eq!(sampler.time(), None);
        let bar = progress.bar(1_000_000, "images");
        while progress.check().is_ok() {
            std::thread::sleep(Duration::from_millis(2));
            bar.inc(3);
        }
        let time = sampler.time().unwrap();
        assert!(sampler.steps() < 300 && time.each > 0.0005, "{time:?} after {}", sampler.steps());
    }
}

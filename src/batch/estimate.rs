//! What a run will take, said before it begins: from sizes, and from a short sample of the work itself.

use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use crate::core::bytes::format_bytes;
use crate::core::error::Result;
use crate::core::progress::{Bar, Progress, Reporter, Status, Task};
use crate::io;

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
    #[serde(flatten)]
    pub cost: Spent,
    /// The part of it that any number of items takes.
    pub fixed: Spent,
    /// Threads that the time is meant for.
    pub threads: usize,
    /// What was timed.
    pub measured: String,
}

impl fmt::Display for Estimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { items, unit, disk_bytes, memory_bytes, cost, threads, measured, .. } = self;
        let (disk, memory, time) =
            (format_bytes(*disk_bytes), format_bytes(*memory_bytes), Span(cost.seconds));
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

/// Time that work takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub struct Spent {
    /// By the clock.
    pub seconds: f64,
    /// Of all processor cores together: hardly changed by what else a machine does.
    pub core_seconds: f64,
}

impl Spent {
    /// The same for each of so many.
    pub fn times(self, amount: f64) -> Self {
        Self { seconds: self.seconds * amount, core_seconds: self.core_seconds * amount }
    }

    /// Both together.
    pub fn and(self, other: Self) -> Self {
        Self { seconds: self.seconds + other.seconds, core_seconds: self.core_seconds + other.core_seconds }
    }
}

/// A clock of this process.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    begun: Instant,
    core_seconds: Option<f64>,
}

impl Clock {
    /// Begins now.
    pub fn start() -> Self {
        Self { begun: Instant::now(), core_seconds: io::core_seconds() }
    }

    /// What was spent since; where the system does not tell the time of cores, all of them are taken for busy.
    pub fn spent(&self) -> Spent {
        let seconds = self.begun.elapsed().as_secs_f64();
        let cores = self.core_seconds.zip(io::core_seconds()).map(|(before, now)| now - before);
        Spent { seconds, core_seconds: cores.unwrap_or(seconds * rayon::current_num_threads() as f64) }
    }
}

/// How long short work is repeated: many ticks of the clocks that systems count processor time by.
const REPEATED_FOR: Duration = Duration::from_millis(400);

/// What a piece of work costs: the mean of as many times as it can be done in a moment, and of one at least.
///
/// # Errors
/// The first of the work.
pub fn spent_on<E>(mut work: impl FnMut() -> Result<(), E>) -> Result<Spent, E> {
    let (clock, mut times) = (Clock::start(), 0.0);
    while times < 1.0 || clock.begun.elapsed() < REPEATED_FOR {
        work()?;
        times += 1.0;
    }
    Ok(clock.spent().times(1.0 / times))
}

/// Cost that goes with the amount of work: so much at the beginning, and so much for each unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinearCost {
    /// What any amount takes.
    pub fixed: Spent,
    /// What each unit takes.
    pub each: Spent,
}

impl LinearCost {
    /// So much for each unit, and nothing at the beginning.
    pub fn of_each(each: Spent) -> Self {
        Self { fixed: Spent::default(), each }
    }

    /// The line through two measurements of an amount and its cost; what noise would make negative is none.
    ///
    /// # Panics
    /// When the second is not of more: a broken invariant of the caller.
    pub fn through((less, first): (f64, Spent), (more, second): (f64, Spent)) -> Self {
        assert!(less < more, "two amounts, found {less} and {more}");
        let (fixed, each) = line((less, first.seconds), (more, second.seconds));
        let (fixed_cores, each_cores) = line((less, first.core_seconds), (more, second.core_seconds));
        Self {
            fixed: Spent { seconds: fixed, core_seconds: fixed_cores },
            each: Spent { seconds: each, core_seconds: each_cores },
        }
    }

    /// The cost of an amount.
    pub fn of(&self, amount: f64) -> Spent {
        self.fixed.and(self.each.times(amount))
    }
}

/// Offset and slope of the line through two points, neither of them negative.
fn line((less, lower): (f64, f64), (more, upper): (f64, f64)) -> (f64, f64) {
    let slope = (upper - lower) / (more - less);
    // Where more work took less time, nothing but noise was measured, and a share of the longer time is as good.
    if slope <= 0.0 {
        return (0.0, lower.max(upper) / more);
    }
    match lower - slope * less {
        offset if offset > 0.0 => (offset, slope),
        _ => (0.0, upper / more),
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
    clock: Clock,
    steps: u64,
    /// Steps and their cost after the first report, and after the last one.
    first: Option<(u64, Spent)>,
    last: Option<(u64, Spent)>,
}

impl Sampler {
    /// Begins now; the work is asked to stop after about `patience`.
    pub fn new(patience: Duration) -> Self {
        let seen = Seen { clock: Clock::start(), steps: 0, first: None, last: None };
        Self { seen: Arc::new(Mutex::new(seen)), stop: Arc::default(), patience }
    }

    /// Where the work is to report; it is stopped with `whole`, too, which it is a sample of.
    pub fn progress(&self, whole: &Progress) -> Progress {
        whole.part(Arc::new(self.clone()), Arc::clone(&self.stop))
    }

    /// Takes a sample's interrupt for its end, unless the user asked for it.
    ///
    /// # Errors
    /// That of the sample, or of an interrupt by the user.
    pub fn end<T>(&self, sampled: Result<T>, whole: &Progress) -> Result<()> {
        whole.check()?;
        sampled.map(|_| ()).or_else(|error| if error.is_interrupt() { Ok(()) } else { Err(error) })
    }

    /// How many steps were seen.
    pub fn steps(&self) -> u64 {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner).steps
    }

    /// The cost of steps; nothing when none was seen.
    pub fn cost(&self) -> LinearCost {
        let seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        match (seen.first, seen.last) {
            (Some((less, first)), Some((more, last))) if less < more => {
                LinearCost::through((less as f64, first), (more as f64, last))
            }
            (_, Some((steps, spent))) => LinearCost::of_each(spent.times(1.0 / steps as f64)),
            _ => LinearCost::default(),
        }
    }
}

impl Reporter for Sampler {
    fn bar(&self, _: u64, _: &'static str) -> Box<dyn Bar> {
        Box::new(self.clone())
    }

    fn task(&self, _: String) -> Box<dyn Task> {
        Box::new(self.clone())
    }
}

impl Task for Sampler {}

impl Bar for Sampler {
    fn inc(&self, steps: u64) {
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        // Steps that were done before take no time.
        if steps == 0 {
            return;
        }
        seen.steps += steps;
        let now = (seen.steps, seen.clock.spent());
        seen.first = seen.first.or(Some(now));
        seen.last = Some(now);
        if now.1.seconds > self.patience.as_secs_f64() {
            self.stop.store(true, Ordering::Relaxed);
        }
    }

    fn start_at(&self, _: u64) {}

    fn show(&self, _: Status) {}

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
        assert_eq!(line((1.0, 3.0), (3.0, 4.0)), (2.5, 0.5));
        assert_eq!(line((2.0, 1.0), (4.0, 4.0)), (0.0, 1.0), "no offset below zero");
        assert_eq!(line((1.0, 4.0), (2.0, 3.0)), (0.0, 2.0), "more work in less time");
        let spent = |seconds| Spent { seconds, core_seconds: 2.0 * seconds };
        let cost = LinearCost::through((1.0, spent(3.0)), (3.0, spent(4.0)));
        assert_eq!(cost.of(10.0), Spent { seconds: 7.5, core_seconds: 15.0 });
    }

    #[test]
    fn short_work_is_repeated_and_an_error_ends_it() {
        let mut times = 0;
        let spent = spent_on(|| {
            times += 1;
            std::thread::sleep(Duration::from_millis(10));
            Ok::<(), ()>(())
        });
        let seconds = spent.unwrap().seconds;
        assert!(times > 1 && seconds >= 0.01 && seconds * f64::from(times) >= REPEATED_FOR.as_secs_f64());
        assert_eq!(spent_on(|| Err("no")).unwrap_err(), "no");
    }

    #[test]
    fn work_is_stopped_when_enough_was_seen_of_it() {
        let sampler = Sampler::new(Duration::from_millis(20));
        let interrupted = Arc::new(AtomicBool::new(false));
        let whole = Progress::new(None, Arc::clone(&interrupted));
        let progress = sampler.progress(&whole);
        assert_eq!(sampler.cost(), LinearCost::default());
        let bar = progress.bar(1_000_000, "images");
        while progress.check().is_ok() {
            std::thread::sleep(Duration::from_millis(2));
            bar.inc(3);
        }
        let cost = sampler.cost();
        assert!(sampler.steps() < 300 && cost.each.seconds > 0.0005, "{cost:?} after {}", sampler.steps());
        sampler.end(progress.check(), &whole).unwrap();
        interrupted.store(true, Ordering::Relaxed);
        assert!(sampler.end(progress.check(), &whole).unwrap_err().is_interrupt());
    }
}

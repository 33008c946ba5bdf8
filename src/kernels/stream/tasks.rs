//! A list of tasks that threads take in order, each waiting for no more than it depends on.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// How often a thread looks for what it waits for before it lets others run.
const LOOKS: usize = 1 << 12;

/// Calls `work` once for each place of `needs`, from all threads of the pool: with `i` once it has returned for every
/// number below `needs[i]`, whose effects are visible by then.
///
/// Tasks begin in their order, so that the first unfinished one never waits and any number of threads gets through.
/// `work` must not use the pool itself: a thread that waits there for others may be given a turn here, and wait for the
/// task that it is in.
///
/// # Panics
/// When `work` panics; tasks that depend on the failed one are not begun.
pub(super) fn run_in_order(needs: &[usize], work: impl Fn(usize) + Sync) {
    debug_assert!(
        needs.iter().enumerate().all(|(task, &needed)| needed <= task),
        "a task waits for a later one"
    );
    let list = List {
        needs,
        next: AtomicUsize::new(0),
        finished: needs.iter().map(|_| AtomicBool::new(false)).collect(),
        failed: AtomicBool::new(false),
    };
    rayon::scope(|scope| {
        for _ in 1..rayon::current_num_threads().min(needs.len()) {
            scope.spawn(|_| list.take_turns(&work));
        }
        list.take_turns(&work);
    });
}

struct List<'a> {
    needs: &'a [usize],
    /// The task that is taken next.
    next: AtomicUsize,
    finished: Vec<AtomicBool>,
    /// A task panicked: nobody may wait for it.
    failed: AtomicBool,
}

impl List<'_> {
    /// Takes tasks until there are no more.
    fn take_turns(&self, work: &(impl Fn(usize) + Sync)) {
        let mut first_unfinished = 0;
        loop {
            let task = self.next.fetch_add(1, Ordering::Relaxed);
            let Some(&needed) = self.needs.get(task) else { return };
            if !self.wait(needed, &mut first_unfinished) {
                return;
            }
            let failure = OnPanic(&self.failed);
            work(task);
            std::mem::forget(failure);
            self.finished[task].store(true, Ordering::Release);
        }
    }

    /// Waits until all tasks below `needed` are finished; tells whether they will ever be. Those below
    /// `first_unfinished` are known to be.
    fn wait(&self, needed: usize, first_unfinished: &mut usize) -> bool {
        let mut looks = 0;
        while *first_unfinished < needed {
            if self.finished[*first_unfinished].load(Ordering::Acquire) {
                *first_unfinished += 1;
            } else if self.failed.load(Ordering::Relaxed) {
                return false;
            } else {
                looks += 1;
                if looks % LOOKS == 0 { std::thread::yield_now() } else { std::hint::spin_loop() }
            }
        }
        true
    }
}

/// Raises a flag when dropped, which happens when a task unwinds.
struct OnPanic<'a>(&'a AtomicBool);

impl Drop for OnPanic<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_threads(threads: usize, run: impl FnOnce() + Send) {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(run);
    }

    #[test]
    fn every_task_runs_once_and_after_what_it_needs() {
        for threads in [1, 2, 5] {
            let needs: Vec<usize> = (0..200usize).map(|task| task.saturating_sub(1 + task * 7 % 5)).collect();
            let runs: Vec<AtomicUsize> = needs.iter().map(|_| AtomicUsize::new(0)).collect();
            with_threads(threads, || {
                run_in_order(&needs, |task| {
                    for earlier in &runs[..needs[task]] {
                        assert_eq!(earlier.load(Ordering::Relaxed), 1, "before task {task}");
                    }
                    if task % 3 == 0 {
                        std::thread::sleep(std::time::Duration::from_micros(50));
                    }
                    runs[task].fetch_add(1, Ordering::Relaxed);
                });
            });
            assert!(runs.iter().all(|runs| runs.load(Ordering::Relaxed) == 1), "{threads} threads");
        }
    }

    #[test]
    fn a_panic_ends_the_run() {
        for threads in [1, 3] {
            let needs: Vec<usize> = (0..20).collect();
            let begun = AtomicUsize::new(0);
            let run = || {
                with_threads(threads, || {
                    run_in_order(&needs, |task| {
                        begun.fetch_add(1, Ordering::Relaxed);
                        assert!(task != 7, "task seven");
                    });
                });
            };
            assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(run)).is_err());
            assert_eq!(
                begun.load(Ordering::Relaxed),
                8,
                "{threads} threads: tasks behind the failed one ran"
            );
        }
    }
}

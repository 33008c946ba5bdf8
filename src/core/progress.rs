//! Lets a stage say how far it is, and learn that it should stop, without knowing who listens.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::error::{Error, Result};

/// Shows how far stages are: on a terminal, in a window, in a log.
pub trait Reporter: fmt::Debug + Send + Sync {
    /// Begins to show work of `length` steps; `what` names them, or what is being done.
    fn bar(&self, length: u64, what: &'static str) -> Box<dyn Bar>;
}

/// One piece of work that is shown; dropped, it is shown no longer.
pub trait Bar: Send + Sync {
    /// Shows that `steps` more are done.
    fn inc(&self, steps: u64);

    /// Shows that the work goes on from `position`, which an earlier process came to: its steps took no time here.
    fn start_at(&self, position: u64);

    /// Shows another text than what the bar began with.
    fn set_message(&self, message: String);

    /// Shows the work no longer.
    fn finish_and_clear(&self);
}

/// Where stages report their progress, and the flag that asks them to stop.
///
/// Cheap to clone; the default reports to nobody and never stops.
#[derive(Clone, Debug, Default)]
pub struct Progress {
    reporter: Option<Arc<dyn Reporter>>,
    interrupted: Arc<AtomicBool>,
}

/// The bar that nobody sees.
struct Unseen;

impl Bar for Unseen {
    fn inc(&self, _: u64) {}

    fn start_at(&self, _: u64) {}

    fn set_message(&self, _: String) {}

    fn finish_and_clear(&self) {}
}

impl Progress {
    /// Reports to `reporter`, if there is one, and stops when `interrupted` is set.
    pub fn new(reporter: Option<Arc<dyn Reporter>>, interrupted: Arc<AtomicBool>) -> Self {
        Self { reporter, interrupted }
    }

    /// The same without bars: for work inside of work that has one.
    pub fn without_bars(&self) -> Self {
        Self { reporter: None, interrupted: Arc::clone(&self.interrupted) }
    }

    /// Starts a bar of `length` steps.
    pub fn bar(&self, length: u64, what: &'static str) -> Box<dyn Bar> {
        self.reporter.as_ref().map_or_else(|| Box::new(Unseen) as _, |reporter| reporter.bar(length, what))
    }

    /// Ends the work early when the user has asked for it; call between items.
    ///
    /// # Errors
    /// [`Error::Interrupted`] after an interrupt.
    pub fn check(&self) -> Result<()> {
        if self.interrupted.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;

    /// Notes what it is told.
    #[derive(Clone, Debug, Default)]
    struct Notes(Arc<Mutex<Vec<String>>>);

    impl Notes {
        fn add(&self, note: String) {
            self.0.lock().unwrap().push(note);
        }
    }

    impl Reporter for Notes {
        fn bar(&self, length: u64, what: &'static str) -> Box<dyn Bar> {
            self.add(format!("{length} {what}"));
            Box::new(self.clone())
        }
    }

    impl Bar for Notes {
        fn inc(&self, steps: u64) {
            self.add(format!("+{steps}"));
        }

        fn start_at(&self, position: u64) {
            self.add(format!("at {position}"));
        }

        fn set_message(&self, message: String) {
            self.add(message);
        }

        fn finish_and_clear(&self) {
            self.add("done".to_owned());
        }
    }

    #[test]
    fn a_reporter_hears_of_the_work_and_not_of_the_work_inside_of_it() {
        let (notes, interrupted) = (Notes::default(), Arc::new(AtomicBool::new(false)));
        let progress = Progress::new(Some(Arc::new(notes.clone())), Arc::clone(&interrupted));
        let (outer, inner) = (progress.bar(3, "images"), progress.without_bars());
        inner.bar(9, "tiles").inc(9);
        outer.start_at(1);
        outer.inc(2);
        outer.finish_and_clear();
        assert_eq!(*notes.0.lock().unwrap(), ["3 images", "at 1", "+2", "done"]);
        inner.check().unwrap();
        interrupted.store(true, Ordering::Relaxed);
        assert!(matches!(inner.check(), Err(Error::Interrupted)));
    }
}

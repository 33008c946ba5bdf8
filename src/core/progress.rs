//! Lets a stage say how far it is, and learn that it should stop, without knowing who listens.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use serde_json::{Map, Value};

use super::error::{Error, Result};

/// Shows how far stages are: on a terminal, in a window, in a log.
pub trait Reporter: fmt::Debug + Send + Sync {
    /// Begins to show work of `length` steps; `unit` names them: `images`, or [`PIXELS`].
    fn bar(&self, length: u64, unit: &'static str) -> Box<dyn Bar>;

    /// Begins to show work that does not tell how far it is; dropped, it is shown no longer.
    fn task(&self, what: String) -> Box<dyn Task>;
}

/// The unit of work that is counted in pixels, of which there are many.
pub const PIXELS: &str = "pixels";

/// One piece of work that is shown; dropped, it is shown no longer.
pub trait Bar: Send + Sync {
    /// Shows that `steps` more are done.
    fn inc(&self, steps: u64);

    /// Shows that the work goes on from `position`, which an earlier process came to: its steps took no time here.
    fn start_at(&self, position: u64);

    /// Shows what else is known of the work now, until something newer is.
    fn show(&self, status: Status);

    /// Shows the work no longer.
    fn finish_and_clear(&self);
}

/// A piece of work that is shown as long as this is there.
pub trait Task: Send + Sync {}

/// What is known of work beside how far it is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Status {
    /// For people.
    pub text: String,
    /// For scripts, by keys in kebab-case.
    pub values: Map<String, Value>,
}

/// Where stages report their progress, and the flag that asks them to stop.
///
/// Cheap to clone; the default reports to nobody and never stops.
#[derive(Clone, Debug, Default)]
pub struct Progress {
    reporter: Option<Arc<dyn Reporter>>,
    interrupted: Arc<AtomicBool>,
    /// The flag of the work that this is a part of.
    around: Option<Arc<AtomicBool>>,
}

/// The work that nobody sees.
struct Unseen;

impl Bar for Unseen {
    fn inc(&self, _: u64) {}

    fn start_at(&self, _: u64) {}

    fn show(&self, _: Status) {}

    fn finish_and_clear(&self) {}
}

impl Task for Unseen {}

impl Progress {
    /// Reports to `reporter`, if there is one, and stops when `interrupted` is set.
    pub fn new(reporter: Option<Arc<dyn Reporter>>, interrupted: Arc<AtomicBool>) -> Self {
        Self { reporter, interrupted, around: None }
    }

    /// That of a part of the work, which reports to `reporter` and stops when `enough` is set too.
    pub fn part(&self, reporter: Arc<dyn Reporter>, enough: Arc<AtomicBool>) -> Self {
        Self { reporter: Some(reporter), interrupted: enough, around: Some(Arc::clone(&self.interrupted)) }
    }

    /// The same without bars: for work inside of work that has one.
    pub fn without_bars(&self) -> Self {
        Self { reporter: None, ..self.clone() }
    }

    /// Starts a bar of `length` steps, which `unit` names.
    pub fn bar(&self, length: u64, unit: &'static str) -> Box<dyn Bar> {
        self.reporter.as_ref().map_or_else(|| Box::new(Unseen) as _, |reporter| reporter.bar(length, unit))
    }

    /// Shows work that does not tell how far it is, as long as what is returned is there.
    pub fn task(&self, what: impl fmt::Display) -> Box<dyn Task> {
        self.reporter
            .as_ref()
            .map_or_else(|| Box::new(Unseen) as _, |reporter| reporter.task(what.to_string()))
    }

    /// Ends the work early when the user has asked for it; call between items.
    ///
    /// # Errors
    /// [`Error::Interrupted`] after an interrupt.
    pub fn check(&self) -> Result<()> {
        let is_set = |flag: &Arc<AtomicBool>| flag.load(Ordering::Relaxed);
        let stops = is_set(&self.interrupted) || self.around.as_ref().is_some_and(is_set);
        if stops { Err(Error::Interrupted) } else { Ok(()) }
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
        fn bar(&self, length: u64, unit: &'static str) -> Box<dyn Bar> {
            self.add(format!("{length} {unit}"));
            Box::new(self.clone())
        }

        fn task(&self, what: String) -> Box<dyn Task> {
            self.add(what);
            Box::new(self.clone())
        }
    }

    impl Task for Notes {}

    impl Bar for Notes {
        fn inc(&self, steps: u64) {
            self.add(format!("+{steps}"));
        }

        fn start_at(&self, position: u64) {
            self.add(format!("at {position}"));
        }

        fn show(&self, status: Status) {
            self.add(status.text);
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
        drop(inner.task("reading"));
        drop(progress.task("writing"));
        outer.start_at(1);
        outer.inc(2);
        outer.finish_and_clear();
        assert_eq!(*notes.0.lock().unwrap(), ["3 images", "writing", "at 1", "+2", "done"]);
        inner.check().unwrap();
        interrupted.store(true, Ordering::Relaxed);
        assert!(matches!(inner.check(), Err(Error::Interrupted)));
    }

    #[test]
    fn a_part_stops_by_itself_and_with_the_whole() {
        let flags = [(); 2].map(|()| Arc::new(AtomicBool::new(false)));
        let [whole, enough] = &flags;
        let progress = Progress::new(None, Arc::clone(whole));
        let part = || progress.part(Arc::new(Notes::default()), Arc::clone(enough)).without_bars();
        part().check().unwrap();
        enough.store(true, Ordering::Relaxed);
        assert!(part().check().is_err() && progress.check().is_ok());
        enough.store(false, Ordering::Relaxed);
        whole.store(true, Ordering::Relaxed);
        assert!(part().check().is_err());
    }
}

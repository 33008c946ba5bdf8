//! Lets work over files say what happens, without knowing who listens.

use std::fmt::Display;
use std::time::Instant;

use crate::core::progress::Progress;

/// Whoever watches work over files: hears of it, sees how far it is, and may stop it.
pub trait Watcher: Sync {
    /// Where to report how far the work is, and whom to ask whether to stop.
    fn progress(&self) -> &Progress;

    /// Tells of a result: a file that is written, or how many are there.
    fn tell(&self, text: &dyn Display);

    /// Tells what may spoil a result.
    fn warn(&self, text: &dyn Display);

    /// Tells what the user should know beforehand.
    fn note(&self, text: &dyn Display);

    /// Tells a detail, for who wants to know.
    fn detail(&self, text: &dyn Display);
}

/// Does a step of the work, which is shown meanwhile, and tells as a detail how long it took.
///
/// # Errors
/// Those of the step.
pub fn timed<T, E>(
    watcher: &dyn Watcher,
    doing: impl Display,
    step: impl FnOnce() -> Result<T, E>,
) -> Result<T, E> {
    let started = Instant::now();
    let doing = doing.to_string();
    let task = watcher.progress().task(&doing);
    let result = step()?;
    drop(task);
    watcher.detail(&format_args!("{doing}: {:.2} s", started.elapsed().as_secs_f64()));
    Ok(result)
}

#[cfg(test)]
pub(crate) mod testing {
    //! Notes what a watcher hears.

    use super::*;
    use std::sync::Mutex;

    /// Notes all but details, whose times differ.
    #[derive(Default)]
    pub(crate) struct Notes {
        progress: Progress,
        heard: Mutex<Vec<String>>,
    }

    impl Notes {
        /// One that may stop the work.
        pub(crate) fn of(progress: Progress) -> Self {
            Self { progress, ..Self::default() }
        }

        /// What was heard since it was asked last.
        pub(crate) fn take(&self) -> Vec<String> {
            std::mem::take(&mut self.heard.lock().unwrap())
        }

        fn add(&self, text: String) {
            self.heard.lock().unwrap().push(text);
        }
    }

    impl Watcher for Notes {
        fn progress(&self) -> &Progress {
            &self.progress
        }

        fn tell(&self, text: &dyn Display) {
            self.add(text.to_string());
        }

        fn warn(&self, text: &dyn Display) {
            self.add(format!("warning: {text}"));
        }

        fn note(&self, text: &dyn Display) {
            self.add(format!("note: {text}"));
        }

        fn detail(&self, _: &dyn Display) {}
    }
}

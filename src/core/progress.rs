//! Lets a stage say how far it is, and learn that it should stop, without knowing who listens.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::{ProgressBar, ProgressStyle};

use super::error::{Error, Result};

/// Where stages report their progress, and the flag that asks them to stop.
///
/// Cheap to clone; the default reports to nobody and never stops.
#[derive(Clone, Debug, Default)]
pub struct Progress {
    visible: bool,
    interrupted: Arc<AtomicBool>,
}

impl Progress {
    /// Makes a reporter that draws bars on stderr when `visible`, and stops when `interrupted` is set.
    pub fn new(visible: bool, interrupted: Arc<AtomicBool>) -> Self {
        Self { visible, interrupted }
    }

    /// The same without bars: for work inside of work that has one.
    pub fn without_bars(&self) -> Self {
        Self { visible: false, interrupted: Arc::clone(&self.interrupted) }
    }

    /// Starts a bar of `length` steps, with rate and time left.
    ///
    /// # Panics
    /// Never: the template is a constant.
    pub fn bar(&self, length: u64, what: &'static str) -> ProgressBar {
        if !self.visible {
            return ProgressBar::hidden();
        }
        let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} {per_sec} ETA {eta}")
            .expect("the template is a constant");
        let bar = ProgressBar::new(length).with_style(style).with_message(what);
        bar.enable_steady_tick(std::time::Duration::from_millis(200));
        bar
    }

    /// Ends the work early when the user has asked for it; call between items.
    ///
    /// # Errors
    /// [`Error::Interrupted`] after an interrupt.
    pub fn check(&self) -> Result<()> {
        if self.interrupted.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
    }
}

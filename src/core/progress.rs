//! Lets a stage say how far it is, and learn that it should stop, without knowing who listens.

use std::io::{self, IsTerminal as _, Write as _};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle, TermLike};

use super::error::{Error, Result};

/// Where stages report their progress, and the flag that asks them to stop.
///
/// Cheap to clone; the default reports to nobody and never stops.
#[derive(Clone, Debug, Default)]
pub struct Progress {
    visible: bool,
    interrupted: Arc<AtomicBool>,
}

/// How often bars are drawn where no terminal shows them: each drawing stays in the log.
const PLAIN_HZ: u8 = 2;

/// A stderr that is no terminal, such as a log or a pipe: bars overwrite their line by a carriage return.
#[derive(Debug)]
struct PlainStderr;

impl TermLike for PlainStderr {
    fn width(&self) -> u16 {
        80
    }

    fn move_cursor_up(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn move_cursor_down(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn move_cursor_right(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn move_cursor_left(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn write_line(&self, line: &str) -> io::Result<()> {
        writeln!(io::stderr().lock(), "{line}")
    }

    fn write_str(&self, text: &str) -> io::Result<()> {
        write!(io::stderr().lock(), "{text}")
    }

    fn clear_line(&self) -> io::Result<()> {
        self.write_str("\r")
    }

    fn flush(&self) -> io::Result<()> {
        io::stderr().lock().flush()
    }
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
        let target = if io::stderr().is_terminal() {
            ProgressDrawTarget::stderr()
        } else {
            ProgressDrawTarget::term_like_with_hz(Box::new(PlainStderr), PLAIN_HZ)
        };
        let bar = ProgressBar::with_draw_target(Some(length), target).with_style(style).with_message(what);
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

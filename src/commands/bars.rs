//! Draws the bars of stages on stderr.

use std::io::{self, IsTerminal as _, Write as _};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle, TermLike};

use udc::core::progress::{Bar, Reporter};

/// Draws bars on stderr, with rate and time left.
#[derive(Debug)]
pub(crate) struct StderrBars;

/// A bar on stderr.
struct StderrBar(ProgressBar);

/// How often bars are drawn where no terminal shows them: each drawing stays in the log.
const PLAIN_HZ: u8 = 2;

/// How often rate and time left are drawn anew while no step ends.
const TICK: Duration = Duration::from_millis(200);

impl Reporter for StderrBars {
    fn bar(&self, length: u64, what: &'static str) -> Box<dyn Bar> {
        let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} {per_sec} ETA {eta}")
            .expect("the template is a constant");
        let target = if io::stderr().is_terminal() {
            ProgressDrawTarget::stderr()
        } else {
            ProgressDrawTarget::term_like_with_hz(Box::new(PlainStderr), PLAIN_HZ)
        };
        let bar = ProgressBar::with_draw_target(Some(length), target).with_style(style).with_message(what);
        bar.enable_steady_tick(TICK);
        Box::new(StderrBar(bar))
    }
}

impl Bar for StderrBar {
    fn inc(&self, steps: u64) {
        self.0.inc(steps);
    }

    fn start_at(&self, position: u64) {
        self.0.set_position(position);
        self.0.reset_eta();
    }

    fn set_message(&self, message: String) {
        self.0.set_message(message);
    }

    fn finish_and_clear(&self) {
        self.0.finish_and_clear();
    }
}

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

//! Runs a command to its end, or until the user asks to stop: it is ended then, and leaves nobody behind.

use std::io::Read;
use std::process::{Command, ExitStatus, Stdio};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::Duration;

use anyhow::Result;

use udc::core::progress::Progress;

/// How often the user is asked for: soon enough for whoever waits, and seldom enough not to be measured.
const PATIENCE: Duration = Duration::from_millis(50);

/// What a command wrote, and how it ended.
pub(super) struct Output {
    pub(super) status: ExitStatus,
    pub(super) stdout: Vec<u8>,
    pub(super) stderr: Vec<u8>,
}

/// Runs a command to its end. An interrupt kills it: a signal may have reached this process alone.
pub(super) fn output_of(command: &mut Command, progress: &Progress) -> Result<Output> {
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
    let (send, told) = channel();
    let (out, err) = (child.stdout.take(), child.stderr.take());
    // Both at once: a pipe that nobody empties stops who writes to it.
    std::thread::spawn({
        let send = send.clone();
        move || tell(out, true, &send)
    });
    std::thread::spawn(move || tell(err, false, &send));
    let (mut stdout, mut stderr) = (Vec::new(), Vec::new());
    loop {
        match told.recv_timeout(PATIENCE) {
            Ok((true, bytes)) => stdout = bytes,
            Ok((false, bytes)) => stderr = bytes,
            // Both are told of: the command has ended.
            Err(RecvTimeoutError::Disconnected) => break,
            Err(RecvTimeoutError::Timeout) => {}
        }
        if let Err(interrupt) = progress.check() {
            let _ = child.kill();
            child.wait()?;
            return Err(interrupt.into());
        }
    }
    Ok(Output { status: child.wait()?, stdout, stderr })
}

/// Reads a pipe to its end and tells what came through it.
fn tell(pipe: Option<impl Read>, is_stdout: bool, send: &Sender<(bool, Vec<u8>)>) {
    let mut bytes = Vec::new();
    // What cannot be read is missed by whoever reads the answer.
    let _ = pipe.map(|mut pipe| pipe.read_to_end(&mut bytes));
    let _ = send.send((is_stdout, bytes));
}

#[cfg(all(test, unix))]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::Instant;

    use super::*;

    #[test]
    fn a_command_is_heard_to_its_end() {
        let mut command = Command::new("sh");
        command.args(["-c", "head -c 200000 /dev/zero; echo no >&2; exit 3"]);
        let Output { status, stdout, stderr } = output_of(&mut command, &Progress::default()).unwrap();
        assert_eq!((status.code(), stdout.len(), &stderr[..]), (Some(3), 200_000, &b"no\n"[..]));
    }

    #[test]
    fn an_interrupt_ends_the_command() {
        let interrupted = Arc::new(AtomicBool::new(false));
        let progress = Progress::new(None, Arc::clone(&interrupted));
        let begun = Instant::now();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(Duration::from_millis(100));
                interrupted.store(true, Ordering::Relaxed);
            });
            assert!(output_of(Command::new("sleep").arg("600"), &progress).is_err());
        });
        assert!(begun.elapsed() < Duration::from_secs(60));
    }
}

//! Runs `udc` in a scratch folder and looks at what came out.

use std::path::Path;
use std::process::{Command, Output};
#[cfg(unix)]
use std::time::{Duration, Instant};

/// How long a file may take to appear: some hundred times as long as it does.
#[cfg(unix)]
const LONGEST_WAIT: Duration = Duration::from_secs(120);

/// Runs `udc` with `args` in `folder`.
pub(crate) fn udc(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_udc")).args(args).current_dir(folder).output().expect("udc starts")
}

/// Runs `udc` and returns its stdout; fails with its stderr when it does not succeed.
pub(crate) fn succeed(folder: &Path, args: &[&str]) -> String {
    let output = udc(folder, args);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "udc {args:?} failed: {stderr}");
    String::from_utf8(output.stdout).expect("stdout is text")
}

/// Runs `udc`, expects exit code `code` with a one-line error, and returns stderr.
pub(crate) fn fail(folder: &Path, args: &[&str], code: i32) -> String {
    let output = udc(folder, args);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "udc {args:?} said: {stderr}");
    assert!(!stderr.contains("panicked"), "udc {args:?} panicked: {stderr}");
    stderr
}

/// Runs `udc`, presses Ctrl-C as soon as the file `first` exists, and returns exit code and stderr.
#[cfg(unix)]
pub(crate) fn interrupt_after(folder: &Path, args: &[&str], first: &str) -> (Option<i32>, String) {
    signal_after(folder, args, first, "-INT")
}

/// The same with another signal.
#[cfg(unix)]
pub(crate) fn signal_after(folder: &Path, args: &[&str], first: &str, signal: &str) -> (Option<i32>, String) {
    let mut run = Command::new(env!("CARGO_BIN_EXE_udc"))
        .args(args)
        .current_dir(folder)
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .expect("udc starts");
    let deadline = Instant::now() + LONGEST_WAIT;
    while !folder.join(first).exists() {
        let ended = run.try_wait().expect("the child can be asked");
        if (ended.is_some() && !folder.join(first).exists()) || Instant::now() > deadline {
            let _ = run.kill();
            let output = run.wait_with_output().expect("udc ends");
            let said = String::from_utf8_lossy(&output.stderr);
            panic!("udc {args:?} wrote no {first} (ended: {ended:?}, at most {LONGEST_WAIT:?}): {said}");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let pid = run.id().to_string();
    assert!(Command::new("kill").args([signal, &pid]).status().expect("kill starts").success());
    let output = run.wait_with_output().expect("udc ends");
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

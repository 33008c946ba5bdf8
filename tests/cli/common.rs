//! Runs `udc` in a scratch folder and looks at what came out.

use std::path::Path;
use std::process::{Command, Output};

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

//! Opens pages in the user's browser.

use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use super::Session;

/// How long a program that opens pages may take to say that it cannot.
const LONGEST_WAIT: Duration = Duration::from_secs(3);

/// Opens a page; where nothing opens it, says where it lies.
pub(super) fn open(page: &Path, session: &Session) {
    let page = std::path::absolute(page).unwrap_or_else(|_| page.to_owned());
    if !is_opened(&page) {
        session.note(format_args!("no program opens pages here; open {} in a browser", page.display()));
    }
}

/// Whether the program that opens files here took the page; one that is still at work after a while did.
fn is_opened(page: &Path) -> bool {
    let mut command = opener(page);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    let Ok(mut child) = command.spawn() else { return false };
    let deadline = Instant::now() + LONGEST_WAIT;
    while Instant::now() < deadline {
        match child.try_wait() {
            Ok(Some(status)) => return status.success(),
            Ok(None) => sleep(Duration::from_millis(20)),
            Err(_) => return false,
        }
    }
    true
}

fn opener(page: &Path) -> Command {
    let mut command;
    if cfg!(target_os = "windows") {
        command = Command::new("cmd");
        // The first text in quotes is the window's title.
        command.args(["/C", "start", ""]).arg(page);
    } else if cfg!(target_os = "macos") {
        command = Command::new("open");
        command.arg(page);
    } else {
        command = Command::new("xdg-open");
        command.arg(page);
    }
    command
}

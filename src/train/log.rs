//! The log of a run, one JSON object a line: how far it tells, and where it goes on.

use std::path::Path;

use serde_json::Value;

use crate::core::error::Result;
use crate::io::{self, LineLog};

/// The last iteration that a log tells of; 0 without any, or without a log.
pub(super) fn last_logged(path: &Path) -> Result<u64> {
    let text = if path.is_file() { io::read_text(path)? } else { String::new() };
    Ok(text.lines().filter_map(iteration_of).max().unwrap_or(0))
}

/// The iteration that a line of the log tells of; none of a line that a killed process began.
fn iteration_of(line: &str) -> Option<u64> {
    serde_json::from_str::<Value>(line).ok()?["iteration"].as_u64()
}

/// Opens the log at the line after `iteration`: what a killed process wrote past its checkpoint will be
/// written again.
pub(super) fn open_log(path: &Path, iteration: u64) -> Result<LineLog> {
    let text = if path.is_file() { io::read_text(path)? } else { String::new() };
    let is_done = |line: &&str| iteration_of(line).is_some_and(|found| found <= iteration);
    let kept: String = text.lines().take_while(is_done).map(|line| format!("{line}\n")).collect();
    // Where folders cannot be locked, as on network file systems, files may be.
    LineLog::open(path)?.try_lock()?;
    LineLog::replace(path, &kept)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_goes_on_behind_an_iteration() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        assert_eq!(last_logged(&path).unwrap(), 0);
        std::fs::write(&path, "{\"iteration\":2}\n{\"iteration\":4}\n{\"iteration\":6,\"lo").unwrap();
        assert_eq!(last_logged(&path).unwrap(), 4);
        drop(open_log(&path, 3).unwrap());
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "{\"iteration\":2}\n");
    }
}

//! Reads what the system tells of this process: memory and time.

use std::fs;
use std::path::Path;

use tempfile::TempDir;

use crate::core::error::{Error, Result};

/// The most memory that this process has held at once, where the system tells.
pub fn peak_memory_bytes() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kibibytes: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kibibytes * 1024)
}

/// Ticks of the clock that the system counts processor time by, in a second: 100 on every Linux that is in use.
const TICKS_PER_SECOND: f64 = 100.0;

/// Seconds that this process has spent on all cores together, where the system tells.
pub fn core_seconds() -> Option<f64> {
    core_seconds_at(11)
}

/// Seconds that processes which this one has started, and waited for, have spent on all cores together.
pub fn core_seconds_of_children() -> Option<f64> {
    core_seconds_at(13)
}

/// The sum of two fields behind the program's name: time in the program, and in the system for it.
fn core_seconds_at(first: usize) -> Option<f64> {
    let stat = fs::read_to_string("/proc/self/stat").ok()?;
    // The name of the program, which may hold anything, stands in parentheses.
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = |index: usize| fields.get(index)?.parse::<f64>().ok();
    Some((ticks(first)? + ticks(first + 1)?) / TICKS_PER_SECOND)
}

/// Makes a folder for files that nobody is to keep, on the disk that `output` is to be written to where that may be
/// written; it goes with what is returned.
///
/// # Errors
/// [`Error::Io`] when neither there nor where the system keeps such files one can be made.
pub fn scratch_folder(output: &Path) -> Result<TempDir> {
    let absolute = std::path::absolute(output).unwrap_or_else(|_| output.to_owned());
    let near = absolute.ancestors().find(|folder| folder.is_dir());
    let builder = || {
        let mut builder = tempfile::Builder::new();
        builder.prefix(".udc-").suffix(".sample");
        builder
    };
    let near = near.and_then(|near| builder().tempdir_in(near).ok());
    let made = near.map_or_else(|| builder().tempdir(), Ok);
    made.map_err(|source| Error::io("create", std::env::temp_dir(), source))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scratch_folder_lies_near_the_output_and_goes_again() {
        let root = tempfile::tempdir().unwrap();
        let scratch = scratch_folder(&root.path().join("not/there/yet")).unwrap();
        let path = scratch.path().to_owned();
        assert_eq!(path.parent().unwrap(), root.path());
        fs::write(path.join("a"), "a").unwrap();
        drop(scratch);
        assert!(!path.exists() && root.path().is_dir());
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_process_has_some_memory_and_spends_time() {
        assert!(peak_memory_bytes().unwrap() > 1 << 20);
        let before = core_seconds().unwrap();
        let begun = std::time::Instant::now();
        while core_seconds().unwrap() < before + 0.05 {
            assert!(begun.elapsed().as_secs() < 60, "time passes");
        }
    }
}

//! Writes a training's numbers for TensorBoard: event files beside the log.
//!
//! A process writes one file, named after the step that it goes on from. A resumed one first cuts from older
//! files what comes after that step, as it does with the log, so that no step is there twice; a TensorBoard that
//! is looking on is told to forget those steps. Events hold the time of day, so that these files, unlike all
//! others of a run, differ between runs.

mod event;
mod record;

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::core::error::Result;
use crate::io::{self, AppendFile};

/// What the names of event files begin with; TensorBoard looks for it, and reads files in the order of names.
const PREFIX: &str = "events.out.tfevents.";

/// An event file that is being written.
#[derive(Debug)]
pub(super) struct EventLog {
    file: AppendFile,
}

impl EventLog {
    /// Begins the file of a process that goes on from `iteration`, after cutting what older files have past it.
    pub(super) fn open(folder: &Path, iteration: u64) -> Result<Self> {
        for path in event_files(folder)? {
            cut(&path, iteration)?;
        }
        let path = folder.join(format!("{PREFIX}{iteration:010}.udc"));
        io::remove(&path)?;
        let mut log = Self { file: AppendFile::at(&path)? };
        log.append(&event::file_version(now_s()))?;
        if iteration > 0 {
            log.append(&event::restart(now_s(), iteration + 1))?;
        }
        Ok(log)
    }

    /// Writes named numbers of one step.
    pub(super) fn write(&mut self, step: u64, values: &[(String, f64)]) -> Result<()> {
        self.append(&event::scalars(now_s(), step, values))
    }

    fn append(&mut self, event: &[u8]) -> Result<()> {
        self.file.append(&record::frame(event))
    }
}

/// Removes the event files of a run.
pub(super) fn remove_all(folder: &Path) -> Result<()> {
    event_files(folder)?.iter().try_for_each(|path| io::remove(path))
}

fn event_files(folder: &Path) -> Result<Vec<PathBuf>> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let names = io::list_folder(folder)?.into_iter().filter(|name| name.starts_with(PREFIX));
    Ok(names.map(|name| folder.join(name)).collect())
}

/// Keeps the records of a file up to `iteration`, and none from a damaged one on; a file without any other
/// scalars goes.
fn cut(path: &Path, iteration: u64) -> Result<()> {
    let bytes = io::read_bytes(path)?;
    let (mut rest, mut last) = (&bytes[..], 0);
    while let Some((contents, after)) = record::split_first(rest) {
        let step = event::step_of(contents);
        if step > iteration {
            break;
        }
        (rest, last) = (after, last.max(step));
    }
    let kept = &bytes[..bytes.len() - rest.len()];
    if last == 0 {
        io::remove(path)
    } else if kept.len() < bytes.len() {
        io::write_atomically(path, true, |file| file.write_all(kept))
    } else {
        Ok(())
    }
}

fn now_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |time| time.as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steps(path: &Path) -> Vec<u64> {
        let bytes = io::read_bytes(path).unwrap();
        let mut rest = &bytes[..];
        let mut steps = Vec::new();
        while let Some((contents, after)) = record::split_first(rest) {
            steps.push(event::step_of(contents));
            rest = after;
        }
        assert!(rest.is_empty(), "a record is damaged");
        steps
    }

    fn write(log: &mut EventLog, steps: std::ops::RangeInclusive<u64>) {
        steps.for_each(|step| log.write(step, &[("loss".to_owned(), 0.5)]).unwrap());
    }

    #[test]
    fn a_resumed_log_has_every_step_once() {
        let folder = tempfile::tempdir().unwrap();
        let name = |iteration: u64| folder.path().join(format!("{PREFIX}{iteration:010}.udc"));
        write(&mut EventLog::open(folder.path(), 0).unwrap(), 1..=7);
        // Killed within a record, after the checkpoint of iteration 5.
        let whole = io::read_bytes(&name(0)).unwrap();
        io::write_atomically(&name(0), true, |file| file.write_all(&whole[..whole.len() - 3])).unwrap();
        write(&mut EventLog::open(folder.path(), 5).unwrap(), 6..=9);
        assert_eq!(steps(&name(0)), [0, 1, 2, 3, 4, 5]);
        assert_eq!(steps(&name(5)), [0, 6, 6, 7, 8, 9], "the mark, then the steps");
        // Killed again before any checkpoint, and resumed at the same iteration, then at an earlier one.
        write(&mut EventLog::open(folder.path(), 5).unwrap(), 6..=6);
        assert_eq!(steps(&name(5)), [0, 6, 6]);
        EventLog::open(folder.path(), 3).unwrap();
        assert!(!name(5).exists());
        assert_eq!(steps(&name(0)), [0, 1, 2, 3]);
        remove_all(folder.path()).unwrap();
        assert!(io::list_folder(folder.path()).unwrap().is_empty());
    }
}

//! Finds out which outputs are there already, and that they were made in the same way of the same files.

use std::fmt;
use std::path::Path;

use serde_json::Value;

use super::{Stages, Watcher};
use crate::core::error::{Error, Result};
use crate::core::provenance::Provenance;
use crate::io::{is_whole, read_provenance, remove};

/// The jobs whose outputs are not there yet; tells how many are, and which of them are not whole.
///
/// # Errors
/// When an output carries a provenance that says it was made otherwise.
pub(super) fn remaining<S: Stages>(
    stages: &S,
    jobs: Vec<S::Job>,
    watcher: &dyn Watcher,
) -> Result<Vec<S::Job>> {
    let count = jobs.len();
    let mut remaining = Vec::with_capacity(count);
    for job in jobs {
        if is_broken(stages.output(&job))? {
            watcher.warn(&format_args!(
                "{} was not written to its end, and is made anew",
                stages.output(&job).display()
            ));
            remaining.push(job);
        } else if !is_done(stages, &job)? {
            remaining.push(job);
        }
    }
    watcher.tell(&format_args!("{} of {count} images are there", count - remaining.len()));
    Ok(remaining)
}

/// Whether the output of a job is there.
///
/// # Errors
/// When it carries a provenance that says it was made otherwise.
pub(super) fn is_done<S: Stages>(stages: &S, job: &S::Job) -> Result<bool> {
    let output = stages.output(job);
    let mut made = match find(output)? {
        Found::Nothing => return Ok(false),
        Found::Silent => return Ok(true),
        Found::Made(made) => made.config,
    };
    stages.forget_places(&mut made);
    let agrees = |said: &Value| {
        said.as_object().is_some_and(|keys| keys.iter().all(|(key, value)| made.get(key) == Some(value)))
    };
    if agrees(&stages.describe(job)) && agrees(&stages.identify(job)?) {
        Ok(true)
    } else {
        Err(otherwise(output))
    }
}

/// Whether a file is in an output's place that was not written to its end, as far as [`is_whole`] tells.
///
/// # Errors
/// [`Error::Io`] when it cannot be read.
pub fn is_broken(output: &Path) -> Result<bool> {
    Ok(output.exists() && !is_whole(output)?)
}

/// Removes what is in an output's place and was not written to its end, which the output is about to take.
///
/// # Errors
/// As [`is_broken`]; [`Error::Io`] when it cannot be removed.
pub(super) fn make_way(output: &Path) -> Result<()> {
    if is_broken(output)? { remove(output) } else { Ok(()) }
}

/// Writes an output of a run that keeps what is there, where `resume` says so: one that another process has made as `wanted`
/// says meanwhile is kept too.
///
/// # Errors
/// Those of `write` and of [`is_made`].
pub fn write_or_keep(
    output: &Path,
    resume: bool,
    wanted: &Provenance,
    write: impl FnOnce() -> Result<()>,
) -> Result<()> {
    if resume {
        make_way(output)?;
    }
    match write() {
        Err(error) if resume && error.is_already_there() && is_made(output, wanted)? => Ok(()),
        written => written,
    }
}

/// Whether an image is there that was made as `wanted` says.
///
/// # Errors
/// [`Error::Unsupported`] for one that says that it was made otherwise; those of reading it.
pub fn is_made(output: &Path, wanted: &Provenance) -> Result<bool> {
    let made = match find(output)? {
        Found::Nothing => return Ok(false),
        Found::Silent => return Ok(true),
        Found::Made(made) => made,
    };
    let is_same = made.command == wanted.command && made.config == wanted.config;
    if is_same { Ok(true) } else { Err(otherwise(output)) }
}

/// What is there of an output.
enum Found {
    Nothing,
    /// A file that cannot say how it was made, which is taken for done.
    Silent,
    Made(Provenance),
}

fn find(output: &Path) -> Result<Found> {
    if !output.exists() {
        return Ok(Found::Nothing);
    }
    let carries_provenance =
        output.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr"));
    match read_provenance(output)? {
        Some(made) => Ok(Found::Made(made)),
        None if carries_provenance => Err(Error::Unsupported(format!(
            "{} is not of this program, which tells in each EXR how it was made; name another folder, or pass \
             --overwrite instead of --resume",
            output.display()
        ))),
        None => Ok(Found::Silent),
    }
}

/// How many outputs of a run that goes on were there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Kept {
    /// Those that are kept.
    pub whole: usize,
    /// Those that were not written to their end, and are made anew.
    pub broken: usize,
}

impl fmt::Display for Kept {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.whole > 0 {
            write!(f, ", {} of them were there", self.whole)?;
        }
        match self.broken {
            0 => Ok(()),
            1 => write!(f, ", one was not written to its end and was made anew"),
            several => write!(f, ", {several} were not written to their end and were made anew"),
        }
    }
}

fn otherwise(output: &Path) -> Error {
    Error::Unsupported(format!(
        "{} was made with other settings or of other files; use the same flags, or pass --overwrite instead of \
         --resume",
        output.display()
    ))
}

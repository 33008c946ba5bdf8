//! Finds out which outputs are there already, and that they were made in the same way of the same files.

use serde_json::Value;

use super::{Stages, Watcher};
use crate::core::error::{Error, Result};
use crate::io::read_provenance;

/// The jobs whose outputs are not there yet; tells how many are.
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
        if !is_done(stages, &job)? {
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
    if !output.exists() {
        return Ok(false);
    }
    let made = read_provenance(output)?.map(|provenance| provenance.config);
    let carries_provenance =
        output.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr"));
    if made.is_none() && carries_provenance {
        return Err(Error::Unsupported(format!(
            "{} is not of this program, which tells in each EXR how it was made; name another folder, or pass \
             --overwrite instead of --resume",
            output.display()
        )));
    }
    // A format that cannot say how it was made is taken for done.
    let Some(mut made) = made else { return Ok(true) };
    stages.forget_places(&mut made);
    let agrees = |said: &Value| {
        said.as_object().is_some_and(|keys| keys.iter().all(|(key, value)| made.get(key) == Some(value)))
    };
    if !agrees(&stages.describe(job)) || !agrees(&stages.identify(job)?) {
        return Err(Error::Unsupported(format!(
            "{} was made with other settings or of other files; use the same flags, or pass --overwrite instead of \
             --resume",
            output.display()
        )));
    }
    Ok(true)
}

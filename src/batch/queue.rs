//! Works through files one after another while the next is read and the last is written.

use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use serde_json::{Map, Value};

use super::Watcher;
use super::resume::{is_done, make_way, remaining};
use crate::core::error::{Error, Result};
use crate::core::shard::Shard;
use crate::io::MadeFolder;

/// What is done to each job.
///
/// Reading, computing and writing run at the same time, each on a job of its own; a job waits for the next step to be
/// free, so that at most three are in memory.
pub trait Stages: Sync {
    /// What there is to do.
    type Job: Sync;
    /// What was read for it.
    type Input: Send;
    /// What is to be written.
    type Output: Send;

    /// What is being done to which file, for messages: `restoring a.exr`.
    fn doing(&self, job: &Self::Job) -> String;

    /// The file that it becomes.
    fn output<'a>(&self, job: &'a Self::Job) -> &'a Path;

    /// Everything that decides what it becomes, as far as it is known before the inputs are read.
    fn describe(&self, job: &Self::Job) -> Value;

    /// Takes out of what an output says of itself where files lay, which decides nothing.
    fn forget_places(&self, _made: &mut Value) {}

    /// What tells the files that it is made of from others, whatever their paths. It is asked for where the output is
    /// there, for it may take time.
    ///
    /// # Errors
    /// When a file cannot be read.
    fn identify(&self, _job: &Self::Job) -> Result<Value> {
        Ok(Value::Object(Map::new()))
    }

    /// Makes what all jobs need, while the first is read.
    fn prepare(&self) {}

    /// Reads what the job needs.
    ///
    /// # Errors
    /// When a file cannot be read or used.
    fn read(&self, job: &Self::Job) -> Result<Self::Input>;

    /// Computes the result.
    ///
    /// # Errors
    /// When there is none.
    fn compute(&self, job: &Self::Job, input: Self::Input) -> Result<Self::Output>;

    /// Writes it.
    ///
    /// # Errors
    /// When the file cannot be written.
    fn write(&self, job: &Self::Job, output: Self::Output) -> Result<()>;
}

/// Which of the jobs are done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Selection {
    /// Those of which run; other runs, perhaps at the same time, write the others into the same folder.
    pub shard: Shard,
    /// Only those whose outputs are not there.
    pub resume: bool,
}

/// Does the selected jobs, whose outputs lie in one folder, and tells of every file that is written. A job that fails does
/// not keep the others from being done; the failures are named at the end.
///
/// # Errors
/// The failures; an interrupt at once. Before any work, more shards than jobs; and where outputs are kept, one that says it
/// was made otherwise.
pub fn run<S: Stages>(
    stages: &S,
    jobs: Vec<S::Job>,
    selection: Selection,
    watcher: &dyn Watcher,
) -> Result<()> {
    let Selection { shard, resume } = selection;
    shard.check(jobs.len(), "images")?;
    let mut jobs = shard.choose(jobs);
    if resume {
        jobs = remaining(stages, jobs, watcher)?;
    }
    let folder = jobs.first().and_then(|job| stages.output(job).parent());
    let made = folder.map_or(Ok(MadeFolder::default()), MadeFolder::create)?;
    if shard.is_part() {
        made.keep();
    }
    run_all(stages, &jobs, resume, watcher)
}

fn run_all<S: Stages>(stages: &S, jobs: &[S::Job], resume: bool, watcher: &dyn Watcher) -> Result<()> {
    // A single job shows its own progress.
    let progress = watcher.progress();
    let progress = if jobs.len() > 1 { progress.clone() } else { progress.without_bars() };
    let bar = progress.bar(jobs.len() as u64, "images");
    let single = match jobs {
        [job] => Some(watcher.progress().task(stages.doing(job))),
        _ => None,
    };
    let failures = std::thread::scope(|scope| {
        let (read, inputs) = sync_channel(0);
        let (computed, outputs) = sync_channel(0);
        scope.spawn(move || read_jobs(stages, jobs, watcher, &read));
        let writer =
            scope.spawn(|| write_jobs(stages, outputs, (jobs.len() > 1, resume), watcher, || bar.inc(1)));
        if !jobs.is_empty() {
            stages.prepare();
        }
        let stopped = compute_jobs(stages, inputs, &computed);
        drop(computed);
        let failures = writer.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        stopped.map(|()| failures)
    })?;
    bar.finish_and_clear();
    drop(single);
    if failures.is_empty() {
        return Ok(());
    }
    let (failed, all) = (failures.len(), jobs.len());
    Err(Error::Unsupported(format!("{failed} of {all} images were not done: {}", failures.join("; "))))
}

type Inputs<'a, S> = (&'a <S as Stages>::Job, Result<<S as Stages>::Input>);
type Outcomes<'a, S> = (&'a <S as Stages>::Job, Result<<S as Stages>::Output>);

fn read_jobs<'a, S: Stages>(
    stages: &S,
    jobs: &'a [S::Job],
    watcher: &dyn Watcher,
    read: &SyncSender<Inputs<'a, S>>,
) {
    for job in jobs {
        let input = watcher.progress().check().and_then(|()| stages.read(job));
        // Nobody listens any more after an interrupt.
        if read.send((job, input)).is_err() {
            return;
        }
    }
}

/// Ends early when the user asked for it or the writer is gone.
fn compute_jobs<'a, S: Stages>(
    stages: &S,
    inputs: Receiver<Inputs<'a, S>>,
    computed: &SyncSender<Outcomes<'a, S>>,
) -> Result<()> {
    for (job, input) in inputs {
        let output = input.and_then(|input| stages.compute(job, input));
        match output {
            Err(error) if error.is_interrupt() => return Err(error),
            output => {
                if computed.send((job, output)).is_err() {
                    break;
                }
            }
        }
    }
    Ok(())
}

fn write_jobs<'a, S: Stages>(
    stages: &S,
    outputs: Receiver<Outcomes<'a, S>>,
    (several, resume): (bool, bool),
    watcher: &dyn Watcher,
    on_job: impl Fn(),
) -> Result<Vec<String>>
where
    S::Job: 'a,
{
    let mut failures = Vec::new();
    for (job, output) in outputs {
        let write = |output| {
            if resume {
                make_way(stages.output(job))?;
            }
            stages.write(job, output)
        };
        let written = output.and_then(|output| match write(output) {
            // Another process, as a job that a cluster began again, has made the same meanwhile.
            Err(error) if resume && error.is_already_there() && is_done(stages, job)? => Ok(()),
            written => written,
        });
        if written.is_ok() {
            watcher.tell(&stages.output(job).display());
        }
        on_job();
        match written.map_err(|error| error.while_doing(stages.doing(job))) {
            Ok(()) => {}
            Err(error) if !several => return Err(error),
            Err(error) => {
                let said = error.in_full();
                watcher.warn(&said);
                failures.push(said);
            }
        }
    }
    Ok(failures)
}

#[cfg(test)]
mod tests;

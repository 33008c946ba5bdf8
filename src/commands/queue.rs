//! Works through files one after another while the next is read and the last is written.

use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use anyhow::{Context as _, Result, bail};
use serde_json::{Map, Value};

use udc::io::read_provenance;

use super::{Session, was_interrupted};

/// What is done to each job.
///
/// Reading, computing and writing run at the same time, each on a job of its own; a job waits for the next step to be
/// free, so that at most three are in memory.
pub(crate) trait Stages: Sync {
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
    fn identify(&self, _job: &Self::Job) -> Result<Value> {
        Ok(Value::Object(Map::new()))
    }
    /// Makes what all jobs need, while the first is read.
    fn prepare(&self) {}
    /// Reads what the job needs.
    fn read(&self, job: &Self::Job) -> Result<Self::Input>;
    /// Computes the result.
    fn compute(&self, job: &Self::Job, input: Self::Input) -> Result<Self::Output>;
    /// Writes it, and tells the user.
    fn write(&self, job: &Self::Job, output: Self::Output) -> Result<()>;
}

/// The jobs whose outputs are not there yet; tells the user how many are.
///
/// # Errors
/// When an output carries a provenance that says it was made otherwise.
pub(crate) fn remaining<S: Stages>(stages: &S, jobs: Vec<S::Job>, session: &Session) -> Result<Vec<S::Job>> {
    let count = jobs.len();
    let mut remaining = Vec::with_capacity(count);
    for job in jobs {
        if !is_done(stages, &job)? {
            remaining.push(job);
        }
    }
    session.tell(format_args!("{} of {count} images are there", count - remaining.len()));
    Ok(remaining)
}

fn is_done<S: Stages>(stages: &S, job: &S::Job) -> Result<bool> {
    let output = stages.output(job);
    if !output.exists() {
        return Ok(false);
    }
    let made = read_provenance(output)?.map(|provenance| provenance.config);
    let carries_provenance =
        output.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr"));
    if made.is_none() && carries_provenance {
        bail!(
            "{} is not of this program, which tells in each EXR how it was made; name another folder, or pass \
             --overwrite instead of --resume",
            output.display()
        );
    }
    // A format that cannot say how it was made is taken for done.
    let Some(mut made) = made else { return Ok(true) };
    stages.forget_places(&mut made);
    let agrees = |said: &Value| {
        said.as_object().is_some_and(|keys| keys.iter().all(|(key, value)| made.get(key) == Some(value)))
    };
    if !agrees(&stages.describe(job)) || !agrees(&stages.identify(job)?) {
        bail!(
            "{} was made with other settings or of other files; use the same flags, or pass --overwrite instead of \
             --resume",
            output.display()
        );
    }
    Ok(true)
}

type Outcomes<'a, S> = (&'a <S as Stages>::Job, Result<<S as Stages>::Output>);

/// Does all jobs. A job that fails does not keep the others from being done; the failures are named at the end.
///
/// # Errors
/// The failures; an interrupt at once.
pub(crate) fn run_all<S: Stages>(stages: &S, jobs: &[S::Job], session: &Session) -> Result<()> {
    // A single job shows its own progress.
    let progress = if jobs.len() > 1 { session.progress.clone() } else { session.progress.without_bars() };
    let bar = progress.bar(jobs.len() as u64, "images");
    let failures = std::thread::scope(|scope| {
        let (read, inputs) = sync_channel(0);
        let (computed, outputs) = sync_channel(0);
        scope.spawn(move || read_jobs(stages, jobs, session, &read));
        let writer = scope.spawn(|| write_jobs(stages, outputs, jobs.len() > 1, session, || bar.inc(1)));
        if !jobs.is_empty() {
            stages.prepare();
        }
        let stopped = compute_jobs(stages, inputs, &computed);
        drop(computed);
        let failures = writer.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        stopped.map(|()| failures)
    })?;
    bar.finish_and_clear();
    if failures.is_empty() {
        return Ok(());
    }
    bail!("{} of {} images were not done: {}", failures.len(), jobs.len(), failures.join("; "))
}

fn read_jobs<'a, S: Stages>(
    stages: &S,
    jobs: &'a [S::Job],
    session: &Session,
    read: &SyncSender<(&'a S::Job, Result<S::Input>)>,
) {
    for job in jobs {
        let input = session.progress.check().map_err(anyhow::Error::from).and_then(|()| stages.read(job));
        // Nobody listens any more after an interrupt.
        if read.send((job, input)).is_err() {
            return;
        }
    }
}

/// Ends early when the user asked for it or the writer is gone.
fn compute_jobs<'a, S: Stages>(
    stages: &S,
    inputs: Receiver<(&'a S::Job, Result<S::Input>)>,
    computed: &SyncSender<Outcomes<'a, S>>,
) -> Result<()> {
    for (job, input) in inputs {
        let output = input.and_then(|input| stages.compute(job, input));
        match output {
            Err(error) if was_interrupted(&error) => return Err(error),
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
    several: bool,
    session: &Session,
    on_job: impl Fn(),
) -> Result<Vec<String>>
where
    S::Job: 'a,
{
    let mut failures = Vec::new();
    for (job, output) in outputs {
        let written = output.and_then(|output| stages.write(job, output));
        on_job();
        match written.with_context(|| stages.doing(job)) {
            Ok(()) => {}
            Err(error) if !several => return Err(error),
            Err(error) => {
                session.warn(format_args!("{error:#}"));
                failures.push(format!("{error:#}"));
            }
        }
    }
    Ok(failures)
}

//! A training with its folder: configuration, log, checkpoints and models, so that it can be killed at any
//! moment and resumed to the same bytes.
//!
//! Each validation leaves pictures of its first images, `previews/<iteration>/<n>.png`: degraded, restored, clean.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde::Serialize;
use serde_json::{Value, json};

use super::checkpoint::{Best, Checkpoint, Checkpoints};
use super::config::TrainConfig;
use super::data::TrainingData;
use super::identity::DataIdentity;
use super::instruction_sets::InstructionSets;
use super::live::LiveView;
use super::log::{last_logged, open_log};
use super::tensorboard::{self, EventLog};
use super::trainer::{ADVICE, Step, Trainer};
use super::validation::{Validation, ValidationScore, Validator};
use crate::core::error::{Error, Result};
use crate::core::metrics::{Measure, Metric};
use crate::core::progress::Progress;
use crate::io::{self, LineLog};
use crate::network::weights::{self, Weights};
use crate::network::{Backends, Origin, Parameters};

/// The names in a run's folder.
const CONFIG_FILE: &str = "config.toml";
const LOG_FILE: &str = "metrics.jsonl";
const CHECKPOINTS: &str = "checkpoints";
const MODEL_FILE: &str = "model.safetensors";
const BEST_FILE: &str = "best.safetensors";
const PREVIEWS: &str = "previews";

/// What a run needs to know.
pub struct Job<'a> {
    /// How to train.
    pub config: &'a TrainConfig,
    /// What to learn from.
    pub data: &'a dyn TrainingData,
    /// What to measure on.
    pub validation: Option<&'a dyn TrainingData>,
    /// The configuration's `validation.metrics`, ready to measure.
    pub measures: &'a [Measure],
    /// Whether the data say themselves how they were formed: the configuration's `data.formation` is then not used, nor
    /// recorded.
    pub data_say_formation: bool,
    /// What tells the data from others; it goes into models and states.
    pub identity: DataIdentity,
    /// Where to compute.
    pub backends: Backends,
    /// Where to report, and whom to ask whether to stop.
    pub progress: &'a Progress,
    /// Where warnings go.
    pub warn: &'a dyn Fn(&str),
}

/// How a run begins.
#[derive(Clone, Debug)]
pub enum Start {
    /// From these weights, or random ones, in a folder without a run.
    New(Option<Parameters>),
    /// The same, after removing a run that is there, once a step of the new one was rehearsed.
    Replace(Option<Parameters>),
    /// From the latest checkpoint that is intact.
    Resume,
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Number of steps done in all.
    pub iteration: u64,
    /// Whether the user stopped it before its end; it can be resumed.
    pub interrupted: bool,
    /// The last step of this process, if it made one.
    pub last_step: Option<Step>,
    /// The last validation of this process, if it made one.
    pub last_validation: Option<Validation>,
    /// That of the weights that the run began with, if this process began it with weights.
    pub initial_validation: Option<Validation>,
}

impl Outcome {
    /// The last validation's means, metric by metric; none without a validation.
    pub fn validation_scores(&self) -> &[ValidationScore] {
        self.last_validation.as_ref().map_or(&[], |validation| &validation.scores)
    }

    /// What the weights that the run began with reached in a metric.
    pub fn initial(&self, metric: Metric) -> Option<f64> {
        self.initial_validation.as_ref()?.restored(metric)
    }
}

/// The configuration that a run began with.
///
/// # Errors
/// [`Error::Format`] when the folder holds no run; [`Error::Config`] when its configuration was damaged.
pub fn read_config(folder: &Path) -> Result<String> {
    let path = folder.join(CONFIG_FILE);
    if !path.is_file() {
        let reason =
            format!("there is no run to resume, it has no {CONFIG_FILE}; leave out --resume to begin one");
        return Err(Error::format(folder, reason));
    }
    io::read_text(&path)
}

impl Job<'_> {
    /// Trains until the configured number of iterations, or until the user asks to stop.
    ///
    /// # Errors
    /// [`Error::Format`] when the folder holds a run that is not to be replaced, or none to resume;
    /// [`Error::Config`] when a resumed run was configured otherwise or learned from other data; those of the data
    /// and of [`Trainer::step`]. Checkpoints are kept whatever happens.
    pub fn run(&self, folder: &Path, start: Start) -> Result<Outcome> {
        self.config.validate()?;
        let validator = match self.validation {
            Some(data) if self.config.validation.every > 0 => {
                Some(Validator::new(data, self.measures, self.config)?)
            }
            _ => None,
        };
        let mut run = self.open(folder, start, validator)?;
        let interrupted = run.advance(self).and_then(|interrupted| {
            run.save_checkpoint(self)?;
            Ok(interrupted)
        });
        let interrupted = interrupted.map_err(|error| run.point_back(error))?;
        Ok(Outcome {
            iteration: run.trainer.iteration(),
            interrupted,
            last_step: run.last_step,
            last_validation: run.last_validation,
            initial_validation: run.initial_validation,
        })
    }

    fn open(&self, folder: &Path, start: Start, validator: Option<Validator>) -> Result<Run> {
        let checkpoints = Checkpoints::new(folder.join(CHECKPOINTS));
        let replaces = matches!(start, Start::Replace(_));
        let mut lock = if folder.is_dir() { io::try_lock_folder(folder)? } else { None };
        let (initial, checkpoint) = match start {
            Start::New(initial) => {
                refuse_run(folder)?;
                checkpoints.remove_unfinished()?;
                (initial, None)
            }
            Start::Replace(initial) => (initial, None),
            Start::Resume => (None, self.latest(folder, &checkpoints)?),
        };
        let begins_with_weights = initial.is_some();
        // What kept the weights that a run began with had computed nothing yet.
        let has_steps = |checkpoint: &&Checkpoint| checkpoint.state.iteration > 0;
        let kept =
            checkpoint.as_ref().filter(has_steps).and_then(|checkpoint| checkpoint.instruction_sets.clone());
        let instruction_sets =
            kept.unwrap_or_else(|| InstructionSets::current(&self.backends, self.config.precision));
        let (trainer, best) = match checkpoint {
            Some(Checkpoint { state, best, .. }) => {
                (Trainer::from_state(self.config, state, self.data.len(), &self.backends)?, best)
            }
            None => (Trainer::new(self.config, initial, self.data.len(), self.backends.clone())?, None),
        };
        if replaces {
            if holds_run(folder)? {
                // Rehearsed, so that the old run is not lost to data or settings that no step can be made with.
                trainer.clone().step(self.data)?;
            }
            remove_run(folder)?;
        }
        io::create_folder(folder)?;
        if lock.is_none() {
            lock = io::try_lock_folder(folder)?;
        }
        if begins_with_weights {
            // A run that is killed before its first checkpoint must not be resumed from random weights.
            checkpoints.await_first()?;
        }
        let text = self.recorded();
        io::write_atomically(&folder.join(CONFIG_FILE), true, |out| out.write_all(text.as_bytes()))?;
        let log = open_log(&folder.join(LOG_FILE), trainer.iteration())?;
        let events = EventLog::open(folder, trainer.iteration())?;
        let folder = folder.to_owned();
        let mut run = Run {
            folder,
            _lock: lock,
            checkpoints,
            log,
            events,
            trainer,
            instruction_sets,
            best,
            validator,
            last_step: None,
            last_validation: None,
            initial_validation: None,
        };
        if begins_with_weights {
            run.keep_initial(self)?;
        }
        Ok(run)
    }

    /// The checkpoint that a run goes on from; none where it had not come to one.
    fn latest(&self, folder: &Path, checkpoints: &Checkpoints) -> Result<Option<Checkpoint>> {
        self.check_same(folder)?;
        if checkpoints.awaits_first()? {
            let reason = "the run began with weights of --init and was stopped before it kept them; begin it again, with \
                          --init and without --resume";
            return Err(Error::format(folder, reason));
        }
        remove_unfinished(folder)?;
        let Some(checkpoint) = checkpoints.latest(&self.config.architecture, self.warn)? else {
            self.refuse_lost_checkpoints(folder)?;
            return Ok(None);
        };
        self.identity.check_same(&checkpoint.data)?;
        let (done, asked) = (checkpoint.state.iteration, self.config.iterations);
        if done > asked {
            let reason = format!("is {asked}, and the run has made {done} already; give at least as many");
            return Err(Error::config("iterations", reason));
        }
        Ok(Some(checkpoint))
    }

    /// Refuses to begin a run anew that has come past its first checkpoint, which is gone: its model would be lost.
    fn refuse_lost_checkpoints(&self, folder: &Path) -> Result<()> {
        let model = folder.join(MODEL_FILE);
        let every = self.config.checkpoint.every;
        // The model is written after a checkpoint, as are the lines of later steps.
        let has_passed = every > 0 && last_logged(&folder.join(LOG_FILE))? > every;
        if !has_passed && !model.exists() {
            return Ok(());
        }
        let checkpoints = folder.join(CHECKPOINTS);
        Err(Error::format(
            checkpoints,
            format!(
                "holds no checkpoint to go on from, though the run has kept one: put the folder back; or begin another run with \
                 --init {}, or this one anew with --overwrite and without --resume",
                model.display()
            ),
        ))
    }

    /// Refuses to resume a run under another configuration than its own.
    fn check_same(&self, folder: &Path) -> Result<()> {
        let before = TrainConfig::from_toml(&read_config(folder)?, &[])?;
        match self.config.first_difference(&before) {
            None => Ok(()),
            Some(difference) => Err(Error::config(
                "configuration",
                format!(
                    "{difference} when the run began; resume with its own {CONFIG_FILE}, or begin a new run"
                ),
            )),
        }
    }

    /// The configuration as TOML, without what it did not decide.
    fn recorded(&self) -> String {
        let text = self.config.to_toml();
        if self.data_say_formation { without_formation(&text) } else { text }
    }

    /// What a model file says of its training; nothing that another process on another day would say
    /// differently with the same instruction set.
    fn describe(&self, iteration: u64, instruction_sets: &InstructionSets) -> Value {
        let mut config = serde_json::to_value(self.config).expect("configurations are plain data");
        if self.data_say_formation
            && let Some(data) = config["data"].as_object_mut()
        {
            data.remove("formation");
        }
        json!({
            "program": concat!("udc ", env!("CARGO_PKG_VERSION")), "iteration": iteration, "config": config,
            "tone-curve": self.identity.tone_curve, "instruction-sets": instruction_sets.to_string(),
        })
    }
}

/// Whether a run has got somewhere in a folder; one that failed at its first step may be begun again.
fn holds_run(folder: &Path) -> Result<bool> {
    let log = folder.join(LOG_FILE);
    let has_log = log.is_file() && !io::read_text(&log)?.is_empty();
    let checkpoints = Checkpoints::new(folder.join(CHECKPOINTS));
    let has_checkpoint = !checkpoints.iterations()?.is_empty();
    // Those of weights that a run began with are kept before its first checkpoint is.
    let has_best = folder.join(BEST_FILE).exists() && !checkpoints.awaits_first()?;
    Ok(has_log || has_checkpoint || has_best || folder.join(MODEL_FILE).exists())
}

fn refuse_run(folder: &Path) -> Result<()> {
    if holds_run(folder)? {
        let reason = "there is a run already; pass --resume to go on with it, --overwrite to begin anew, or name \
                      another folder";
        return Err(Error::format(folder, reason));
    }
    let config = folder.join(CONFIG_FILE);
    if config.is_file() && !is_recorded(&io::read_text(&config)?) {
        let reason = "it is not of a run, which would write its own over it; name another folder with -o, or rename the file";
        return Err(Error::format(&config, reason));
    }
    Ok(())
}

/// Whether a configuration is what a run writes, in which no comment and no other section would be lost.
fn is_recorded(text: &str) -> bool {
    TrainConfig::from_toml(text, &[]).is_ok_and(|config| {
        let whole = config.to_toml();
        text == whole || text == without_formation(&whole)
    })
}

/// The TOML of a configuration without what data decide.
fn without_formation(text: &str) -> String {
    let mut is_used = true;
    let used = |line: &&str| {
        if line.starts_with('[') {
            is_used = !line.starts_with("[data.formation");
        }
        is_used
    };
    text.lines().filter(used).map(|line| format!("{line}\n")).collect()
}

/// Removes what killed processes left of files that they were writing; of checkpoints, reading them does it.
fn remove_unfinished(folder: &Path) -> Result<()> {
    let previews = folder.join(PREVIEWS);
    let names = if previews.is_dir() { io::list_folder(&previews)? } else { Vec::new() };
    let folders = names.iter().map(|name| previews.join(name)).chain([folder.to_owned()]);
    folders.into_iter().try_for_each(|folder| io::remove_unfinished(&folder, Duration::ZERO))
}

fn remove_run(folder: &Path) -> Result<()> {
    remove_unfinished(folder)?;
    let names = [CONFIG_FILE, LOG_FILE, CHECKPOINTS, MODEL_FILE, BEST_FILE, PREVIEWS];
    names.iter().try_for_each(|name| io::remove(&folder.join(name)))?;
    tensorboard::remove_all(folder)
}

/// A run between two steps.
struct Run {
    folder: PathBuf,
    /// Keeps other processes from training in the folder.
    _lock: Option<File>,
    checkpoints: Checkpoints,
    log: LineLog,
    events: EventLog,
    trainer: Trainer,
    instruction_sets: InstructionSets,
    best: Option<Best>,
    validator: Option<Validator>,
    last_step: Option<Step>,
    last_validation: Option<Validation>,
    initial_validation: Option<Validation>,
}

impl Run {
    /// Measures and keeps the weights that the run begins with: none after them may be better.
    fn keep_initial(&mut self, job: &Job<'_>) -> Result<()> {
        self.validate(job)?;
        self.initial_validation = self.last_validation.take();
        self.save_checkpoint(job)
    }

    /// Makes steps until the end; true when the user stopped it before.
    fn advance(&mut self, job: &Job<'_>) -> Result<bool> {
        let config = job.config;
        let bar = job.progress.bar(config.iterations, "steps");
        bar.start_at(self.trainer.iteration());
        let mut view = LiveView::new(config.validation.best, self.best);
        while self.trainer.iteration() < config.iterations {
            if job.progress.check().is_err() {
                return Ok(true);
            }
            if self.last_step.is_none() {
                // Only now: a run that has ended keeps its model's arithmetic, whoever looks at it.
                self.instruction_sets =
                    self.instruction_sets.followed((&job.backends, config.precision), job.warn);
            }
            let started = Instant::now();
            let step = self.trainer.step(job.data)?;
            let taken = started.elapsed();
            let is_due = |every: u64| every > 0 && step.iteration.is_multiple_of(every);
            if is_due(config.log_every) {
                self.write_line(&step)?;
                let Step { iteration, loss, learning_rate, gradient_norm } = step;
                let values =
                    [("loss", loss), ("learning_rate", learning_rate), ("gradient_norm", gradient_norm)];
                let values = values.map(|(name, value)| (format!("train/{name}"), value));
                self.events.write(iteration, &values)?;
            }
            self.last_step = Some(step);
            if is_due(config.validation.every) {
                self.validate(job)?;
            }
            if is_due(config.checkpoint.every) {
                self.save_checkpoint(job)?;
            }
            view.note_validation(self.last_validation.as_ref(), self.best);
            bar.show(view.after(&step, taken, self.trainer.waited()));
            bar.inc(1);
        }
        bar.finish_and_clear();
        Ok(false)
    }

    fn write_line(&mut self, line: &impl Serialize) -> Result<()> {
        self.log.append(&serde_json::to_string(line).expect("log lines are plain data"))
    }

    fn validate(&mut self, job: &Job<'_>) -> Result<()> {
        let Some(validator) = &self.validator else { return Ok(()) };
        let weights = self.weights(job);
        let iteration = self.trainer.iteration();
        let previews = self.folder.join(PREVIEWS).join(iteration.to_string());
        let validation = validator.run((&weights, job.backends.first()), iteration, &previews).map_err(
            |error| match error {
                Error::Diverged(what) => Error::Diverged(format!(
                    "the training diverged: at the validation after iteration {iteration}, {what}; {ADVICE}"
                )),
                error => error,
            },
        )?;
        let metric = job.config.validation.best;
        if let Some(value) = validation.restored(metric)
            && self.best.is_none_or(|best| metric.is_better(value, best.value))
        {
            self.best = Some(Best { iteration, value });
            weights::write(&self.folder.join(BEST_FILE), &weights, true)?;
        }
        self.write_line(&validation)?;
        let values =
            validation.named().into_iter().map(|(name, value)| (format!("validation/{name}"), value));
        self.events.write(iteration, &values.collect::<Vec<_>>())?;
        self.last_validation = Some(validation);
        Ok(())
    }

    /// Adds to what a training ended by which checkpoint there is to go back to.
    fn point_back(&self, error: Error) -> Error {
        let Error::Diverged(what) = error else { return error };
        let last = self
            .checkpoints
            .iterations()
            .unwrap_or_default()
            .last()
            .map(|&last| self.checkpoints.model(last));
        Error::Diverged(match last {
            Some(model) => format!(
                "{what}; the run's last checkpoint is kept, a new run can begin with --init {}, or with that of an earlier \
                 one",
                model.display()
            ),
            None => format!("{what}; the run has no checkpoint yet, begin it again with --overwrite"),
        })
    }

    /// Writes a checkpoint and, once it is complete, the run's model; neither of weights that compute nothing finite.
    fn save_checkpoint(&self, job: &Job<'_>) -> Result<()> {
        self.trainer.check()?;
        self.log.sync()?;
        let weights = self.weights(job);
        let (state, data) = (self.trainer.state().into_owned(), job.identity.parts());
        let instruction_sets = Some(self.instruction_sets.clone());
        let checkpoint = Checkpoint { state, best: self.best, data, instruction_sets };
        self.checkpoints.save(&checkpoint, &weights, job.config.checkpoint.keep)?;
        weights::write(&self.folder.join(MODEL_FILE), &weights, true)
    }

    fn weights(&self, job: &Job<'_>) -> Weights {
        Weights {
            architecture: job.config.architecture.clone(),
            parameters: self.trainer.weights().into_owned(),
            origin: Origin {
                training: Some(job.describe(self.trainer.iteration(), &self.instruction_sets)),
                kernel_bank_sha256: job.identity.kernel_bank_sha256.clone(),
                state_dict: None,
            },
        }
    }
}

//! Describes how far a training run has come, and what a checkpoint of it holds.

use std::fmt;
use std::path::Path;

use serde::{Serialize, Serializer};
use serde_json::{Map, Value};

use super::Inspection;
use super::model::ModelDescription;
use super::tensors::TensorsDescription;
use super::text::plain;
use crate::core::error::{Error, Result};
use crate::io::read_text;
use crate::network::Architecture;
use crate::train::TrainConfig;

const CONFIG: &str = "config.toml";
const LOG: &str = "metrics.jsonl";
const MODEL: &str = "model.safetensors";

/// What a checkpoint goes on from, beside its model.
const STATE: &str = "state.safetensors";

/// What a state says of its training, beside the iteration, and how people are told of it.
const FACTS: [(&str, &str); 3] = [
    ("instruction-sets", "computed with"),
    ("best-iteration", "best iteration"),
    ("best-value", "best value"),
];

/// How far a training run has come.
#[derive(Clone, Debug, Serialize)]
pub struct RunDescription {
    /// The latest iteration that the log or the model tells of.
    pub iteration: u64,
    /// The iteration that the training ends at.
    pub iterations: u64,
    /// The last number of each kind in the log.
    pub last: Map<String, Value>,
    /// The model, where one was written.
    #[serde(serialize_with = "as_inspected")]
    pub model: Option<ModelDescription>,
    #[serde(skip)]
    architecture: Architecture,
}

/// What a checkpoint of a run holds.
#[derive(Clone, Debug, Serialize)]
pub struct CheckpointDescription {
    /// The iteration that it was written at.
    pub iteration: Value,
    /// Its model.
    #[serde(serialize_with = "as_inspected")]
    pub model: ModelDescription,
    /// What the state says beside it, by its keys.
    #[serde(flatten)]
    pub facts: Map<String, Value>,
}

/// Writes a model as its own inspection is written, with its kind.
fn as_inspected<S: Serializer, M: Clone + Into<Option<ModelDescription>>>(
    model: &M,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    model.clone().into().map(Inspection::Model).serialize(serializer)
}

/// Whether a folder is that of a training run.
pub(super) fn is_run(folder: &Path) -> bool {
    let has = |name: &str| folder.join(name).exists();
    has(CONFIG) && [LOG, MODEL, "checkpoints"].into_iter().any(has)
}

/// Whether a folder is a checkpoint of a run: `checkpoints/<iteration>`.
pub(super) fn is_checkpoint(folder: &Path) -> bool {
    folder.join(STATE).is_file() && !is_run(folder)
}

impl RunDescription {
    /// Describes a run by its configuration, log and model.
    pub(super) fn read(folder: &Path) -> Result<Self> {
        let config = TrainConfig::from_toml(&read_text(&folder.join(CONFIG))?, &[]).map_err(|error| {
            error.while_doing(format!("reading the configuration of {}", folder.display()))
        })?;
        let log = folder.join(LOG);
        let last = last_values(&if log.is_file() { read_text(&log)? } else { String::new() });
        let model = folder.join(MODEL);
        let model = model.is_file().then(|| ModelDescription::read(&model)).transpose()?;
        // The log has not every iteration, and the model is not of the last one.
        let trained = model.as_ref().and_then(|model| model.training.as_ref()?.get("iteration"));
        let iterations = [last.get("iteration"), trained];
        let iteration = iterations.into_iter().flatten().filter_map(Value::as_u64).max().unwrap_or(0);
        Ok(Self { iteration, iterations: config.iterations, last, model, architecture: config.architecture })
    }
}

impl CheckpointDescription {
    /// Describes a checkpoint by its state and model.
    pub(super) fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(STATE);
        let mut state = TensorsDescription::read(&path)?.metadata;
        let iteration = state.remove("iteration").ok_or_else(|| {
            let reason = "is no training state: it does not say its iteration";
            Error::Unsupported(format!("{} {reason}", path.display()))
        })?;
        let model = ModelDescription::read(&folder.join(MODEL))?;
        let fact = |(key, _): (&str, &str)| Some((key.to_owned(), state.remove(key)?));
        Ok(Self { iteration, model, facts: FACTS.into_iter().filter_map(fact).collect() })
    }
}

impl fmt::Display for RunDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "training run, iteration {} of {}", self.iteration, self.iterations)?;
        for (name, value) in self.last.iter().filter(|(name, _)| *name != "iteration") {
            writeln!(f, "  {name:<17} {value}")?;
        }
        match &self.model {
            Some(model) => model.fmt(f),
            None => write!(f, "no model yet\n{}", self.architecture.describe()),
        }
    }
}

impl fmt::Display for CheckpointDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "checkpoint of a training, iteration {}", plain(&self.iteration))?;
        for (key, name) in FACTS {
            if let Some(value) = self.facts.get(key) {
                writeln!(f, "  {name:<16}{}", plain(value))?;
            }
        }
        self.model.fmt(f)
    }
}

/// The last number of each kind in a log; a line that was cut off is none.
fn last_values(log: &str) -> Map<String, Value> {
    let mut last = Map::new();
    for line in log.lines() {
        if let Ok(Value::Object(values)) = serde_json::from_str(line) {
            last.extend(values.into_iter().filter(|(_, value)| value.is_number()));
        }
    }
    last
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_last_numbers_are_those_before_a_cut_line() {
        let log = "{\"iteration\":1,\"psnr\":20.5}\n{\"iteration\":2,\"loss\":0.25}\n{\"iteration\":3,\"lo";
        let last = last_values(log);
        assert_eq!(Value::Object(last), json!({"iteration": 2, "psnr": 20.5, "loss": 0.25}));
    }
}

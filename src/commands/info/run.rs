//! Says how far a training run has come, and what a checkpoint of it holds.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context as _, Result, bail};
use serde_json::{Map, Value, json};

use udc::io::{FileDescription, describe, read_text};
use udc::train::TrainConfig;

/// What a checkpoint goes on from, beside its model.
const STATE: &str = "state.safetensors";

/// Whether a folder is that of a training run.
pub(super) fn is_run(folder: &Path) -> bool {
    let has = |name: &str| folder.join(name).exists();
    has("config.toml") && ["metrics.jsonl", "model.safetensors", "checkpoints"].into_iter().any(has)
}

/// What a run is, for scripts and for people.
pub(super) fn examine(folder: &Path) -> Result<(Value, String)> {
    let config = TrainConfig::from_toml(&read_text(&folder.join("config.toml"))?, &[])
        .with_context(|| format!("reading the configuration of {}", folder.display()))?;
    let log = folder.join("metrics.jsonl");
    let last = last_values(&if log.is_file() { read_text(&log)? } else { String::new() });
    let model = folder.join("model.safetensors");
    let (model, description) = match model.is_file() {
        true => super::examine_model(&model)?,
        false => (Value::Null, format!("no model yet\n{}", config.architecture.describe())),
    };
    // The log has not every iteration, and the model is not of the last one.
    let iterations = [last.get("iteration"), model.pointer("/training/iteration")];
    let iteration = iterations.into_iter().flatten().filter_map(Value::as_u64).max().unwrap_or(0);
    let mut text = format!("training run, iteration {iteration} of {}\n", config.iterations);
    for (name, value) in last.iter().filter(|(name, _)| *name != "iteration") {
        writeln!(text, "  {name:<14}{value}")?;
    }
    let object = json!({
        "kind": "run", "iteration": iteration, "iterations": config.iterations, "last": last, "model": model,
    });
    Ok((object, text + &description))
}

/// Whether a folder is a checkpoint of a run: `checkpoints/<iteration>`.
pub(super) fn is_checkpoint(folder: &Path) -> bool {
    folder.join(STATE).is_file() && !is_run(folder)
}

/// What a checkpoint is, for scripts and for people.
pub(super) fn examine_checkpoint(folder: &Path) -> Result<(Value, String)> {
    let path = folder.join(STATE);
    let FileDescription::Model(state) = describe(&path)? else {
        bail!("{} is no training state", path.display());
    };
    let Some(iteration) = state.metadata.get("iteration") else {
        bail!("{} is no training state: it does not say its iteration", path.display());
    };
    let (model, description) = super::examine_model(&folder.join("model.safetensors"))?;
    let mut object = json!({"kind": "checkpoint", "iteration": iteration, "model": model});
    let mut text = format!("checkpoint of a training, iteration {}\n", plain(iteration));
    for (key, name) in [
        ("instruction-sets", "computed with"),
        ("best-iteration", "best iteration"),
        ("best-value", "best value"),
    ] {
        if let Some(value) = state.metadata.get(key) {
            writeln!(text, "  {name:<16}{}", plain(value))?;
            object[key] = value.clone();
        }
    }
    Ok((object, text + &description))
}

/// A value as people read it: a text without its quotes.
fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
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

    #[test]
    fn the_last_numbers_are_those_before_a_cut_line() {
        let log = "{\"iteration\":1,\"psnr\":20.5}\n{\"iteration\":2,\"loss\":0.25}\n{\"iteration\":3,\"lo";
        let last = last_values(log);
        assert_eq!(Value::Object(last), json!({"iteration": 2, "psnr": 20.5, "loss": 0.25}));
    }
}

//! Looks at the configuration of a training, and at the folder of a run.

use std::path::{Path, PathBuf};

use serde_json::Value;

use super::dataset::tell_of_unfinished;
use super::{Findings, Role};
use crate::core::metrics::Metric;
use crate::io::{list_folder, read_configuration, read_text};
use crate::train::TrainConfig;

/// Looks at a configuration, and returns it where it can be read.
pub(super) fn look(path: &Path, findings: &mut Findings) -> Option<TrainConfig> {
    let about = path.display();
    let config = match read_configuration(path).and_then(|text| TrainConfig::from_toml(&text, &[])) {
        Ok(config) => config,
        Err(error) => {
            let mend = "mend the key that the text names; `udc train --help` and configs/ have examples";
            findings.refused(about, "configuration", &error, mend);
            return None;
        }
    };
    let missing: Vec<(&str, PathBuf)> =
        files_of(&config).into_iter().filter(|(_, path)| !path.exists()).collect();
    for (key, file) in &missing {
        let what = format!("{key} names {}, which is not there", file.display());
        let mend = format!(
            "put it there, or give its place: --set {key}=PATH (paths are relative to where udc runs)"
        );
        findings.fail(&about, "configuration-file-missing", what, mend);
    }
    let every = config.validation.every;
    if every == 0 || every > config.iterations {
        let what =
            format!("it never validates: validation.every is {every}, of {} iterations", config.iterations);
        let mend = "--set validation.every=N with a smaller N, so that best.safetensors is written";
        findings.warn(&about, "never-validated", what, mend);
    }
    if config.checkpoint.every > config.iterations {
        let what = format!(
            "it keeps no checkpoint before its end: checkpoint.every is {}, of {} iterations",
            config.checkpoint.every, config.iterations
        );
        findings.warn(
            &about,
            "never-kept",
            what,
            "--set checkpoint.every=N with a smaller N, so that it can be killed",
        );
    }
    if missing.is_empty() {
        let what = format!(
            "a training of {} weights, {} iterations of {} crops of {} × {}",
            config.architecture.parameters(),
            config.iterations,
            config.data.batch * config.data.accumulate,
            config.data.crop,
            config.data.crop
        );
        findings.ok(&about, "configuration", what);
    }
    Some(config)
}

/// The files that a training needs, by the keys that name them.
fn files_of(config: &TrainConfig) -> Vec<(&'static str, PathBuf)> {
    let mut files = Vec::new();
    let mut add = |key, file: &str| files.push((key, PathBuf::from(file)));
    if config.loss.perceptual.weight > 0.0 {
        add("loss.perceptual.file", &config.loss.perceptual.file);
    }
    if config.validation.metrics.contains(&Metric::Lpips) {
        add("validation.lpips-alexnet", &config.validation.lpips_alexnet);
        add("validation.lpips-linear", &config.validation.lpips_linear);
    }
    if let Some(examples) = &config.examples {
        files
            .extend(examples.scenes.panoramas.iter().map(|path| ("examples.scenes.panoramas", path.clone())));
        files.extend(examples.panels.psf.iter().map(|path| ("examples.panels.psf", path.clone())));
    }
    files
}

/// Looks at the folder of a run; what of it is looked at closer.
pub(super) fn parts_of_run(folder: &Path, findings: &mut Findings) -> Vec<(PathBuf, Role)> {
    let about = folder.display();
    let checkpoints = folder.join("checkpoints");
    tell_of_unfinished(folder, &[folder.to_owned(), checkpoints.clone()], findings);
    let names = list_folder(&checkpoints).unwrap_or_default();
    if let Some(draft) = names.iter().find(|name| name.ends_with(".partial")) {
        let what = format!("the checkpoint {draft} was not finished");
        findings.warn(
            &about,
            "leftovers",
            what,
            "go on with the run, which removes it: `udc train --resume`",
        );
    }
    if names.iter().all(|name| name.parse::<u64>().is_err()) {
        let what = "it has no checkpoint to go on from";
        findings.warn(
            &about,
            "no-checkpoint",
            what,
            "wait for the first, or begin anew with a smaller checkpoint.every",
        );
    }
    let log = read_text(&folder.join("metrics.jsonl")).unwrap_or_default();
    let lost = |line: &str| {
        let line: Option<Value> = serde_json::from_str(line).ok();
        line.is_some_and(|line| line.get("loss").is_some_and(Value::is_null))
    };
    if log.lines().any(lost) {
        let what = "its log holds a loss that is not finite";
        findings.fail(
            &about,
            "diverged",
            what,
            "begin anew with a smaller optimizer.learning-rate, or optimizer.clip-norm",
        );
    }
    let parts = [
        ("config.toml", Role::Configuration),
        ("model.safetensors", Role::Model),
        ("best.safetensors", Role::Model),
    ];
    let there = parts.map(|(name, role)| (folder.join(name), role)).into_iter();
    there.filter(|(path, _)| path.is_file()).collect()
}

//! Looks at a network's weights.

use std::path::Path;

use super::Findings;
use crate::network::Model;

/// Looks at a model, and returns it where it can be read: its reader refuses weights that are not finite, missing, left over
/// or of another shape.
pub(super) fn look(path: &Path, findings: &mut Findings) -> Option<Model> {
    let about = path.display();
    let model = match Model::load(path) {
        Ok(model) => model,
        Err(error) => {
            let mend = "take an earlier checkpoint of its run (RUN/checkpoints/N/model.safetensors), or copy it again";
            findings.refused(about, "model-unreadable", &error, mend);
            return None;
        }
    };
    let architecture = model.architecture();
    let (origin, parameters) = (model.origin(), architecture.parameters());
    let dead: Vec<&str> = model
        .weights()
        .parameters
        .iter()
        .filter(|parameter| parameter.values.len() > 1 && is_constant(&parameter.values))
        .map(|parameter| parameter.name.as_str())
        .collect();
    let of_weights: Vec<&&str> = dead.iter().filter(|name| name.ends_with("weight")).collect();
    if let Some(first) = of_weights.first() {
        let what = format!(
            "all weights of {first} are the same, of {} tensors so: it is not trained, or was damaged",
            of_weights.len()
        );
        let mend = "train it, or name the model of a run that has ended; a network that is only to begin a training is well so";
        findings.warn(&about, "model-untrained", what, mend);
    }
    if architecture.reads_code() && origin.kernel_bank_sha256.is_none() {
        let what = "it reads kernel codes, and does not say of which bank: codes of another bank mean something else to it";
        findings.warn(
            &about,
            "model-bank-unknown",
            what,
            "name the bank whose codes it was trained with, and no other",
        );
    }
    if origin.tone_curve().is_none() {
        let what = "it does not say under which tone curve it was trained";
        findings.warn(
            &about,
            "model-curve-unknown",
            what,
            "give --alpha and --x-max of its training to `udc restore`",
        );
    }
    let iteration = origin.training.as_ref().and_then(|training| training.get("iteration")?.as_u64());
    let trained = iteration.map_or(String::new(), |iteration| format!(", trained for {iteration} steps"));
    findings.ok(&about, "model", format!("a network of {parameters} finite weights{trained}"));
    Some(model)
}

fn is_constant(values: &[f32]) -> bool {
    values.iter().all(|value| value.total_cmp(&values[0]).is_eq())
}

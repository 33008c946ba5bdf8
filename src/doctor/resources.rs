//! Looks at what work with these things needs, against what there is: memory, disk, a folder to write to.

use std::path::Path;

use super::Findings;
use super::patient::{Opened, Patient};
use crate::core::bytes::format_bytes;
use crate::io::{available_memory_bytes, check_writable, free_disk_bytes};
use crate::restore::{KernelKnowledge, MemoryBudget, Restoration};
use crate::train::TrainConfig;

/// Bytes of a weight, and of what a checkpoint keeps of it: itself, the optimiser's two moments, and a running mean.
const WEIGHT_BYTES: u64 = 4;

/// Bytes that a degraded and a clean crop take, a pixel.
const PIXEL_BYTES: u64 = 2 * 3 * 4;

/// What a step computes of a batch takes so many times its images, for a network of 32 features: 16 crops of 800 × 800 take
/// some 60 GiB.
const STEP_SHARE: u64 = 250;
const FEATURES: u64 = 32;

pub(super) fn look(patient: &Patient, opened: &Opened, findings: &mut Findings) {
    let memory = available_memory_bytes();
    for (path, config) in &opened.configurations {
        let needed = training_bytes(config);
        tell_of_memory(
            path,
            ("training-memory", "with its cache of images, the training takes about", needed),
            memory,
            findings,
        );
        let kept = kept_bytes(config);
        let place = patient.output.as_deref().unwrap_or(Path::new("."));
        tell_of_disk(path, kept, free_disk_bytes(place), findings);
    }
    restoring(opened, memory, findings);
    if let Some(output) = &patient.output {
        match check_writable(output) {
            Ok(()) => findings.ok(output.display(), "output-writable", "results can be written there"),
            Err(error) => {
                findings.refused(
                    output.display(),
                    "output-writable",
                    &error,
                    "name another folder, or ask for the right to write",
                );
            }
        }
    }
}

/// What restoring the largest of the images with each model takes.
fn restoring(opened: &Opened, memory: Option<u64>, findings: &mut Findings) {
    let of_datasets = opened.datasets.iter().flat_map(|(_, sizes)| sizes.iter());
    let sizes = of_datasets.chain(opened.images.iter().map(|(_, size)| size));
    let Some(&size) = sizes.max_by_key(|[height, width]| height * width) else { return };
    let kernel = opened.psfs.first().map(|(_, psf)| KernelKnowledge::of_psf(psf.clone()));
    for (path, model) in &opened.models {
        let architecture = model.architecture();
        let knowledge = match (&kernel, architecture.code_len()) {
            (Some(kernel), None) => kernel.clone(),
            (_, Some(length)) if architecture.reads_code() => KernelKnowledge::Code(vec![0.0; length].into()),
            (None, _) if !architecture.planes().is_empty() => continue,
            _ => KernelKnowledge::Nothing,
        };
        let budget = MemoryBudget { limit_bytes: memory.unwrap_or(u64::MAX), ..MemoryBudget::default() };
        let plan = Restoration::by_network(model.clone(), knowledge)
            .and_then(|restoration| restoration.with_memory(budget).plan(size));
        let check = "restoring-memory";
        match plan {
            Ok(plan) => findings.ok(path.display(), check, format!("restoring an image of {plan}")),
            Err(error) => {
                let mend = "end other programs, or restore smaller images";
                findings.refused(path.display(), check, &error, mend);
            }
        }
    }
}

/// About what a training takes: a step, the weights with what the optimiser keeps, and the images that are kept.
fn training_bytes(config: &TrainConfig) -> u64 {
    let data = &config.data;
    let batch = (data.batch as u64).saturating_mul((data.crop as u64).pow(2)).saturating_mul(PIXEL_BYTES);
    let features = config.architecture.features as u64;
    let step = batch.saturating_mul(STEP_SHARE).saturating_mul(features) / FEATURES;
    let of_weights = config.architecture.parameters() * WEIGHT_BYTES * 6;
    step + of_weights + ((data.cache_mib as u64) << 20)
}

/// What a run keeps on disk: checkpoints, one of them being written, with their models; the latest and the best model.
fn kept_bytes(config: &TrainConfig) -> u64 {
    let mean = u64::from(config.optimizer.ema_decay > 0.0);
    let of_checkpoint = 4 + mean;
    let weights = config.architecture.parameters() * WEIGHT_BYTES;
    weights * (of_checkpoint * (config.checkpoint.keep as u64 + 1) + 3)
}

fn tell_of_memory(
    path: &Path,
    (check, doing, needed): (&'static str, &str, u64),
    available: Option<u64>,
    findings: &mut Findings,
) {
    let Some(available) = available else { return };
    let what = format!("{doing} {}, of {} that can be taken", format_bytes(needed), format_bytes(available));
    if needed > available {
        let mend =
            "make data.batch smaller and data.accumulate larger by as much, or data.crop, or data.cache-mib";
        findings.warn(path.display(), check, what, mend);
    } else {
        findings.ok(path.display(), check, what);
    }
}

fn tell_of_disk(path: &Path, needed: u64, free: Option<u64>, findings: &mut Findings) {
    let Some(free) = free else { return };
    let what = format!(
        "checkpoints and models take {} on disk, of {} that are free",
        format_bytes(needed),
        format_bytes(free)
    );
    if needed > free {
        let mend = "make room, name a folder on another disk (-o), or keep fewer checkpoints: --set checkpoint.keep=1";
        findings.fail(path.display(), "training-disk", what, mend);
    } else {
        findings.ok(path.display(), "training-disk", what);
    }
}

#[cfg(test)]
mod tests {
    use super::super::Level;
    use super::*;

    fn level(look: impl FnOnce(&mut Findings)) -> Level {
        let mut findings = Findings::default();
        look(&mut findings);
        findings.0[0].level
    }

    #[test]
    fn what_does_not_fit_is_found() {
        let path = Path::new("config.toml");
        let told = |needed| ("training-memory", "it takes about", needed);
        assert_eq!(level(|f| tell_of_memory(path, told(5), Some(5), f)), Level::Ok);
        assert_eq!(level(|f| tell_of_memory(path, told(6), Some(5), f)), Level::Warning);
        assert_eq!(level(|f| tell_of_disk(path, 5, Some(5), f)), Level::Ok);
        assert_eq!(level(|f| tell_of_disk(path, 6, Some(5), f)), Level::Error);
    }

    #[test]
    fn the_published_training_takes_what_its_configuration_says() {
        let mut config = TrainConfig::default();
        (config.data.batch, config.data.accumulate, config.data.crop, config.data.cache_mib) =
            (16, 1, 800, 0);
        let gibibytes = training_bytes(&config) >> 30;
        assert!((55..65).contains(&gibibytes), "{gibibytes} GiB");
    }
}

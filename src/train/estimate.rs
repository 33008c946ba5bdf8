//! Says beforehand what a training takes, from steps on one sample and on two.

use std::time::Duration;

use super::{TrainConfig, Trainer, TrainingData};
use crate::batch::{Estimate, HEADER_BYTES, LinearCost, PROCESS_BYTES, Spent, spent_on};
use crate::core::error::Result;
use crate::core::image::CHANNELS;
use crate::io;
use crate::kernels::keep_freed_memory;
use crate::network::Backend;

/// A step computes forward, and backward for inputs and for weights: three times the products of a restoration.
const PASSES: f64 = 3.0;

/// Memory of a training step by the number of its samples.
#[derive(Clone, Copy, Debug)]
struct StepMemory {
    before: u64,
    each: u64,
}

/// Says what a training takes, after steps on one sample and on two; only on one, where that took longer than `patience`.
///
/// Where the system does not tell the memory of a process, that of a step is left out.
///
/// # Errors
/// Those of [`Trainer::new`] and [`Trainer::step`].
pub fn estimate(
    config: &TrainConfig,
    data: &dyn TrainingData,
    backend: Backend,
    patience: Duration,
) -> Result<Estimate> {
    keep_freed_memory();
    let weights = config.architecture.parameters();
    let before = io::peak_memory_bytes().unwrap_or(PROCESS_BYTES);
    let one = time_step(config, data, backend, 1)?;
    let after_one = io::peak_memory_bytes().unwrap_or(before);
    let mut memory = StepMemory { before, each: after_one - before };
    let mut cost = LinearCost::of_each(one);
    let mut timed = "1 sample";
    if config.data.batch > 1 && one.seconds < patience.as_secs_f64() {
        let two = time_step(config, data, backend, 2)?;
        cost = LinearCost::through((1.0, one), (2.0, two));
        let each = io::peak_memory_bytes().unwrap_or(after_one) - after_one;
        if each > 0 {
            memory = StepMemory { before: after_one - each.min(after_one), each };
        }
        timed = "1 and 2 samples";
    }
    let steps = config.iterations as f64 * config.data.accumulate as f64;
    let checked =
        config.validation.images as f64 * (config.iterations / config.validation.every.max(1)) as f64;
    let validation_pixels = (config.validation.crop as f64 / config.data.crop as f64).powi(2);
    let validation = cost.each.times(checked / PASSES * validation_pixels);
    Ok(Estimate {
        items: config.iterations,
        unit: "steps",
        disk_bytes: disk_bytes(config, weights),
        memory_bytes: memory.before
            + memory.each * config.data.batch as u64
            + ((config.data.cache_mib as u64) << 20).min(data.kept_bytes()?),
        cost: cost.of(config.data.batch as f64).times(steps).and(validation),
        fixed: Spent::default(),
        threads: rayon::current_num_threads(),
        measured: format!("steps on {timed} of {} × {} pixels", config.data.crop, config.data.crop),
    })
}

/// The cost of a step on so many samples, but for the first.
fn time_step(
    config: &TrainConfig,
    data: &dyn TrainingData,
    backend: Backend,
    samples: usize,
) -> Result<Spent> {
    let mut config = config.clone();
    (config.data.batch, config.data.accumulate) = (samples, 1);
    let mut trainer = Trainer::new(&config, None, data.len(), backend)?;
    trainer.step(data)?;
    spent_on(|| trainer.step(data).map(|_| ()))
}

/// Checkpoints with weights, their mean and the optimiser's two moments, the latest and the best model, previews, logs.
fn disk_bytes(config: &TrainConfig, weights: u64) -> u64 {
    let copies = 3 + u64::from(config.optimizer.ema_decay > 0.0);
    // The checkpoint that is being written stands beside those that are kept.
    let kept = config.checkpoint.keep as u64 + 1;
    let tensors = weights * 4 * (kept * copies + 2);
    let preview = 3 * (CHANNELS * config.validation.crop.pow(2)) as u64;
    let lines = config.iterations / config.log_every.max(1) * 512;
    tensors + config.validation.images as u64 * preview + lines + (kept + 2) * HEADER_BYTES
}

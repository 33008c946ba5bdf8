//! `udc bench`: how fast this machine runs the network, how near that is to what it can do, and how fast it reads a dataset.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Result;
use clap::Args;
use serde_json::json;

use udc::core::bytes::format_bytes;
use udc::dataset::Dataset;
use udc::dataset::benchmark::{ReadSpeed, Reading, time_reading};
use udc::kernels::{Isa, benchmark, peak};
use udc::network::benchmark::time_network;
use udc::network::{Backend, Precision};
use udc::train::benchmark::{BatchShape, LARGEST_SIDE, time_step};

use super::device::DeviceArgs;
use super::{Session, peak_memory_bytes};

/// Time the network's operations and the whole network on this machine, or reading a dataset
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  udc bench --size 256 --size 800
  udc bench --read dataset

UDC_SIMD=avx512|avx2|portable forces an instruction set; GFLOP/s count the sums as written down, so that \
Winograd's convolutions can exceed the peak")]
pub(crate) struct BenchArgs {
    /// Side of the images that the whole network restores
    #[arg(long, value_name = "PIXELS", default_values_t = [256, 800])]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=i64::from(LARGEST_SIDE)))]
    size: Vec<u32>,
    /// Batches that the full network is trained on, as 4x128 for four crops of 128 × 128
    #[arg(long, value_name = "BATCH", default_value = "4x128")]
    train: Vec<BatchShape>,
    /// Time reading the images of this dataset instead, in random order as a training does. What the system has in memory
    /// comes from there: take a dataset that is larger, or of a disk that was just mounted
    #[arg(long, value_name = "DATASET", conflicts_with_all = ["size", "train", "only", "device"])]
    read: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceArgs,
    /// Of the single operations, time only those whose names contain this
    #[arg(long, value_name = "TEXT", default_value = "")]
    only: String,
    /// Seconds spent on each operation
    #[arg(long, value_name = "S", default_value = "0.5", value_parser = parse_patience)]
    patience: Duration,
}

/// Reading is timed for so long at least, unless there is less to read.
const LEAST_READING: Duration = Duration::from_secs(5);

/// Of the order in which images are read: another one than a training's.
const READING_SEED: u64 = 0;

/// The longest time for an operation, a day.
const LONGEST_PATIENCE_S: f64 = 86_400.0;

impl BenchArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        if let Some(folder) = &self.read {
            return self.time_reading(folder, session);
        }
        let backend = self.device.find(session)?;
        if backend.is_cpu() {
            self.time_operations(session)?;
        } else {
            session.say(backend)?;
        }
        let mut timings = Vec::new();
        for side in &self.size {
            time_network(backend, *side as usize, self.patience, &session.progress, |timing| {
                timings.push(json!({
                    "side": timing.side, "bf16": timing.has_bf16_products, "seconds": timing.seconds,
                    "operations": timing.operations, "bytes": timing.bytes,
                }));
                session.say(timing)
            })?;
        }
        session.result("networks", timings);
        self.time_steps(backend, session)
    }

    /// Times training steps, in bfloat16 too where the device trains so.
    fn time_steps(&self, backend: Backend, session: &Session) -> Result<()> {
        let mut timings = Vec::new();
        let precisions = [Precision::F32, Precision::Bf16];
        let trained_in =
            precisions.into_iter().filter(|precision| backend.check_training(*precision).is_ok());
        for precision in trained_in {
            for batch in &self.train {
                let ms = time_step((backend, precision), *batch, self.patience, &session.progress)? * 1e3;
                let is_rounded = precision == Precision::Bf16;
                timings.push(json!({ "batch": batch.to_string(), "bf16": is_rounded, "seconds": ms / 1e3 }));
                let flag = if is_rounded { " --precision bf16" } else { "" };
                let memory = peak_memory_bytes().map_or(String::new(), |bytes| {
                    format!(", the process has taken up to {} MiB", bytes >> 20)
                });
                session.say(format_args!("training step {batch}{flag}: {ms:.1} ms{memory}"))?;
            }
        }
        session.result("training-steps", timings);
        Ok(())
    }

    /// Times how the images of a dataset are read: first as they are stored, which may find them in memory then.
    fn time_reading(&self, folder: &Path, session: &Session) -> Result<()> {
        let dataset = Dataset::open(folder)?;
        let patience = self.patience.max(LEAST_READING);
        for (reading, name) in [(Reading::Stored, "as stored"), (Reading::Decoded, "decoded")] {
            let ReadSpeed { files, bytes, seconds } =
                time_reading(&dataset, reading, patience, READING_SEED, &session.progress)?;
            session.say(format_args!(
                "{name}: {files} images of {} in {seconds:.2} s by {} threads, {:.0} images/s, {:.0} MiB/s",
                format_bytes(bytes),
                rayon::current_num_threads(),
                files as f64 / seconds,
                bytes as f64 / f64::from(1 << 20) / seconds
            ))?;
            let told = json!({ "images": files, "bytes": bytes, "seconds": seconds });
            session.result(&format!("read-{}", name.replace(' ', "-")), told);
        }
        Ok(())
    }

    /// Times the operations that kernels do on the CPU, beside what it can do at most.
    fn time_operations(&self, session: &Session) -> Result<()> {
        let threads = rayon::current_num_threads();
        let peak = peak::measure(Isa::current()) * threads as f64;
        session.say(format!(
            "{}, {threads} threads, peak {:.0} GFLOP/s of multiply-adds",
            Isa::current().name(),
            peak / 1e9
        ))?;
        session.results_of(json!({
            "instruction-set": Isa::current().name(), "threads": threads, "peak-flops": peak,
        }));
        let (mut outcome, mut timings) = (Ok(()), Vec::new());
        let stops = || session.progress.check().is_err();
        benchmark::run(&self.only, self.patience, &stops, |timing| {
            timings.push(json!({
                "name": timing.name, "seconds": timing.seconds, "operations": timing.operations,
            }));
            let speed = timing.operations / timing.seconds;
            let (ms, share) = (timing.seconds * 1e3, speed / peak * 100.0);
            let line = format!("{:44} {ms:9.2} ms {:7.0} GFLOP/s {share:5.0} %", timing.name, speed / 1e9);
            if outcome.is_ok() {
                outcome = session.say(line);
            }
        });
        outcome?;
        session.progress.check()?;
        session.result("operations", timings);
        Ok(())
    }
}

fn parse_patience(text: &str) -> Result<Duration, String> {
    match text.parse() {
        Ok(seconds) if (0.0..=LONGEST_PATIENCE_S).contains(&seconds) => Ok(Duration::from_secs_f64(seconds)),
        _ => Err(format!("must be a number of seconds from 0 to {LONGEST_PATIENCE_S}")),
    }
}

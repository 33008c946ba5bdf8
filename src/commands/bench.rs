//! `udc bench`: how fast this machine runs the network, and how near that is to what it can do.

use std::time::Duration;

use anyhow::Result;
use clap::Args;
use serde_json::json;

use udc::kernels::{Isa, benchmark, peak};
use udc::network::benchmark::time_network;
use udc::train::benchmark::{BatchShape, LARGEST_SIDE, time_step};

use super::device::DeviceArgs;
use super::{Session, peak_memory_bytes};

/// Time the network's operations and the whole network on this machine
#[derive(Args, Debug)]
#[command(after_help = "\
Example: udc bench --size 256 --size 800
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
    #[command(flatten)]
    device: DeviceArgs,
    /// Of the single operations, time only those whose names contain this
    #[arg(long, value_name = "TEXT", default_value = "")]
    only: String,
    /// Seconds spent on each operation
    #[arg(long, value_name = "S", default_value = "0.5", value_parser = parse_patience)]
    patience: Duration,
}

/// The longest time for an operation, a day.
const LONGEST_PATIENCE_S: f64 = 86_400.0;

impl BenchArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let backend = self.device.find(session)?;
        if backend.is_cpu() {
            self.time_operations(session)?;
        } else {
            session.say(backend)?;
        }
        let mut timings = Vec::new();
        for side in &self.size {
            time_network(backend, *side as usize, self.patience, |timing| {
                timings.push(json!({
                    "side": timing.side, "bf16": timing.has_bf16_products, "seconds": timing.seconds,
                    "operations": timing.operations, "bytes": timing.bytes,
                }));
                session.say(timing)
            })?;
        }
        session.result("networks", std::mem::take(&mut timings));
        for batch in &self.train {
            let ms = time_step(backend, *batch, self.patience)? * 1e3;
            timings.push(json!({ "batch": batch.to_string(), "seconds": ms / 1e3 }));
            let memory = peak_memory_bytes()
                .map_or(String::new(), |bytes| format!(", the process has taken up to {} MiB", bytes >> 20));
            session.say(format_args!("training step {batch}: {ms:.1} ms{memory}"))?;
        }
        session.result("training-steps", timings);
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
        benchmark::run(&self.only, self.patience, |timing| {
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

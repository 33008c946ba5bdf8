//! `udc bench`: how fast this machine runs the network, and how near that is to what it can do.

use std::time::Duration;

use anyhow::Result;
use clap::Args;
use ndarray::Array3;

use udc::core::image::ToneMappedImage;
use udc::core::kernel_code::KernelCode;
use udc::kernels::{Isa, benchmark, keep_freed_memory, peak};
use udc::network::{
    Architecture, Backend, Initialisation, Inputs, Model, Origin, Parameters, Planes, weights::Weights,
};
use udc::train::{InMemory, Patch, TrainConfig, Trainer, TrainingData as _};

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
    #[arg(long, value_name = "BATCH", default_value = "4x128", value_parser = parse_batch)]
    train: Vec<Batch>,
    /// Of the single operations, time only those whose names contain this
    #[arg(long, value_name = "TEXT", default_value = "")]
    only: String,
    /// Seconds spent on each operation
    #[arg(long, value_name = "S", default_value = "0.5", value_parser = parse_patience)]
    patience: Duration,
}

/// Side of the largest images and batches: more would take most machines' memory many times over.
const LARGEST_SIDE: u32 = 8192;

/// The longest time for an operation, a day.
const LONGEST_PATIENCE_S: f64 = 86_400.0;

impl BenchArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let patience = self.patience;
        let threads = rayon::current_num_threads();
        let peak = peak::measure(Isa::current()) * threads as f64;
        session.say(format!(
            "{}, {threads} threads, peak {:.0} GFLOP/s of multiply-adds",
            Isa::current().name(),
            peak / 1e9
        ))?;
        let mut outcome = Ok(());
        benchmark::run(&self.only, patience, |timing| {
            let speed = timing.operations / timing.seconds;
            let (ms, share) = (timing.seconds * 1e3, speed / peak * 100.0);
            let line = format!("{:44} {ms:9.2} ms {:7.0} GFLOP/s {share:5.0} %", timing.name, speed / 1e9);
            if outcome.is_ok() {
                outcome = session.say(line);
            }
        });
        outcome?;
        self.size.iter().try_for_each(|side| time_network(session, *side as usize, patience))?;
        self.train.iter().try_for_each(|batch| time_training(session, *batch, patience))
    }
}

/// A training batch: so many square crops of so many pixels a side.
#[derive(Clone, Copy, Debug)]
struct Batch {
    crops: usize,
    side: usize,
}

fn parse_patience(text: &str) -> Result<Duration, String> {
    match text.parse() {
        Ok(seconds) if (0.0..=LONGEST_PATIENCE_S).contains(&seconds) => Ok(Duration::from_secs_f64(seconds)),
        _ => Err(format!("must be a number of seconds from 0 to {LONGEST_PATIENCE_S}")),
    }
}

fn parse_batch(text: &str) -> Result<Batch, String> {
    let parts: Option<(usize, usize)> =
        text.split_once('x').and_then(|(crops, side)| Some((crops.parse().ok()?, side.parse().ok()?)));
    let largest = (LARGEST_SIDE as usize).pow(2);
    match parts {
        Some((crops, side)) if crops > 0 && side > 0 => {
            let pixels = side.checked_mul(side).and_then(|pixels| pixels.checked_mul(crops));
            match pixels.filter(|pixels| *pixels <= largest) {
                Some(_) => Ok(Batch { crops, side }),
                None => Err(format!("must have at most {largest} pixels in all")),
            }
        }
        _ => Err("must be a number of crops and their side, as 4x128".to_owned()),
    }
}

/// Times a step of the training: forward, L1, backward, Adam.
fn time_training(session: &Session, Batch { crops, side }: Batch, patience: Duration) -> Result<()> {
    let mut config = TrainConfig::default();
    (config.data.batch, config.data.accumulate, config.data.crop) = (crops, 1, side);
    let image = |value| ToneMappedImage::from_planes(Array3::from_elem((3, side, side), value));
    let code = Some(KernelCode::zeros(config.architecture.code_dim));
    let data = InMemory(vec![Patch {
        degraded: image(0.5)?,
        ground_truth: image(0.25)?,
        code,
        planes: Planes::default(),
    }]);
    keep_freed_memory();
    let mut trainer = Trainer::new(&config, None, data.len(), Backend::default())?;
    let mut outcome = Ok(());
    let seconds = benchmark::best_time(patience, || {
        if outcome.is_ok() {
            outcome = trainer.step(&data).map(|_| ());
        }
    });
    outcome?;
    let memory = peak_memory_bytes()
        .map_or(String::new(), |bytes| format!(", the process has taken up to {} MiB", bytes >> 20));
    session.say(format!("training step {crops}×{side}²: {:.1} ms{memory}", seconds * 1e3))
}

/// Times the whole network, with random weights, on one image.
fn time_network(session: &Session, side: usize, patience: Duration) -> Result<()> {
    let architecture = Architecture::default();
    let parameters = Parameters::random(&architecture, Initialisation::Released, 0);
    let macs = architecture.macs(side, side);
    let code = KernelCode::zeros(architecture.code_dim);
    let weights = Weights { architecture, parameters, origin: Origin::default() };
    let model = Model::new(weights);
    let image = ToneMappedImage::from_planes(Array3::from_elem((3, side, side), 0.5))?;
    let rounded = model.with_bf16_products();
    for model in std::iter::once(model).chain(rounded) {
        model.restore(&Inputs::new(&image, Some(&code)))?;
        let seconds = benchmark::best_time(patience, || {
            model.restore(&Inputs::new(&image, Some(&code))).expect("the same image was restored before");
        });
        let speed = 2.0 * macs as f64 / seconds / 1e9;
        let memory = model.working_bytes(side, side) >> 20;
        let products = if model.has_bf16_products() { " --precision bf16" } else { "" };
        let ms = seconds * 1e3;
        session.say(format!("network @{side}²{products}: {ms:.1} ms, {speed:.0} GFLOP/s, {memory} MiB"))?;
    }
    Ok(())
}

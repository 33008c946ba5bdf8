//! What a GPU computes, beside what the CPU computes; on any device that is found first, be it a program that takes a GPU's
//! place. Where there is none, each test says so and passes.

#![expect(clippy::print_stderr, reason = "what was skipped and what a long test has come to is told")]
#![expect(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    reason = "a test may stop at what it does not expect, and weights are drawn with more bits than they keep"
)]

#[path = "../common/perceptual_weights.rs"]
mod perceptual_weights;

use std::fs;
use std::path::Path;
use std::process::Command;

use ndarray::Array3;

use udc::core::image::{CHANNELS, ToneMappedImage};
use udc::core::kernel_code::KernelCode;
use udc::core::progress::Progress;
use udc::network::weights::Weights;
use udc::network::{
    Architecture, Backend, Condition, DeviceChoice, Initialisation, Inputs, Kind, Model, Origin, Parameters,
    Plane, Planes, Precision, Scales,
};
use udc::perceptual::Lpips;
use udc::restore::{KernelKnowledge, Restoration};
use udc::train::{InMemory, Patch, TrainConfig, Trainer};

const SIDE: usize = 16;

/// The device that is found first.
fn device() -> Option<Backend> {
    let found = DeviceChoice::Numbered(0).find(Backend::default());
    match found {
        Ok(backend) => {
            eprintln!("computing on {backend}");
            Some(backend)
        }
        Err(reason) => {
            eprintln!("skipped: {reason}");
            None
        }
    }
}

fn image(seed: usize, [height, width]: [usize; 2]) -> ToneMappedImage {
    let value = |(c, y, x)| ((seed * 31 + c * 7919 + y * 104_729 + x * 1299) % 1000) as f32 / 1000.0;
    ToneMappedImage::from_planes(Array3::from_shape_fn((CHANNELS, height, width), value)).expect("RGB")
}

fn planes(size: [usize; 2]) -> Planes {
    Plane::ALL.into_iter().enumerate().map(|(seed, plane)| (plane, image(seed + 3, size))).collect()
}

/// Every family, DISCNet with every condition, and small filters and large ones.
fn architectures() -> Vec<Architecture> {
    let of = |kind, condition| Architecture {
        kind,
        condition,
        features: 6,
        filter_size: 3,
        code_dim: 2,
        ..Architecture::default()
    };
    let discnet = |condition| of(Kind::Discnet, condition);
    vec![
        discnet(Condition::ImagePsf),
        discnet(Condition::Image),
        discnet(Condition::Psf),
        discnet(Condition::None),
        Architecture { filter_size: 9, ..discnet(Condition::ImagePsf) },
        Architecture { scales: Scales::Single, ..discnet(Condition::ImagePsf) },
        of(Kind::Unet, Condition::None),
        of(Kind::Srmdnf, Condition::ImagePsf),
        of(Kind::Sftmd, Condition::ImagePsf),
        of(Kind::DeUnet, Condition::Image),
        of(Kind::Guided, Condition::None),
    ]
}

/// Weights under which neither signals nor gradients vanish or explode.
fn parameters(architecture: &Architecture) -> Parameters {
    let initialisation = match architecture.kind {
        Kind::Discnet | Kind::Sftmd => Initialisation::Released,
        _ => Initialisation::Paper,
    };
    Parameters::random(architecture, initialisation, 4)
}

fn model(architecture: &Architecture) -> Model {
    let parameters = parameters(architecture);
    Model::new(Weights { architecture: architecture.clone(), parameters, origin: Origin::default() })
}

fn largest_difference(a: &ToneMappedImage, b: &ToneMappedImage) -> f32 {
    a.as_slice().iter().zip(b.as_slice()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

fn largest(image: &ToneMappedImage) -> f32 {
    image.as_slice().iter().fold(0.0, |largest, value| largest.max(value.abs()))
}

/// The same sums in another order, through up to a hundred layers: 1e-4 of the largest value.
#[test]
fn every_family_restores_as_on_the_cpu() {
    let Some(backend) = device() else { return };
    for size in [[SIDE, SIDE], [21, 34]] {
        let (image, planes, code) = (image(0, size), planes(size), KernelCode::from_vec(vec![0.4, -0.7]));
        for architecture in architectures() {
            let model = model(&architecture);
            let inputs = Inputs::new(&image, Some(&code)).with_planes(&planes);
            let on_cpu = model.restore(&inputs).expect("the CPU restores");
            let on_gpu = model.with_backend(backend).restore(&inputs).expect("the GPU restores");
            let error = largest_difference(&on_cpu, &on_gpu) / largest(&on_cpu);
            assert!(error < 1e-4, "{architecture:?}, {size:?}: {error:e}");
        }
    }
}

#[test]
fn tiles_are_the_whole_image() {
    let Some(backend) = device() else { return };
    let architecture = &architectures()[0];
    let kernel = KernelKnowledge::Code(KernelCode::from_vec(vec![0.4, -0.7]));
    let restoration = Restoration::by_network(model(architecture), kernel).expect("a network and its code");
    let restore = |restoration: Restoration| {
        let restored =
            restoration.with_backend(backend).restore(image(1, [40, 200]).into(), &Progress::default());
        restored.expect("it restores").into_tone_mapped()
    };
    let (whole, tiled) = (restore(restoration.clone()), restore(restoration.with_tile(Some(64))));
    let error = largest_difference(&whole, &tiled) / largest(&whole);
    assert!(error < 1e-5, "{error:e}");
}

#[test]
fn lpips_is_that_of_the_cpu() {
    let Some(backend) = device() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let [alexnet, linear] =
        ["alexnet.safetensors", "linear.safetensors"].map(|name| folder.path().join(name));
    perceptual_weights::write_alexnet(&alexnet);
    perceptual_weights::write_linear(&linear);
    let load = |backend| Lpips::load(&alexnet, &linear, backend).expect("weights");
    let (on_cpu, on_gpu) = (load(Backend::default()), load(backend));
    for size in [[31, 31], [64, 90]] {
        let (a, b) = (image(1, size), image(2, size));
        let distance = |lpips: &Lpips| lpips.distance(&a, &b).expect("images of one size");
        let (expected, found) = (distance(&on_cpu), distance(&on_gpu));
        assert!((found / expected - 1.0).abs() < 1e-4, "{size:?}: {found}, on the CPU {expected}");
    }
}

fn data(side: usize) -> InMemory {
    let size = [side, side];
    let patch = |seed| Patch {
        degraded: image(seed, size),
        ground_truth: image(seed + 100, size),
        code: Some(KernelCode::from_vec(vec![0.4, -0.7])),
        planes: planes(size),
    };
    InMemory((0..4).map(patch).collect())
}

/// Loss, and norm of the gradients, of each step.
fn told(config: &TrainConfig, backend: Backend, steps: usize) -> Vec<[f64; 2]> {
    let initial = parameters(&config.architecture);
    let mut trainer = Trainer::new(config, Some(initial), 4, backend).expect("the configuration is valid");
    let data = data(config.data.crop);
    let mut step = || {
        let step = trainer.step(&data).expect("it learns");
        [step.loss, step.gradient_norm]
    };
    (0..steps).map(|_| step()).collect()
}

fn losses(config: &TrainConfig, backend: Backend, steps: usize) -> Vec<f64> {
    told(config, backend, steps).into_iter().map(|[loss, _]| loss).collect()
}

/// Losses within 1e-3 of the CPU's, and norms of gradients within 5e-3.
fn assert_steps_are_those_of_the_cpu(config: &TrainConfig, backend: Backend, steps: usize) {
    let pairs = told(config, Backend::default(), steps).into_iter().zip(told(config, backend, steps));
    for (step, (on_cpu, on_gpu)) in pairs.enumerate() {
        for (on_cpu, on_gpu, most) in [(on_cpu[0], on_gpu[0], 1e-3), (on_cpu[1], on_gpu[1], 5e-3)] {
            let error = (on_gpu / on_cpu - 1.0).abs();
            assert!(error < most, "{:?}, step {step}: {on_gpu}, on the CPU {on_cpu}", config.architecture);
        }
    }
    eprintln!("{:?}: {steps} steps as on the CPU", config.architecture.kind);
}

/// Twenty steps.
fn assert_trainings_follow_those_of_the_cpu(is_chosen: impl Fn(Kind) -> bool) {
    let Some(backend) = device() else { return };
    for architecture in architectures().into_iter().filter(|architecture| is_chosen(architecture.kind)) {
        let mut config = TrainConfig { architecture, iterations: 20, ..TrainConfig::default() };
        (config.data.batch, config.data.crop) = (2, SIDE);
        config.optimizer.clip_norm = 1.0;
        config.optimizer.ema_decay = 0.9;
        let steps = if config.architecture.kind == Kind::Sftmd { 5 } else { 20 };
        assert_steps_are_those_of_the_cpu(&config, backend, steps);
    }
}

#[test]
fn trainings_of_discnet_follow_those_of_the_cpu() {
    assert_trainings_follow_those_of_the_cpu(|kind| kind == Kind::Discnet);
}

#[test]
fn trainings_of_sftmd_follow_those_of_the_cpu() {
    assert_trainings_follow_those_of_the_cpu(|kind| kind == Kind::Sftmd);
}

#[test]
fn trainings_of_other_families_follow_those_of_the_cpu() {
    assert_trainings_follow_those_of_the_cpu(|kind| !matches!(kind, Kind::Discnet | Kind::Sftmd));
}

/// A program in a GPU's place may end its loops early, by which gradients of many pixels would be wrong: it says so. Cards are
/// compared with the CPU.
#[test]
fn large_crops_are_trained_as_on_the_cpu_or_refused() {
    let Some(backend) = device() else { return };
    let architecture = architectures().swap_remove(6);
    let mut config = TrainConfig { architecture, iterations: 4, ..TrainConfig::default() };
    (config.data.batch, config.data.crop) = (1, 272);
    config.optimizer.clip_norm = 1.0;
    if backend.check_batch(config.data.crop.pow(2)).is_ok() {
        assert_steps_are_those_of_the_cpu(&config, backend, 2);
        return;
    }
    let refused = Trainer::new(&config, None, 4, backend).expect_err("it cannot").to_string();
    assert!(refused.contains("73984 pixels") && refused.contains("data.crop"), "{refused}");
    eprintln!("refused: {refused}");
}

/// Losses within 3 % of those of 32 bits where the device computes in bfloat16, else a refusal that says what to do.
#[test]
fn trainings_in_bfloat16_follow_those_in_32_bits_or_are_refused() {
    let Some(backend) = device() else { return };
    let mut config = TrainConfig {
        architecture: architectures().swap_remove(0),
        iterations: 20,
        ..TrainConfig::default()
    };
    (config.data.batch, config.data.crop) = (2, SIDE);
    config.precision = Precision::Bf16;
    if !backend.supports(Precision::Bf16) {
        let refused = Trainer::new(&config, None, 4, backend).expect_err("it cannot").to_string();
        assert!(refused.contains("precision") && refused.contains("train with f32"), "{refused}");
        eprintln!("refused: {refused}");
        return;
    }
    let rounded = losses(&config, backend, 20);
    config.precision = Precision::F32;
    let exact = losses(&config, backend, 20);
    for (step, (exact, rounded)) in exact.into_iter().zip(rounded).enumerate() {
        assert!((rounded / exact - 1.0).abs() < 0.03, "step {step}: {rounded}, in 32 bits {exact}");
    }
    eprintln!("20 steps in bfloat16 as in 32 bits");
}

/// A network that learns in fifty steps of few kernels.
const SMALL: &str = r#"
iterations = 50
log-every = 1
[architecture]
kind = "unet"
condition = "none"
features = 4
[data]
crop = 16
batch = 2
[checkpoint]
every = 25
"#;

fn udc(folder: &Path, line: &str) -> String {
    let ended = Command::new(env!("CARGO_BIN_EXE_udc"))
        .current_dir(folder)
        .args(line.split_whitespace())
        .output()
        .expect("it starts");
    let said = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert!(ended.status.success(), "udc {line}: {said}");
    said
}

/// The loss of each step, from the log.
fn logged(run: &Path) -> Vec<f64> {
    let log = fs::read_to_string(run.join("metrics.jsonl")).expect("a run has a log");
    let lines = log.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).expect("it is JSON"));
    lines.filter_map(|line| line["loss"].as_f64()).collect()
}

/// Fifty steps at a stretch, and 25 before an end and 25 after it; nothing promises the same bits.
#[test]
fn a_training_goes_on_where_it_ended() {
    if device().is_none() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    fs::write(folder.join("small.toml"), SMALL).expect("it is written");
    udc(folder, "psf --random 3 --size 9 -o psf.exr");
    udc(folder, "scenes -o scenes --count 4 --size 24 --seed 2");
    udc(folder, "synth scenes --psf psf.exr --split train -o dataset");
    let train = "train small.toml --data dataset --device gpu:0 -o";
    udc(folder, &format!("{train} whole"));
    udc(folder, &format!("{train} parts --set iterations=25"));
    udc(folder, &format!("{train} parts --resume --set iterations=50"));
    let (whole, parts) = (logged(&folder.join("whole")), logged(&folder.join("parts")));
    assert_eq!((whole.len(), parts.len()), (50, 50));
    for (step, (a, b)) in whole.iter().zip(&parts).enumerate() {
        assert!((a / b - 1.0).abs() < 1e-3, "step {step}: {a} and {b}");
    }
    assert!(whole[49] < whole[0], "{whole:?}");
    eprintln!("the same bits: {}", whole == parts);
}

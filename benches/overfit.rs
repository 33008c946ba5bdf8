//! Trains every architecture on four patches until it has learnt them by heart:
//! `cargo bench --bench overfit [-- KIND] [features=N] [iterations=N] [rate=R]`.
//!
//! A network that cannot is broken in its forward pass, its gradients or its optimiser. Without `features` the
//! networks are a fraction of the published width, so that all of them take minutes; `features=0` is the
//! published width. Each has the first weights that suit it, see [`NETWORKS`].
#![expect(clippy::print_stdout, reason = "a benchmark's output is its log")]

use std::time::Instant;

use ndarray::{Array1, Array3};
use udc::core::image::ToneMappedImage;
use udc::core::metrics::{MetricDefinition, psnr};
use udc::kernels::keep_freed_memory;
use udc::network::weights::Weights;
use udc::network::{Architecture, Backend, Condition, Initialisation, Inputs, Kind, Model, Origin, Planes};
use udc::train::{InMemory, Patch, ScheduleConfig, TrainConfig, Trainer};

/// Side of the patches.
const SIDE: usize = 64;

/// PSNR to reach, in dB, and the number of steps between two looks at it.
const GOAL: f64 = 45.0;
const LOOK: u64 = 100;

/// How one architecture is trained.
struct Case {
    kind: Kind,
    condition: Condition,
    published_features: usize,
    reduced_features: usize,
    initialisation: Initialisation,
}

/// Twelve convolutions without a shortcut want Kaiming's variance in each of them; in sixteen residual blocks in a row
/// the same variance multiplies signals to 10⁶, so that SFTMD starts from PyTorch's default.
const NETWORKS: [Case; 5] = [
    case(Kind::Discnet, Condition::ImagePsf, [32, 8], Initialisation::Paper),
    case(Kind::Unet, Condition::None, [32, 16], Initialisation::Paper),
    case(Kind::Srmdnf, Condition::ImagePsf, [128, 64], Initialisation::Paper),
    case(Kind::Sftmd, Condition::ImagePsf, [64, 16], Initialisation::Released),
    case(Kind::DeUnet, Condition::Image, [32, 8], Initialisation::Paper),
];

const fn case(
    kind: Kind,
    condition: Condition,
    [published_features, reduced_features]: [usize; 2],
    initialisation: Initialisation,
) -> Case {
    Case { kind, condition, published_features, reduced_features, initialisation }
}

fn main() {
    keep_freed_memory();
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let number = |key: &str| {
        let value = arguments.iter().find_map(|a| a.strip_prefix(key)?.strip_prefix('='));
        value.map(|text| text.parse::<f64>().unwrap_or_else(|_| panic!("{key} is a number, found {text}")))
    };
    let wanted = arguments.iter().find(|a| !a.contains('='));
    let mut failed = Vec::new();
    for case in NETWORKS {
        let (kind, condition) = (case.kind, case.condition);
        let name = serde_json::to_value(kind).expect("a name").as_str().expect("a name").to_owned();
        if wanted.is_some_and(|wanted| *wanted != name) {
            continue;
        }
        let features = match number("features").map(whole) {
            None => case.reduced_features,
            Some(0) => case.published_features,
            Some(features) => features,
        };
        let iterations = number("iterations").map_or(3000, |n| whole(n) as u64);
        let mut config = TrainConfig {
            architecture: Architecture { kind, condition, features, ..Architecture::default() },
            initialisation: case.initialisation,
            iterations,
            schedule: ScheduleConfig { period: iterations, minimum: 1e-6 },
            ..TrainConfig::default()
        };
        (config.data.crop, config.data.batch, config.data.accumulate) = (SIDE, 4, 1);
        config.optimizer.learning_rate = number("rate").unwrap_or(1e-3);
        config.optimizer.clip_norm = 1.0;
        if !learns(&name, &config) {
            failed.push(name);
        }
    }
    assert!(failed.is_empty(), "below {GOAL} dB: {}", failed.join(", "));
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small counts")]
fn whole(number: f64) -> usize {
    number as usize
}

/// Trains until the goal or the last step; whether the goal was reached.
fn learns(name: &str, config: &TrainConfig) -> bool {
    let data = data();
    let (parameters, features) = (config.architecture.parameters(), config.architecture.features);
    println!("{name}: {features} features, {parameters} parameters, degraded {:.2} dB", quality(&data, None));
    let mut trainer = Trainer::new(config, None, data.0.len(), Backend::default()).expect("a valid training");
    let begun = Instant::now();
    let (mut best, mut sum) = (0.0_f64, 0.0);
    while trainer.iteration() < config.iterations && best <= GOAL {
        let step = trainer.step(&data).expect("a step");
        sum += step.loss;
        if step.iteration.is_multiple_of(LOOK) {
            let weights = Weights {
                architecture: config.architecture.clone(),
                parameters: trainer.weights().into_owned(),
                origin: Origin::default(),
            };
            let found = quality(&data, Some(&Model::new(weights)));
            best = best.max(found);
            let (loss, seconds) = (sum / LOOK as f64, begun.elapsed().as_secs_f64());
            println!("{name}: {:5} steps, loss {loss:.6}, {found:.2} dB, {seconds:.0} s", step.iteration);
            sum = 0.0;
        }
    }
    best > GOAL
}

/// The mean PSNR of the patches, restored by a model or as they are.
fn quality(data: &InMemory, model: Option<&Model>) -> f64 {
    let of_patch = |patch: &Patch| {
        let restored = match model {
            Some(model) => {
                model.restore(&Inputs::new(&patch.degraded, patch.code.as_ref())).expect("a patch fits")
            }
            None => patch.degraded.clone(),
        };
        psnr(&restored, &patch.ground_truth, &MetricDefinition::float()).expect("patches of one size")
    };
    data.0.iter().map(of_patch).sum::<f64>() / data.0.len() as f64
}

/// Four patches with edges and lamps, and what a wide kernel, another for each, makes of them.
fn data() -> InMemory {
    let patch = |n: usize| {
        let clean = Array3::from_shape_fn((3, SIDE, SIDE), |at| scene(n, at));
        let degraded =
            Array3::from_shape_fn((3, SIDE, SIDE), |at| 0.6 * clean[at] + 0.4 * blurred(&clean, n, at));
        let image = |planes| ToneMappedImage::from_planes(planes).expect("three channels");
        let code = Array1::from_shape_fn(5, |i| ((n * 5 + i) as f32).sin());
        Patch {
            degraded: image(degraded),
            ground_truth: image(clean),
            code: Some(code),
            planes: Planes::default(),
        }
    };
    InMemory((0..4).map(patch).collect())
}

fn scene(n: usize, (c, y, x): (usize, usize, usize)) -> f32 {
    let (v, u) = (y as f32 / SIDE as f32, x as f32 / SIDE as f32);
    let waves = 0.3 + 0.1 * (9.0 * u + 5.0 * v + (n + c) as f32).sin() + 0.1 * (4.0 * v * v - 7.0 * u).cos();
    let wall = if (u * 1.7 + v) % 0.4 < 0.15 { 0.2 } else { 0.0 };
    let centre = 0.25 + 0.15 * n as f32;
    let is_lamp = (u - centre).hypot(v - 0.5) < 0.06;
    if is_lamp { 0.95 - 0.05 * c as f32 } else { waves + wall }
}

/// The mean over a cross of pixels, their distance being the kernel's.
fn blurred(clean: &Array3<f32>, n: usize, (c, y, x): (usize, usize, usize)) -> f32 {
    let at = |y: usize, x: usize| clean[[c, y.min(SIDE - 1), x.min(SIDE - 1)]];
    let arms = (1..=4).map(|i| i * (n + 1));
    let of_arm =
        |d: usize| at(y + d, x) + at(y, x + d) + at(y.saturating_sub(d), x) + at(y, x.saturating_sub(d));
    arms.map(of_arm).sum::<f32>() / 16.0
}

//! Tests of the steps of a training.

use super::*;
use crate::core::image::ToneMappedImage;
use crate::network::Backend;
use crate::network::{Architecture, Condition, Initialisation, Inputs, Kind, Scales, testing};
use crate::perceptual::{FeatureDistance, PerceptualLoss};
use crate::train::InMemory;
use crate::train::loss::Loss;
use ndarray::{Array1, Array3};
use std::sync::atomic::{AtomicUsize, Ordering};

mod on_device;

fn config(batch: usize, accumulate: usize) -> TrainConfig {
    let mut config = TrainConfig::default();
    config.architecture = Architecture { features: 2, filter_size: 3, ..config.architecture };
    (config.data.batch, config.data.accumulate, config.data.crop) = (batch, accumulate, 12);
    config
}

fn data() -> InMemory {
    let image = |phase: f32| {
        let value = |(c, y, x): (usize, usize, usize)| {
            0.5 + 0.5 * ((c + 3 * y) as f32 * 0.31 + x as f32 * 0.17 + phase).sin()
        };
        ToneMappedImage::from_planes(Array3::from_shape_fn((3, 14, 15), value)).unwrap()
    };
    let patch = |i: usize| Patch {
        degraded: image(i as f32 + 0.4),
        ground_truth: image(i as f32),
        code: Some(Array1::from_elem(5, i as f32 * 0.1)),
        planes: crate::network::Planes::default(),
    };
    InMemory((0..4).map(patch).collect())
}

/// Counts the samples that are drawn; the one of number `broken` and those after it cannot be drawn.
struct Counted {
    data: InMemory,
    drawn: AtomicUsize,
    broken: usize,
}

impl TrainingData for Counted {
    fn len(&self) -> usize {
        self.data.len()
    }

    fn patch(&self, item: usize, side: usize, rng: &mut Rng) -> Result<Patch> {
        if self.drawn.fetch_add(1, Ordering::Relaxed) >= self.broken {
            return Err(Error::Unsupported("the disk is gone".to_owned()));
        }
        self.data.patch(item, side, rng)
    }

    fn check_size(&self, side: usize) -> Result<()> {
        self.data.check_size(side)
    }

    fn kept_bytes(&self) -> Result<u64> {
        self.data.kept_bytes()
    }
}

fn counted(broken: usize) -> Counted {
    Counted { data: data(), drawn: AtomicUsize::new(0), broken }
}

#[test]
fn steps_are_the_same_whether_their_batches_were_drawn_ahead() {
    for accumulate in [1, 2] {
        let mut config = config(2, accumulate);
        config.iterations = 5;
        let mut ahead = Trainer::new(&config, None, 4, Backend::default()).unwrap();
        let mut in_turn = ahead.clone();
        let data = counted(usize::MAX);
        for step in 1..=5 {
            in_turn.ahead = None;
            assert_eq!(ahead.step(&data).unwrap(), in_turn.step(&self::data()).unwrap());
            assert_eq!(ahead.ahead.is_some(), step < 5, "nothing is drawn for a step that is not made");
        }
        assert_eq!(ahead.state, in_turn.state);
        assert_eq!(data.drawn.into_inner(), 5 * accumulate * 2, "each sample is drawn once");
    }
}

/// One thread has to draw and to compute.
#[test]
fn a_single_thread_draws_ahead_too() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let (alone, steps) = pool.install(|| trained(&config(2, 1), 3));
    let (together, expected) = trained(&config(2, 1), 3);
    assert_eq!((alone.state, steps), (together.state, expected));
}

#[test]
fn data_that_end_are_reported_by_the_step_that_needs_them() {
    let mut trainer = Trainer::new(&config(2, 1), None, 4, Backend::default()).unwrap();
    let data = counted(5);
    for iteration in 1..=2 {
        assert_eq!(trainer.step(&data).unwrap().iteration, iteration);
    }
    let message = trainer.step(&data).unwrap_err().to_string();
    assert_eq!((message.as_str(), trainer.iteration()), ("the disk is gone", 2));
}

fn trained(config: &TrainConfig, steps: usize) -> (Trainer, Vec<Step>) {
    let mut trainer = Trainer::new(config, None, 4, Backend::default()).unwrap();
    let steps = (0..steps).map(|_| trainer.step(&data()).unwrap()).collect();
    (trainer, steps)
}

/// Both average the same four gradients; sums of f32 in another order.
#[test]
fn accumulated_batches_equal_one_large_batch() {
    let (_, large) = trained(&config(4, 1), 2);
    let (_, parts) = trained(&config(1, 4), 2);
    for (large, parts) in large.iter().zip(&parts) {
        assert!((large.loss / parts.loss - 1.0).abs() < 1e-5, "{large:?} {parts:?}");
        assert!((large.gradient_norm / parts.gradient_norm - 1.0).abs() < 1e-4, "{large:?} {parts:?}");
    }
}

#[test]
fn a_step_goes_down_its_gradient() {
    let mut config = config(4, 1);
    (config.optimizer.learning_rate, config.data.shuffle) = (1e-3, false);
    let (_, steps) = trained(&config, 12);
    assert!(steps[11].loss < 0.9 * steps[0].loss, "{steps:?}");
}

#[test]
fn the_running_mean_is_what_is_saved() {
    let mut config = config(1, 1);
    config.optimizer.ema_decay = 0.5;
    let (trainer, _) = trained(&config, 1);
    let before = Parameters::random(&config.architecture, config.initialisation, config.seed);
    let weights = trainer.weights();
    let after = trainer.state.parameters.iter().zip(weights.iter()).zip(before.iter());
    for ((last, mean), first) in after {
        for ((last, mean), first) in last.values.iter().zip(&mean.values).zip(&first.values) {
            assert!((mean - 0.5 * (last + first)).abs() < 1e-7);
        }
    }
}

#[test]
fn a_loss_that_is_not_finite_stops_the_training_and_changes_nothing() {
    let config = config(1, 1);
    let mut initial = Parameters::random(&config.architecture, Initialisation::Paper, 1);
    initial.iter_mut().for_each(|p| p.values.iter_mut().for_each(|v| *v *= 1e20));
    let mut trainer = Trainer::new(&config, Some(initial.clone()), 4, Backend::default()).unwrap();
    let message = trainer.step(&data()).unwrap_err().to_string();
    assert!(message.contains("diverged") && message.contains("iteration 1"), "{message}");
    assert_eq!((trainer.iteration(), &*trainer.weights()), (0, &initial));
}

#[test]
fn data_without_items_or_with_other_codes_are_refused() {
    assert!(Trainer::new(&config(1, 1), None, 0, Backend::default()).is_err());
    let mut config = config(1, 1);
    config.architecture.code_dim = 3;
    let mut trainer = Trainer::new(&config, None, 4, Backend::default()).unwrap();
    let message = trainer.step(&data()).unwrap_err().to_string();
    assert!(message.contains("expected 3 numbers") && message.contains("found 5"), "{message}");
}

/// Gradients of 10²³ are finite, and so is their norm; their squares are not in 32 bits.
#[test]
fn moments_that_overflow_are_refused_and_nothing_is_changed() {
    let mut config = config(1, 1);
    (config.loss.l1, config.optimizer.ema_decay) = (1e25, 0.9);
    let mut trainer = Trainer::new(&config, None, 4, Backend::default()).unwrap();
    let before = trainer.state.clone();
    let message = trainer.step(&data()).unwrap_err().to_string();
    for part in ["mean squared gradient of", "iteration 1", "optimizer.learning-rate", "optimizer.clip-norm"]
    {
        assert!(message.contains(part), "{message}");
    }
    assert_eq!(trainer.state, before);
    config.optimizer.clip_norm = 1.0;
    let mut clipped = Trainer::new(&config, None, 4, Backend::default()).unwrap();
    clipped.step(&data()).unwrap();
    assert_eq!(clipped.state.first_overflow(), None);
}

#[test]
fn a_weight_without_a_gradient_is_named() {
    let parameters = Parameters::random(&config(1, 1).architecture, Initialisation::Released, 1);
    let gradients = || parameters.iter().map(|p| Some(vec![0.0; p.values.len()])).collect::<Vec<_>>();
    let worker = Worker::new(&config(1, 1), &parameters, Backend::default()).unwrap();
    assert_eq!(worker.complete(gradients()).unwrap().len(), parameters.iter().count());
    let (mut missing, name) = (gradients(), &parameters.iter().nth(3).unwrap().name);
    missing[3] = None;
    let message = worker.complete(missing).unwrap_err().to_string();
    assert!(message.contains(&format!("no gradient to {name}:")), "{message}");
}

/// Every weight of every kind of network is one that training reaches.
#[test]
fn every_weight_of_every_network_has_a_gradient() {
    let discnet = |condition, scales| Architecture { condition, scales, ..Architecture::default() };
    let fixed = |kind, condition| Architecture { kind, condition, ..Architecture::default() };
    let architectures = [
        discnet(Condition::Image, Scales::Single),
        discnet(Condition::Psf, Scales::Single),
        discnet(Condition::ImagePsf, Scales::Single),
        discnet(Condition::Image, Scales::Multi),
        discnet(Condition::Psf, Scales::Multi),
        discnet(Condition::ImagePsf, Scales::Multi),
        discnet(Condition::None, Scales::Multi),
        fixed(Kind::Unet, Condition::None),
        fixed(Kind::Srmdnf, Condition::ImagePsf),
        fixed(Kind::Sftmd, Condition::ImagePsf),
        fixed(Kind::DeUnet, Condition::Image),
    ];
    for architecture in architectures {
        let mut config = config(1, 1);
        config.architecture = Architecture { features: 2, filter_size: 3, ..architecture };
        let architecture = config.architecture.clone();
        let trained = Trainer::new(&config, None, 4, Backend::default()).and_then(|mut t| t.step(&data()));
        assert!(trained.is_ok(), "{architecture:?}: {trained:?}");
    }
}

/// Convolutions of a network in VGG-19's shape with few channels: weights, then bias, of each.
type Convolutions = Vec<Vec<(Vec<f32>, Vec<f32>)>>;

/// Channels of the small network; its first convolution reads three.
const CHANNELS_OF_VGG: usize = 4;

fn small_vgg() -> Convolutions {
    let mut state = 0_u32;
    let mut uniform = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32 - 0.5
    };
    let mut inputs = 3;
    let mut convolution = |_| {
        let spread = 0.3 * (24.0 / (9.0 * inputs as f32)).sqrt();
        let mut weight: Vec<f32> = (0..CHANNELS_OF_VGG * inputs * 9).map(|_| spread * uniform()).collect();
        // Passes the image on, which few channels of random weights would not.
        (0..CHANNELS_OF_VGG).for_each(|o| weight[(o * inputs + o % inputs) * 9 + 4] += 1.0);
        inputs = CHANNELS_OF_VGG;
        (weight, (0..CHANNELS_OF_VGG).map(|_| 0.1 + 0.1 * uniform()).collect())
    };
    [2, 2, 4, 4, 4].map(|count| (0..count).map(&mut convolution).collect()).to_vec()
}

/// Planes `[channel][row][column]` in double precision.
type Planes = Vec<Vec<Vec<f64>>>;

/// The features of the last convolution, term by term: zero padding, rectifiers between, 2 × 2 maxima between stages.
fn features(image: &ToneMappedImage, network: &Convolutions) -> Planes {
    let (mean, deviation) = ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]);
    let normalised = |c: usize, y, x| (f64::from(image.planes()[[c, y, x]]) - mean[c]) / deviation[c];
    let plane =
        |c| (0..image.height()).map(|y| (0..image.width()).map(|x| normalised(c, y, x)).collect()).collect();
    let mut planes: Planes = (0..3).map(plane).collect();
    for (s, stage) in network.iter().enumerate() {
        if s > 0 {
            planes = planes.iter().map(|plane| halve(plane)).collect();
        }
        for (c, (weight, bias)) in stage.iter().enumerate() {
            planes = convolve(&planes, weight, bias);
            if (s, c) != (network.len() - 1, stage.len() - 1) {
                planes.iter_mut().flatten().flatten().for_each(|value| *value = value.max(0.0));
            }
        }
    }
    planes
}

fn halve(plane: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let largest = |y: usize, x: usize| {
        let [a, b] = [&plane[2 * y], &plane[2 * y + 1]].map(|row| row[2 * x].max(row[2 * x + 1]));
        a.max(b)
    };
    (0..plane.len() / 2).map(|y| (0..plane[0].len() / 2).map(|x| largest(y, x)).collect()).collect()
}

fn convolve(planes: &Planes, weight: &[f32], bias: &[f32]) -> Planes {
    let (height, width) = (planes[0].len() as i64, planes[0][0].len() as i64);
    let at = |i: usize, y: i64, x: i64| match (0..height).contains(&y) && (0..width).contains(&x) {
        true => planes[i][y as usize][x as usize],
        false => 0.0,
    };
    let value = |o: usize, y: i64, x: i64| {
        let mut sum = f64::from(bias[o]);
        for (i, (dy, dx)) in (0..planes.len()).flat_map(|i| (0..9).map(move |k| (i, (k / 3, k % 3)))) {
            let weight = weight[((o * planes.len() + i) * 3 + dy as usize) * 3 + dx as usize];
            sum += f64::from(weight) * at(i, y + dy - 1, x + dx - 1);
        }
        sum
    };
    let plane = |o| (0..height).map(|y| (0..width).map(|x| value(o, y, x)).collect()).collect();
    (0..bias.len()).map(plane).collect()
}

/// A trainer whose loss has the small network, over crops that survive four halvings.
fn perceptual_trainer(distance: FeatureDistance) -> (Trainer, InMemory) {
    let mut config = config(2, 1);
    (config.data.crop, config.data.shuffle, config.loss.l1) = (16, false, 0.7);
    config.optimizer.learning_rate = 1e-3;
    let whole = data().0.into_iter().map(|patch| {
        let enlarged = |image: &ToneMappedImage| {
            let planes = image.planes();
            let at = |(c, y, x): (usize, usize, usize)| planes[[c, y % 14, x % 15]];
            ToneMappedImage::from_planes(Array3::from_shape_fn((3, 16, 16), at)).unwrap()
        };
        Patch { degraded: enlarged(&patch.degraded), ground_truth: enlarged(&patch.ground_truth), ..patch }
    });
    let data = InMemory(whole.collect());
    let mut trainer = Trainer::new(&config, None, 4, Backend::default()).unwrap();
    let network = PerceptualLoss::of_convolutions(&small_vgg(), distance);
    trainer.worker = trainer.worker.with_loss(Loss::with_perceptual(config.loss.l1, WEIGHT, network));
    (trainer, data)
}

/// Weight of the perceptual distance, large enough to count beside L1.
const WEIGHT: f64 = 0.5;

/// The first step's loss is that of both parts, computed from the restored images by other code. 32-bit features of
/// sixteen convolutions agree to 10⁻⁵ of their size.
#[test]
fn the_loss_of_a_step_is_l1_and_the_weighted_distance_of_features() {
    use crate::network::Model;
    use crate::network::weights::Weights;
    for distance in [FeatureDistance::SquaredL2, FeatureDistance::L1] {
        let (mut trainer, data) = perceptual_trainer(distance);
        let model = Model::new(Weights {
            architecture: trainer.config.architecture.clone(),
            parameters: trainer.state.parameters.clone(),
            origin: crate::network::Origin::default(),
        });
        let (mut l1, mut far) = (0.0, 0.0);
        for patch in &data.0[..2] {
            let restored = model.restore(&Inputs::new(&patch.degraded, patch.code.as_ref())).unwrap();
            let pairs = restored.as_slice().iter().zip(patch.ground_truth.as_slice());
            l1 += pairs.map(|(a, b)| f64::from((a - b).abs())).sum::<f64>() / (2 * 3 * 16 * 16) as f64;
            let [found, wanted] =
                [&restored, &patch.ground_truth].map(|image| features(image, &small_vgg()).concat().concat());
            let apart = |(a, b): (&f64, &f64)| match distance {
                FeatureDistance::SquaredL2 => (a - b).powi(2),
                FeatureDistance::L1 => (a - b).abs(),
            };
            far += found.iter().zip(&wanted).map(apart).sum::<f64>() / (2 * found.len()) as f64;
        }
        let expected = 0.7 * l1 + WEIGHT * far;
        assert!(WEIGHT * far > 0.05 * expected, "{distance:?}: the features count, {far} beside {l1}");
        let loss = trainer.step(&data).unwrap().loss;
        assert!((loss / expected - 1.0).abs() < 1e-4, "{distance:?}: {loss}, expected {expected}");
    }
}

/// Along its gradient the loss rises by the gradient's norm: both parts take part in it. The step is so small that few
/// rectifiers switch, and moves the loss by far more than its rounding.
#[test]
fn a_perceptual_loss_has_the_gradient_of_its_value_and_falls() {
    let (mut trainer, data) = perceptual_trainer(FeatureDistance::SquaredL2);
    let start = trainer.state.parameters.clone();
    let patches: Vec<Patch> = data.0[..2].to_vec();
    let differentiate = |parameters: &Parameters| {
        let network = trainer.worker.network(parameters);
        trainer.differentiate(&network, &patches).unwrap()
    };
    let (_, gradients) = differentiate(&start);
    let norm = global_norm(&gradients);
    let moved = |sign: f32| {
        let mut parameters = start.clone();
        for (parameter, gradient) in parameters.iter_mut().zip(&gradients) {
            for (value, gradient) in parameter.values.iter_mut().zip(gradient) {
                *value += sign * 3e-4 * gradient / norm as f32;
            }
        }
        differentiate(&parameters).0
    };
    let slope = (moved(1.0) - moved(-1.0)) / 6e-4;
    assert!((slope / norm - 1.0).abs() < 0.02, "{slope}, the gradient's norm is {norm}");
    let losses: Vec<f64> = (0..24).map(|_| trainer.step(&data).unwrap().loss).collect();
    assert!(losses[22] + losses[23] < losses[0] + losses[1], "{losses:?}");
}

/// The third image is so bright that the squares of its gradients overflow, though its loss does not.
#[test]
fn a_training_that_overflows_leaves_its_last_checkpoint_as_it_was() {
    use crate::core::progress::Progress;
    use crate::train::{DataIdentity, Job, Start};
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(1, 1);
    config.architecture =
        Architecture { kind: Kind::Unet, condition: Condition::None, ..config.architecture };
    (config.data.shuffle, config.checkpoint.every, config.iterations) = (false, 1, 9);
    let mut data = data();
    let bright = data.0[2].degraded.planes().mapv(|value| value * 1e22);
    data.0[2].degraded = ToneMappedImage::from_planes(bright).unwrap();
    let run = |start| {
        let (identity, progress) = (DataIdentity::default(), Progress::default());
        let job = Job {
            config: &config,
            data: &data,
            validation: None,
            data_say_formation: false,
            measures: &[],
            identity,
            backends: Backend::default().into(),
            progress: &progress,
            warn: &|text| panic!("{text}"),
        };
        job.run(folder.path(), start).unwrap_err().to_string()
    };
    let state = || std::fs::read(folder.path().join("checkpoints/2/state.safetensors")).unwrap();
    let message = run(Start::New(None));
    assert!(message.contains("overflowed") && message.contains("iteration 3"), "{message}");
    let before = state();
    assert_eq!(
        run(Start::Resume),
        message,
        "the checkpoint is whole, and the training comes to the same end"
    );
    assert!(state() == before && !folder.path().join("checkpoints/3").exists());
}

/// Samples as large as crops are, whose planes differ from each other.
fn data_with_planes(scale: f32) -> InMemory {
    let with_planes = |patch: Patch| {
        let [degraded, ground_truth] =
            [&patch.degraded, &patch.ground_truth].map(|image| image.crop(0, 0, 12, 12));
        let planes = testing::planes_of(&ground_truth.map_values(|v| scale * v));
        Patch { degraded, ground_truth, planes, ..patch }
    };
    InMemory(data().0.into_iter().map(with_planes).collect())
}

/// The loss of a step is that of images which the model restores with the planes, to the rounding of sums.
#[test]
fn a_network_that_reads_planes_learns_from_them_and_restores_with_them() {
    use crate::network::weights::Weights;
    use crate::network::{Model, Origin};
    for kind in [Kind::AllPlanes, Kind::AllPlanesTensors] {
        let mut config = config(4, 1);
        config.architecture =
            Architecture { kind, condition: Condition::None, features: 4, ..config.architecture };
        (config.optimizer.learning_rate, config.data.shuffle) = (1e-3, false);
        let mut trainer = Trainer::new(&config, None, 4, Backend::default()).unwrap();
        let loss_of = |trainer: &Trainer, data: &InMemory| {
            let (architecture, parameters) = (config.architecture.clone(), trainer.weights().into_owned());
            let model = Model::new(Weights { architecture, parameters, origin: Origin::default() });
            let loss = |patch: &Patch| {
                let inputs = Inputs::new(&patch.degraded, None).with_planes(&patch.planes);
                let restored = model.restore(&inputs).unwrap();
                let pairs = restored.as_slice().iter().zip(patch.ground_truth.as_slice());
                pairs.map(|(a, b)| f64::from((a - b).abs())).sum::<f64>() / restored.as_slice().len() as f64
            };
            data.0.iter().map(loss).sum::<f64>() / data.0.len() as f64
        };
        let data = data_with_planes(1.0);
        let first = loss_of(&trainer, &data);
        for _ in 0..12 {
            let expected = loss_of(&trainer, &data);
            let found = trainer.step(&data).unwrap().loss;
            assert!((found / expected - 1.0).abs() < 1e-5, "{kind:?}: {found}, expected {expected}");
        }
        assert!(loss_of(&trainer, &data) < 0.9 * first, "{kind:?}: {first}");
        let others = loss_of(&trainer, &data_with_planes(0.5));
        assert!((others / loss_of(&trainer, &data) - 1.0).abs() > 1e-2, "{kind:?}: planes count");
    }
}

#[test]
fn data_without_the_planes_that_a_network_reads_are_refused() {
    let mut config = config(1, 1);
    config.architecture =
        Architecture { kind: Kind::AllPlanes, condition: Condition::None, ..config.architecture };
    let mut trainer = Trainer::new(&config, None, 4, Backend::default()).unwrap();
    let message = trainer.step(&data()).unwrap_err().to_string();
    assert!(message.contains("the plane \"deconvolved\""), "{message}");
}

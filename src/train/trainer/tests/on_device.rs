//! Trainings whose weights are on a device, with the CPU in its place: in bfloat16 as well.

use super::*;
use crate::network::Precision;
use crate::train::on_device::Gather;
use crate::train::worker::Batch;
use burn::tensor::DType;

/// Every family whose last layer learns from the first step on.
fn architectures() -> Vec<Architecture> {
    let of = |kind, condition| Architecture {
        kind,
        condition,
        features: 6,
        filter_size: 3,
        ..Architecture::default()
    };
    vec![
        of(Kind::Discnet, Condition::ImagePsf),
        of(Kind::Unet, Condition::None),
        of(Kind::Srmdnf, Condition::ImagePsf),
        of(Kind::Sftmd, Condition::ImagePsf),
        of(Kind::DeUnet, Condition::Image),
        of(Kind::Guided, Condition::None),
    ]
}

fn mixed(architecture: Architecture) -> TrainConfig {
    let mut config = TrainConfig { architecture, precision: Precision::Bf16, ..config(2, 1) };
    config.data.crop = 12;
    config
}

fn losses(config: &TrainConfig, backend: Backend, steps: usize) -> Vec<f64> {
    let mut trainer = Trainer::new(config, None, 4, backend).unwrap();
    (0..steps).map(|_| trainer.step(&data_with_planes(1.0)).unwrap().loss).collect()
}

/// The mean over some hundred pixels of errors that rounding changes by up to 4 % each, in both directions, and that those
/// of twenty steps change in one: 3 %.
#[test]
fn trainings_in_bfloat16_follow_those_in_32_bits() {
    for architecture in architectures() {
        let mut config = mixed(architecture);
        (config.optimizer.learning_rate, config.optimizer.clip_norm, config.optimizer.ema_decay) =
            (1e-3, 1.0, 0.9);
        let rounded = losses(&config, Backend::AsDevice, 20);
        config.precision = Precision::F32;
        let exact = losses(&config, Backend::AsDevice, 20);
        let errors = exact.iter().zip(&rounded).map(|(exact, rounded)| (rounded / exact - 1.0).abs());
        let largest = errors.fold(0.0, f64::max);
        assert!(largest > 0.0 && largest < 0.03, "{:?}: {exact:?} {rounded:?}", config.architecture.kind);
        assert!(
            exact[19] < exact[0] && rounded[19] < rounded[0],
            "{:?}: it learns",
            config.architecture.kind
        );
    }
}

/// A step changes each weight by at most the learning rate, a thousandth of what bfloat16 tells apart near the largest.
#[test]
fn changes_that_bfloat16_does_not_tell_apart_add_up() {
    let mut config = mixed(architectures().swap_remove(0));
    config.optimizer.learning_rate = 1e-6;
    let mut trainer = Trainer::new(&config, None, 4, Backend::AsDevice).unwrap();
    let before = trainer.weights().into_owned();
    for _ in 0..20 {
        trainer.step(&data_with_planes(1.0)).unwrap();
    }
    let after = trainer.weights().into_owned();
    let pairs = || before.iter().zip(after.iter()).flat_map(|(a, b)| a.values.iter().zip(&b.values));
    let largest = pairs().map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(largest > 1.5e-5 && largest < 2.5e-5, "{largest:e}");
    let moved = pairs().filter(|(a, b)| a != b && half::bf16::from_f32(**a) == half::bf16::from_f32(**b));
    assert!(moved.count() > before.iter().map(|p| p.values.len()).sum::<usize>() / 2);
}

#[test]
fn gradients_and_outputs_in_bfloat16_are_of_32_bits() {
    let config = mixed(architectures().swap_remove(0));
    let trainer = Trainer::new(&config, None, 4, Backend::AsDevice).unwrap();
    let on_device = trainer.on_device.as_ref().unwrap();
    let network = trainer.worker.network_of_flat(on_device.weights());
    let patches = data_with_planes(1.0).0;
    let batch = Batch::new(&network, &patches, &trainer.worker.device).unwrap();
    let restored = network.forward(batch.inputs);
    assert_eq!(restored.dtype(), DType::F32);
    let gradients = restored.sum().backward();
    for gradient in Gather::of(&network, gradients, trainer.state.parameters.len()) {
        assert_eq!(gradient.unwrap().dtype(), DType::F32);
    }
}

#[test]
fn the_cpu_refuses_to_train_in_bfloat16() {
    let config = mixed(architectures().swap_remove(0));
    let message = Trainer::new(&config, None, 4, Backend::Flex).unwrap_err().to_string();
    assert!(message.contains("precision") && message.contains("--device gpu"), "{message}");
}

fn shared(batch: usize, accumulate: usize) -> TrainConfig {
    let mut config = config(batch, accumulate);
    (config.optimizer.learning_rate, config.optimizer.clip_norm, config.optimizer.ema_decay) =
        (1e-3, 0.1, 0.9);
    config
}

fn steps(trainer: &mut Trainer, count: usize) -> Vec<Step> {
    (0..count).map(|_| trainer.step(&data()).unwrap()).collect()
}

/// The same samples in the same order; sums of f32 in another.
#[test]
fn a_batch_that_devices_share_makes_the_step_of_one() {
    for (devices, accumulate) in [(2, 1), (4, 1), (2, 2)] {
        let config = shared(4, accumulate);
        let mut alone = Trainer::new(&config, None, 4, Backend::AsDevice).unwrap();
        let mut together = Trainer::new(&config, None, 4, Backends::as_devices(devices)).unwrap();
        for (alone, together) in steps(&mut alone, 4).iter().zip(steps(&mut together, 4)) {
            assert!((alone.loss / together.loss - 1.0).abs() < 1e-5, "{alone:?} {together:?}");
            assert!(
                (alone.gradient_norm / together.gradient_norm - 1.0).abs() < 1e-4,
                "{alone:?} {together:?}"
            );
        }
        let values = |trainer: &Trainer| -> Vec<f32> {
            trainer.weights().iter().flat_map(|parameter| parameter.values.clone()).collect()
        };
        for (a, b) in values(&alone).into_iter().zip(values(&together)) {
            // Four steps of Adam; where a gradient is rounding alone its direction may be another.
            assert!((a - b).abs() < 1e-4, "{a} {b}");
        }
    }
}

/// A training that is rehearsed uses the same devices as the one that follows.
#[test]
fn a_training_on_several_devices_repeats_to_the_bit() {
    let mut trainer = Trainer::new(&shared(4, 1), None, 4, Backends::as_devices(2)).unwrap();
    let mut rehearsed = trainer.clone();
    assert_eq!(steps(&mut rehearsed, 3), steps(&mut trainer, 3));
    assert_eq!(rehearsed.state(), trainer.state());
}

#[test]
fn a_device_that_fails_keeps_no_other_waiting() {
    let mut config = shared(2, 1);
    config.data.shuffle = false;
    let mut trainer = Trainer::new(&config, None, 4, Backends::as_devices(2)).unwrap();
    for broken in [0, 1] {
        let mut trainer = trainer.clone();
        let mut data = data();
        data.0[broken].code = None;
        let message = format!("{:#}", anyhow::Error::from(trainer.step(&data).unwrap_err()));
        assert!(message.contains("kernel code"), "{message}");
        assert_eq!(trainer.iteration(), 0);
    }
    assert_eq!(steps(&mut trainer, 2).len(), 2);
}

#[test]
fn a_batch_that_devices_cannot_share_is_refused() {
    let message = Trainer::new(&shared(3, 2), None, 4, Backends::as_devices(2)).unwrap_err().to_string();
    assert!(message.contains("data.batch") && message.contains("multiple of 2"), "{message}");
}

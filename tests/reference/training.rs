//! Twelve training steps against the same steps in PyTorch: losses, learning rates, final weights.

use std::path::{Path, PathBuf};

use ndarray::{Array2, Array4, Axis};
use serde_json::Value;
use udc::core::image::{LinearImage, ToneMappedImage};
use udc::core::tone::ToneCurve;
use udc::network::{Backend, Planes, weights};
use udc::train::{InMemory, Patch, TrainConfig, Trainer};

use crate::discnet::npy;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/training").join(name)
}

fn images(name: &str) -> Vec<ToneMappedImage> {
    let batch: Array4<f32> = npy(&fixture(name)).into_dimensionality().expect("a batch has four axes");
    let planes = batch.permuted_axes([0, 3, 1, 2]);
    let tone_map = |image: ndarray::ArrayView3<'_, f32>| {
        let image = LinearImage::from_planes(image.to_owned()).expect("the images are RGB");
        ToneCurve::default().tone_map(&image)
    };
    planes.axis_iter(Axis(0)).map(tone_map).collect()
}

fn data() -> InMemory {
    let codes: Array2<f32> = npy(&fixture("codes.npy")).into_dimensionality().expect("codes have two axes");
    let pairs = images("degraded.npy").into_iter().zip(images("gt.npy")).zip(codes.rows());
    let patch = |((degraded, ground_truth), code): ((_, _), ndarray::ArrayView1<'_, f32>)| Patch {
        degraded,
        ground_truth,
        code: Some(code.to_owned()),
        planes: Planes::default(),
    };
    InMemory(pairs.map(patch).collect())
}

/// The backends of this build.
const BACKENDS: &[Backend] = &[
    Backend::Flex,
    #[cfg(feature = "ndarray-backend")]
    Backend::NdArray,
];

/// The bounds are those promised: 1e-4 relative for losses, 1e-5 for weights, twenty times less than twelve
/// steps of at most 2e-4 each could move a weight.
#[test]
fn twelve_steps_follow_pytorch() {
    BACKENDS.iter().for_each(|backend| follow_pytorch(*backend));
}

fn follow_pytorch(backend: Backend) {
    let text = std::fs::read_to_string(fixture("case.json")).unwrap();
    let case: Value = serde_json::from_str(&text).unwrap();
    let numbers = |key: &str| -> Vec<f64> { serde_json::from_value(case[key].clone()).unwrap() };
    let initial = weights::read(&fixture("init.pth")).unwrap();
    let mut config = TrainConfig { architecture: initial.architecture.clone(), ..TrainConfig::default() };
    config.schedule.period = 8;
    (config.data.batch, config.data.accumulate, config.data.crop, config.data.shuffle) = (2, 1, 48, false);
    let data = data();
    let mut trainer = Trainer::new(&config, Some(initial.parameters), data.0.len(), backend).unwrap();
    for (loss, rate) in numbers("losses").into_iter().zip(numbers("learning_rates")) {
        let step = trainer.step(&data).unwrap();
        assert!((step.learning_rate - rate).abs() <= 1e-12, "{step:?}: expected rate {rate}");
        assert!((step.loss - loss).abs() <= 1e-4 * loss, "{step:?}: expected loss {loss}");
    }
    assert_eq!(trainer.iteration(), 12);
    let expected = weights::read(&fixture("after_12.pth")).unwrap();
    for (found, expected) in trainer.weights().iter().zip(expected.parameters.iter()) {
        assert_eq!(found.name, expected.name);
        let pairs = found.values.iter().zip(&expected.values);
        let error = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(error <= 1e-5, "{backend:?}, {}: {error:e}", found.name);
    }
}

//! DISCNet at its published width of 32 features against PyTorch: an image wider than the kernels' batches and tiles,
//! and the gradients of a batch of four.

use std::path::{Path, PathBuf};

use ndarray::{Array1, Array3};
use serde_json::Value;
use udc::core::image::ToneMappedImage;
use udc::core::kernel_code::KernelCode;
use udc::network::weights::Weights;
use udc::network::{Architecture, Backend, Initialisation, Inputs, Model, Origin, Parameters, Planes};
use udc::train::{InMemory, Patch, TrainConfig, Trainer};

use crate::discnet::npy;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/full_width").join(name)
}

/// Numbers from −1/2 to 1/2, by the formula of `make.py`.
fn numbers(name: &str, count: usize) -> Vec<f32> {
    let seed =
        name.bytes().fold(2_166_136_261u32, |seed, byte| (seed ^ u32::from(byte)).wrapping_mul(16_777_619));
    let number = |place: usize| {
        let mut x = (place as u32).wrapping_mul(2_654_435_761).wrapping_add(seed);
        x = (x ^ x >> 16).wrapping_mul(0x85eb_ca6b);
        x = (x ^ x >> 13).wrapping_mul(0xc2b2_ae35);
        ((x ^ x >> 16) >> 8) as f32 / (1 << 24) as f32 - 0.5
    };
    (0..count).map(number).collect()
}

/// Weights of deviation 1 / √fan, a fifth of it in residual blocks, biases up to 1/20, slopes of 1/4.
fn parameters(architecture: &Architecture) -> Parameters {
    let mut parameters = Parameters::random(architecture, Initialisation::Released, 0);
    for parameter in parameters.iter_mut() {
        let fan: usize = parameter.shape.iter().skip(1).product();
        let is_residual = [".conv1.", ".conv2."].iter().any(|part| parameter.name.contains(part));
        let scale = match parameter.shape.len() {
            1 => 0.1,
            _ => (if is_residual { 0.2 } else { 1.0 }) * (12.0 / fan as f64).sqrt(),
        };
        let is_slope = parameter.shape == [1];
        let drawn = numbers(&parameter.name, parameter.values.len());
        for (value, number) in parameter.values.iter_mut().zip(drawn) {
            *value = if is_slope { 0.25 } else { number * scale as f32 };
        }
    }
    parameters
}

fn images(name: &str, count: usize, height: usize, width: usize) -> Vec<ToneMappedImage> {
    let values: Vec<f32> = numbers(name, count * 3 * height * width).iter().map(|n| n + 0.5).collect();
    let image = |values: &[f32]| {
        let planes = Array3::from_shape_vec((3, height, width), values.to_vec()).unwrap();
        ToneMappedImage::from_planes(planes).unwrap()
    };
    values.chunks(3 * height * width).map(image).collect()
}

fn codes(count: usize) -> Vec<KernelCode> {
    numbers("code", count * 5).chunks(5).map(|code| Array1::from_vec(code.to_vec())).collect()
}

/// 1e-5 is the accuracy promised; the outputs reach 1.9.
#[test]
fn a_network_of_published_width_computes_what_pytorch_computes() {
    let architecture = Architecture::default();
    assert_eq!(architecture.features, 32);
    let parameters = parameters(&architecture);
    let model = Model::new(Weights { architecture, parameters, origin: Origin::default() });
    let restored = model.restore(&Inputs::new(&images("image", 1, 40, 200)[0], Some(&codes(1)[0]))).unwrap();
    let expected: Array3<f32> = npy(&fixture("output.npy")).into_dimensionality().unwrap();
    let expected = expected.permuted_axes([2, 0, 1]);
    let error = restored.planes().iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(error <= 1e-5, "{error:e}");
}

/// Takes the gradients of one step from how far Adam moves the weights.
///
/// Its first step is `rate · g / (|g| + ε)`: with an ε of 1e8, far above any gradient, and a rate of a million times that,
/// a million times the gradient, beside which what rounding takes from a weight is nothing.
fn gradients(config: &mut TrainConfig, initial: &Parameters, data: &InMemory) -> (f64, f64, Vec<Vec<f64>>) {
    const SCALE: f64 = 1e6;
    config.optimizer.epsilon = 1e8;
    config.optimizer.learning_rate = SCALE * config.optimizer.epsilon;
    let mut trainer = Trainer::new(config, Some(initial.clone()), data.0.len(), Backend::default()).unwrap();
    let step = trainer.step(data).unwrap();
    let weights = trainer.weights();
    let moved = initial.iter().zip(weights.iter()).map(|(before, after)| {
        let pairs = before.values.iter().zip(&after.values);
        pairs.map(|(before, after)| (f64::from(*before) - f64::from(*after)) / SCALE).collect()
    });
    (step.loss, step.gradient_norm, moved.collect())
}

/// Gradients add up to 16,384 products of each layer in 32 bits, through some forty layers: 1e-4 of the largest of a
/// tensor; a group of sums or a tile that is left out is a hundred times more.
#[test]
fn gradients_of_a_batch_at_published_width_are_those_of_pytorch() {
    let text = std::fs::read_to_string(fixture("gradients.json")).unwrap();
    let case: Value = serde_json::from_str(&text).unwrap();
    let mut config = TrainConfig::default();
    (config.data.batch, config.data.accumulate, config.data.crop, config.data.shuffle) = (4, 1, 64, false);
    let pairs = images("degraded", 4, 64, 64).into_iter().zip(images("ground truth", 4, 64, 64));
    let patch = |((degraded, ground_truth), code)| Patch {
        degraded,
        ground_truth,
        code: Some(code),
        planes: Planes::default(),
    };
    let data = InMemory(pairs.zip(codes(4)).map(patch).collect());
    let initial = parameters(&config.architecture);
    let (loss, norm, gradients) = gradients(&mut config, &initial, &data);

    let number = |value: &Value| value.as_f64().unwrap();
    let relative = |found: f64, expected: f64| (found - expected).abs() / expected.abs();
    assert!(relative(loss, number(&case["loss"])) < 1e-6, "loss {loss}");
    assert!(relative(norm, number(&case["norm"])) < 1e-5, "norm {norm}");
    assert_eq!(initial.len(), case["gradients"].as_object().unwrap().len());
    for (parameter, found) in initial.iter().zip(&gradients) {
        let (name, expected) = (&parameter.name, &case["gradients"][&parameter.name]);
        let (norm, largest) = (number(&expected["norm"]), number(&expected["largest"]));
        for (place, value) in expected["values"].as_array().unwrap().iter().enumerate() {
            let at = place * found.len() / 8;
            let error = (found[at] - number(value)).abs() / largest;
            assert!(error < 1e-4, "{name}, place {at}: {} is not {value} ({error:.1e})", found[at]);
        }
        for (index, sum) in expected["sums"].as_array().unwrap().iter().enumerate() {
            let factors = numbers(&format!("{name}/{index}"), found.len());
            let total: f64 = found.iter().zip(&factors).map(|(g, factor)| g * f64::from(*factor)).sum();
            let error = (total - number(sum)).abs() / norm;
            assert!(error < 1e-4, "{name}, sum {index}: {total} is not {sum} ({error:.1e})");
        }
    }
}

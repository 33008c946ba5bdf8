//! The perceptual loss and LPIPS against PyTorch's, with weights that a formula gives: no published weights are
//! needed.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use ndarray::Array3;
use serde_json::Value;
use udc::core::image::ToneMappedImage;
use udc::core::io::{self, TensorData};
use udc::perceptual::{FeatureDistance, Lpips, PerceptualLoss};

use crate::discnet::npy;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/perceptual").join(name)
}

fn case() -> Value {
    serde_json::from_str(&std::fs::read_to_string(fixture("case.json")).unwrap()).unwrap()
}

fn image(name: &str) -> ToneMappedImage {
    let rows: Array3<f32> = npy(&fixture(name)).into_dimensionality().expect("images have three axes");
    ToneMappedImage::from_planes(rows.permuted_axes([2, 0, 1])).expect("images are RGB")
}

/// The finaliser of SplitMix64, of the state after `z`.
fn splitmix64(z: u64) -> u64 {
    let z = z.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The formula of the fixture: tensor `t`'s values.
fn values(t: u64, shape: &[usize]) -> Vec<f32> {
    let fan_in: usize = shape[1..].iter().product();
    let scale = if shape.len() == 1 { 0.1 } else { (24.0 / fan_in as f64).sqrt() };
    let uniform = |j: u64| (splitmix64((t << 40) + j) >> 40) as f64 / (1u64 << 24) as f64 - 0.5;
    (0..shape.iter().product::<usize>() as u64).map(|j| (scale * uniform(j)) as f32).collect()
}

/// Writes the convolutions of a torchvision network: (place, [outputs, inputs, side, side]).
fn write_convolutions(path: &Path, layers: &[(usize, [usize; 4])]) {
    let mut tensors = BTreeMap::new();
    for (i, (place, shape)) in layers.iter().enumerate() {
        let mut add = |t: usize, part: &str, shape: &[usize]| {
            let data: TensorData<'_> = (shape.to_vec(), Cow::Owned(values(t as u64, shape)));
            tensors.insert(format!("features.{place}.{part}"), data);
        };
        add(2 * i, "weight", shape);
        add(2 * i + 1, "bias", &shape[..1]);
    }
    io::write_safetensors(path, &tensors, &BTreeMap::new(), false).unwrap();
}

fn write_vgg19(path: &Path) {
    let places = [0, 2, 5, 7, 10, 12, 14, 16, 19, 21, 23, 25, 28, 30, 32, 34];
    let outputs = [64, 64, 128, 128, 256, 256, 256, 256, 512, 512, 512, 512, 512, 512, 512, 512];
    let inputs = std::iter::once(3).chain(outputs);
    let layers = places.into_iter().zip(outputs.into_iter().zip(inputs));
    let layers: Vec<_> = layers.map(|(place, (o, i))| (place, [o, i, 3, 3])).collect();
    write_convolutions(path, &layers);
}

fn write_alexnet(path: &Path) {
    let layers = [
        (0, [64, 3, 11, 11]),
        (3, [192, 64, 5, 5]),
        (6, [384, 192, 3, 3]),
        (8, [256, 384, 3, 3]),
        (10, [256, 256, 3, 3]),
    ];
    write_convolutions(path, &layers);
}

fn write_linear(path: &Path) {
    let mut tensors = BTreeMap::new();
    for (i, channels) in [64, 192, 384, 256, 256].into_iter().enumerate() {
        let weights = (0..channels).map(|j| (0.5 + 0.5 * ((j + i) as f64).sin()) as f32).collect();
        let data: TensorData<'_> = (vec![1, channels, 1, 1], Cow::Owned(weights));
        tensors.insert(format!("lin{i}.model.1.weight"), data);
    }
    io::write_safetensors(path, &tensors, &BTreeMap::new(), false).unwrap();
}

fn assert_near(found: f64, expected: f64, tolerance: f64, what: &str) {
    assert!((found / expected - 1.0).abs() <= tolerance, "{what}: {found}, expected {expected}");
}

#[test]
fn lpips_is_that_of_pytorch() {
    let folder = tempfile::tempdir().unwrap();
    let (alexnet, linear) =
        (folder.path().join("alexnet.safetensors"), folder.path().join("linear.safetensors"));
    write_alexnet(&alexnet);
    write_linear(&linear);
    let lpips = Lpips::load(&alexnet, &linear).unwrap();
    let (x, y) = (image("x.npy"), image("y.npy"));
    assert_near(lpips.distance(&x, &y).unwrap(), case()["lpips_alex"].as_f64().unwrap(), 1e-4, "LPIPS");
    assert!(lpips.distance(&x, &x).unwrap().abs() < 1e-12);
    let message = lpips.distance(&x, &x.crop(0, 0, 40, 40)).unwrap_err().to_string();
    assert!(message.contains("40 × 40"), "{message}");
    assert!(lpips.distance(&x.crop(0, 0, 30, 40), &y.crop(0, 0, 30, 40)).is_err());
    assert!(lpips.distance(&x.crop(0, 0, 31, 31), &y.crop(0, 0, 31, 31)).is_ok());
    let message = Lpips::load(&linear, &alexnet).unwrap_err().to_string();
    assert!(
        message.contains("features.0.weight") && message.contains("alexnet-owt-7be5be79.pth"),
        "{message}"
    );
}

/// The values are PyTorch's. Along its gradient the loss rises by the gradient's norm; the step moves pixels by up
/// to some thousandths, so that few rectifiers switch.
#[test]
fn the_perceptual_loss_is_that_of_pytorch_and_rises_along_its_gradient() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("vgg19.safetensors");
    write_vgg19(&path);
    let (x, y) = (image("x.npy"), image("y.npy"));
    let sides = [1, x.height(), x.width()];
    let case = case();
    for (distance, key) in [(FeatureDistance::SquaredL2, "mse"), (FeatureDistance::L1, "l1")] {
        let loss = PerceptualLoss::load(&path, distance).unwrap();
        let (value, gradient) = loss.value_and_gradient(x.as_slice(), y.as_slice(), sides).unwrap();
        assert_near(value, case["vgg19_conv5_4"][key].as_f64().unwrap(), 1e-4, key);
        let norm = gradient.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
        let step = 0.02;
        let moved = |sign: f64| {
            let along = |(x, g): (&f32, &f32)| x + (sign * step * f64::from(*g) / norm) as f32;
            let moved: Vec<f32> = x.as_slice().iter().zip(&gradient).map(along).collect();
            loss.value_and_gradient(&moved, y.as_slice(), sides).unwrap().0
        };
        assert_near((moved(1.0) - moved(-1.0)) / (2.0 * step), norm, 2e-2, "slope");
        let pair = [x.as_slice(), y.as_slice()].concat();
        let (both, gradients) =
            loss.value_and_gradient(&pair, &[y.as_slice(); 2].concat(), [2, 80, 96]).unwrap();
        assert_near(2.0 * both, value, 1e-5, "a batch with one equal pair");
        assert_near(2.0 * f64::from(gradients[100]), f64::from(gradient[100]), 1e-3, "its gradient");
        assert!(loss.value_and_gradient(&[0.0; 3 * 15 * 16], &[0.0; 3 * 15 * 16], [1, 15, 16]).is_err());
    }
}

#[test]
fn missing_weights_are_described() {
    let absent = Path::new("absent.pth");
    let message = PerceptualLoss::load(absent, FeatureDistance::L1).unwrap_err().to_string();
    for part in ["absent.pth", "no such file", "VGG-19", "vgg19-dcbb9e9d.pth", "features.34"] {
        assert!(message.contains(part), "{message}");
    }
    let message = Lpips::load(absent, absent).unwrap_err().to_string();
    assert!(message.contains("AlexNet"), "{message}");
}

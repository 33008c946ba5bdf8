//! The perceptual loss and LPIPS against PyTorch's, with weights that a formula gives: no published weights are
//! needed.

use std::path::{Path, PathBuf};

use ndarray::Array3;
use serde_json::Value;
use udc::core::image::ToneMappedImage;
use udc::network::Backend;
use udc::perceptual::{FeatureDistance, Lpips, PerceptualLoss};

use crate::discnet::npy;
use crate::perceptual_weights::{write_alexnet, write_convolutions, write_linear};

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

fn write_vgg19(path: &Path) {
    let places = [0, 2, 5, 7, 10, 12, 14, 16, 19, 21, 23, 25, 28, 30, 32, 34];
    let outputs = [64, 64, 128, 128, 256, 256, 256, 256, 512, 512, 512, 512, 512, 512, 512, 512];
    let inputs = std::iter::once(3).chain(outputs);
    let layers = places.into_iter().zip(outputs.into_iter().zip(inputs));
    let layers: Vec<_> = layers.map(|(place, (o, i))| (place, [o, i, 3, 3])).collect();
    write_convolutions(path, &layers);
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
    let lpips = Lpips::load(&alexnet, &linear, Backend::default()).unwrap();
    let (x, y) = (image("x.npy"), image("y.npy"));
    assert_near(lpips.distance(&x, &y).unwrap(), case()["lpips_alex"].as_f64().unwrap(), 1e-4, "LPIPS");
    assert!(lpips.distance(&x, &x).unwrap().abs() < 1e-12);
    let message = lpips.distance(&x, &x.crop(0, 0, 40, 40)).unwrap_err().to_string();
    assert!(message.contains("40 × 40"), "{message}");
    assert!(lpips.distance(&x.crop(0, 0, 30, 40), &y.crop(0, 0, 30, 40)).is_err());
    assert!(lpips.distance(&x.crop(0, 0, 31, 31), &y.crop(0, 0, 31, 31)).is_ok());
    let message = Lpips::load(&linear, &alexnet, Backend::default()).unwrap_err().to_string();
    assert!(
        message.contains("features.0.weight") && message.contains("alexnet-owt-7be5be79.pth"),
        "{message}"
    );
}

/// The values are PyTorch's. Along its gradient the loss rises by the gradient's norm; the step is so
/// small that few rectifiers and poolings switch, and moves the loss by 1e-3 of itself, far more than its rounding.
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
        let step = 0.004;
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
    let message = Lpips::load(absent, absent, Backend::default()).unwrap_err().to_string();
    assert!(message.contains("AlexNet"), "{message}");
}

//! `udc restore --bank --angle auto`: any panel whose angle is not known.

use ndarray::Array3;
use rand::RngExt as _;
use udc::codes::make_rotated_bank;
use udc::core::fft::{Boundary, Convolver};
use udc::core::image::{Linear, LinearImage};
use udc::core::psf::Psf;
use udc::core::rng::stream;
use udc::core::tone::ToneCurve;
use udc::io::{self, WriteOptions};

use super::common::succeed;

/// Where captures saturate.
const LEVEL: f32 = 500.0;

/// A core and a lattice of orders, turned counter-clockwise as displayed.
fn lattice(angle_deg: f64) -> Psf {
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    let light = |(_, y, x): (usize, usize, usize)| {
        let (dy, dx) = (y as f64 - 30.0, x as f64 - 30.0);
        let (u, v) = (cos * dx - sin * dy, sin * dx + cos * dy);
        let beside = |at: f64| at - 8.0 * (at / 8.0).round();
        let orders = (-(beside(u).powi(2) + beside(v).powi(2)) / 2.0 - u.hypot(v) / 20.0).exp();
        ((-(u * u + v * v) / 2.0).exp() + 0.01 * orders) as f32
    };
    Psf::from_energy(Array3::from_shape_fn((3, 61, 61), light)).unwrap()
}

/// An angle between two of the bank is found in a capture, and restores it better than one beside it.
#[test]
fn the_angle_of_a_bank_is_found_in_each_capture() {
    const SIDE: usize = 192;
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let bank = make_rotated_bank(&lattice(0.0), &[-9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0], 2).unwrap();
    io::write_bank(&folder.join("bank.safetensors"), &bank, false).unwrap();
    let mut rng = stream(8, "night");
    let mut scene = Array3::from_shape_simple_fn((3, SIDE, SIDE), || 0.05 + 0.1 * rng.random::<f32>());
    for _ in 0..20 {
        let [y, x] = [(); 2].map(|()| rng.random_range(10..SIDE - 13));
        let light = 10f32.powf(rng.random_range(0.5..3.5));
        scene.slice_mut(ndarray::s![.., y..y + 3, x..x + 3]).fill(light);
    }
    let scene = LinearImage::from_planes(scene).unwrap();
    let convolver = Convolver::new([SIDE, SIDE], [61, 61], Boundary::Replicate).unwrap();
    let seen =
        convolver.convolve(&convolver.spectrum(&scene).unwrap(), &convolver.otf(&lattice(4.3)).unwrap());
    let capture = LinearImage::from_planes(seen.mapv(|light| light.min(LEVEL))).unwrap();
    io::write_image(&folder.join("seen.exr"), &capture, &WriteOptions::default()).unwrap();
    let curve = ToneCurve::new(0.25, LEVEL).unwrap();
    let restore = |angle: &str| {
        let call =
            ["restore", "seen.exr", "--bank", "bank.safetensors", "--overwrite", "--json", "-o", "o.exr"];
        let said = succeed(folder, &[&call[..], &[angle]].concat());
        let restored = io::read_image::<Linear>(&folder.join("o.exr")).unwrap();
        let pairs = restored.as_slice().iter().zip(scene.as_slice());
        let error: f32 = pairs.map(|(a, b)| (curve.compress(*a) - curve.compress(*b)).powi(2)).sum();
        (said, error)
    };
    let (said, found) = restore("--angle=auto");
    let event = said.lines().find(|line| line.contains("angle-deg")).unwrap();
    let event: serde_json::Value = serde_json::from_str(event).unwrap();
    let angle = event["angle"]["angle-deg"].as_f64().unwrap();
    assert!((angle - 4.3).abs() < 0.8, "{angle}");
    let straight = restore("--angle=0").1;
    assert!(found < 0.8 * straight, "{found} {straight}");
}

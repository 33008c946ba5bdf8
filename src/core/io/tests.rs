use ndarray::{Array1, Array2, Array3};

use super::*;
use crate::core::image::{LinearImage, ToneMappedImage};
use crate::core::kernel_code::{CodeBasis, KernelBank};

/// Values of many magnitudes, none of them special.
fn scene(height: usize, width: usize) -> LinearImage {
    let planes = Array3::from_shape_fn((3, height, width), |(c, y, x)| {
        let i = (c * height + y) * width + x;
        ((i * 7919) % 1013) as f32 * 2f32.powi((i % 23) as i32 - 12)
    });
    LinearImage::from_planes(planes).unwrap()
}

fn bank() -> KernelBank {
    let psfs: Vec<Psf> = (1..4)
        .map(|k| {
            let energy = Array3::from_shape_fn((3, 4, 5), |(c, y, x)| ((c + y * k + x) % 5 + 1) as f32);
            Psf::from_energy(energy).unwrap()
        })
        .collect();
    let basis = CodeBasis {
        mean: Array1::from_shape_fn(60, |i| i as f32 * 0.1),
        components: Array2::from_shape_fn((2, 60), |(b, i)| (b * 60 + i) as f32),
        explained_variance: Array1::from_vec(vec![2.0, 1.0]),
    };
    let codes = Array2::from_shape_fn((3, 2), |(k, b)| (k * 2 + b) as f32 - 2.5);
    KernelBank::new(psfs, codes, basis, Some(vec![-3.0, 0.0, 3.5])).unwrap()
}

#[test]
fn float_formats_return_an_image_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    for (height, width) in [(1, 1), (7, 5), (37, 130)] {
        let image = scene(height, width);
        for name in ["a.exr", "a.npy"] {
            let path = folder.path().join(name);
            write_image(&path, &image, &WriteOptions { overwrite: true, ..Default::default() }).unwrap();
            assert_eq!(read_image::<Linear>(&path).unwrap(), image, "{name} of {height} × {width}");
        }
    }
}

#[test]
fn a_bank_returns_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bank.safetensors");
    write_bank(&path, &bank(), false).unwrap();
    assert_eq!(read_bank(&path).unwrap(), bank());
}

#[test]
fn refuses_an_image_of_the_other_domain() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    write_image(&path, &scene(3, 4), &WriteOptions::default()).unwrap();
    let message = read_image::<ToneMapped>(&path).unwrap_err().to_string();
    assert!(message.contains("--domain linear"), "{message}");
}

#[test]
fn integer_formats_round_to_their_step() {
    let folder = tempfile::tempdir().unwrap();
    let planes = Array3::from_shape_fn((3, 9, 11), |(c, y, x)| (c * 99 + y * 11 + x) as f32 / 296.0);
    let image = ToneMappedImage::from_planes(planes).unwrap();
    for (name, step) in [("a.png", 1.0 / 65535.0), ("a.tif", 1.0 / 65535.0)] {
        let path = folder.path().join(name);
        write_image(&path, &image, &WriteOptions::default()).unwrap();
        let read = read_image::<ToneMapped>(&path).unwrap();
        for (a, b) in image.as_slice().iter().zip(read.as_slice()) {
            assert!((a - b).abs() <= 0.5 * step + f32::EPSILON, "{name}: {a} {b}");
        }
    }
}

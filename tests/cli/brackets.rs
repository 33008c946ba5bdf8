//! Brackets: exposure times in any unit, several pictures of one time, dark frames.

use std::fs;
use std::path::Path;

use ndarray::Array3;
use tempfile::{TempDir, tempdir};
use udc::core::io::{self, PixelOptions, Pixels, WriteOptions};
use udc::core::psf::Psf;

use crate::common::succeed;

const SHARES: [f32; 3] = [1.0, 1.0 / 4.0, 1.0 / 16.0];
const FILES: [&str; 3] = ["long.npy", "middle.npy", "short.npy"];

fn write(folder: &Path, name: &str, planes: Array3<f32>) {
    let options = PixelOptions { overwrite: true, ..PixelOptions::default() };
    io::write_pixels(&folder.join(name), &Pixels::of_planes(planes), options).unwrap();
}

/// A scene whose lamp is five times as bright as white of the longest exposure.
fn scene() -> Array3<f32> {
    Array3::from_shape_fn((3, 48, 56), |(c, y, x)| {
        let squared = (y as f32 - 20.0).powi(2) + (x as f32 - 30.0).powi(2);
        0.1 + 0.02 * (c + 1) as f32 * (1.0 + (0.3 * x as f32).sin()) + 5.0 * (-squared / 20.0).exp()
    })
}

/// A scratch folder with the scene in three exposures, and a PSF to restore it by.
fn scratch() -> TempDir {
    let scratch = tempdir().unwrap();
    for (name, share) in FILES.iter().zip(SHARES) {
        write(scratch.path(), name, scene().mapv(|v| (v * share).min(1.0)));
    }
    let energy = Array3::from_shape_fn((3, 9, 9), |(_, y, x)| {
        (-((y as f32 - 4.0).powi(2) + (x as f32 - 4.0).powi(2)) / 2.0).exp()
    });
    let psf = Psf::from_energy(energy).unwrap();
    io::write_psf(&scratch.path().join("psf.exr"), &psf, &WriteOptions::default()).unwrap();
    scratch
}

/// The bytes of what `udc` makes of the files in one file name.
fn made(folder: &Path, command: &[&str], more: &[&str]) -> Vec<u8> {
    succeed(folder, &[command, &FILES, &["-o", "made.exr", "--overwrite"], more].concat());
    fs::read(folder.join("made.exr")).unwrap()
}

#[test]
fn exposure_times_in_seconds_give_the_same_image_as_ratios() {
    let scratch = scratch();
    let of = |command: &[&str], times: &str| made(scratch.path(), command, &["--exposures", times]);
    let restore = ["restore", "--method", "wiener", "--psf", "psf.exr"];
    let psf = ["fuse", "--psf", "--normalize", "none", "--size", "24"];
    for command in [&["fuse"][..], &["fuse", "--merge", "weighted"], &psf, &restore] {
        let shares = of(command, "1,1/4,1/16");
        for times in ["1/60,1/240,1/960", "16,4,1", "0.3,0.075,0.01875"] {
            assert!(of(command, times) == shares, "{command:?} with {times} differs");
        }
    }
}

/// 1 is white of the longest exposure, whatever its time.
#[test]
fn irradiance_is_the_same_in_seconds() {
    let scratch = scratch();
    made(scratch.path(), &["fuse"], &["--exposures", "1/60,1/240,1/960"]);
    let fused = io::read_pixels(&scratch.path().join("made.exr")).unwrap().planes;
    assert!(fused.iter().zip(&scene()).all(|(found, expected)| (found / expected - 1.0).abs() < 1e-5));
    succeed(scratch.path(), &["fuse", "short.npy", "--exposures", "1/960", "-o", "one.exr"]);
    let one = io::read_pixels(&scratch.path().join("one.exr")).unwrap().planes;
    assert!(one.iter().zip(&scene()).all(|(found, v)| (found / (v / 16.0) - 1.0).abs() < 1e-5));
}

//! Captures that a sensor's black level was left in.

use std::path::Path;

use ndarray::Array3;
use udc::core::fft::{Boundary, Convolver};
use udc::core::image::{Linear, LinearImage};
use udc::io::{self, WriteOptions};

use super::common::{succeed, udc};

const SIDE: usize = 96;
/// 64 of 1023.
const BLACK: f32 = 0.0626;

/// Writes a capture of a dark room with a picture on its wall, above this level.
fn write_capture(folder: &Path, black: f32, name: &str) {
    let psf = io::read_psf(&folder.join("psf.exr")).unwrap();
    let light = |(channel, y, x): (usize, usize, usize)| match (y / 12, x / 12) {
        (2..6, 1..5) => 0.1 + 0.1 * ((y / 12 + 2 * (x / 12) + channel) % 7) as f32,
        _ => 0.001 + 0.0005 * ((y / 3 + x / 5 + channel) % 3) as f32,
    };
    let scene = LinearImage::from_planes(Array3::from_shape_fn((3, SIDE, SIDE), light)).unwrap();
    let convolver = Convolver::new([SIDE; 2], [psf.height(), psf.width()], Boundary::Replicate).unwrap();
    let seen = convolver.convolve(&convolver.spectrum(&scene).unwrap(), &convolver.otf(&psf).unwrap());
    let capture = seen.mapv(|light| ((light.max(0.0) + black).min(1.0) * 1023.0).round() / 1023.0);
    let capture = LinearImage::from_planes(capture).unwrap();
    io::write_image(&folder.join(name), &capture, &WriteOptions::default()).unwrap();
}

#[test]
fn a_black_level_that_was_left_in_is_told_and_taken_away_on_demand() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    succeed(folder, &["psf", "--random", "12", "--size", "65", "-o", "psf.exr"]);
    write_capture(folder, 0.0, "clean.exr");
    write_capture(folder, BLACK, "raised.exr");
    let said = |capture: &str, flags: &[&str]| {
        let call = ["restore", capture, "--psf", "psf.exr", "-o", "restored.exr", "--overwrite"];
        let output = udc(folder, &[&call[..], flags].concat());
        assert!(output.status.success());
        String::from_utf8(output.stderr).unwrap()
    };
    let warned = said("raised.exr", &[]);
    assert!(
        warned.contains("the darkest light is 0.063 in all colours") && warned.contains("--black"),
        "{warned}"
    );
    assert!(!said("clean.exr", &[]).contains("--black"), "nothing was left in");
    let dark = said("raised.exr", &["--black", "0.0626"]);
    assert!(!dark.contains("--black"), "{dark}");
    let restored = io::read_image::<Linear>(&folder.join("restored.exr")).unwrap();
    let darkest = restored.as_slice().iter().copied().fold(1.0, f32::min);
    assert!(darkest < 0.005, "{darkest}");
}

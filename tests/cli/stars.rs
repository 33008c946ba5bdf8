//! Lamps of a pixel in dark captures.

use std::path::Path;

use ndarray::Array3;
use rand::RngExt as _;
use udc::core::fft::{Boundary, Convolver};
use udc::core::image::{Linear, LinearImage};
use udc::core::rng::stream;
use udc::io::{self, WriteOptions};

use super::common::succeed;
use super::restore::scratch;

const SIDE: usize = 128;
/// Photoelectrons of a full pixel, and those that reading it out adds.
const FULL: f32 = 300.0;
const READ: f32 = 4.0;
/// Rows and columns, and their light in red, green and blue.
const STARS: [([usize; 2], [f32; 3]); 4] = [
    ([30, 34], [42.0, 25.0, 24.0]),
    ([40, 90], [79.0, 42.0, 77.0]),
    ([88, 40], [12.0, 12.0, 12.0]),
    ([94, 96], [150.0, 130.0, 100.0]),
];

fn scene() -> LinearImage {
    let mut scene = Array3::from_elem((3, SIDE, SIDE), 0.01);
    for ([y, x], light) in STARS {
        (0..3).for_each(|channel| scene[[channel, y, x]] = light[channel]);
    }
    LinearImage::from_planes(scene).unwrap()
}

/// Writes a capture of the scene with the noise of a sensor of 10 bits.
fn write_capture(folder: &Path) {
    let psf = io::read_psf(&folder.join("psf.exr")).unwrap();
    let convolver = Convolver::new([SIDE; 2], [psf.height(), psf.width()], Boundary::Replicate).unwrap();
    let seen = convolver.convolve(&convolver.spectrum(&scene()).unwrap(), &convolver.otf(&psf).unwrap());
    let mut rng = stream(3, "sensor");
    let capture = seen.mapv(|light| {
        let bell: f32 = (0..12).map(|_| rng.random::<f32>()).sum::<f32>() - 6.0;
        let noise = bell * (light.max(0.0) * FULL + READ * READ).sqrt() / FULL;
        ((light + noise).clamp(0.0, 1.0) * 1023.0).round() / 1023.0
    });
    let capture = LinearImage::from_planes(capture).unwrap();
    io::write_image(&folder.join("capture.exr"), &capture, &WriteOptions::default()).unwrap();
}

/// The network alone would leave them at 0.02 to 0.3.
#[test]
fn stars_do_not_go_out() {
    let scratch = scratch();
    let folder = scratch.path();
    succeed(folder, &["psf", "--random", "12", "--size", "101", "-o", "psf.exr", "--overwrite"]);
    write_capture(folder);
    succeed(folder, &["restore", "capture.exr", "--psf", "psf.exr", "-o", "restored.exr"]);
    let restored = io::read_image::<Linear>(&folder.join("restored.exr")).unwrap();
    for ([y, x], _) in STARS {
        for channel in 0..3 {
            let plane = restored.channel(channel);
            let near = plane.slice(ndarray::s![y - 1..y + 2, x - 1..x + 2]);
            let brightest = near.fold(0.0f32, |most, light| light.max(most));
            assert!((0.9..1.1).contains(&brightest), "{y} {x} {channel}: {brightest}");
        }
    }
    // They are no larger than they were: nine pixels each at most, where the capture has up to a hundred.
    let green = restored.channel(1);
    let bright = green.iter().filter(|light| **light > 0.5).count();
    assert!(bright <= 9 * STARS.len(), "{bright}");
}

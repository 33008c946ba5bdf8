//! `udc pose`: by how much a panel is turned and scaled, told by lamps.

use std::fs;
use std::path::Path;

use ndarray::Array3;
use udc::core::fft::{Boundary, Convolver};
use udc::core::image::LinearImage;
use udc::core::psf::Psf;
use udc::io::{WriteOptions, write_image, write_psf};
use udc::restore::read_pose;

use super::common::{fail, succeed};

const SIDE: usize = 128;

/// A core and four orders, 30 pixels out, of a panel that is turned counter-clockwise.
fn panel(turn_deg: f64) -> Psf {
    let (sin, cos) = turn_deg.to_radians().sin_cos();
    let light = |y: usize, x: usize| {
        let (dy, dx) = (y as f64 - 40.0, x as f64 - 40.0);
        let (u, v) = (cos * dx - sin * dy, sin * dx + cos * dy);
        let order = |a: f64, b: f64| (-((u - a).powi(2) + (v - b).powi(2)) / 3.0).exp();
        let orders = order(30.0, 0.0) + order(-30.0, 0.0) + order(0.0, 30.0) + order(0.0, -30.0);
        (-(u * u + v * v) / 2.0).exp() + 2e-3 * orders
    };
    Psf::from_energy(Array3::from_shape_fn((3, 81, 81), |(_, y, x)| light(y, x) as f32)).unwrap()
}

/// Writes what a sensor that saturates at 16 sees of walls and, with `light`, of two lamps.
fn write_capture(path: &Path, psf: &Psf, light: f32) {
    let scene = LinearImage::from_planes(Array3::from_shape_fn((3, SIDE, SIDE), |(_, y, x)| {
        let near = |cy: usize, cx: usize| y.abs_diff(cy) < 3 && x.abs_diff(cx) < 3;
        let wall = 0.2 + 0.01 * ((y * 7 + x * 3) % 11) as f32;
        if near(50, 48) || near(80, 84) { light.max(wall) } else { wall }
    }))
    .unwrap();
    let convolver = Convolver::new([SIDE, SIDE], [81, 81], Boundary::Zero).unwrap();
    let seen = convolver.convolve(&convolver.spectrum(&scene).unwrap(), &convolver.otf(psf).unwrap());
    let seen = LinearImage::from_planes(seen.mapv(|value| value.clamp(0.0, 16.0))).unwrap();
    write_image(path, &seen, &WriteOptions::default()).unwrap();
}

pub(crate) fn write_inputs(folder: &Path) {
    let turned = panel(0.4);
    write_psf(&folder.join("psf.exr"), &panel(0.0), &WriteOptions::default()).unwrap();
    write_capture(&folder.join("lamps.exr"), &turned, 3000.0);
    write_capture(&folder.join("street.exr"), &turned, 1200.0);
    write_capture(&folder.join("walls.exr"), &turned, 0.0);
}

#[test]
fn finds_the_pose_from_the_captures_that_tell_it() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_inputs(folder);
    let captures = ["lamps.exr", "street.exr", "walls.exr"];
    let options = ["--psf", "psf.exr", "--x-max", "16", "-o", "pose.toml"];
    let said = succeed(folder, &[["pose"].as_slice(), &captures, &options].concat());
    assert!(
        said.contains("walls.exr: tells nothing: there are no lamps in view")
            && said.contains("told by 2 of 3"),
        "{said}"
    );
    let pose = read_pose(&folder.join("pose.toml")).unwrap();
    assert!((pose.turn_deg - 0.4).abs() < 0.03 && pose.scale.abs() < 1e-3, "{pose:?}");

    let again = fail(folder, &[["pose"].as_slice(), &captures, &options].concat(), 1);
    assert!(again.contains("pose.toml") && again.contains("--overwrite"), "{again}");
}

#[test]
fn says_when_no_capture_tells_the_pose() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_inputs(folder);
    let said =
        fail(folder, &["pose", "walls.exr", "--psf", "psf.exr", "--x-max", "16", "-o", "pose.toml"], 1);
    assert!(said.contains("no capture tells the pose") && said.contains("--x-max 16"), "{said}");
    assert!(!fs::exists(folder.join("pose.toml")).unwrap());
}

#[test]
fn refuses_to_write_over_what_it_reads_and_what_is_no_pose() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_inputs(folder);
    let pose = |psf: &str, output: &str| {
        fail(folder, &["pose", "lamps.exr", "--psf", psf, "-o", output, "--overwrite"], 1)
    };
    let before = fs::read(folder.join("psf.exr")).unwrap();
    let said = pose("psf.exr", "psf.exr");
    assert!(said.contains("psf.exr") && said.contains(".toml"), "{said}");
    fs::copy(folder.join("psf.exr"), folder.join("psf.toml")).unwrap();
    let said = pose("psf.toml", "psf.toml");
    assert!(said.contains("psf.toml would be read and written over"), "{said}");
    assert_eq!(fs::read(folder.join("psf.exr")).unwrap(), before);
}

/// A grey file is seen through all colours of the PSF at once, by their shares in luminance.
#[test]
fn the_pose_of_a_grey_capture_is_told_by_the_psf_of_grey_light() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let shares = [0.2126, 0.7152, 0.0722];
    let light = |radius: f64, turn_deg: f64| {
        let (sin, cos) = f64::to_radians(turn_deg).sin_cos();
        move |y: usize, x: usize| {
            let (dy, dx) = (y as f64 - 40.0, x as f64 - 40.0);
            let (u, v) = (cos * dx - sin * dy, sin * dx + cos * dy);
            let order = |a: f64, b: f64| (-((u - a).powi(2) + (v - b).powi(2)) / 3.0).exp();
            let orders = order(radius, 0.0) + order(-radius, 0.0) + order(0.0, radius) + order(0.0, -radius);
            (-(u * u + v * v) / 2.0).exp() + 2e-3 * orders
        }
    };
    let panel = |turn_deg: f64| {
        let colors = [34.0, 30.0, 26.0].map(|radius| light(radius, turn_deg));
        Psf::from_energy(Array3::from_shape_fn((3, 81, 81), |(c, y, x)| colors[c](y, x) as f32)).unwrap()
    };
    let grey = |psf: Psf| {
        let sum = |y: usize, x: usize| (0..3).map(|c| shares[c] * psf.planes()[[c, y, x]]).sum();
        Psf::from_energy(Array3::from_shape_fn((3, 81, 81), |(_, y, x)| sum(y, x))).unwrap()
    };
    write_psf(&folder.join("psf.exr"), &panel(0.0), &WriteOptions::default()).unwrap();
    write_psf(&folder.join("grey.exr"), &grey(panel(0.0)), &WriteOptions::default()).unwrap();
    write_capture(&folder.join("lamps.exr"), &grey(panel(0.4)), 3000.0);
    let pose = |psf: &str, output: &str| {
        succeed(folder, &["pose", "lamps.exr", "--psf", psf, "--x-max", "16", "-o", output]);
        read_pose(&folder.join(output)).unwrap()
    };
    let (of_colors, of_grey) = (pose("psf.exr", "a.toml"), pose("grey.exr", "b.toml"));
    assert!((of_colors.turn_deg - of_grey.turn_deg).abs() < 1e-4, "{of_colors:?} {of_grey:?}");
    assert!((of_colors.scale - of_grey.scale).abs() < 1e-6, "{of_colors:?} {of_grey:?}");
}

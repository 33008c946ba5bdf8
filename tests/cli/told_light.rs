//! What `udc restore` tells where a capture's light contradicts its flags, or its file holds it badly.

use std::path::Path;

use udc::core::image::{Linear, LinearImage};
use udc::io::{self, WriteOptions};

use super::common::udc;
use super::guided::{SATURATION, write_capture};

/// What a restoration of a capture says, with these flags, and that it is done.
fn said(folder: &Path, capture: &str, flags: &[&str]) -> String {
    let call = ["restore", capture, "--psf", "psf.exr", "--overwrite"];
    let output = udc(folder, &[&call[..], flags].concat());
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{said}");
    said
}

/// The capture in other units, in the folder.
fn write_times(folder: &Path, times: f32, name: &str) {
    let light = io::read_image::<Linear>(&folder.join("capture.exr")).unwrap();
    let image = LinearImage::from_planes(light.into_planes() * times).unwrap();
    io::write_image(&folder.join(name), &image, &WriteOptions::default()).unwrap();
}

#[test]
fn light_far_above_the_level_that_is_told_is_told_of() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_capture(folder);
    let above = said(folder, "capture.exr", &["--x-max", "2", "-o", "a.exr"]);
    assert!(above.contains("above --x-max 2, up to 4, and is taken for saturated"), "{above}");
    let is_said = |x_max: &str| {
        said(folder, "capture.exr", &["--x-max", x_max, "-o", "a.exr"]).contains("above --x-max")
    };
    assert!(!is_said("4") && !is_said("3.5") && !is_said("16"));
}

#[test]
fn tone_mapped_files_of_light_in_other_units_are_told_of_their_steps() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_capture(folder);
    write_times(folder, 4000.0, "electrons.exr");
    let mapped = ["--output-domain", "tone-mapped"];
    let told = |capture: &str, flags: &[&str]| said(folder, capture, flags).contains("hold it in steps of");
    let x_max = format!("{}", 4000.0 * SATURATION);
    let of = |flags: &[&'static str]| [&mapped[..], flags].concat();
    assert!(told("electrons.exr", &[&of(&["--half", "-o", "h.exr"])[..], &["--x-max", &x_max]].concat()));
    assert!(told("electrons.exr", &of(&["-o", "p.png"])));
    assert!(!told("electrons.exr", &of(&["-o", "f.exr"])), "32 bits hold it");
    assert!(!told("electrons.exr", &["--half", "-o", "l.exr"]), "linear light");
    assert!(!told("capture.exr", &of(&["--half", "-o", "h.exr"])), "usual units");
}

#[test]
fn half_floats_of_light_in_small_units_are_told_of_their_steps() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_capture(folder);
    write_times(folder, 1e-6, "small.exr");
    let told = |flags: &[&str]| said(folder, "small.exr", flags).contains("half floats hold in steps of");
    assert!(told(&["--half", "-o", "h.exr"]) && told(&["--half", "-o", "h.npy"]));
    assert!(!told(&["-o", "f.exr"]), "32 bits hold it");
    assert!(!said(folder, "capture.exr", &["--half", "-o", "h.exr"]).contains("half floats hold"));
}

#[test]
fn bars_are_told_of_and_not_the_psf() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_capture(folder);
    let mut planes = io::read_image::<Linear>(&folder.join("capture.exr")).unwrap().into_planes();
    planes.slice_mut(ndarray::s![.., ..6, ..]).fill(0.0);
    let image = LinearImage::from_planes(planes).unwrap();
    io::write_image(&folder.join("barred.exr"), &image, &WriteOptions::default()).unwrap();
    let told = said(folder, "barred.exr", &["-o", "r.exr"]);
    assert!(told.contains("its rows 0 to 5 hold nothing") && !told.contains("PSF"), "{told}");
    assert!(!said(folder, "capture.exr", &["-o", "r.exr"]).contains("hold nothing"));
}

/// As of the pictures beside them in a folder: the floats are linear light.
#[test]
fn floats_that_are_told_to_be_encoded_are_told_of() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_capture(folder);
    let light = io::read_image::<Linear>(&folder.join("capture.exr")).unwrap();
    let planes = light.into_planes() / SATURATION;
    let pixels = io::Pixels::of_planes(planes);
    for name in ["foreign.exr", "foreign.png"] {
        io::write_pixels(&folder.join(name), &pixels, io::PixelOptions::default()).unwrap();
    }
    let told = |capture: &str| {
        said(folder, capture, &["--domain", "srgb", "-o", "r.exr"]).contains("it holds floats")
    };
    assert!(told("foreign.exr") && !told("foreign.png"));
}

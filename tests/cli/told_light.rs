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

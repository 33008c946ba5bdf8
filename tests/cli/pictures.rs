//! Pictures of integers and sRGB, which clip at 1, and what is known of a capture on its way to `udc finish`.

use std::path::Path;

use ndarray::{Array3, s};
use udc::core::capture::CaptureInfo;
use udc::core::image::LinearImage;
use udc::core::orientation::Orientation;
use udc::io::{self, PixelOptions, Pixels, WriteOptions, read_pixels};

use super::common::{fail, succeed, udc};

/// A picture of 8 bits; columns take the codes in turn.
fn write_page(path: &Path, codes: &[u8]) {
    let code = |(_, _, x): (usize, usize, usize)| f32::from(codes[x * codes.len() / 160]) / 255.0;
    let options = PixelOptions { eight_bit: true, ..PixelOptions::default() };
    let pixels = Pixels::of_planes(Array3::from_shape_fn((3, 160, 160), code));
    io::write_pixels(path, &pixels, options).unwrap();
}

fn write_point(path: &Path) {
    let mut point = Array3::zeros((3, 5, 5));
    point.slice_mut(s![.., 2, 2]).fill(1.0);
    io::write_image(path, &LinearImage::from_planes(point).unwrap(), &WriteOptions::default()).unwrap();
}

fn saturation(path: &Path) -> Option<[f32; 3]> {
    io::read_capture_info(path).unwrap().and_then(|info| info.saturation)
}

/// What a capture's file may say: lying on its side, pushed by a stop and a half.
fn write_capture(path: &Path, value: f32) {
    let capture = CaptureInfo {
        saturation: Some([1.9, 1.0, 1.6]),
        orientation: Orientation::from_exif(6),
        baseline_exposure_ev: Some(-1.5),
        ..CaptureInfo::default()
    };
    let planes = Array3::from_shape_fn((3, 48, 64), |(_, y, _)| value * (0.5 + y as f32 / 48.0));
    let options = WriteOptions { capture: Some(capture), overwrite: true, ..WriteOptions::default() };
    io::write_image(path, &LinearImage::from_planes(planes).unwrap(), &options).unwrap();
}

/// The value of 8 bits in the middle of a finished picture.
fn shown(folder: &Path, args: &[&str]) -> f32 {
    succeed(folder, &[&["finish"], args, &["-o", "finished.png", "--overwrite"]].concat());
    let planes = read_pixels(&folder.join("finished.png")).unwrap().planes;
    let (_, height, width) = planes.dim();
    255.0 * planes[[1, height / 2, width / 2]]
}

fn said(folder: &Path, args: &[&str]) -> String {
    let output = udc(folder, args);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    said
}

#[test]
fn a_bright_page_finishes_bright() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_page(&folder.join("page.png"), &[245]);
    write_page(&folder.join("white.png"), &[255]);
    for (name, domain) in [("page.png", "srgb"), ("white.png", "srgb"), ("white.png", "linear")] {
        let found = shown(folder, &[name, "--domain", domain]);
        assert!(found > 235.0, "{name} as {domain}: {found}");
    }
    // The file of linear light that is made of it says the same.
    succeed(folder, &["convert", "page.png", "page.exr", "--domain", "srgb"]);
    let [direct, converted] =
        [&["page.png", "--domain", "srgb"][..], &["page.exr"]].map(|args| shown(folder, args));
    assert_eq!(direct, converted);
    // A flag still says otherwise.
    let dimmer = shown(folder, &["page.png", "--domain", "srgb", "--saturation", "5,5,5", "--no-clahe"]);
    assert!(dimmer < 150.0, "{dimmer}");
}

#[test]
fn a_restored_picture_says_where_it_clips() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_point(&folder.join("psf.exr"));
    write_page(&folder.join("page.png"), &[40, 245, 255]);
    for (domain, expected) in [("srgb", Some([1.0; 3])), ("linear", Some([1.0; 3])), ("tone-mapped", None)] {
        let restore =
            ["restore", "page.png", "--method", "constrained", "--psf", "psf.exr", "--domain", domain];
        succeed(folder, &[&restore[..], &["-o", "restored.exr", "--overwrite"]].concat());
        assert_eq!(saturation(&folder.join("restored.exr")), expected, "{domain}");
    }
    succeed(folder, &["tonemap", "page.png", "--domain", "srgb", "-o", "mapped.exr"]);
    assert_eq!(saturation(&folder.join("mapped.exr")), Some([1.0; 3]));
}

/// Scenes are no captures: where images that are made of them clip, their formation says.
#[test]
fn scenes_of_srgb_do_not_tell_images_made_of_them_to_clip_at_one() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_point(&folder.join("psf.exr"));
    write_page(&folder.join("page.png"), &[40, 245, 255]);
    let synth =
        ["synth", "page.png", "--psf", "psf.exr", "--split", "train", "--domain", "srgb", "-o", "dataset"];
    succeed(folder, &synth);
    for name in ["dataset/gt/page.exr", "dataset/degraded/r+00/page.exr"] {
        assert_eq!(saturation(&folder.join(name)), Some([500.0; 3]), "{name}");
    }
    let panorama = Pixels::of_planes(Array3::from_elem((3, 24, 48), 0.9));
    io::write_pixels(&folder.join("around.png"), &panorama, PixelOptions::default()).unwrap();
    succeed(
        folder,
        &["crop", "around.png", "--views", "1", "--size", "24", "--domain", "srgb", "-o", "views"],
    );
    assert_eq!(saturation(&folder.join("views/around_01.exr")), None);
}

#[test]
fn every_command_says_what_of_a_capture_its_output_cannot_carry() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_capture(&folder.join("a.exr"), 0.1);
    let flags = ["--saturation 1.9000,1.0000,1.6000", "--orientation 6", "--baseline-exposure -1.5"];
    for args in [
        &["tonemap", "a.exr", "-o", "a.png"][..],
        &["tonemap", "a.exr", "-o", "b.npy"],
        &["convert", "a.exr", "c.png"],
        &["convert", "a.exr", "d.npy"],
    ] {
        let said = said(folder, args);
        for flag in flags {
            assert!(said.contains(flag), "{args:?}: {flag} is not in {said}");
        }
    }
    for args in [&["tonemap", "a.exr", "-o", "e.exr"][..], &["convert", "a.exr", "f.exr"]] {
        assert!(!said(folder, args).contains("cannot carry"), "{args:?}");
    }
    // Integers of light clip at 1 whoever reads them, so that nothing is lost.
    write_page(&folder.join("page.png"), &[245]);
    let said = said(folder, &["convert", "page.png", "linear.png", "--domain", "srgb"]);
    assert!(!said.contains("cannot carry"), "{said}");
}

#[test]
fn the_baseline_exposure_may_be_given_by_a_flag() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_capture(&folder.join("a.exr"), 0.004);
    succeed(folder, &["convert", "a.exr", "a.npy"]);
    let flags = ["a.npy", "--saturation", "1.9,1,1.6", "--orientation", "6"];
    let carried = shown(folder, &["a.exr"]);
    let given = shown(folder, &[&flags[..], &["--baseline-exposure", "-1.5"]].concat());
    assert_eq!(carried, given);
    // A night is shown no more than three stops brighter: a stop and a half matter.
    let without = shown(folder, &flags);
    assert!((without - carried).abs() > 10.0, "{without} {carried}");
    let other = shown(folder, &["a.exr", "--baseline-exposure", "0"]);
    assert_eq!(other, without, "the flag stands above the file");
    let finish =
        |more: &[&'static str]| [&["finish", "a.exr", "-o", "b.png", "--baseline-exposure"], more].concat();
    for stops in ["11", "NaN", "bright"] {
        let said = fail(folder, &finish(&[stops]), 2);
        assert!(said.contains("from -10 to 10"), "{said}");
    }
    let said = fail(folder, &finish(&["1", "--curve", "srgb"]), 2);
    assert!(said.contains("belongs to the automatic exposure"), "{said}");
}

#[test]
fn a_singular_colour_matrix_and_levels_out_of_range_are_refused() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_capture(&folder.join("a.exr"), 0.1);
    for nine in ["0 0 0 0 0 0 0 0 0", "0.3 0.6 0.1 0.3 0.6 0.1 0.3 0.6 0.1"] {
        std::fs::write(folder.join("flat.txt"), format!("ccm: {nine}")).unwrap();
        let said = fail(folder, &["finish", "a.exr", "--ccm", "flat.txt", "-o", "a.png"], 1);
        assert!(said.contains("flat.txt") && said.contains("singular"), "{said}");
    }
    assert!(!folder.join("a.png").exists());
    for levels in ["1e-30,1,1", "0,1,1", "1,1,1e10"] {
        let said = fail(folder, &["finish", "a.exr", "--saturation", levels, "-o", "a.png"], 2);
        assert!(said.contains("from 1e-6 to 1e9"), "{said}");
    }
}

#[test]
fn a_picture_of_a_few_pixels_is_as_bright_as_a_large_one_of_the_same_light() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    for [height, width] in [[1, 1], [30, 1], [15, 15], [30, 40], [40, 40], [200, 200]] {
        let light = LinearImage::from_planes(Array3::from_elem((3, height, width), 0.2)).unwrap();
        let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
        io::write_image(&folder.join("even.exr"), &light, &options).unwrap();
        let found = shown(folder, &["even.exr"]);
        // Middle grey is 118; local contrast moves it a little.
        assert!((112.0..=124.0).contains(&found), "{height} × {width}: {found}");
    }
}

//! Pictures of integers: every command asks what they hold, and sRGB is decoded to linear light.

use std::fs;
use std::path::Path;

use ndarray::{Array3, s};
use udc::core::image::{Linear, LinearImage, ToneMapped};
use udc::core::tone::ToneCurve;
use udc::io::{self, DomainTag, PixelOptions, Pixels, WriteOptions, read_image, read_image_told};

use super::color_tags::with_chunk;
use super::common::{fail, succeed, udc};

/// The 8-bit value that sRGB stands for 0.2158605 of white by (IEC 61966-2-1).
pub(super) const GREY: u8 = 128;
pub(super) const LIGHT_OF_GREY: f32 = 0.215_860_5;

/// A grey picture, twice as wide as high, in the format of the path's extension.
pub(super) fn write_grey(path: &Path, eight_bit: bool) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let planes = Array3::from_elem((3, 24, 48), f32::from(GREY) / 255.0);
    let options = PixelOptions { eight_bit, overwrite: true, ..PixelOptions::default() };
    io::write_pixels(path, &Pixels::of_planes(planes), options).unwrap();
}

/// NumPy's own layout of 8- or 16-bit integers, `[24, 48, 3]`.
fn write_npy(path: &Path, descr: &str, sample: &[u8]) {
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': (24, 48, 3), }}");
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let length = u16::try_from(header.len()).unwrap().to_le_bytes();
    let data = sample.repeat(24 * 48 * 3);
    fs::write(path, [b"\x93NUMPY\x01\0", &length[..], header.as_bytes(), &data].concat()).unwrap();
}

fn write_point(path: &Path) {
    let mut point = Array3::zeros((3, 5, 5));
    point.slice_mut(s![.., 2, 2]).fill(1.0);
    io::write_image(path, &LinearImage::from_planes(point).unwrap(), &WriteOptions::default()).unwrap();
}

/// A scratch folder with a PSF, its bank, and the picture `name`.
fn scratch(name: &str) -> tempfile::TempDir {
    let scratch = tempfile::tempdir().unwrap();
    write_point(&scratch.path().join("psf.exr"));
    let path = scratch.path().join(name);
    match name {
        "u1.npy" => write_npy(&path, "|u1", &[GREY]),
        "u2.npy" => write_npy(&path, "<u2", &(u16::from(GREY) * 257).to_le_bytes()),
        _ => write_grey(&path, name.contains('8')),
    }
    scratch
}

/// Every way to read a picture as light, `IN` standing for it, and the flag that tells what it holds.
const READERS: [(&[&str], &str); 14] = [
    (&["synth", "IN", "--psf", "psf.exr", "-o", "out"], "--domain"),
    (&["crop", "IN", "--views", "1", "--size", "8", "-o", "out"], "--domain"),
    (&["tonemap", "IN", "-o", "out.exr"], "--domain"),
    (&["restore", "IN", "--method", "wiener", "--psf", "psf.exr", "-o", "out.exr"], "--domain"),
    (
        &["restore", "IN", "--exposures", "1", "--method", "wiener", "--psf", "psf.exr", "-o", "out.exr"],
        "--domain",
    ),
    (&["finish", "IN", "-o", "out.exr"], "--domain"),
    (&["convert", "IN", "out.exr"], "--domain"),
    (&["convert", "IN", "out.npy"], "--domain"),
    (&["fuse", "IN", "--exposures", "1", "-o", "out.exr"], "--domain"),
    (&["codes", "IN", "--angles=-3,0,3", "--dim", "1", "-o", "out.safetensors"], "--domain"),
    (&["report", "IN", "-o", "out.html"], "--domain"),
    (&["info", "--psf", "IN"], "--domain"),
    (&["synth", "scene.exr", "--psf", "IN", "-o", "out"], "--psf-domain"),
    (&["restore", "scene.exr", "--method", "wiener", "--psf", "IN", "-o", "out.exr"], "--psf-domain"),
];

#[test]
fn every_command_asks_what_a_picture_of_integers_holds() {
    for name in ["in8.jpg", "in8.png", "in8.tif", "u1.npy", "in16.png", "in16.tif", "u2.npy"] {
        let scratch = scratch(name);
        succeed(scratch.path(), &["tonemap", "psf.exr", "-o", "mapped.exr"]);
        succeed(scratch.path(), &["tonemap", "--inverse", "mapped.exr", "-o", "scene.exr"]);
        let before = io::list_folder(scratch.path()).unwrap();
        for (reader, flag) in READERS {
            let reader: Vec<&str> =
                reader.iter().map(|&word| if word == "IN" { name } else { word }).collect();
            let message = fail(scratch.path(), &reader, 1);
            assert!(
                message.contains(name) && message.contains("does not say whether"),
                "{reader:?}: {message}"
            );
            assert!(message.contains(&format!("{flag} linear")), "{reader:?}: {message}");
            assert!(message.contains(&format!("{flag} srgb")), "{reader:?}: {message}");
            assert_eq!(io::list_folder(scratch.path()).unwrap(), before, "{reader:?} left something behind");
        }
    }
}

#[test]
fn evaluating_folders_asks_too() {
    let scratch = tempfile::tempdir().unwrap();
    for name in ["restored/a8.png", "gt/a8.jpg"] {
        write_grey(&scratch.path().join(name), true);
    }
    let eval = ["eval", "--restored", "restored", "--gt", "gt", "-o", "results"];
    let message = fail(scratch.path(), &eval, 1);
    assert!(message.contains("--domain linear, --domain tone-mapped or --domain srgb"), "{message}");
    succeed(scratch.path(), &[&eval[..], &["--domain", "srgb"]].concat());
}

fn middle(folder: &Path, name: &str) -> f32 {
    read_image::<Linear>(&folder.join(name)).unwrap().planes()[[1, 12, 20]]
}

#[test]
fn an_srgb_picture_is_decoded_to_linear_light_by_every_command() {
    let scratch = scratch("in8.png");
    let folder = scratch.path();
    let run = |args: &[&str]| succeed(folder, &[args, &["--domain", "srgb"]].concat());
    let is_light = |found: f32, what: &str| {
        assert!((found - LIGHT_OF_GREY).abs() < 1e-6, "{what}: {found} for {LIGHT_OF_GREY}");
    };
    run(&["convert", "in8.png", "converted.exr"]);
    is_light(middle(folder, "converted.exr"), "convert");
    run(&["synth", "in8.png", "--psf", "psf.exr", "--split", "train", "-o", "dataset"]);
    is_light(middle(folder, "dataset/gt/in8.exr"), "synth");
    // The convolution with a point: rounding of a transform, 1e-6 of the largest value.
    is_light(middle(folder, "dataset/degraded/r+00/in8.exr"), "synth, degraded");
    run(&["crop", "in8.png", "--views", "1", "--size", "24", "-o", "views"]);
    let view = read_image::<Linear>(&folder.join("views/in8_01.exr")).unwrap();
    is_light(view.planes()[[1, 12, 12]], "crop");
    run(&["fuse", "in8.png", "-o", "fused.exr"]);
    is_light(middle(folder, "fused.exr"), "fuse");
    run(&["tonemap", "in8.png", "-o", "mapped.exr"]);
    let mapped = read_image::<ToneMapped>(&folder.join("mapped.exr")).unwrap().planes()[[1, 12, 20]];
    let expected = ToneCurve::default().compress(LIGHT_OF_GREY);
    assert!((mapped - expected).abs() < 1e-6, "tonemap: {mapped} for {expected}");
    // What is decoded and encoded again by the curve of sRGB is the picture.
    run(&["finish", "in8.png", "--curve", "srgb", "--no-clahe", "-o", "finished.png"]);
    let finished = io::read_pixels(&folder.join("finished.png")).unwrap().planes[[1, 12, 20]];
    assert!((finished - f32::from(GREY) / 255.0).abs() < 0.6 / 255.0, "finish: {finished}");
    run(&[
        "restore",
        "in8.png",
        "--method",
        "wiener",
        "--psf",
        "psf.exr",
        "--balance",
        "1e-6",
        "-o",
        "restored.exr",
    ]);
    let restored = middle(folder, "restored.exr");
    assert!((restored - LIGHT_OF_GREY).abs() < 1e-3, "restore: {restored}");
}

#[test]
fn a_dataset_that_was_begun_of_linear_scenes_does_not_go_on_with_srgb_ones() {
    let scratch = scratch("in8.png");
    let synth = ["synth", "in8.png", "--psf", "psf.exr", "--split", "train", "-o", "dataset", "--domain"];
    succeed(scratch.path(), &[&synth[..], &["linear"]].concat());
    let message = fail(scratch.path(), &[&synth[..], &["srgb", "--resume"]].concat(), 1);
    assert!(message.contains("another scene-domain"), "{message}");
    succeed(scratch.path(), &[&synth[..], &["linear", "--resume"]].concat());
}

/// A PSF in a picture for screens: the faint parts are much fainter than their values.
#[test]
fn an_srgb_psf_is_decoded_before_it_is_normalised() {
    let scratch = tempfile::tempdir().unwrap();
    let mut planes = Array3::zeros((3, 5, 5));
    planes.slice_mut(s![.., 2, 2]).fill(1.0);
    planes.slice_mut(s![.., 2, 3]).fill(f32::from(GREY) / 255.0);
    let options = PixelOptions { eight_bit: true, ..PixelOptions::default() };
    io::write_pixels(&scratch.path().join("psf.png"), &Pixels::of_planes(planes), options).unwrap();
    let peak = |domain: &str| {
        let text = succeed(scratch.path(), &["info", "--psf", "--json", "psf.png", "--domain", domain]);
        serde_json::from_str::<serde_json::Value>(&text).unwrap()["channels"][0]["peak"].as_f64().unwrap()
    };
    assert!((peak("linear") - 1.0 / (1.0 + f64::from(GREY) / 255.0)).abs() < 1e-6);
    assert!((peak("srgb") - 1.0 / (1.0 + f64::from(LIGHT_OF_GREY))).abs() < 1e-6);
}

#[test]
fn srgb_exposures_are_decoded_before_they_are_fused() {
    let scratch = tempfile::tempdir().unwrap();
    // Light of 0.5, 0.125 and 2, the last saturated in the longest exposure and read from the shorter.
    let light = |x: usize| [0.5, 0.125, 2.0][x % 3];
    let encode = |v: f64| udc::core::color::srgb_encode(v.min(1.0)) as f32;
    for (name, time) in [("a.png", 1.0), ("b.png", 0.25)] {
        let planes = Array3::from_shape_fn((3, 24, 48), |(_, _, x)| encode(light(x / 16) * time));
        io::write_pixels(&scratch.path().join(name), &Pixels::of_planes(planes), PixelOptions::default())
            .unwrap();
    }
    let fuse = ["fuse", "a.png", "b.png", "--exposures", "1,1/4", "--domain", "srgb", "-o", "fused.exr"];
    succeed(scratch.path(), &fuse);
    let fused = read_image::<Linear>(&scratch.path().join("fused.exr")).unwrap();
    for x in [4, 20, 40] {
        // 16 bits of sRGB: half a step is at most 1.2e-5 of white, times four in the shorter exposure.
        let (found, expected) = (f64::from(fused.planes()[[0, 12, x]]), light(x / 16));
        assert!((found - expected).abs() < 1e-4, "{found} for {expected}");
    }
    // What levels declare raw is not asked for, and is no sRGB.
    succeed(
        scratch.path(),
        &["fuse", "a.png", "b.png", "--exposures", "1,1/4", "--white", "1", "-o", "raw.exr"],
    );
    let message = fail(scratch.path(), &[&fuse[..8], &["raw2.exr", "--white", "65535"]].concat(), 1);
    assert!(message.contains("--domain says srgb"), "{message}");
}

#[test]
fn a_file_that_says_its_domain_is_not_taken_for_srgb() {
    let scratch = scratch("in8.png");
    succeed(scratch.path(), &["convert", "in8.png", "linear.exr", "--domain", "linear"]);
    for command in [
        &["tonemap", "linear.exr", "-o", "out.exr"][..],
        &["synth", "linear.exr", "--psf", "psf.exr", "-o", "out"],
        &["finish", "linear.exr", "-o", "out.png"],
    ] {
        let message = fail(scratch.path(), &[command, &["--domain", "srgb"]].concat(), 1);
        assert!(message.contains("holds linear values where srgb ones are needed"), "{message}");
    }
    let mut planes = Array3::from_elem((3, 4, 4), 0.5);
    planes[[0, 1, 1]] = 1.5;
    let path = scratch.path().join("bright.npy");
    io::write_pixels(&path, &Pixels::of_planes(planes), PixelOptions::default()).unwrap();
    let message = fail(scratch.path(), &["tonemap", "bright.npy", "-o", "out.exr", "--domain", "srgb"], 1);
    assert!(message.contains("1.5") && message.contains("0 to 1"), "{message}");
}

/// `udc restore -o x.png` and back: the values of the type's steps, after one question.
#[test]
fn a_tone_mapped_picture_of_sixteen_bits_round_trips() {
    let scratch = tempfile::tempdir().unwrap();
    let values = |(c, y, x): (usize, usize, usize)| (c * 7 + y * 5 + x * 3) as f32 / 10.0;
    let scene = LinearImage::from_planes(Array3::from_shape_fn((3, 12, 16), values)).unwrap();
    io::write_image(&scratch.path().join("scene.exr"), &scene, &WriteOptions::default()).unwrap();
    let mapped = ToneCurve::default().tone_map(&scene);
    for name in ["a.png", "a.tif"] {
        succeed(scratch.path(), &["tonemap", "scene.exr", "-o", name]);
        let path = scratch.path().join(name);
        let (read, warning) = read_image_told::<ToneMapped>(&path, Some(DomainTag::ToneMapped)).unwrap();
        assert_eq!(warning, None);
        for (a, b) in mapped.as_slice().iter().zip(read.as_slice()) {
            assert!((a - b).abs() <= 0.5 / 65535.0 + f32::EPSILON, "{name}: {a} {b}");
        }
        let finish = ["finish", name, "-o", "finished.png", "--overwrite"];
        assert!(fail(scratch.path(), &finish, 1).contains("--domain tone-mapped"));
        succeed(scratch.path(), &[&finish[..], &["--domain", "tone-mapped"]].concat());
        // The inverse is told by its name.
        succeed(scratch.path(), &["tonemap", "--inverse", name, "-o", "back.exr", "--overwrite"]);
    }
}

/// What is said on stderr of a run that succeeds.
fn said(folder: &Path, args: &[&str]) -> String {
    let output = udc(folder, args);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "udc {args:?} failed: {stderr}");
    stderr
}

/// Levels say where black and white are, not that a JPEG is linear: it has been for the screen since the camera made it.
#[test]
fn levels_and_gains_do_not_make_a_jpeg_raw() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    for name in ["a.jpg", "a.png"] {
        write_grey(&folder.join(name), true);
    }
    for flags in [&["--white", "255"][..], &["--black", "0"], &["--white-balance", "1,1,1"]] {
        for name in ["a.jpg", "a.png"] {
            let fuse = [&["fuse", name, "-o", "out.exr"], flags].concat();
            let asked = fail(folder, &fuse, 1);
            assert!(asked.contains(name) && asked.contains("add --domain linear to apply them"), "{asked}");
            let refused = fail(folder, &[&fuse[..], &["--domain", "srgb"]].concat(), 1);
            assert!(refused.contains("levels") && refused.contains("--domain says srgb"), "{refused}");
            assert!(!folder.join("out.exr").exists());
            succeed(folder, &[&fuse[..], &["--domain", "linear", "--overwrite"]].concat());
            fs::remove_file(folder.join("out.exr")).unwrap();
        }
    }
    // 16 bits, as demosaicked raw pictures have, of a white that is said; the tag that speaks against it is named.
    write_grey(&folder.join("b.png"), false);
    let tagged = with_chunk(&fs::read(folder.join("b.png")).unwrap(), b"sRGB", &[0]);
    fs::write(folder.join("tagged.png"), tagged).unwrap();
    let fuse = |name: &str| said(folder, &["fuse", name, "-o", "out.exr", "--white", "65535", "--overwrite"]);
    assert_eq!(fuse("b.png"), "");
    let warned = fuse("tagged.png");
    assert!(warned.contains("sRGB chunk says sRGB") && warned.contains("taken for linear light"), "{warned}");
    let asked = fail(folder, &["fuse", "b.png", "-o", "no.exr", "--white-balance", "2,1,2"], 1);
    assert!(asked.contains("--domain linear"), "gains alone are no white level: {asked}");
}

#[test]
fn commands_that_need_linear_light_offer_no_other_domain_and_begin_nothing() {
    let scratch = scratch("in8.png");
    let folder = scratch.path();
    let before = io::list_folder(folder).unwrap();
    for command in [
        &["synth", "in8.png", "--psf", "psf.exr", "-o", "out"][..],
        &["crop", "in8.png", "--views", "1", "--size", "8", "-o", "out"],
        &["tonemap", "in8.png", "-o", "out.exr"],
        &["fuse", "in8.png", "-o", "out.exr"],
    ] {
        let asked = fail(folder, command, 1);
        assert!(!asked.contains("--domain tone-mapped"), "{asked}");
        assert!(asked.contains("udc tonemap --inverse"), "{asked}");
        let refused = fail(folder, &[command, &["--domain", "tone-mapped"]].concat(), 2);
        assert!(refused.contains("linear, srgb"), "{refused}");
    }
    assert_eq!(io::list_folder(folder).unwrap(), before);
    // The advice holds.
    succeed(folder, &["tonemap", "--inverse", "in8.png", "-o", "light.exr"]);
    succeed(folder, &["synth", "light.exr", "--psf", "psf.exr", "--split", "train", "-o", "out"]);
}

#[test]
fn a_first_scene_that_cannot_be_used_leaves_no_dataset_behind() {
    let scratch = scratch("in8.png");
    let mut planes = Array3::from_elem((3, 12, 12), 0.5);
    planes[[1, 2, 3]] = f32::NAN;
    io::write_pixels(&scratch.path().join("nan.npy"), &Pixels::of_planes(planes), PixelOptions::default())
        .unwrap();
    let synth = ["synth", "nan.npy", "--psf", "psf.exr", "--split", "train", "-o", "out"];
    let message = fail(scratch.path(), &synth, 1);
    assert!(message.contains("nan.npy"), "{message}");
    assert!(!scratch.path().join("out").exists());
}

#[test]
fn srgb_said_of_a_linear_file_is_answered_by_leaving_it_out() {
    let scratch = scratch("in8.png");
    let folder = scratch.path();
    succeed(folder, &["convert", "in8.png", "linear.exr", "--domain", "linear"]);
    for command in
        [&["finish", "linear.exr", "-o", "out.png"][..], &["tonemap", "linear.exr", "-o", "out.exr"]]
    {
        let message = fail(folder, &[command, &["--domain", "srgb"]].concat(), 1);
        assert!(
            message.contains("leave out the flag that says srgb (as --domain or --psf-domain)"),
            "{message}"
        );
        assert!(!message.contains("udc tonemap`"), "{message}");
        succeed(folder, command);
    }
}

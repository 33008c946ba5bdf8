//! A tone-mapped EXR says by which curve it was mapped: every command gets its light back by that.

use std::fs;
use std::path::Path;

use udc::core::capture::CaptureInfo;
use udc::core::image::{Linear, ToneMapped};
use udc::core::tone::ToneCurve;
use udc::io::{self, WriteOptions};

use super::common::{fail, succeed, udc};
use super::restore::{code, model, scratch};
use super::{pose, view};

const TONE: [&str; 4] = ["--alpha", "0.1", "--x-max", "16"];

/// `scene.exr` and `mapped.exr`, which is φ of it with another α and x-max than the usual ones.
fn mapped(folder: &Path) {
    succeed(folder, &[&["tonemap", "scene.exr", "-o", "mapped.exr"], &TONE[..]].concat());
}

fn stderr(folder: &Path, args: &[&str]) -> String {
    let output = udc(folder, args);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{args:?}: {said}");
    said
}

/// The largest difference of two images over the largest value.
fn difference(folder: &Path, a: &str, b: &str) -> f32 {
    let [a, b] = [a, b].map(|name| io::read_image::<Linear>(&folder.join(name)).unwrap());
    let largest = a.as_slice().iter().zip(b.as_slice()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    largest / b.max()
}

/// α and x-max, as a file's origin says them.
fn tone_of(path: &Path) -> [f32; 2] {
    let ToneCurve { alpha, x_max } = io::read_provenance(path).unwrap().unwrap().tone_curve().unwrap();
    [alpha, x_max]
}

#[test]
fn the_inverse_of_the_tone_mapping_needs_no_flags() {
    let scratch = scratch();
    let folder = scratch.path();
    mapped(folder);
    let said = stderr(folder, &["tonemap", "--inverse", "mapped.exr", "-o", "light.exr"]);
    assert!(!said.contains("warning"), "{said}");
    assert!(difference(folder, "light.exr", "scene.exr") < 1e-4);
    assert_eq!(tone_of(&folder.join("light.exr")), [0.1, 16.0]);
    // A copy says it as well, and a user who says another is believed and told of it.
    succeed(folder, &["convert", "mapped.exr", "copy.exr"]);
    succeed(folder, &["tonemap", "--inverse", "copy.exr", "-o", "of-copy.exr"]);
    assert!(difference(folder, "of-copy.exr", "scene.exr") < 1e-4);
    let said = stderr(folder, &["tonemap", "--inverse", "mapped.exr", "-o", "told.exr", "--alpha", "0.2"]);
    assert!(said.contains("alpha 0.1 and x-max 16") && said.contains("--alpha 0.2"), "{said}");
    let told = io::read_image::<Linear>(&folder.join("told.exr")).unwrap();
    let scene = io::read_image::<Linear>(&folder.join("scene.exr")).unwrap();
    assert!((told.max() / scene.max() - 2.0).abs() < 1e-3, "{} of {}", told.max(), scene.max());
    let refused = fail(folder, &["tonemap", "--inverse", "mapped.exr", "-o", "o.exr", "--alpha", "0"], 1);
    assert!(refused.contains("alpha"), "{refused}");
}

#[test]
fn a_tone_mapped_capture_is_restored_as_the_linear_one() {
    let scratch = scratch();
    let folder = scratch.path();
    mapped(folder);
    let (model, code) = (model(), code());
    let ways: [&[&str]; 4] = [
        &["--psf", "psf.exr", "--x-max", "16"],
        &["--psf", "psf.exr", "--method", "wiener"],
        &["--psf", "psf.exr", "--method", "joint"],
        &["--model", &model, "--code", &code],
    ];
    for way in ways {
        for (input, output) in [("scene.exr", "of-linear.exr"), ("mapped.exr", "of-mapped.exr")] {
            let how = ["restore", input, "-o", output, "--output-domain", "linear", "--overwrite"];
            let said = stderr(folder, &[&how[..], way].concat());
            assert!(!said.contains("is tone-mapped with"), "{said}");
        }
        let apart = difference(folder, "of-mapped.exr", "of-linear.exr");
        assert!(apart < 5e-3, "{way:?}: {apart}");
    }
}

/// By default the output is tone-mapped as the input, by the curve that it says.
#[test]
fn a_restored_tone_mapped_image_says_its_curve() {
    let scratch = scratch();
    let folder = scratch.path();
    mapped(folder);
    let wiener = ["--psf", "psf.exr", "--method", "wiener"];
    succeed(folder, &[&["restore", "scene.exr", "-o", "linear.exr"], &wiener[..]].concat());
    succeed(folder, &[&["restore", "mapped.exr", "-o", "restored.exr"], &wiener[..]].concat());
    let restored = io::read_image::<ToneMapped>(&folder.join("restored.exr")).unwrap();
    assert_eq!(tone_of(&folder.join("restored.exr"))[0], 0.25);
    let brightest = io::read_image::<Linear>(&folder.join("linear.exr")).unwrap().max();
    assert!((restored.max() - ToneCurve::default().compress(brightest)).abs() < 1e-3);
}

/// A capture that says that it saturates above the usual x-max: the curve that its restoration says would cut it there.
#[test]
fn light_above_the_usual_x_max_returns_from_its_tone_mapping() {
    let scratch = scratch();
    let folder = scratch.path();
    let counts = io::read_image::<Linear>(&folder.join("scene.exr")).unwrap().map_values(|light| 1e3 * light);
    let capture = Some(CaptureInfo { saturation: Some([8e3; 3]), ..CaptureInfo::default() });
    let options = WriteOptions { capture, ..WriteOptions::default() };
    io::write_image::<Linear>(&folder.join("counts.exr"), &counts, &options).unwrap();
    let restore = ["restore", "counts.exr", "--psf", "psf.exr", "--method", "constrained"];
    succeed(folder, &[&restore[..], &["-o", "linear.exr"]].concat());
    succeed(folder, &[&restore[..], &["-o", "mapped.exr", "--output-domain", "tone-mapped"]].concat());
    succeed(folder, &["tonemap", "--inverse", "mapped.exr", "-o", "back.exr"]);
    let brightest = |name: &str| io::read_image::<Linear>(&folder.join(name)).unwrap().max();
    let (linear, back) = (brightest("linear.exr").min(8e3), brightest("back.exr"));
    // A float's last bit of φ, near 1, is a four-hundredth of such light.
    assert!(linear > 4e3 && (back / linear - 1.0).abs() < 0.01, "{back} of {linear}");
    assert_eq!(tone_of(&folder.join("back.exr"))[1], 8e3);
}

/// Counts of a sensor that say nothing of where they clip: φ(500) would be most of the image, and white of its picture.
#[test]
fn counts_that_say_no_level_are_neither_cut_nor_shown_white() {
    let scratch = scratch();
    let folder = scratch.path();
    let counts = io::read_image::<Linear>(&folder.join("scene.exr")).unwrap().map_values(|light| 1e3 * light);
    io::write_image::<Linear>(&folder.join("counts.npy"), &counts, &WriteOptions::default()).unwrap();
    for method in [&[][..], &["--method", "joint"], &["--method", "constrained"], &["--method", "wiener"]] {
        let restore = |more: &[&str]| {
            let call = ["restore", "counts.npy", "--psf", "psf.exr", "--overwrite", "-o"];
            succeed(folder, &[&call[..], more, method].concat());
        };
        restore(&["linear.exr"]);
        restore(&["mapped.exr", "--output-domain", "tone-mapped"]);
        restore(&["photo.jpg"]);
        succeed(folder, &["tonemap", "--inverse", "mapped.exr", "-o", "back.exr", "--overwrite"]);
        let brightest = |name: &str| io::read_image::<Linear>(&folder.join(name)).unwrap().max();
        let [_, x_max] = tone_of(&folder.join("mapped.exr"));
        let (linear, back) = (brightest("linear.exr").min(x_max), brightest("back.exr"));
        assert!(linear > 4e3 && (back / linear - 1.0).abs() < 0.02, "{method:?}: {back} of {linear}");
        restore(&["linear.npy"]);
        succeed(folder, &["finish", "linear.exr", "-o", "finished.png", "--overwrite"]);
        succeed(folder, &["finish", "linear.npy", "-o", "of-npy.png", "--overwrite"]);
        for picture in ["photo.jpg", "finished.png", "of-npy.png"] {
            let planes = io::read_pixels(&folder.join(picture)).unwrap().planes;
            let mean = planes.mean().unwrap();
            assert!(mean < 0.8, "{method:?}: {picture} has a mean of {mean}");
        }
    }
}

/// A file may say that its capture saturates higher.
#[test]
fn what_is_cut_saturates_where_it_was_cut() {
    let scratch = scratch();
    let folder = scratch.path();
    let scene = io::read_image::<Linear>(&folder.join("scene.exr")).unwrap();
    let (cut, x_max) = (0.5 * scene.max(), format!("{}", 0.5 * scene.max()));
    let capture = Some(CaptureInfo { saturation: Some([16.0 * cut; 3]), ..CaptureInfo::default() });
    let options = WriteOptions { capture, ..WriteOptions::default() };
    io::write_image::<Linear>(&folder.join("told.exr"), &scene, &options).unwrap();
    succeed(folder, &["tonemap", "told.exr", "-o", "cut.exr", "--x-max", &x_max]);
    succeed(folder, &["convert", "told.exr", "clipped.png", "--clip"]);
    let ways: [&[&str]; 3] =
        [&["cut.exr"], &["cut.exr", "--method", "constrained"], &["told.exr", "--x-max", &x_max]];
    for way in ways {
        let call = ["restore", "--psf", "psf.exr", "-o", "restored.exr", "--overwrite"];
        succeed(folder, &[&call[..], way].concat());
        let info = io::read_capture_info(&folder.join("restored.exr")).unwrap().unwrap();
        for level in info.saturation.unwrap() {
            assert!((level / cut - 1.0).abs() < 1e-3, "{way:?}: {level} of {cut}");
        }
    }
}

#[test]
fn a_tone_mapped_image_is_finished_and_shown_as_its_light() {
    let scratch = scratch();
    let folder = scratch.path();
    mapped(folder);
    let shown = |input: &str, output: &str| {
        succeed(folder, &["finish", input, "-o", output]);
        io::read_pixels(&folder.join(output)).unwrap().planes
    };
    let (linear, of_mapped) = (shown("scene.exr", "linear.png"), shown("mapped.exr", "mapped.png"));
    let apart = linear.iter().zip(&of_mapped).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(apart <= 1.5 / 255.0, "{apart}");
    let said = stderr(folder, &["finish", "mapped.exr", "-o", "told.png", "--alpha", "0.25"]);
    assert!(said.contains("--alpha 0.25"), "{said}");

    succeed(folder, &["view", "scene.exr", "mapped.exr", "-o", "page.html"]);
    let page = fs::read_to_string(folder.join("page.html")).unwrap();
    assert!(page.contains("tone-mapped, x/(x+0.1)"));
    let data = view::data_of(&page);
    let brightest = |at: usize| {
        let light = view::light_of(&page, &data["scenes"][0]["pictures"][at]["half"]);
        light.into_iter().fold(0.0, f32::max)
    };
    assert!((brightest(1) / brightest(0) - 1.0).abs() < 5e-3, "{} {}", brightest(1), brightest(0));
}

#[test]
fn the_pose_of_a_tone_mapped_capture_is_that_of_its_light() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    pose::write_inputs(folder);
    succeed(folder, &[&["tonemap", "lamps.exr", "-o", "mapped.exr"], &TONE[..]].concat());
    let pose = |input: &str, output: &str| {
        succeed(folder, &["pose", input, "--psf", "psf.exr", "-o", output]);
        udc::restore::read_pose(&folder.join(output)).unwrap()
    };
    let (linear, mapped) = (pose("lamps.exr", "linear.toml"), pose("mapped.exr", "mapped.toml"));
    assert!((linear.turn_deg - mapped.turn_deg).abs() < 1e-3, "{linear:?} {mapped:?}");
    assert!((linear.scale - mapped.scale).abs() < 1e-5, "{linear:?} {mapped:?}");
}

#[test]
fn radiance_holds_no_tone_mapped_values() {
    let scratch = scratch();
    let folder = scratch.path();
    mapped(folder);
    let wiener = ["--psf", "psf.exr", "--method", "wiener"];
    for command in [
        &["tonemap", "scene.exr", "-o", "o.hdr"][..],
        &["convert", "mapped.exr", "o.hdr"],
        &[&["restore", "mapped.exr", "-o", "o.hdr"], &wiener[..]].concat(),
        &[&["restore", "scene.exr", "-o", "o.hdr", "--output-domain", "tone-mapped"], &wiener[..]].concat(),
        &["finish", "scene.exr", "-o", "o.hdr"],
    ] {
        let said = fail(folder, command, 1);
        assert!(said.contains("linear light") && said.contains(".exr"), "{command:?}: {said}");
        assert!(!folder.join("o.hdr").exists());
    }
    succeed(
        folder,
        &[&["restore", "mapped.exr", "-o", "o.hdr", "--output-domain", "linear"], &wiener[..]].concat(),
    );
}

#[test]
fn what_a_numpy_file_cannot_say_of_its_mapping_is_told_once() {
    let scratch = scratch();
    let folder = scratch.path();
    mapped(folder);
    let flags = "--domain tone-mapped --alpha 0.1 --x-max 16";
    let said = stderr(folder, &["convert", "mapped.exr", "mapped.npy"]);
    assert!(said.contains(flags), "{said}");
    fs::create_dir(folder.join("scenes")).unwrap();
    for name in ["a.exr", "b.exr"] {
        fs::copy(folder.join("scene.exr"), folder.join("scenes").join(name)).unwrap();
    }
    let tonemap = ["tonemap", "scenes", "-o", "mapped/", "--format", "npy"];
    let said = stderr(folder, &[&tonemap[..], &TONE].concat());
    assert_eq!(said.matches(flags).count(), 1, "{said}");
    // As told, the light is the same again.
    let restore = ["restore", "--psf", "psf.exr", "--method", "wiener", "--output-domain", "linear"];
    let told: Vec<&str> = flags.split(' ').collect();
    succeed(folder, &[&restore[..], &["mapped.npy", "-o", "a.exr"], &told].concat());
    succeed(folder, &[&restore[..], &["scene.exr", "-o", "b.exr"]].concat());
    assert!(difference(folder, "a.exr", "b.exr") < 5e-3);
    let said = stderr(folder, &["tonemap", "scene.exr", "-o", "shown.png"]);
    assert!(!said.contains("cannot say how"), "{said}");
}

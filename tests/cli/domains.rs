//! Pictures of integers: every command asks what they hold, and sRGB is decoded to linear light.

use std::fs;
use std::path::Path;

use ndarray::{Array3, s};
use udc::core::image::{Linear, LinearImage, ToneMapped};
use udc::core::tone::ToneCurve;
use udc::io::{self, DomainTag, PixelOptions, Pixels, WriteOptions, read_image, read_image_told};

use super::common::{fail, succeed, udc};
use super::tiff::{Field, Tiff};

/// The 8-bit value that sRGB stands for 0.2158605 of white by (IEC 61966-2-1).
const GREY: u8 = 128;
const LIGHT_OF_GREY: f32 = 0.215_860_5;

/// A grey picture, twice as wide as high, in the format of the path's extension.
fn write_grey(path: &Path, eight_bit: bool) {
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

/// CRC-32 of PNG's chunks.
fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32| (crc >> 1) ^ if crc & 1 == 1 { 0xedb8_8320 } else { 0 };
    !bytes.iter().fold(u32::MAX, |crc, &byte| (0..8).fold(crc ^ u32::from(byte), |crc, _| step(crc)))
}

/// The PNG file with one more chunk behind its header of 13 bytes.
fn with_chunk(png: &[u8], name: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let place = 8 + 12 + 13;
    let contents = [&name[..], data].concat();
    let length = u32::try_from(data.len()).unwrap().to_be_bytes();
    [&png[..place], &length, &contents, &crc32(&contents).to_be_bytes(), &png[place..]].concat()
}

/// A profile of a name, a gamma and primaries, with every tag's data behind the table.
fn profile(name: &str, gamma: f64, colorants: [[f64; 3]; 3]) -> Vec<u8> {
    let fixed = |v: f64| ((v * 65536.0).round() as i32).to_be_bytes();
    let xyz = |c: [f64; 3]| [b"XYZ \0\0\0\0", c.map(fixed).as_flattened()].concat();
    let mut text =
        [b"desc\0\0\0\0", &u32::try_from(name.len() + 1).unwrap().to_be_bytes()[..], name.as_bytes()]
            .concat();
    text.extend([0; 4]);
    let curve =
        [b"curv\0\0\0\0\0\0\0\x01", &((gamma * 256.0).round() as u16).to_be_bytes()[..], &[0, 0]].concat();
    let [red, green, blue] = colorants.map(xyz);
    let tags: [(&[u8; 4], Vec<u8>); 5] =
        [(b"desc", text), (b"rXYZ", red), (b"gXYZ", green), (b"bXYZ", blue), (b"rTRC", curve)];
    let mut table = u32::try_from(tags.len()).unwrap().to_be_bytes().to_vec();
    let (mut data, first) = (Vec::new(), 128 + 4 + 12 * tags.len());
    for (signature, contents) in &tags {
        let number = |value: usize| u32::try_from(value).unwrap().to_be_bytes();
        table.extend([&signature[..], &number(first + data.len()), &number(contents.len())].concat());
        data.extend(contents);
        data.resize(data.len().next_multiple_of(4), 0);
    }
    let mut header = [0; 128];
    header[36..40].copy_from_slice(b"acsp");
    [&header[..], &table, &data].concat()
}

/// Red, green and blue of sRGB and of Display P3 under D50, as published profiles have them.
const SRGB: [[f64; 3]; 3] = [[0.4361, 0.2225, 0.0139], [0.3851, 0.7169, 0.0971], [0.1431, 0.0606, 0.7141]];
const DISPLAY_P3: [[f64; 3]; 3] =
    [[0.5151, 0.2412, -0.0011], [0.2920, 0.6922, 0.0419], [0.1571, 0.0666, 0.7841]];

/// Data that is stored as it is, in zlib's frame.
fn zlib(data: &[u8]) -> Vec<u8> {
    let length = u16::try_from(data.len()).unwrap();
    let (mut a, mut b) = (1u32, 0u32);
    for &byte in data {
        a = (a + u32::from(byte)) % 65521;
        b = (b + a) % 65521;
    }
    let adler = ((b << 16) | a).to_be_bytes();
    [&[0x78, 0x01, 0x01][..], &length.to_le_bytes(), &(!length).to_le_bytes(), data, &adler].concat()
}

/// What is said of `contents` as a file `name` that is told to be of `domain`.
fn warnings(name: &str, contents: &[u8], domain: &str) -> String {
    let scratch = tempfile::tempdir().unwrap();
    fs::write(scratch.path().join(name), contents).unwrap();
    let output = udc(scratch.path(), &["convert", name, "out.exr", "--domain", domain]);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{name}: {stderr}");
    // Tags never change a value.
    let value = middle_of_any(&scratch.path().join("out.exr"));
    let expected = if domain == "srgb" { LIGHT_OF_GREY } else { f32::from(GREY) / 255.0 };
    assert!((value - expected).abs() < 0.01, "{name} as {domain}: {value} for {expected}");
    stderr
}

fn middle_of_any(path: &Path) -> f32 {
    io::read_pixels(path).unwrap().planes[[1, 12, 20]]
}

fn file(name: &str) -> Vec<u8> {
    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join(name);
    write_grey(&path, true);
    fs::read(path).unwrap()
}

#[test]
fn png_chunks_that_disagree_with_the_domain_are_named() {
    let png = file("a.png");
    let linear = with_chunk(&png, b"gAMA", &100_000u32.to_be_bytes());
    let said = warnings("a.png", &linear, "srgb");
    assert!(said.contains("warning: a.png: its gAMA chunk says a gamma of 1.000 (linear light)"), "{said}");
    assert_eq!(warnings("a.png", &linear, "linear"), "");
    let screen = with_chunk(&png, b"gAMA", &45_455u32.to_be_bytes());
    assert_eq!(warnings("a.png", &screen, "srgb"), "");
    let srgb = with_chunk(&png, b"sRGB", &[0]);
    assert_eq!(warnings("a.png", &srgb, "srgb"), "");
    let said = warnings("a.png", &srgb, "linear");
    assert!(said.contains("its sRGB chunk says sRGB") && said.contains("taken as they are"), "{said}");
    let cicp = with_chunk(&png, b"cICP", &[9, 16, 0, 1]);
    let said = warnings("a.png", &cicp, "srgb");
    assert!(said.contains("cICP chunk says PQ, primaries of BT.2020"), "{said}");
    assert_eq!(warnings("a.png", &png, "linear"), "", "a file that says nothing contradicts nothing");
}

#[test]
fn a_reference_picture_of_another_curve_is_warned_of() {
    let scratch = tempfile::tempdir().unwrap();
    let image = LinearImage::from_planes(Array3::from_elem((3, 16, 16), 0.5)).unwrap();
    io::write_image(&scratch.path().join("in.exr"), &image, &WriteOptions::default()).unwrap();
    let plain = file("a.png");
    fs::write(scratch.path().join("plain.png"), &plain).unwrap();
    let linear = with_chunk(&plain, b"gAMA", &100_000u32.to_be_bytes());
    fs::write(scratch.path().join("linear.png"), linear).unwrap();
    let said = |reference: &str, output: &str| {
        let output = udc(scratch.path(), &["finish", "in.exr", "--reference", reference, "-o", output]);
        assert!(output.status.success());
        String::from_utf8(output.stderr).unwrap()
    };
    assert!(!said("plain.png", "a.png").contains("plain.png: its"));
    let warned = said("linear.png", "b.png");
    assert!(warned.contains("linear.png: its gAMA chunk says a gamma of 1.000"), "{warned}");
}

/// Black at 16 and white at 235 of 255, as video has them.
#[test]
fn a_png_of_narrow_range_is_widened_and_says_so() {
    let png = with_chunk(&file("a.png"), b"cICP", &[1, 13, 0, 0]);
    let scratch = tempfile::tempdir().unwrap();
    for (name, contents) in [("narrow.png", &png), ("full.png", &file("a.png"))] {
        fs::write(scratch.path().join(name), contents).unwrap();
    }
    let read = |name: &str| io::inspect_image(&scratch.path().join(name)).unwrap();
    let ((narrow, _), (full, encoding)) = (read("narrow.png"), read("full.png"));
    let [unit, steps] = if encoding.sample_type == "uint8" { [1.0, 255.0] } else { [256.0, 65535.0] };
    for (narrow, full) in narrow.planes.iter().zip(&full.planes) {
        let expected: f32 = (full * steps - 16.0 * unit) / (219.0 * unit);
        assert!((narrow - expected.clamp(0.0, 1.0)).abs() < 1e-5, "{narrow} instead of {expected}");
    }
    let said = succeed(scratch.path(), &["info", "narrow.png"]);
    assert!(said.contains("narrow range"), "{said}");
}

#[test]
fn icc_profiles_that_disagree_with_the_domain_are_named() {
    let embed = |profile: &[u8]| {
        let png = with_chunk(&file("a.png"), b"iCCP", &[b"name\0\0", &zlib(profile)[..]].concat());
        let jpeg = file("a.jpg");
        let segment = [b"ICC_PROFILE\0\x01\x01", profile].concat();
        let length = u16::try_from(segment.len() + 2).unwrap().to_be_bytes();
        let jpeg = [&jpeg[..2], &[0xff, 0xe2], &length, &segment, &jpeg[2..]].concat();
        let mut tiff = Tiff::new();
        let mut fields = tiff.image(2, &[u16::from(GREY) * 257; 24 * 48 * 3], [24, 48]);
        fields.push((34675, Field::Bytes(profile.to_vec())));
        let first = tiff.directory(fields);
        [("a.png", png), ("a.jpg", jpeg), ("a.tif", tiff.finish(first))]
    };
    for (name, contents) in embed(&profile("Display P3", 2.2, DISPLAY_P3)) {
        let said = warnings(name, &contents, "srgb");
        assert!(said.contains("`Display P3`") && said.contains("are not those of sRGB"), "{name}: {said}");
    }
    for (name, contents) in embed(&profile("Linear light", 1.0, SRGB)) {
        let said = warnings(name, &contents, "srgb");
        assert!(said.contains("`Linear light` (linear light)"), "{name}: {said}");
        assert_eq!(warnings(name, &contents, "linear"), "", "{name}");
    }
    for (name, contents) in embed(&profile("sRGB IEC61966-2.1", 2.2, SRGB)) {
        assert_eq!(warnings(name, &contents, "srgb"), "", "{name}");
        let said = warnings(name, &contents, "linear");
        assert!(said.contains("`sRGB IEC61966-2.1` (the curve of sRGB)"), "{name}: {said}");
    }
}

/// An sRGB tag is no answer to the question: programs stamp it on whatever they save, tone-mapped pictures too.
#[test]
fn info_and_the_question_show_the_tags_of_a_file() {
    let scratch = tempfile::tempdir().unwrap();
    fs::write(scratch.path().join("a.png"), with_chunk(&file("a.png"), b"sRGB", &[0])).unwrap();
    let text = succeed(scratch.path(), &["info", "a.png"]);
    assert!(text.contains("not declared") && text.contains("colours   sRGB chunk: sRGB"), "{text}");
    let json = succeed(scratch.path(), &["info", "--json", "a.png"]);
    assert!(json.contains("\"place\":\"sRGB chunk\""), "{json}");
    let message = fail(scratch.path(), &["tonemap", "a.png", "-o", "out.exr"], 1);
    assert!(message.contains("sRGB chunk: sRGB, which is no answer"), "{message}");
}

#[test]
fn a_damaged_profile_says_nothing_and_the_picture_is_read() {
    let png = file("a.png");
    let whole = profile("Display P3", 2.2, DISPLAY_P3);
    for length in (0..whole.len()).step_by(7) {
        let cut = with_chunk(&png, b"iCCP", &[b"name\0\0", &zlib(&whole[..length])[..]].concat());
        warnings("a.png", &cut, "srgb");
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

//! What files say of their colours, which changes no value: profiles and chunks that speak against a domain.

use std::fs;
use std::path::Path;

use ndarray::Array3;
use udc::core::image::LinearImage;
use udc::io::{self, WriteOptions};

use super::common::{fail, succeed, udc};
use super::domains::{GREY, LIGHT_OF_GREY, write_grey};
use super::tiff::{Field, Tiff};

/// CRC-32 of PNG's chunks.
fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32| (crc >> 1) ^ if crc & 1 == 1 { 0xedb8_8320 } else { 0 };
    !bytes.iter().fold(u32::MAX, |crc, &byte| (0..8).fold(crc ^ u32::from(byte), |crc, _| step(crc)))
}

/// The PNG file with one more chunk behind its header of 13 bytes.
pub(super) fn with_chunk(png: &[u8], name: &[u8; 4], data: &[u8]) -> Vec<u8> {
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

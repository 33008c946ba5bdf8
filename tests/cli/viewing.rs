//! What finished pictures carry beside their pixels: profiles, EXIF, gains; and what is taken from those that are read.

use std::fs;
use std::path::Path;

use ndarray::Array3;
use serde_json::Value;
use udc::core::capture::CaptureInfo;
use udc::core::color::srgb_decode;
use udc::core::exif::{Exif, Position};
use udc::core::image::LinearImage;
use udc::core::orientation::Orientation;
use udc::core::primaries::Primaries;
use udc::io::{self, DomainTag, PixelOptions, Pixels, WriteOptions, read_pixels, write_pixels};

use super::common::{fail, succeed, udc};
use super::tiff::{Field, Tiff};

fn exif() -> Exif {
    Exif {
        make: Some("Maker".to_owned()),
        model: Some("UDC 1".to_owned()),
        taken: Some("2026:11:23 12:30:05".to_owned()),
        exposure_s: Some(1.0 / 60.0),
        f_number: Some(1.8),
        iso: Some(400.0),
        focal_length_mm: Some(4.2),
        position: Some(Position { latitude_deg: 46.5, longitude_deg: -7.25, ..Position::default() }),
        ..Exif::default()
    }
}

/// An orange ramp that is brighter to the right, with a lamp above all a display shows.
fn write_scene(path: &Path, info: &CaptureInfo) {
    let planes = Array3::from_shape_fn((3, 40, 60), |(c, y, x)| {
        let color = [1.0, 0.4, 0.1][c];
        color * (0.02 + x as f32 / 100.0) + if y < 8 && x < 8 { 30.0 } else { 0.0 }
    });
    let options = WriteOptions { capture: Some(info.clone()), ..WriteOptions::default() };
    io::write_image(path, &LinearImage::from_planes(planes).unwrap(), &options).unwrap();
}

fn described(folder: &Path, name: &str) -> Value {
    serde_json::from_str(&succeed(folder, &["info", "--json", name])).unwrap()
}

#[test]
fn pictures_carry_profile_and_exif_and_lie_upright() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let info =
        CaptureInfo { exif: Some(exif()), orientation: Orientation::from_exif(6), ..CaptureInfo::default() };
    write_scene(&folder.join("a.exr"), &info);
    for (name, space, said) in [
        ("a.jpg", "srgb", "`sRGB`"),
        ("b.jpg", "display-p3", "`Display P3`"),
        ("a.png", "display-p3", "`Display P3`"),
        ("a.tif", "display-p3", "`Display P3`"),
        ("b.tif", "srgb", "`sRGB`"),
    ] {
        succeed(folder, &["finish", "a.exr", "--color-space", space, "-o", name]);
        let found = described(folder, name);
        assert!(found["color_tags"][0]["says"].as_str().unwrap().contains(said), "{name}: {found}");
        assert_eq!((&found["width"], &found["height"]), (&Value::from(40), &Value::from(60)), "{name}");
        let capture = read_pixels(&folder.join(name)).unwrap().capture.unwrap();
        assert_eq!(capture.exif, Some(exif()), "{name}");
        assert_eq!(capture.orientation, Orientation::from_exif(1), "{name}: turned once is enough");
        assert_eq!(capture.primaries.is_some(), space == "display-p3", "{name}");
    }
    let text = succeed(folder, &["info", "a.jpg"]);
    assert!(text.contains("Maker, UDC 1") && text.contains("1/60 s, f/1.8, ISO 400, 4.2 mm"), "{text}");
    succeed(folder, &["finish", "a.exr", "--no-exif", "-o", "bare.jpg"]);
    assert!(!String::from_utf8_lossy(&fs::read(folder.join("bare.jpg")).unwrap()).contains("Maker"));
}

/// The same light in both spaces: decoded and brought to sRGB, the two agree within the rounding of 16 bits.
#[test]
fn display_p3_shows_the_same_light() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_scene(&folder.join("a.exr"), &CaptureInfo::default());
    let shown = |name: &str, space: &str| {
        let more = ["--color-space", space, "--no-clahe", "--curve", "srgb", "--bits", "16"];
        succeed(folder, &[&["finish", "a.exr", "-o", name][..], &more].concat());
        read_pixels(&folder.join(name)).unwrap().planes.mapv(|v| srgb_decode(f64::from(v)))
    };
    let (srgb, p3) = (shown("srgb.png", "srgb"), shown("p3.png", "display-p3"));
    let matrix = Primaries::DISPLAY_P3.matrix_to(&Primaries::SRGB).unwrap();
    for (y, x) in [(20, 5), (20, 30), (30, 59)] {
        for (c, row) in matrix.iter().enumerate() {
            let found: f64 = row.iter().enumerate().map(|(k, part)| part * p3[[k, y, x]]).sum();
            assert!((found - srgb[[c, y, x]]).abs() < 1e-4, "{c} {y} {x}: {found} {}", srgb[[c, y, x]]);
        }
    }
    assert!(p3[[1, 20, 30]] > srgb[[1, 20, 30]], "orange has less saturated numbers in the larger space");
}

/// A JPEG of a phone that was held upright: its pixels lie on their side, and its finished picture must not.
#[test]
fn the_orientation_of_jpeg_and_tiff_is_seen() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let planes = Array3::from_shape_fn((3, 16, 32), |(_, y, x)| if y < 8 && x < 8 { 0.9 } else { 0.2 });
    let mut pixels = Pixels::of_planes(planes);
    pixels.domain = Some(DomainTag::Display);
    let options = PixelOptions { eight_bit: true, ..PixelOptions::default() };
    pixels.capture = Some(CaptureInfo { exif: Some(exif()), ..CaptureInfo::default() });
    write_pixels(&folder.join("a.jpg"), &pixels, options).unwrap();
    // Of the one field of its tag, one value of 16 bits.
    let mut bytes = fs::read(folder.join("a.jpg")).unwrap();
    let field = [0x12, 0x01, 0x03, 0x00, 0x01, 0x00, 0x00, 0x00, 0x01];
    let place = bytes.windows(9).position(|window| window == field).unwrap();
    bytes[place + 8] = 6;
    fs::write(folder.join("a.jpg"), bytes).unwrap();
    succeed(folder, &["finish", "a.jpg", "--domain", "srgb", "-o", "upright.png"]);
    let shown = read_pixels(&folder.join("upright.png")).unwrap();
    assert_eq!(shown.planes.dim(), (3, 32, 16));
    assert!(
        shown.planes[[0, 2, 13]] > 0.7 && shown.planes[[0, 2, 2]] < 0.6,
        "the bright corner is to the right"
    );
    assert_eq!(shown.capture.unwrap().exif.unwrap().model, exif().model, "and EXIF is kept");
    succeed(folder, &["finish", "a.jpg", "--domain", "srgb", "--orientation", "1", "-o", "as-it-is.png"]);
    assert_eq!(read_pixels(&folder.join("as-it-is.png")).unwrap().planes.dim(), (3, 16, 32));

    let mut file = Tiff::new();
    let mut fields = file.image(1, &[30_000; 16 * 32], [16, 32]);
    fields.push((274, Field::Shorts(vec![3])));
    let first = file.directory(fields);
    fs::write(folder.join("a.tif"), file.finish(first)).unwrap();
    let capture = read_pixels(&folder.join("a.tif")).unwrap().capture.unwrap();
    assert_eq!(capture.orientation, Orientation::from_exif(3));
}

/// Light of ACES primaries and pictures of Display P3 are shown as what they are.
#[test]
fn primaries_of_inputs_are_converted() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let srgb = [0.5, 0.25, 0.1];
    let matrix = Primaries::SRGB.matrix_to(&Primaries::BT2020).unwrap();
    let wide = matrix.map(|row| row.iter().zip(srgb).map(|(a, b)| a * b).sum::<f64>() as f32);
    let planes = Array3::from_shape_fn((3, 20, 20), |(c, ..)| wide[c]);
    let capture = Some(CaptureInfo { primaries: Some(Primaries::BT2020), ..CaptureInfo::default() });
    let options = WriteOptions { capture, ..WriteOptions::default() };
    io::write_image(&folder.join("wide.exr"), &LinearImage::from_planes(planes).unwrap(), &options).unwrap();
    assert!(succeed(folder, &["info", "wide.exr"]).contains("primaries BT.2020"));
    let plain = ["--curve", "none", "--no-clahe", "--no-clip", "-o"];
    succeed(folder, &[&["finish", "wide.exr"][..], &plain, &["shown.exr"]].concat());
    let shown = read_pixels(&folder.join("shown.exr")).unwrap().planes;
    for (c, expected) in srgb.into_iter().enumerate() {
        assert!((f64::from(shown[[c, 4, 4]]) - expected).abs() < 1e-5, "{shown}");
    }

    let finish = ["finish", "wide.exr", "--color-space", "display-p3", "--curve", "srgb", "--no-clahe", "-o"];
    succeed(folder, &[&finish[..], &["p3.png"]].concat());
    let output = udc(
        folder,
        &["finish", "p3.png", "--domain", "srgb", "--curve", "srgb", "--no-clahe", "-o", "back.png"],
    );
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.contains("Display P3") && said.contains("converts"), "{said}");
    let back = read_pixels(&folder.join("back.png")).unwrap().planes;
    for (c, expected) in srgb.into_iter().enumerate() {
        // Twice rounded to 8 bits, where the curve is at most 0.7 of light a step.
        assert!(
            (srgb_decode(f64::from(back[[c, 4, 4]])) - expected).abs() < 0.012,
            "{c}: {}",
            back[[c, 4, 4]]
        );
    }
}

#[test]
fn gains_for_hdr_displays_are_written_behind_a_jpeg_alone() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_scene(&folder.join("a.exr"), &CaptureInfo::default());
    succeed(folder, &["finish", "a.exr", "-o", "sdr.jpg"]);
    succeed(folder, &["finish", "a.exr", "--hdr=2.5", "-o", "hdr.jpg"]);
    let planes = |name: &str| read_pixels(&folder.join(name)).unwrap().planes;
    assert_eq!(planes("sdr.jpg"), planes("hdr.jpg"), "other displays show the same");
    let bytes = fs::read(folder.join("hdr.jpg")).unwrap();
    let text = String::from_utf8_lossy(&bytes);
    assert!(text.contains("hdrgm:GainMapMax=\"2.") && text.contains("Item:Semantic=\"GainMap\""));
    assert!(fail(folder, &["finish", "a.exr", "--hdr", "-o", "a.png"], 1).contains("--hdr is for JPEG"));
    let said = fail(folder, &["finish", "a.exr", "--hdr", "--reference", "sdr.jpg", "-o", "b.jpg"], 1);
    assert!(said.contains("--reference"), "{said}");
    assert!(fail(folder, &["finish", "a.exr", "--hdr=99", "-o", "b.jpg"], 1).contains("stops"));
    assert!(!folder.join("b.jpg").exists());
}

/// What the paper's pictures are made with is as it was: each channel by itself, noise taken for detail, sRGB.
#[test]
fn curves_that_are_given_keep_the_published_look() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_scene(&folder.join("a.exr"), &CaptureInfo::default());
    let finish = |name: &str, more: &[&str]| {
        succeed(folder, &[&["finish", "a.exr", "-o", name][..], more].concat());
        read_pixels(&folder.join(name)).unwrap().planes
    };
    let published = finish("a.png", &["--curve", "gamma"]);
    let spelled = finish(
        "b.png",
        &["--gamma", "2.8", "--max", "6", "--clip", "16", "--roll-off", "channels", "--noise", "0"],
    );
    assert_eq!(published, spelled);
    let [by_hue, automatic] =
        [finish("c.png", &["--curve", "gamma", "--roll-off", "hue"]), finish("d.png", &[])];
    assert!(by_hue != published && automatic != published);
    assert!(fail(folder, &["finish", "a.exr", "-o", "e.png", "--noise", "loud"], 2).contains("write `auto`"));
}

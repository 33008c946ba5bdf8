//! Reads files that other software wrote (`tests/fixtures/files/make.py`).

use std::path::PathBuf;

use super::*;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/files").join(name)
}

/// The value of channel c, row y, column x of every ramp: exact in half floats.
fn ramp(c: usize, y: usize, x: usize) -> f32 {
    (c * 100 + y * 10 + x) as f32 / 8.0
}

fn integers(c: usize, y: usize, x: usize) -> usize {
    c * 60 + y * 7 + x
}

fn check(name: &str, shape: (usize, usize, usize), expected: impl Fn(usize, usize, usize) -> f32) {
    let planes = read_pixels(&fixture(name)).unwrap_or_else(|error| panic!("{error}")).planes;
    assert_eq!(planes, Array3::from_shape_fn(shape, |(c, y, x)| expected(c, y, x)), "{name}");
}

fn refusal(name: &str) -> String {
    read_pixels(&fixture(name)).unwrap_err().to_string()
}

#[test]
fn reads_numpy_images_of_every_order_and_type() {
    for name in ["hwc_f4.npy", "chw_f8_big.npy", "hwc_f2_fortran.npy", "chw_f4_fortran.npy", "version2.npy"] {
        check(name, (3, 6, 5), ramp);
    }
    check("hwc_u1.npy", (3, 6, 5), |c, y, x| integers(c, y, x) as f32 / 255.0);
    check("hw_u2_big.npy", (1, 6, 5), |_, y, x| (integers(0, y, x) * 257) as f32 / 65535.0);
    check("bayer_f4.npy", (4, 6, 5), |c, y, x| if c < 3 { ramp(c, y, x) } else { ramp(0, y, x) + 50.0 });
}

#[test]
fn channels_are_last_when_a_shape_is_ambiguous() {
    check("ambiguous.npy", (3, 3, 5), |c, y, x| (y * 15 + x * 3 + c) as f32);
}

#[test]
fn reads_arrays_that_are_no_images() {
    assert_eq!(read_array(&fixture("code.npy")).unwrap().as_slice().unwrap(), [1.5, -2.0, 0.25]);
    let matrix = read_array(&fixture("matrix_i8.npy")).unwrap();
    assert_eq!((matrix.shape(), matrix[[2, 1]]), (&[3, 3][..], 7.0));
}

#[test]
fn reads_openexr_images_of_every_layout_and_type() {
    for name in [
        "float_zip.exr",
        "half_piz.exr",
        "half_tiled.exr",
        "mixed_types_alpha.exr",
        "prefixed.exr",
        "multi_part.exr",
    ] {
        check(name, (3, 6, 5), ramp);
    }
    check("luminance.exr", (1, 6, 5), |_, y, x| ramp(1, y, x));
    check("uint.exr", (3, 6, 5), |c, y, x| integers(c, y, x) as f32);
}

/// B44 is integer arithmetic; DWA is a transform whose results are rounded to halves, which may go either way.
#[test]
fn reads_lossy_openexr_as_the_openexr_library_does() {
    for (name, steps) in [("b44", 0.0), ("dwaa", 1.0)] {
        let found = read_pixels(&fixture(&format!("{name}.exr"))).unwrap().planes;
        let expected = read_pixels(&fixture(&format!("{name}_decoded.npy"))).unwrap().planes;
        for (a, b) in found.iter().zip(&expected) {
            assert!(
                (a - b).abs() <= steps * b.abs().max(2f32.powi(-14)) * 2f32.powi(-10),
                "{name}: {a} for {b}"
            );
        }
    }
}

#[test]
fn reads_the_exposure_time_of_openexr() {
    assert_eq!(read_pixels(&fixture("half_piz.exr")).unwrap().exposure_s, Some(0.125));
}

/// The data starts at column 2 and row −1 of a display window of 9 × 4.
#[test]
fn places_the_data_window_in_the_display_window() {
    check("window.exr", (3, 4, 9), |c, y, x| if (2..7).contains(&x) { ramp(c, y + 1, x - 2) } else { 0.0 });
    let path = fixture("window.exr");
    let pixels = read_pixels(&path).unwrap();
    assert_eq!(pixels.without_data, 4 * 4);
    assert!(pixels.describe_darkness(&path).unwrap().contains("16 of 36 pixels hold no data"));
    let whole = fixture("half_piz.exr");
    assert_eq!(read_pixels(&whole).unwrap().describe_darkness(&whole), None);
}

#[test]
fn names_the_layers_when_it_cannot_choose() {
    for name in ["two_layers.exr", "two_parts.exr"] {
        let message = refusal(name);
        assert!(message.contains("left") && message.contains("right"), "{message}");
    }
}

#[test]
fn reads_integer_images() {
    for name in ["rgb8.png", "opaque.png", "rgb16.png", "rgb16.tif"] {
        check(name, (3, 6, 5), |c, y, x| integers(c, y, x) as f32 / 255.0);
    }
    for name in ["grey8.png", "grey16.tif"] {
        check(name, (1, 6, 5), |_, y, x| integers(0, y, x) as f32 / 255.0);
    }
    let flat = read_pixels(&fixture("flat.jpg")).unwrap().planes;
    for ((c, ..), value) in flat.indexed_iter() {
        // A flat JPEG is exact up to the rounding of its colour transform.
        assert!((value * 255.0 - [200.0, 100.0, 50.0][c]).abs() <= 2.0, "{value}");
    }
}

#[test]
fn reads_float_tiff_and_radiance() {
    check("rgb32f.tif", (3, 6, 5), ramp);
    check("grey32f.tif", (1, 6, 5), ramp);
    // Mantissa m and exponent e stand for m · 2^(e − 136).
    check("flat.hdr", (3, 6, 5), |c, y, x| integers(c, y, x).max(1) as f32 * 2f32.powi(130 - 136));
}

#[test]
fn refuses_what_is_no_usable_image() {
    assert!(refusal("transparent.png").contains("flatten"));
    assert!(refusal("strings.npy").contains("<U2"));
    assert!(refusal("empty.npy").contains("empty"));
    assert!(refusal("code.npy").contains("[H, W, 3]"));
    assert!(refusal("matrix_i8.npy").contains("int64"));
    assert!(refusal("make.py").contains("not an image"));
}

/// Every prefix is refused, never believed or a panic.
#[test]
fn refuses_a_grey_float_tiff_that_is_cut_off_or_is_not_compressed_as_it_says() {
    let bytes = std::fs::read(fixture("grey32f.tif")).unwrap();
    let decode = |bytes: &[u8]| decode_image(Path::new("a.tif"), bytes, Format::Tiff, None);
    for length in 0..bytes.len() {
        // Behind the samples stands what no reader needs.
        assert!(
            decode(&bytes[..length]).is_err() || length * 4 > bytes.len() * 3,
            "{length} of {}",
            bytes.len()
        );
    }
    // Tag 259, type 3 (SHORT), one value: 1.
    let field = [3, 1, 3, 0, 1, 0, 0, 0, 1];
    let place = bytes.windows(field.len()).position(|window| window == field).unwrap();
    let mut compressed = bytes.clone();
    compressed[place + 8] = 5;
    let message = decode(&compressed).unwrap_err().to_string();
    assert!(message.contains("cannot be decoded"), "{message}");
}

/// Cameras and converters call the channel of a mosaic what they like.
#[test]
fn a_single_openexr_channel_may_have_any_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let grey = Pixels::of_planes(Array3::from_shape_fn((1, 5, 7), |(_, y, x)| ramp(0, y, x)));
    write_pixels(&path, &grey, PixelOptions::default()).unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    let start = bytes.windows(7).position(|window| window == b"chlist\0").unwrap() + 7 + 4;
    assert_eq!(&bytes[start..start + 2], b"Y\0");
    bytes[start] = b'K';
    std::fs::write(&path, bytes).unwrap();
    assert_eq!(read_pixels(&path).unwrap().planes, grey.planes);
}

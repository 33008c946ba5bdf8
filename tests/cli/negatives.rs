//! Digital negatives as cameras store them: compressed without loss, or packed. The fixtures are by other software.

use std::fs;
use std::path::{Path, PathBuf};

use ndarray::{Array3, Axis, Ix3, s};
use udc::io::{inspect_image, read_array};

use super::common::{succeed, udc};
use super::tiff::{Field, Tiff};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/negatives").join(name)
}

/// The samples `[channel, row, column]` of a negative as integers, and its white.
fn samples(name: &str) -> (Array3<f64>, f64) {
    let (read, _) = inspect_image(&fixture(name)).unwrap_or_else(|error| panic!("{error}"));
    let integers = read.planes.mapv(|value| (f64::from(value) * 65535.0).round());
    (integers, (read.raw.unwrap().white * 65535.0).round())
}

/// What the fixtures were made of.
fn stored(name: &str) -> Array3<f64> {
    let array = read_array(&fixture(name)).unwrap();
    let array = if array.ndim() == 2 { array.insert_axis(Axis(2)) } else { array };
    array.into_dimensionality::<Ix3>().unwrap().permuted_axes([2, 0, 1]).as_standard_layout().into_owned()
}

#[test]
fn lossless_jpeg_is_read_in_each_layout_and_with_each_predictor() {
    for name in ["tiles", "pairs", "wide"] {
        assert_eq!(samples(&format!("{name}.dng")), (stored("mosaic.npy"), 16383.0), "{name}");
    }
    assert_eq!(samples("colours.dng"), (stored("colours.npy"), 16383.0));
    assert_eq!(samples("extremes.dng"), (stored("extremes.npy"), 65535.0));
}

#[test]
fn samples_without_gaps_are_read() {
    let mosaic = stored("mosaic.npy");
    for bits in [10, 12, 14] {
        let shifted =
            mosaic.slice(s![.., .., 1..]).mapv(|value| (value / f64::from(1 << (14 - bits))).floor());
        let white = f64::from((1 << bits) - 1);
        assert_eq!(samples(&format!("packed{bits}.dng")), (shifted, white), "{bits} bits");
    }
}

#[test]
fn numbers_that_stand_for_others_are_replaced() {
    // The table has 900 entries; what lies behind them is the last.
    let expected = stored("mosaic.npy").mapv(|value| 16.0 * (value / 16.0).floor().min(899.0));
    assert_eq!(samples("table.dng"), (expected, 16383.0));
}

#[test]
fn damaged_negatives_are_refused_and_never_read_wrongly_in_length() {
    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join("damaged.dng");
    for name in ["tiles", "pairs", "wide", "extremes", "colours", "packed12", "table"] {
        let whole = fs::read(fixture(&format!("{name}.dng"))).unwrap();
        // The last four bytes say where the next directory is.
        for length in (0..whole.len() - 4).step_by(13) {
            fs::write(&path, &whole[..length]).unwrap();
            assert!(inspect_image(&path).is_err(), "{length} of {} bytes of {name}", whole.len());
        }
        // Whatever a byte is changed to, the file is read or refused.
        for (place, change) in (0..whole.len()).flat_map(|place| [(place, 0x7f), (place, 0x01)]) {
            let mut bytes = whole.clone();
            bytes[place] = bytes[place].wrapping_add(change);
            fs::write(&path, bytes).unwrap();
            let _ = inspect_image(&path);
        }
    }
}

/// The directory lies behind the tiles, so that a file may be whole and a tile cut off.
#[test]
fn tiles_that_end_early_are_refused() {
    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join("short.dng");
    for name in ["tiles", "pairs", "colours"] {
        let mut bytes = fs::read(fixture(&format!("{name}.dng"))).unwrap();
        let end = bytes.windows(2).position(|pair| pair == [0xff, 0xd9]).unwrap();
        // The image ends where a scan's last bytes were.
        bytes.copy_within(end..end + 2, end - 6);
        fs::write(&path, bytes).unwrap();
        let said = inspect_image(&path).unwrap_err().to_string();
        assert!(said.contains("short.dng") && said.contains("cut off"), "{said}");
    }
}

#[test]
fn what_a_negative_says_is_shown() {
    let file = fixture("packed12.dng");
    let file = file.to_str().unwrap();
    let said = succeed(Path::new("."), &["info", file]);
    assert!(said.contains("27 × 22") && said.contains("mosaic    RGGB"), "{said}");
    let json: serde_json::Value =
        serde_json::from_str(&succeed(Path::new("."), &["info", "--json", file])).unwrap();
    let white = json["raw"]["white"].as_f64().unwrap();
    assert!(json["raw"]["bayer"] == "rggb" && (white * 65535.0 - 4095.0).abs() < 1e-6, "{json}");
}

/// A tile's image may be no larger than the tile: many tiles may share a few bytes.
#[test]
fn tiles_do_not_hold_more_than_their_pixels() {
    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join("large.dng");
    let mut bytes = fs::read(fixture("extremes.dng")).unwrap();
    // Half the columns, tag 256.
    let field = bytes.windows(12).position(|field| field == [0, 1, 4, 0, 1, 0, 0, 0, 8, 0, 0, 0]).unwrap();
    bytes[field + 8] = 4;
    fs::write(&path, bytes).unwrap();
    let said = inspect_image(&path).unwrap_err().to_string();
    assert!(said.contains("more samples than the 16"), "{said}");
}

/// Interpolated colours with levels of their own: each is a share of its own white above its own black.
#[test]
fn each_colour_of_an_interpolated_negative_has_its_own_levels() {
    let scratch = tempfile::tempdir().unwrap();
    let (blacks, whites) = ([100_u16, 120, 140], [4000_u16, 3000, 3500]);
    let share = |y: usize, x: usize| (y * 8 + x) as f64 / 63.0;
    let samples: Vec<u16> = (0..8 * 8 * 3)
        .map(|index| {
            let (black, white) = (f64::from(blacks[index % 3]), f64::from(whites[index % 3]));
            (black + share(index / 24, index / 3 % 8) * (white - black)).round() as u16
        })
        .collect();
    let mut file = Tiff::new();
    let mut fields = file.image(34892, &samples, [8, 8]);
    fields.extend([
        (50706, Field::Bytes(vec![1, 4, 0, 0])),
        (50714, Field::Shorts(blacks.to_vec())),
        (50717, Field::Shorts(whites.to_vec())),
    ]);
    let first = file.directory(fields);
    let path = scratch.path().join("linear.dng");
    fs::write(&path, file.finish(first)).unwrap();
    let (read, _) = inspect_image(&path).unwrap();
    let raw = read.raw.unwrap();
    for ((channel, y, x), value) in read.planes.indexed_iter() {
        let found = (f64::from(*value) - raw.black) / (raw.white - raw.black);
        // Half a digital step, and what 32 bits round.
        assert!((found - share(y, x)).abs() < 0.6 / 2880.0, "{found} of channel {channel} at {y}, {x}");
    }
}

/// Floats may have any white level; 1 is theirs only where the file says none.
#[test]
fn floats_have_the_white_level_that_the_negative_says() {
    let scratch = tempfile::tempdir().unwrap();
    let light = |index: usize| index as f32 / 64.0;
    for (white, black) in [(None, 0_u16), (Some(4095_u16), 200)] {
        let range = f32::from(white.unwrap_or(1)) - f32::from(black);
        let halves: Vec<u16> = (0..64)
            .flat_map(|index| {
                let bits = (f32::from(black) + light(index) * range).to_bits();
                [(bits & 0xffff) as u16, (bits >> 16) as u16]
            })
            .collect();
        let mut file = Tiff::new();
        // Each float is two numbers of 16 bits, the lower first.
        let mut fields = file.image(32803, &halves, [8, 16]);
        fields.retain(|(tag, _)| ![256, 258].contains(tag));
        fields.extend([
            (256, Field::Longs(vec![8])),
            (258, Field::Shorts(vec![32])),
            (339, Field::Shorts(vec![3])),
            (33421, Field::Shorts(vec![2, 2])),
            (33422, Field::Bytes(vec![0, 1, 1, 2])),
            (50706, Field::Bytes(vec![1, 4, 0, 0])),
            (50714, Field::Shorts(vec![black])),
        ]);
        fields.extend(white.map(|white| (50717, Field::Shorts(vec![white]))));
        let first = file.directory(fields);
        let path = scratch.path().join("floats.dng");
        fs::write(&path, file.finish(first)).unwrap();
        let (read, encoding) = inspect_image(&path).unwrap();
        let raw = read.raw.unwrap();
        assert_eq!(
            (raw.white, raw.black, &encoding.sample_type[..]),
            (f64::from(white.unwrap_or(1)), f64::from(black), "float")
        );
        for (index, value) in read.planes.iter().enumerate() {
            let found = (f64::from(*value) - raw.black) / (raw.white - raw.black);
            assert!((found - f64::from(light(index))).abs() < 1e-6, "{found} at {index}");
        }
    }
}

/// What is said of a small RGGB negative of this version of the format, with another field.
fn said_of(version: [u8; 2], field: (u16, Field)) -> String {
    let scratch = tempfile::tempdir().unwrap();
    let mut file = Tiff::new();
    let mut fields = file.image(32803, &[1000; 16 * 16], [16, 16]);
    fields.extend([
        (33421, Field::Shorts(vec![2, 2])),
        (33422, Field::Bytes(vec![0, 1, 1, 2])),
        (50706, Field::Bytes(vec![version[0], version[1], 0, 0])),
        field,
    ]);
    let first = file.directory(fields);
    fs::write(scratch.path().join("a.dng"), file.finish(first)).unwrap();
    let output = udc(scratch.path(), &["fuse", "a.dng", "-o", "a.exr"]);
    String::from_utf8(output.stderr).unwrap()
}

#[test]
fn a_third_light_that_is_not_read_is_warned_of() {
    let said = said_of([1, 6], (52529, Field::Shorts(vec![20])));
    assert!(said.contains("calibrated for three lights"), "{said}");
}

#[test]
fn a_negative_whose_pixels_are_not_square_is_warned_of() {
    let said = said_of([1, 4], (50718, Field::Rationals(vec![(1, 1), (2, 1)])));
    assert!(said.contains("0.500 times as wide as high (DefaultScale)"), "{said}");
}

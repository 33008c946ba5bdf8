//! Digital negatives as cameras store them: compressed without loss, or packed. The fixtures are by other software.

use std::fs;
use std::path::{Path, PathBuf};

use ndarray::{Array3, Axis, Ix3, s};
use udc::io::{inspect_image, read_array};

use super::common::succeed;

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

//! Point sources behind a mosaic: cores that its photosites do not sample, and positions that do.

use std::fs;
use std::path::Path;

use ndarray::{Array3, ArrayD};
use udc::core::bayer::BayerPattern;
use udc::io::{read_psf, write_array};

use super::common::{fail, succeed, udc};

const SIDE: usize = 96;
const EXPOSURES: [(&str, f64); 3] = [("a.npy", 1.0), ("b.npy", 1.0 / 32.0), ("c.npy", 1.0 / 768.0)];
const FUSE: [&str; 8] =
    ["fuse", "--point-source", "--exposures", "1,1/32,1/768", "--bayer", "rggb", "--size", "41"];

/// A core of half a pixel, an order of a twentieth of its light and haze around, in light of the longest exposure's white.
fn light(channel: usize, y: f64, x: f64, sigma: f64) -> f64 {
    let spot = |cy: f64, cx: f64, sigma: f64| {
        (-((y - cy).powi(2) + (x - cx).powi(2)) / (2.0 * sigma * sigma)).exp() / (sigma * sigma)
    };
    let order = 8.0 + channel as f64;
    let shape = spot(0.0, 0.0, sigma) + 0.05 * spot(0.0, order, 0.7) + 0.1 * spot(0.0, 0.0, 5.0);
    [100.0, 120.0, 80.0][channel] * shape
}

/// A bracket of the source, displaced from the middle.
fn write_bracket(folder: &Path, [down, right]: [usize; 2], sigma: f64) {
    fs::create_dir_all(folder).unwrap();
    for (name, time) in EXPOSURES {
        let mosaic = ArrayD::from_shape_fn(vec![SIDE, SIDE], |at| {
            let [y, x] = [(0, down), (1, right)].map(|(axis, by)| at[axis] as f64 - (SIDE / 2 + by) as f64);
            (light(BayerPattern::Rggb.channel(at[0], at[1]), y, x, sigma) * time).min(1.0) as f32
        });
        write_array(&folder.join(name), &mosaic, false).unwrap();
    }
}

/// The largest error of a channel: the sum of what is too much and of what lacks.
fn error(file: &Path) -> f64 {
    let psf = read_psf(file).unwrap();
    let truth =
        Array3::from_shape_fn((3, 41, 41), |(c, y, x)| light(c, y as f64 - 20.0, x as f64 - 20.0, 0.5));
    let of_channel = |channel: usize| {
        let truth = truth.index_axis(ndarray::Axis(0), channel);
        let sum = truth.sum();
        psf.channel(channel).iter().zip(&truth).map(|(a, b)| (f64::from(*a) - b / sum).abs()).sum::<f64>()
    };
    (0..3).map(of_channel).fold(0.0, f64::max)
}

#[test]
fn four_positions_measure_a_core_that_one_does_not() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let displacements = [("p0", [0, 0]), ("p1", [0, 1]), ("p2", [1, 0]), ("p3", [1, 1])];
    for (name, displacement) in displacements {
        write_bracket(&folder.join("positions").join(name), displacement, 0.5);
        let input = format!("positions/{name}");
        let output = udc(folder, &[&FUSE[..], &[&input, "-o", "one.exr", "--overwrite"]].concat());
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success() && said.contains("too narrow for a mosaic"), "{name}: {said}");
        assert!(error(&folder.join("one.exr")) > 0.2, "{name}: {}", error(&folder.join("one.exr")));
    }
    let args = [&FUSE[..], &["--positions", "positions", "-o", "four.exr", "--json"]].concat();
    let output = udc(folder, &args);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && !said.contains("too narrow"), "{said}");
    // What the haze loses to the background and to the frame, of a level that is told.
    assert!(error(&folder.join("four.exr")) < 0.01, "{}", error(&folder.join("four.exr")));
    let told = String::from_utf8(output.stdout).unwrap();
    let last: serde_json::Value = serde_json::from_str(told.lines().last().unwrap()).unwrap();
    for (found, (name, [down, right])) in
        last["results"]["positions"].as_array().unwrap().iter().zip(displacements)
    {
        assert_eq!(found["name"], name);
        for (found, expected) in found["displacement-px"].as_array().unwrap().iter().zip([down, right]) {
            assert!((found.as_f64().unwrap() - expected as f64).abs() < 0.15, "{found} of {name}");
        }
    }
    let said = succeed(
        folder,
        &[&FUSE[..], &["--positions", "positions", "-o", "four.exr", "--overwrite"]].concat(),
    );
    assert!(said.contains("position p3: +1.0") || said.contains("position p3: +0.9"), "{said}");

    fs::remove_dir_all(folder.join("positions/p3")).unwrap();
    let said = fail(folder, &[&FUSE[..], &["--positions", "positions", "-o", "three.exr"]].concat(), 1);
    assert!(said.contains("an odd number of pixels down and an odd one right"), "{said}");
    assert!(!folder.join("three.exr").exists());
}

#[test]
fn a_core_that_the_photosites_sample_needs_one_position() {
    let scratch = tempfile::tempdir().unwrap();
    write_bracket(&scratch.path().join("one"), [0, 1], 1.5);
    let output = udc(scratch.path(), &[&FUSE[..], &["one", "-o", "one.exr"]].concat());
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && !said.contains("narrow"), "{said}");
}

#[test]
fn positions_are_of_mosaics_and_of_equal_exposures() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    for name in ["a", "b"] {
        fs::create_dir_all(folder.join(name)).unwrap();
        let picture = ArrayD::from_shape_fn(vec![3, 48, 48], |at| {
            0.5 / (1 + at[1].abs_diff(24) + at[2].abs_diff(24)) as f32
        });
        write_array(&folder.join(name).join("1.npy"), &picture, false).unwrap();
    }
    let args = ["fuse", "--point-source", "--positions", "a", "b", "--size", "21", "-o", "psf.exr"];
    let said = fail(folder, &args, 1);
    assert!(said.contains("--positions are of mosaics"), "{said}");
    let said = fail(folder, &["fuse", "--positions", "a", "b", "-o", "psf.exr"], 2);
    assert!(said.contains("--point-source"), "{said}");
}

//! Brackets: exposure times in any unit, several pictures of one time, dark frames.

use std::fs;
use std::path::Path;

use ndarray::Array3;
use tempfile::{TempDir, tempdir};
use udc::core::psf::Psf;
use udc::io::{self, PixelOptions, Pixels, WriteOptions};

use crate::common::{fail, succeed, udc};

const SHARES: [f32; 3] = [1.0, 1.0 / 4.0, 1.0 / 16.0];
const FILES: [&str; 3] = ["long.npy", "middle.npy", "short.npy"];

fn write(folder: &Path, name: &str, planes: Array3<f32>) {
    let options = PixelOptions { overwrite: true, ..PixelOptions::default() };
    io::write_pixels(&folder.join(name), &Pixels::of_planes(planes), options).unwrap();
}

/// A scene whose lamp is five times as bright as white of the longest exposure.
fn scene() -> Array3<f32> {
    Array3::from_shape_fn((3, 48, 56), |(c, y, x)| {
        let squared = (y as f32 - 20.0).powi(2) + (x as f32 - 30.0).powi(2);
        0.1 + 0.02 * (c + 1) as f32 * (1.0 + (0.3 * x as f32).sin()) + 5.0 * (-squared / 20.0).exp()
    })
}

/// A scratch folder with the scene in three exposures, and a PSF to restore it by.
fn scratch() -> TempDir {
    let scratch = tempdir().unwrap();
    for (name, share) in FILES.iter().zip(SHARES) {
        write(scratch.path(), name, scene().mapv(|v| (v * share).min(1.0)));
    }
    let energy = Array3::from_shape_fn((3, 9, 9), |(_, y, x)| {
        (-((y as f32 - 4.0).powi(2) + (x as f32 - 4.0).powi(2)) / 2.0).exp()
    });
    let psf = Psf::from_energy(energy).unwrap();
    io::write_psf(&scratch.path().join("psf.exr"), &psf, &WriteOptions::default()).unwrap();
    scratch
}

/// The bytes of what `udc` makes of the files in one file name.
fn made(folder: &Path, command: &[&str], more: &[&str]) -> Vec<u8> {
    succeed(folder, &[command, &FILES, &["-o", "made.exr", "--overwrite"], more].concat());
    fs::read(folder.join("made.exr")).unwrap()
}

#[test]
fn exposure_times_in_seconds_give_the_same_image_as_ratios() {
    let scratch = scratch();
    let of = |command: &[&str], times: &str| made(scratch.path(), command, &["--exposures", times]);
    let restore = ["restore", "--method", "wiener", "--psf", "psf.exr"];
    let psf = ["fuse", "--point-source", "--normalize", "none", "--size", "24"];
    for command in [&["fuse"][..], &["fuse", "--merge", "weighted"], &psf, &restore] {
        let shares = of(command, "1,1/4,1/16");
        for times in ["1/60,1/240,1/960", "16,4,1", "0.3,0.075,0.01875"] {
            assert!(of(command, times) == shares, "{command:?} with {times} differs");
        }
    }
}

/// 1 is white of the longest exposure, whatever its time.
#[test]
fn irradiance_is_the_same_in_seconds() {
    let scratch = scratch();
    made(scratch.path(), &["fuse"], &["--exposures", "1/60,1/240,1/960"]);
    let fused = io::read_pixels(&scratch.path().join("made.exr")).unwrap().planes;
    assert!(fused.iter().zip(&scene()).all(|(found, expected)| (found / expected - 1.0).abs() < 1e-5));
    succeed(scratch.path(), &["fuse", "short.npy", "--exposures", "1/960", "-o", "one.exr"]);
    let one = io::read_pixels(&scratch.path().join("one.exr")).unwrap().planes;
    assert!(one.iter().zip(&scene()).all(|(found, v)| (found / (v / 16.0) - 1.0).abs() < 1e-5));
}

#[test]
fn several_files_of_one_time_are_averaged() {
    let scratch = scratch();
    for (index, offset) in [-0.02, 0.02].into_iter().enumerate() {
        write(scratch.path(), &format!("long-{index}.npy"), scene().mapv(|v| (v + offset).min(1.0)));
    }
    let args = ["fuse", "long-0.npy", "middle.npy", "long-1.npy", "short.npy", "-o", "made.exr"];
    let said = succeed(scratch.path(), &[&args[..], &["--exposures", "1/60,1/240,1/60,1/960"]].concat());
    assert!(said.contains("from 1 (mean of 2)") && said.contains("from 1/4,"), "{said}");
    let fused = io::read_pixels(&scratch.path().join("made.exr")).unwrap().planes;
    for (found, expected) in fused.iter().zip(&scene()) {
        // Where one of both is saturated, the middle exposure is taken.
        assert!((found - expected).abs() < 2e-5 * expected, "{found} instead of {expected}");
    }
}

#[test]
fn a_picture_that_moved_or_is_darker_than_its_fellows_is_noticed() {
    let scratch = tempdir().unwrap();
    let texture = |shift: usize| {
        Array3::from_shape_fn((3, 128, 128), |(_, y, x)| {
            let place = ((x + shift) * 7919 + y * 104_729) % 65_521;
            0.3 + 0.6 * ((place * place) % 997) as f32 / 997.0
        })
    };
    write(scratch.path(), "a.npy", texture(0));
    write(scratch.path(), "b.npy", texture(5));
    write(scratch.path(), "c.npy", texture(0).mapv(|v| 0.5 * v));
    let said = fail(scratch.path(), &["fuse", "a.npy", "b.npy", "--exposures", "1,1", "-o", "o.exr"], 1);
    assert!(said.contains("picture 2 of the bracket is displaced") && said.contains("picture 1"), "{said}");
    let output = udc(scratch.path(), &["fuse", "a.npy", "c.npy", "--exposures", "1,1", "-o", "o.exr"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.contains("0.50 times as bright as picture 1"), "{said}");
}

/// What the sensor reads in the dark: a pattern, and a pixel that shines.
fn dark(share: f32) -> Array3<f32> {
    Array3::from_shape_fn((3, 48, 56), |(_, y, x)| {
        let hot = if (y, x) == (40, 7) { 0.3 } else { 0.0 };
        share * (0.004 + 0.0005 * ((y + 2 * x) % 5) as f32 + hot)
    })
}

/// The scene's pictures with darkness in them, and dark frames of each time, which tell their times.
fn write_with_darks(folder: &Path) {
    let write = |name: String, planes: Array3<f32>, share: f32| {
        let exposure_s = Some(f64::from(share) / 60.0);
        let pixels = Pixels { exposure_s, ..Pixels::of_planes(planes) };
        io::write_pixels(&folder.join(name), &pixels, PixelOptions::default()).unwrap();
    };
    for (index, share) in SHARES.into_iter().enumerate() {
        let light = scene().mapv(|v| v * share) + dark(share);
        write(format!("light-{index}.exr"), light.mapv(|v| v.min(1.0)), share);
        write(format!("dark-{index}.exr"), dark(share), share);
    }
}

const LIGHTS: [&str; 3] = ["light-0.exr", "light-1.exr", "light-2.exr"];
const DARKS: [&str; 4] = ["--dark", "dark-1.exr", "dark-0.exr", "dark-2.exr"];

#[test]
fn dark_frames_are_subtracted_and_their_hot_pixels_filled() {
    let scratch = scratch();
    write_with_darks(scratch.path());
    let made = |more: &[&str]| {
        let said = succeed(
            scratch.path(),
            &[&["fuse", "-o", "made.exr", "--overwrite"][..], &LIGHTS, &DARKS, more].concat(),
        );
        assert!(said.contains("hot pixels in the dark frames: 1, filled"), "{said}");
        fs::read(scratch.path().join("made.exr")).unwrap()
    };
    let of_files = made(&[]);
    let fused = io::read_pixels(&scratch.path().join("made.exr")).unwrap().planes;
    for ((c, y, x), expected) in scene().indexed_iter() {
        // The scene's texture is what neighbours cannot tell.
        let tolerance = if (y, x) == (40, 7) { 0.02 } else { 1e-5 + 1e-5 * expected };
        let found = fused[[c, y, x]];
        assert!((found - expected).abs() < tolerance, "{found} instead of {expected} at {y}, {x}");
    }
    let seconds = made(&["--exposures", "1/60,1/240,1/960", "--dark-exposures", "1/240,1/60,1/960"]);
    let shares = made(&["--exposures", "1,1/4,1/16", "--dark-exposures", "1/4,1,1/16"]);
    assert!(seconds == shares);
    assert!(!of_files.is_empty());
}

#[test]
fn restoring_takes_dark_frames_off_brackets_and_single_captures() {
    let scratch = scratch();
    write_with_darks(scratch.path());
    let how = ["--method", "wiener", "--psf", "psf.exr", "--overwrite", "-o", "restored.exr"];
    let restored = |what: &[&str]| {
        succeed(scratch.path(), &[&["restore"][..], what, &how].concat());
        io::read_pixels(&scratch.path().join("restored.exr")).unwrap().planes
    };
    let clean = restored(&["--exposures", "1,1/4,1/16", "long.npy", "middle.npy", "short.npy"]);
    let calibrated = restored(&[&["--bracket"][..], &LIGHTS, &DARKS].concat());
    let spoilt = restored(&[&["--bracket"][..], &LIGHTS].concat());
    let worst = |found: &Array3<f32>, clean: &Array3<f32>| {
        found.iter().zip(clean).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    };
    let (with, without) = (worst(&calibrated, &clean), worst(&spoilt, &clean));
    // The hot pixel is filled to 0.02, as the texture around it is; unfilled it shines with 0.3, less what Wiener spreads.
    assert!(with < 0.02 && without > 0.1, "{with} with and {without} without");

    let clean = restored(&["middle.npy", "--exposures", "1"]);
    let calibrated = restored(&["light-1.exr", "--dark", "dark-1.exr"]);
    assert!(worst(&calibrated, &clean) < 0.02, "{}", worst(&calibrated, &clean));
}

#[test]
fn dark_frames_that_belong_to_no_picture_say_so() {
    let scratch = scratch();
    write_with_darks(scratch.path());
    let refused = |more: &[&str], code: i32| {
        let args = [&["fuse", "-o", "refused.exr"][..], &LIGHTS, more].concat();
        let said = fail(scratch.path(), &args, code);
        assert!(!scratch.path().join("refused.exr").exists());
        said
    };
    let said = refused(&["--dark", "dark-0.exr"], 1);
    assert!(said.contains("no dark frame fits picture 2 of 1/240 s: they have 1/60 s;"), "{said}");
    let said = refused(&[&["--exposures", "1,1/4,1/16"][..], &DARKS].concat(), 1);
    assert!(said.contains("--dark-exposures"), "{said}");
    let said = refused(&["--dark", "light-0.exr", "--exposures", "1,1/4,1/16"], 1);
    assert!(said.contains("dark frame 1 has seen light") && said.contains("cap"), "{said}");
    let said = refused(&["--dark-exposures", "1"], 2);
    assert!(said.contains("--dark"), "{said}");
}

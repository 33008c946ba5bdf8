//! `udc restore` of brackets, raw and other.

use std::path::Path;

use ndarray::ArrayD;
use udc::core::image::{Linear, LinearImage};
use udc::io::{self, WriteOptions};

use super::common::{fail, succeed, udc};
use super::restore::scratch;
use super::restore_files::restore_by_wiener;

#[test]
fn restores_a_bracket_as_its_fused_image() {
    let scratch = scratch();
    let scene = io::read_image::<Linear>(&scratch.path().join("scene.exr")).unwrap();
    for (name, time) in [("long.exr", 1.0), ("middle.exr", 0.25), ("short.exr", 0.0625)] {
        let picture: LinearImage = scene.map_values(|v| (v * time).min(1.0));
        io::write_image(&scratch.path().join(name), &picture, &WriteOptions::default()).unwrap();
    }
    let how = ["--method", "wiener", "--psf", "psf.exr"];
    let bracket = ["restore", "--exposures", "1,1/4,1/16", "long.exr", "middle.exr", "short.exr"];
    succeed(scratch.path(), &[&bracket, &how[..], &["-o", "bracket.exr"]].concat());
    succeed(scratch.path(), &[&["restore", "scene.exr"][..], &how, &["-o", "single.exr"]].concat());
    let [a, b] = ["bracket.exr", "single.exr"]
        .map(|name| io::read_image::<Linear>(&scratch.path().join(name)).unwrap());
    let worst = a.as_slice().iter().zip(b.as_slice()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst < 1e-3, "{worst}");
}

/// A mosaic of a scene in three exposures, 10 bits above a black level, as a camera would store it.
pub(super) fn write_raw_bracket(folder: &Path, exposures: &[(&str, f32)], shift: usize) {
    write_filtered_bracket(folder, exposures, shift, [1.0; 4]);
}

/// The same, the four photosites of each cell behind filters.
pub(super) fn write_filtered_bracket(
    folder: &Path,
    exposures: &[(&str, f32)],
    shift: usize,
    filters: [f32; 4],
) {
    std::fs::create_dir_all(folder).unwrap();
    for (index, (name, time)) in exposures.iter().enumerate() {
        let mosaic = ArrayD::from_shape_fn(vec![96, 112], |place| {
            let (y, x) = (place[0], place[1] + shift * index);
            let lamp = |cy: f32, cx: f32| (-((y as f32 - cy).powi(2) + (x as f32 - cx).powi(2)) / 30.0).exp();
            let light = 0.2 + 12.0 * lamp(40.0, 50.0) + 6.0 * lamp(70.0, 20.0) + 9.0 * lamp(20.0, 90.0);
            let filter = filters[place[0] % 2 * 2 + place[1] % 2];
            (64.0 + (light * filter * time).min(1.0) * 959.0).round()
        });
        io::write_array(&folder.join(name), &mosaic, true).unwrap();
    }
}

pub(super) const RAW: [&str; 8] =
    ["--white", "1023", "--black", "64", "--bayer", "rggb", "--exposures", "1,1/4,1/16"];

#[test]
fn restores_brackets_of_mosaics_folder_by_folder() {
    let scratch = scratch();
    let exposures = [("1.npy", 1.0), ("2.npy", 0.25), ("3.npy", 0.0625)];
    for scene in ["scenes/a", "scenes/b"] {
        write_raw_bracket(&scratch.path().join(scene), &exposures, 0);
    }
    let how = ["--method", "wiener", "--psf", "psf.exr"];
    let restore = |more: &[&'static str]| [&["restore", "scenes"][..], &RAW, &how, more].concat();
    succeed(scratch.path(), &restore(&["-o", "out"]));
    let balanced = ["-o", "balanced", "--white-balance", "2,1,1.5"];
    succeed(scratch.path(), &restore(&balanced));
    let read = |name: &str| io::read_image::<Linear>(&scratch.path().join(name)).unwrap();
    let (plain, balanced) = (read("out/a.exr"), read("balanced/a.exr"));
    assert_eq!(plain, read("out/b.exr"));
    for (channel, gain) in [2.0, 1.0, 1.5].into_iter().enumerate() {
        let ratio = balanced.channel(channel)[[48, 100]] / plain.channel(channel)[[48, 100]];
        assert!((ratio / gain - 1.0).abs() < 0.05, "channel {channel}: {ratio}");
    }
    std::fs::remove_file(scratch.path().join("scenes/b/2.npy")).unwrap();
    let output = udc(scratch.path(), &restore(&["-o", "missing"]));
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("1 of 2 images") && said.contains("expected 3 pictures"), "{said}");
    assert!(scratch.path().join("missing/a.exr").exists());
}

#[test]
fn says_what_is_wrong_with_a_bracket() {
    let scratch = scratch();
    let exposures = [("1.npy", 1.0), ("2.npy", 0.25), ("3.npy", 0.0625)];
    write_filtered_bracket(&scratch.path().join("raw"), &exposures, 0, [0.5, 1.0, 1.0, 0.3]);
    let all = ["raw/1.npy", "raw/2.npy", "raw/3.npy"];
    let flags = |black: &'static str, bayer: &'static str| {
        ["--white", "1023", "--black", black, "--bayer", bayer, "--exposures", "1,1/4,1/16", "--overwrite"]
    };
    let run = |pictures: &[&'static str], black, bayer| {
        let how = ["--method", "wiener", "--psf", "psf.exr", "-o", "out.exr"];
        let arguments = [&["restore"][..], pictures, &flags(black, bayer), &how].concat();
        let output = udc(scratch.path(), &arguments);
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let refuses = |pictures: &[&'static str], black, reason: &str| {
        let (code, said) = run(pictures, black, "rggb");
        assert!(code == Some(1) && said.contains(reason) && said.lines().count() == 1, "{code:?} {said}");
    };
    refuses(&["raw/3.npy", "raw/2.npy", "raw/1.npy"], "64", "is brighter than picture 1");
    refuses(&["raw/1.npy", "raw/3.npy", "raw/2.npy"], "64", "is brighter than picture 2");
    refuses(&all[..2], "64", "expected 3 pictures, one for each exposure time, found 2");
    refuses(&all, "200", "black: lies above");
    refuses(&all, "2000", "white: must lie above black 2000, found 1023");
    let (code, said) = run(&all, "64", "rggb");
    assert!(code == Some(0) && !said.contains("warning"), "{said}");
    for wrong in ["grbg", "gbrg"] {
        let (code, said) = run(&all, "64", wrong);
        assert!(code == Some(0) && said.contains("check --bayer"), "{said}");
    }
    let mosaic = ArrayD::from_elem(vec![94, 112], 70.0f32);
    io::write_array(&scratch.path().join("raw/2.npy"), &mosaic, true).unwrap();
    refuses(&all, "64", "picture 2 of the bracket: expected 1 channels of 96 × 112");
}

#[test]
fn refuses_a_bracket_that_moved_unless_told() {
    let scratch = scratch();
    let exposures = [("1.npy", 1.0), ("2.npy", 0.25), ("3.npy", 0.0625)];
    write_raw_bracket(&scratch.path().join("moved"), &exposures, 4);
    let how = ["--method", "wiener", "--psf", "psf.exr", "-o", "out.exr"];
    let restore = [&["restore", "moved"][..], &RAW, &how].concat();
    let said = fail(scratch.path(), &restore, 1);
    assert!(said.contains("picture 2") && said.contains("--allow-motion"), "{said}");
    succeed(scratch.path(), &[&restore[..], &["--allow-motion"]].concat());
}

#[test]
fn reads_exposure_times_from_the_files_and_says_when_there_are_none() {
    let scratch = scratch();
    let scene = io::read_image::<Linear>(&scratch.path().join("scene.exr")).unwrap();
    let write = |name: &str, time: f32, exposure_s| {
        let planes = scene.planes().mapv(|v| (v * time).min(1.0));
        let pixels = io::Pixels { exposure_s, ..io::Pixels::of_planes(planes) };
        let options = io::PixelOptions { overwrite: true, ..io::PixelOptions::default() };
        io::write_pixels(&scratch.path().join(name), &pixels, options).unwrap();
    };
    for (name, time) in [("1.exr", 1.0), ("2.exr", 0.25), ("3.exr", 0.0625)] {
        write(name, time, Some(f64::from(time)));
    }
    let how = ["--method", "wiener", "--psf", "psf.exr"];
    let restore = [&["restore", "--bracket", "1.exr", "2.exr", "3.exr"][..], &how].concat();
    succeed(scratch.path(), &[&restore[..], &["-o", "bracket.exr"]].concat());
    succeed(scratch.path(), &[&["restore", "scene.exr", "-o", "single.exr"][..], &how].concat());
    let [a, b] = ["bracket.exr", "single.exr"]
        .map(|name| io::read_image::<Linear>(&scratch.path().join(name)).unwrap());
    assert!(a.as_slice().iter().zip(b.as_slice()).all(|(a, b)| (a - b).abs() < 1e-3));
    write("2.exr", 0.25, None);
    let said = fail(scratch.path(), &[&restore[..], &["-o", "o.exr"]].concat(), 1);
    assert!(said.contains("add --exposures"), "{said}");
}

#[test]
fn flags_of_brackets_need_a_bracket() {
    let scratch = scratch();
    for flag in [&["--estimate-exposures"][..], &["--merge", "weighted"], &["--allow-motion"]] {
        let said = fail(
            scratch.path(),
            &restore_by_wiener(&["capture.exr"], &[&["-o", "out.exr"], flag].concat()),
            1,
        );
        assert!(said.contains(flag[0]) && said.contains("--bracket"), "{said}");
    }
}

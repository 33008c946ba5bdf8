//! The command line: measure. `udc psf` and `udc fuse`.

use std::path::Path;

use ndarray::Array3;
use serde_json::Value;
use tempfile::tempdir;
use udc::io::{PixelOptions, Pixels, read_pixels, read_psf, write_pixels};

use crate::common::{fail, succeed};

const EXPOSURES: [(&str, f32); 3] = [("a.npy", 1.0), ("b.npy", 1.0 / 32.0), ("c.npy", 1.0 / 768.0)];

fn write(folder: &Path, name: &str, planes: Array3<f32>) {
    write_pixels(
        &folder.join(name),
        &Pixels::of_planes(planes),
        PixelOptions { overwrite: true, ..PixelOptions::default() },
    )
    .unwrap();
}

/// A point source of brightness 700 at row 33, column 30 on a level of 0.01, with one sidelobe.
fn scene(channels: usize) -> Array3<f32> {
    Array3::from_shape_fn((channels, 64, 60), |(_, y, x)| {
        let spot = |cy: f32, cx: f32| (-((y as f32 - cy).powi(2) + (x as f32 - cx).powi(2)) / 4.0).exp();
        700.0 * spot(33.0, 30.0) + 2.0 * spot(33.0, 42.0) + 0.01
    })
}

fn write_bracket(folder: &Path, scene: &Array3<f32>) {
    for (name, time) in EXPOSURES {
        write(folder, name, scene.mapv(|v| (v * time).min(1.0)));
    }
}

#[test]
fn fuses_a_bracket_to_the_scene() {
    let folder = tempdir().unwrap();
    write_bracket(folder.path(), &scene(3));
    let out = succeed(
        folder.path(),
        &["fuse", "--exposures", "1,1/32,1/768", "a.npy", "b.npy", "c.npy", "-o", "o.exr"],
    );
    assert!(out.contains("o.exr: 60 × 64") && out.contains("from 1/768"), "{out}");
    let fused = read_pixels(&folder.path().join("o.exr")).unwrap().planes;
    assert!(fused.iter().zip(&scene(3)).all(|(a, b)| (a / b - 1.0).abs() < 1e-5));
}

#[test]
fn fuses_a_bracket_to_a_psf_with_its_quality() {
    let folder = tempdir().unwrap();
    write_bracket(folder.path(), &scene(3));
    let args =
        ["fuse", "a.npy", "b.npy", "c.npy", "-o", "psf.exr", "--point-source", "--size", "40", "--json"];
    let told = succeed(folder.path(), &args);
    let last: Value = serde_json::from_str(told.lines().last().unwrap()).unwrap();
    let summary = &last["results"];
    assert_eq!(summary["psf"]["displacement-px"], serde_json::json!([1, 0]));
    let ratio = summary["psf"]["channels"][1]["peak-to-sidelobe"].as_f64().unwrap();
    assert!((ratio / 350.0 - 1.0).abs() < 0.01, "{ratio}");
    let psf = read_psf(&folder.path().join("psf.exr")).unwrap();
    let brightest = psf.channel(0).indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap().0;
    assert_eq!((brightest, psf.height()), ((20, 20), 40));
}

#[test]
fn fuses_a_mosaic() {
    let folder = tempdir().unwrap();
    write_bracket(folder.path(), &scene(1));
    let args = ["fuse", "a.npy", "b.npy", "c.npy", "-o", "o.npy", "--bayer", "rggb"];
    succeed(folder.path(), &args);
    assert_eq!(read_pixels(&folder.path().join("o.npy")).unwrap().planes.dim(), (3, 64, 60));
    let message = fail(folder.path(), &["fuse", "a.npy", "b.npy", "c.npy", "-o", "grey.npy"], 1);
    assert!(message.contains("bayer") && message.contains("rggb"), "{message}");
}

#[test]
fn discards_hot_pixels_by_a_mask() {
    let folder = tempdir().unwrap();
    let mut hot = scene(3);
    hot.slice_mut(ndarray::s![.., 10, 10]).fill(1e6);
    write_bracket(folder.path(), &hot);
    let mask = Array3::from_shape_fn((3, 64, 60), |(_, y, x)| f32::from(u8::from((y, x) != (10, 10))));
    write(folder.path(), "mask.png", mask);
    succeed(folder.path(), &["fuse", "a.npy", "b.npy", "c.npy", "-o", "o.npy", "--mask", "mask.png"]);
    let fused = read_pixels(&folder.path().join("o.npy")).unwrap().planes;
    assert!((fused[[0, 10, 10]] - 0.01).abs() < 1e-5);
}

#[test]
fn warns_of_pixels_that_are_saturated_everywhere() {
    let folder = tempdir().unwrap();
    let bright = scene(3).mapv(|v| v * 4.0);
    write_bracket(folder.path(), &bright);
    let output = crate::common::udc(folder.path(), &["fuse", "a.npy", "b.npy", "c.npy", "-o", "o.npy"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && stderr.contains("saturated in every exposure"), "{stderr}");
}

#[test]
fn fuses_one_or_two_exposures_but_asks_for_the_times_of_two() {
    let folder = tempdir().unwrap();
    write_bracket(folder.path(), &scene(3));
    let message = fail(folder.path(), &["fuse", "a.npy", "b.npy", "-o", "o.npy"], 1);
    assert!(message.contains("fusing bracket a.npy b.npy") && message.contains("--exposures"), "{message}");
    assert!(!folder.path().join("o.npy").exists());
    let brightest = |args: &[&str]| {
        succeed(folder.path(), &[&["fuse", "-o", "o.npy", "--overwrite"], args].concat());
        let fused = read_pixels(&folder.path().join("o.npy")).unwrap().planes;
        fused.iter().copied().fold(0.0, f32::max)
    };
    assert!((brightest(&["a.npy", "b.npy", "--exposures", "1,1/32"]) - 32.0).abs() < 1e-4);
    assert!((brightest(&["a.npy"]) - 1.0).abs() < 1e-6);
}

#[test]
fn pictures_that_say_no_times_are_a_scene_bracket() {
    let folder = tempdir().unwrap();
    let scene = scene(3).mapv(|v| v / 100.0);
    for (name, time) in [("a.npy", 1.0), ("b.npy", 0.25), ("c.npy", 0.0625)] {
        write(folder.path(), name, scene.mapv(|v| (v * time).min(1.0)));
    }
    succeed(folder.path(), &["fuse", "a.npy", "b.npy", "c.npy", "-o", "o.npy"]);
    let fused = read_pixels(&folder.path().join("o.npy")).unwrap().planes;
    assert!(fused.iter().zip(&scene).all(|(a, b)| (a / b - 1.0).abs() < 1e-5));
    let help = succeed(folder.path(), &["fuse", "--help"]);
    assert!(help.contains("1,1/4,1/16"), "{help}");
}

#[test]
fn refuses_an_impossible_size_before_it_reads_pictures() {
    let folder = tempdir().unwrap();
    std::fs::write(folder.path().join("a.npy"), "no picture").unwrap();
    for size in ["0", "100000", "18446744073709551615"] {
        let message =
            fail(folder.path(), &["fuse", "a.npy", "-o", "o.exr", "--point-source", "--size", size], 1);
        assert!(message.contains("between 1 and 8192"), "{message}");
    }
}

#[test]
fn a_black_level_in_integers_asks_for_the_white_level() {
    let folder = tempdir().unwrap();
    write_bracket(folder.path(), &scene(3));
    let message =
        fail(folder.path(), &["fuse", "a.npy", "b.npy", "c.npy", "-o", "o.exr", "--black", "64"], 1);
    assert!(message.contains("black 64") && message.contains("give --white"), "{message}");
}

#[test]
fn refuses_exposures_of_different_sizes_or_in_a_wrong_order() {
    let folder = tempdir().unwrap();
    write_bracket(folder.path(), &scene(3));
    let order = ["fuse", "--exposures", "1/32,1,1/768", "a.npy", "b.npy", "c.npy", "-o", "o.exr"];
    let message = fail(folder.path(), &order, 1);
    assert!(message.contains("is brighter than picture 2"), "{message}");
    write(folder.path(), "b.npy", Array3::zeros((3, 64, 61)));
    let message = fail(folder.path(), &["fuse", "a.npy", "b.npy", "c.npy", "-o", "o.exr"], 1);
    assert!(message.contains("picture 2") && message.contains("64 × 61"), "{message}");
}

#[test]
fn refuses_exposures_that_are_no_numbers() {
    let folder = tempdir().unwrap();
    let message = fail(folder.path(), &["fuse", "--exposures", "1,x,3", "a.npy", "-o", "o.exr"], 2);
    assert!(message.contains("fraction such as 1/32"), "{message}");
}

const DISPLAY: &str = "[sensor]\nsize-px = 64\n[display]\nkind = \"stripe\"\npitch-um = 60\nbackground-transmittance = 0.2\n\
    green = { shape = \"ellipse\", width-um = 20, height-um = 30, transmittance = 1 }\n";

#[test]
fn simulates_the_psf_of_a_display_file() {
    let folder = tempdir().unwrap();
    std::fs::write(folder.path().join("panel.toml"), DISPLAY).unwrap();
    let out = succeed(folder.path(), &["psf", "--display", "panel.toml", "-o", "psf.npy"]);
    assert!(out.contains("psf.npy: PSF of 64 × 64") && out.contains("red"), "{out}");
    let psf = read_psf(&folder.path().join("psf.npy")).unwrap();
    let brightest = psf.channel(2).indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap().0;
    assert_eq!(brightest, (32, 32));
    succeed(folder.path(), &["psf", "--display", "panel.toml", "-o", "odd.npy", "--size", "33"]);
    assert_eq!(read_psf(&folder.path().join("odd.npy")).unwrap().height(), 33);
}

/// A pitch in nanometres instead of micrometres.
#[test]
fn says_of_a_panel_that_the_aperture_hardly_spans_a_pixel_of_it() {
    let folder = tempdir().unwrap();
    for (pitch, is_told) in [("60.0", false), ("60000.0", true)] {
        let panel = DISPLAY.replace("pitch-um = 60", &format!("pitch-um = {pitch}"));
        std::fs::write(folder.path().join("panel.toml"), panel).unwrap();
        let flags = ["psf", "--display", "panel.toml", "-o", "psf.npy", "--overwrite"];
        let output = crate::common::udc(folder.path(), &flags);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{stderr}");
        assert_eq!(stderr.contains("spans 0.03 pixels of its panel"), is_told, "{stderr}");
    }
}

#[test]
fn says_of_a_panel_that_it_has_no_features_or_passes_no_light() {
    let folder = tempdir().unwrap();
    let panel = "[sensor]\nsize-px = 32\n[display]\nkind = \"pentile\"\npitch-um = 60\n";
    std::fs::write(folder.path().join("bare.toml"), panel).unwrap();
    let output = crate::common::udc(folder.path(), &["psf", "--display", "bare.toml", "-o", "psf.npy"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && stderr.contains("bare lens"), "{stderr}");
    std::fs::write(folder.path().join("dark.toml"), format!("{panel}background-transmittance = 0\n"))
        .unwrap();
    let message = fail(folder.path(), &["psf", "--display", "dark.toml", "-o", "dark.npy"], 1);
    assert!(message.contains("passes no light"), "{message}");
}

#[test]
fn a_grid_that_is_too_large_names_the_pixel_pitch() {
    let folder = tempdir().unwrap();
    std::fs::write(folder.path().join("panel.toml"), "[sensor]\nsize-px = 64\npixel-pitch-um = 1120\n")
        .unwrap();
    let message = fail(folder.path(), &["psf", "--display", "panel.toml", "-o", "psf.npy"], 1);
    assert!(message.contains("sensor.pixel-pitch-um"), "{message}");
}

#[test]
fn progress_is_drawn_without_a_terminal_when_asked_for() {
    let folder = tempdir().unwrap();
    std::fs::write(folder.path().join("panel.toml"), DISPLAY).unwrap();
    let args = ["psf", "--display", "panel.toml", "--overwrite", "-o", "psf.npy", "--progress"];
    let stderr = |when: &str| crate::common::udc(folder.path(), &[&args[..], &[when]].concat()).stderr;
    let drawn = String::from_utf8(stderr("always")).unwrap();
    assert!(drawn.contains("wavelengths") && drawn.contains("/3"), "{drawn:?}");
    assert!(stderr("auto").is_empty());
}

#[test]
fn refuses_a_display_file_with_a_typing_error() {
    let folder = tempdir().unwrap();
    std::fs::write(folder.path().join("panel.toml"), format!("{DISPLAY}pitch-mm = 3\n")).unwrap();
    let message = fail(folder.path(), &["psf", "--display", "panel.toml", "-o", "psf.exr"], 1);
    assert!(message.contains("line 8") && message.contains("pitch-mm"), "{message}");
    assert!(!folder.path().join("psf.exr").exists());
}

#[test]
fn refuses_a_grid_that_aliases_and_names_one_that_would_do() {
    let folder = tempdir().unwrap();
    std::fs::write(folder.path().join("panel.toml"), format!("{DISPLAY}[sampling]\ngrid-pitch-um = 20\n"))
        .unwrap();
    let message = fail(folder.path(), &["psf", "--display", "panel.toml", "-o", "psf.exr"], 1);
    assert!(message.contains("sampling.grid-pitch-um") && message.contains("would do"), "{message}");
}

#[test]
fn refuses_to_write_a_psf_as_integers() {
    let folder = tempdir().unwrap();
    std::fs::write(folder.path().join("panel.toml"), DISPLAY).unwrap();
    let message = fail(folder.path(), &["psf", "--display", "panel.toml", "-o", "psf.png"], 1);
    assert!(message.contains("write .exr or .npy"), "{message}");
}

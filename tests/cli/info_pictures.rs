//! `udc info --picture`, and what `udc info` tells of poses.

use std::fs;

use ndarray::Array3;
use serde_json::Value;
use udc::core::image::LinearImage;
use udc::io::{WriteOptions, write_image};
use udc::restore::{Pose, write_pose};

use super::common::{fail, succeed, udc};

#[test]
fn draws_pictures_where_it_is_told_how_wide() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let planes = Array3::from_shape_fn((3, 20, 40), |(c, y, _)| if c == 0 && y < 10 { 1.0 } else { 0.0 });
    let image = LinearImage::from_planes(planes).unwrap();
    write_image(&folder.join("red ü.exr"), &image, &WriteOptions::default()).unwrap();
    succeed(folder, &["psf", "--random", "1", "--size", "31", "-o", "psf.exr"]);
    succeed(folder, &["scenes", "-o", "views", "--count", "1", "--size", "16"]);
    let said = succeed(folder, &["info", "--picture=8", "red ü.exr"]);
    let drawn: Vec<&str> = said.lines().filter(|line| line.contains('▀')).collect();
    assert_eq!(drawn.len(), 2, "8 × 4 pixels are two lines: {said:?}");
    assert_eq!(drawn[0].matches("38;2;255;0;0").count(), 8, "{:?}", drawn[0]);
    assert_eq!(drawn[1].matches("48;2;0;0;0").count(), 8, "{:?}", drawn[1]);
    assert!(drawn.iter().all(|line| line.ends_with("\x1b[0m")), "the colours end with the line");
    // A PSF is told by what it holds, and shown by decades: its surroundings are not black.
    let said = succeed(folder, &["info", "--picture=31", "psf.exr"]);
    assert!(said.lines().any(|line| line.contains('▀') && line.contains("255")), "{said:?}");
    assert!(said.matches("8;2;0;0;0m").count() < 31 * 31 / 2, "{said:?}");
    // The kernels of a bank stand side by side: two are twice as wide as high.
    succeed(folder, &["codes", "psf.exr", "--angles=0,5", "--dim", "1", "-o", "bank.safetensors"]);
    let said = succeed(folder, &["info", "--picture=20", "bank.safetensors"]);
    assert_eq!(said.lines().filter(|line| line.contains('▀')).count(), 5, "{said:?}");
    // What is no picture is described as ever.
    fs::write(folder.join("config.toml"), "iterations = 3").unwrap();
    let said = succeed(folder, &["info", "--picture=8", "config.toml", "views"]);
    assert!(said.contains("training configuration") && said.contains('▀'), "{said}");
}

#[test]
fn draws_nothing_into_a_pipe_unless_told_how_wide() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let image = LinearImage::from_planes(Array3::ones((3, 1, 1))).unwrap();
    write_image(&folder.join("a.exr"), &image, &WriteOptions::default()).unwrap();
    let output = udc(folder, &["info", "--picture", "a.exr"]);
    let (said, stderr) =
        (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap());
    assert!(output.status.success() && said.contains("1 × 1") && !said.contains('\x1b'), "{said:?}");
    assert!(stderr.contains("--picture=80"), "{stderr}");
    assert!(succeed(folder, &["info", "--picture=5", "a.exr"]).contains('▀'));
    assert!(fail(folder, &["info", "--picture=5", "--json", "a.exr"], 2).contains("--picture"));
    assert!(fail(folder, &["info", "--picture=0.5", "a.exr"], 2).contains("--picture"));
}

#[test]
fn describes_a_pose() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let pose =
        Pose { turn_deg: 0.3, scale: 1e-3, turn_sigma_deg: 0.01, scale_sigma: 1e-4, psf_sha256: "cd".into() };
    write_pose(&folder.join("pose.toml"), &pose, false).unwrap();
    let said = succeed(folder, &["info", "pose.toml"]);
    assert!(said.contains("pose") && said.contains("of the PSF cd"), "{said}");
    let json: Value = serde_json::from_str(&succeed(folder, &["info", "--json", "pose.toml"])).unwrap();
    assert_eq!((&json["kind"], &json["turn_deg"]), (&Value::from("pose"), &Value::from(0.3)));
    fs::write(folder.join("pose.toml"), "format = \"udc-pose\"\nversion = 1\nturn-deg = 500\n").unwrap();
    assert!(fail(folder, &["info", "pose.toml"], 1).contains("pose.toml"));
}

//! What raw pictures do not say, or say wrongly: times, levels, white balance, dark frames.

use std::fs;
use std::path::Path;

use ndarray::Array3;
use tempfile::{TempDir, tempdir};
use udc::core::psf::Psf;
use udc::io::{self, PixelOptions, Pixels, WriteOptions};

use super::common::{fail, succeed, udc};
use super::tiff::{Field, Tiff};

const SIDE: usize = 32;
const BLACK: u16 = 64;
const WHITE: u16 = 1023;

/// What a negative says.
#[derive(Clone, Copy, Default)]
struct Said {
    seconds: Option<(u32, u32)>,
    iso: Option<u16>,
    neutral: Option<[u32; 3]>,
    color_matrix: Option<[i32; 9]>,
}

/// A digital negative, RGGB, whose photosites read this share of white.
fn write_negative(path: &Path, light: f64, said: Said) {
    let level = BLACK + (light * f64::from(WHITE - BLACK)).round() as u16;
    let samples = vec![level; SIDE * SIDE];
    let mut file = Tiff::new();
    let mut fields = file.image(32803, &samples, [SIDE, SIDE]);
    fields.extend([
        (33421, Field::Shorts(vec![2, 2])),
        (33422, Field::Bytes(vec![0, 1, 1, 2])),
        (50706, Field::Bytes(vec![1, 4, 0, 0])),
        (50714, Field::Shorts(vec![BLACK])),
        (50717, Field::Longs(vec![u32::from(WHITE)])),
    ]);
    if let Some(neutral) = said.neutral {
        fields.push((50728, Field::Rationals(neutral.map(|value| (value, 1000)).to_vec())));
    }
    if let Some(matrix) = said.color_matrix {
        fields.push((50721, Field::SignedRationals(matrix.map(|value| (value, 1000)).to_vec())));
        fields.push((50778, Field::Shorts(vec![21])));
    }
    let mut exif = Vec::new();
    exif.extend(said.seconds.map(|seconds| (33434, Field::Rationals(vec![seconds]))));
    exif.extend(said.iso.map(|iso| (34855, Field::Shorts(vec![iso]))));
    if !exif.is_empty() {
        let exif = file.directory(exif);
        fields.push((34665, Field::Longs(vec![exif])));
    }
    let first = file.directory(fields);
    fs::write(path, file.finish(first)).unwrap();
}

fn grey(said: Said) -> Said {
    Said { neutral: Some([500, 1000, 625]), ..said }
}

fn write(folder: &Path, name: &str, planes: Array3<f32>) {
    io::write_pixels(&folder.join(name), &Pixels::of_planes(planes), PixelOptions::default()).unwrap();
}

fn scratch() -> TempDir {
    let scratch = tempdir().unwrap();
    let energy = Array3::from_shape_fn((3, 5, 5), |(_, y, x)| {
        (-((y as f32 - 2.0).powi(2) + (x as f32 - 2.0).powi(2)) / 2.0).exp()
    });
    let psf = Psf::from_energy(energy).unwrap();
    io::write_psf(&scratch.path().join("psf.exr"), &psf, &WriteOptions::default()).unwrap();
    scratch
}

const HOW: [&str; 6] = ["--method", "wiener", "--psf", "psf.exr", "-o", "out.exr"];

/// What `udc` says beside its result.
fn warned(folder: &Path, args: &[&str]) -> String {
    let output = udc(folder, args);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "udc {args:?} failed: {said}");
    said
}

#[test]
fn fusing_pictures_of_which_one_says_no_time_asks_for_the_times() {
    let scratch = scratch();
    let times = [("a.dng", Some((1, 60)), 0.8), ("b.dng", Some((1, 120)), 0.4), ("c.dng", None, 0.1)];
    for (name, seconds, light) in times {
        write_negative(&scratch.path().join(name), light, grey(Said { seconds, ..Said::default() }));
    }
    for (command, files) in [
        (&["fuse", "-o", "out.exr"][..], &["a.dng", "b.dng", "c.dng"][..]),
        (&["fuse", "-o", "out.exr"], &["a.dng", "c.dng"]),
        (
            &["restore", "--bracket", "--method", "wiener", "--psf", "psf.exr", "-o", "out.exr"],
            &["a.dng", "c.dng"],
        ),
    ] {
        let said = fail(scratch.path(), &[command, files].concat(), 1);
        assert!(said.contains("not every picture says its exposure time: add --exposures"), "{said}");
        assert!(!scratch.path().join("out.exr").exists());
    }
    succeed(
        scratch.path(),
        &["fuse", "a.dng", "b.dng", "c.dng", "--exposures", "1/60,1/120,1/480", "-o", "out.exr"],
    );
}

#[test]
fn a_white_beyond_what_the_file_can_hold_is_refused() {
    let scratch = scratch();
    write_negative(&scratch.path().join("a.dng"), 0.5, grey(Said::default()));
    let grey = image::ImageBuffer::<image::Luma<u16>, _>::from_pixel(32, 32, image::Luma([500_u16]));
    grey.save(scratch.path().join("a.png")).unwrap();
    write(scratch.path(), "a.npy", Array3::from_elem((1, 32, 32), 0.5));
    for (name, white, largest) in [
        ("a.png", "70000", "65535"),
        ("a.dng", "1e12", "65535"),
        ("a.png", "1e300", "65535"),
        ("a.npy", "1e300", "floats"),
    ] {
        for command in [&["fuse", "-o", "out.exr"][..], &[&["restore"][..], &HOW].concat()] {
            let said =
                fail(scratch.path(), &[command, &[name, "--white", white, "--bayer", "rggb"]].concat(), 1);
            assert!(said.contains("--white") && said.contains(largest), "{said}");
            assert!(!scratch.path().join("out.exr").exists());
        }
    }
}

#[test]
fn floats_of_other_units_than_white_are_noticed() {
    let scratch = scratch();
    write(scratch.path(), "shares.npy", Array3::from_shape_fn((1, 32, 32), |(_, y, _)| 0.03 * y as f32));
    write(
        scratch.path(),
        "counts.npy",
        Array3::from_shape_fn((1, 32, 32), |(_, y, _)| 1000.0 + 400.0 * y as f32),
    );
    for command in
        [&["fuse", "-o", "out.exr", "--overwrite"][..], &[&["restore", "--overwrite"][..], &HOW].concat()]
    {
        let args = |name, white: &[&'static str]| [command, &[name, "--bayer", "rggb"], white].concat();
        let said = warned(scratch.path(), &args("shares.npy", &["--white", "16383"]));
        assert!(
            said.contains("the largest value of all pictures is 0.93, below 1 % of --white 16383"),
            "{said}"
        );
        let said = fail(scratch.path(), &args("counts.npy", &[]), 1);
        assert!(said.contains("100 % of the values lie above 1") && said.contains("--white"), "{said}");
        let said = warned(scratch.path(), &args("counts.npy", &["--white", "16383"]));
        assert!(!said.contains("--white"), "{said}");
        assert!(!warned(scratch.path(), &args("shares.npy", &[])).contains("--white"));
    }
}

#[test]
fn restoring_what_is_mostly_saturated_says_so_as_fusing_does() {
    let scratch = scratch();
    let half =
        |share: usize| Array3::from_shape_fn((1, 32, 32), |(_, y, _)| if y < share { 1.0 } else { 0.3 });
    write(scratch.path(), "half.npy", half(16));
    write(scratch.path(), "lamp.npy", half(2));
    let how = ["--method", "wiener", "--psf", "psf.exr", "-o", "out.exr", "--overwrite", "--bayer", "rggb"];
    let said = warned(scratch.path(), &[&["restore", "half.npy"][..], &how].concat());
    assert!(
        said.contains("50 % of the values are saturated and brighter than written; check --white"),
        "{said}"
    );
    let said = warned(scratch.path(), &[&["restore", "lamp.npy"][..], &how].concat());
    assert!(!said.contains("saturated"), "{said}");
}

/// A camera whose colours are XYZ, with red and blue halved: the white of D65 is X / 2, Y, Z / 2 = 0.4752, 1, 0.5444, and grey
/// photosites of equal counts get the gains 2.104, 1, 1.837.
#[test]
fn a_negative_without_white_balance_is_taken_as_under_daylight_and_says_so() {
    let scratch = scratch();
    let matrix = Some([500, 0, 0, 0, 1000, 0, 0, 0, 500]);
    write_negative(&scratch.path().join("matrix.dng"), 0.4, Said { color_matrix: matrix, ..Said::default() });
    write_negative(&scratch.path().join("none.dng"), 0.4, Said::default());
    for command in ["fuse", "restore"] {
        let how = if command == "fuse" { &["-o", "out.exr"][..] } else { &HOW };
        let run =
            |more: &[&str]| warned(scratch.path(), &[&[command, "--overwrite"][..], how, more].concat());
        let said = run(&["matrix.dng"]);
        assert!(said.contains("matrix.dng says no white balance; taken as under daylight"), "{said}");
        let (x, y) = (0.3127, 0.3290);
        let expected = [2.0 * y / x, 1.0, 2.0 * y / (1.0 - x - y)].map(|gain| 0.4 * gain);
        let planes = io::read_pixels(&scratch.path().join("out.exr")).unwrap().planes;
        for (plane, expected) in planes.outer_iter().zip(expected) {
            // Half a step of the photosites' 959.
            assert!(
                (f64::from(plane[[16, 16]]) / expected - 1.0).abs() < 0.5 / 383.0,
                "{} for {expected}",
                plane[[16, 16]]
            );
        }
        let said = run(&["none.dng"]);
        assert!(
            said.contains("light stays in the camera's own colours: give --white-balance R,G,B"),
            "{said}"
        );
        assert!(!run(&["none.dng", "--white-balance", "2,1,1.6"]).contains("white balance"));
    }
}

#[test]
fn a_negative_of_a_black_night_is_fused() {
    let scratch = scratch();
    write_negative(&scratch.path().join("night.dng"), 0.0, grey(Said::default()));
    succeed(scratch.path(), &["fuse", "night.dng", "-o", "out.exr"]);
    let planes = io::read_pixels(&scratch.path().join("out.exr")).unwrap().planes;
    assert!(planes.iter().all(|value| value.abs() < 1e-5));
}

#[test]
fn dark_frames_of_another_sensitivity_are_named_by_time_and_sensitivity() {
    let scratch = scratch();
    let said = |iso| grey(Said { seconds: Some((1, 60)), iso: Some(iso), ..Said::default() });
    write_negative(&scratch.path().join("light.dng"), 0.5, said(400));
    write_negative(&scratch.path().join("dark.dng"), 0.01, said(100));
    write_negative(&scratch.path().join("right.dng"), 0.01, said(400));
    let said = fail(scratch.path(), &["fuse", "light.dng", "--dark", "dark.dng", "-o", "out.exr"], 1);
    assert!(
        said.contains("no dark frame fits picture 1 of 1/60 s at ISO 400: they have 1/60 s at ISO 100"),
        "{said}"
    );
    succeed(scratch.path(), &["fuse", "light.dng", "--dark", "right.dng", "-o", "out.exr"]);
}

#[test]
fn times_that_are_rounded_differently_are_one_time() {
    let scratch = scratch();
    for (name, seconds) in [("a.dng", (1, 60)), ("b.dng", (167, 10000)), ("c.dng", (1, 60))] {
        write_negative(
            &scratch.path().join(name),
            0.5,
            grey(Said { seconds: Some(seconds), ..Said::default() }),
        );
    }
    let said = succeed(scratch.path(), &["fuse", "a.dng", "b.dng", "c.dng", "-o", "out.exr"]);
    assert!(said.contains("100.00 % from 1 (mean of 3)"), "{said}");
    let said =
        fail(scratch.path(), &["fuse", "a.dng", "b.dng", "--exposures", "1,1e-30", "-o", "refused.exr"], 1);
    assert!(said.contains("further apart than the exposures of any bracket"), "{said}");
}

#[test]
fn sensitivities_count_though_dark_frames_do_not_say_theirs_and_are_asked_for_where_some_pictures_do_not() {
    let scratch = scratch();
    let seconds = Some((1, 60));
    for (name, light, iso) in [
        ("a.dng", 0.8, Some(400)),
        ("b.dng", 0.2, Some(100)),
        ("c.dng", 0.2, None),
        ("dark.dng", 0.001, None),
    ] {
        let said = grey(Said { seconds, iso, ..Said::default() });
        write_negative(&scratch.path().join(name), light, said);
    }
    let said = succeed(scratch.path(), &["fuse", "a.dng", "b.dng", "--dark", "dark.dng", "-o", "out.exr"]);
    assert!(said.contains("from 1,") && said.contains("from 1/4"), "{said}");
    for command in [&["fuse", "-o", "refused.exr"][..], &[&["restore", "--bracket"][..], &HOW].concat()] {
        let said = fail(scratch.path(), &[command, &["--overwrite", "a.dng", "b.dng", "c.dng"]].concat(), 1);
        assert!(said.contains("not every picture says its ISO") && said.contains("--exposures"), "{said}");
    }
}

//! `udc crop` and `udc codes`.

use std::path::Path;

use ndarray::{Array3, Axis};
use udc::core::image::{Linear, LinearImage};
use udc::core::psf::Psf;
use udc::io::{self, WriteOptions};

use super::common::{fail, succeed, udc};

fn write_panorama(path: &Path, height: usize, width: usize) {
    let planes =
        Array3::from_shape_fn((3, height, width), |(c, y, x)| 0.1 + (c + y * 3 + x * 7) as f32 % 5.0);
    io::write_image(path, &LinearImage::from_planes(planes).unwrap(), &WriteOptions::default()).unwrap();
}

/// A core with one long arm, of the given length.
fn write_psf(path: &Path, arm: f32) {
    let energy = Array3::from_shape_fn((3, 31, 31), |(_, y, x)| {
        let (dy, dx) = (y as f32 - 15.0, x as f32 - 15.0);
        (-(dy * dy + dx * dx) / 3.0).exp() + 0.2 * (-dy * dy / 4.0 - dx.abs() / arm).exp()
    });
    io::write_psf(path, &Psf::from_energy(energy).unwrap(), &WriteOptions::default()).unwrap();
}

#[test]
fn cuts_the_views_that_are_asked_for_and_says_where_they_look() {
    let scratch = tempfile::tempdir().unwrap();
    write_panorama(&scratch.path().join("street.exr"), 32, 64);
    let arguments =
        ["crop", "street.exr", "-o", "views", "--size", "24", "--yaw=-90,45", "--pitch=10", "--fov", "70"];
    let said = succeed(scratch.path(), &arguments);
    assert!(said.contains("2 views of 1 panoramas, 24 × 24"), "{said}");
    let pixels = io::read_pixels(&scratch.path().join("views/street_02.exr")).unwrap();
    assert_eq!(pixels.planes.dim(), (3, 24, 24));
    let provenance = pixels.provenance.unwrap();
    assert_eq!(provenance.command, "crop");
    assert_eq!(provenance.config["panorama"], "street");
    assert_eq!(provenance.config["yaw_deg"], 45.0);
    assert_eq!(
        (&provenance.config["pitch_deg"], &provenance.config["fov_deg"]),
        (&10.0.into(), &70.0.into())
    );
    assert!(fail(scratch.path(), &arguments, 1).contains("--overwrite"));
    let sizes = io::read_image::<Linear>(&scratch.path().join("views/street_01.exr")).unwrap();
    assert!(sizes.max() > 0.0);
}

#[test]
fn spreads_eighteen_views_over_each_panorama_of_a_folder() {
    let scratch = tempfile::tempdir().unwrap();
    std::fs::create_dir(scratch.path().join("panoramas")).unwrap();
    write_panorama(&scratch.path().join("panoramas/a.exr"), 16, 32);
    write_panorama(&scratch.path().join("panoramas/b.npy"), 16, 32);
    succeed(
        scratch.path(),
        &["crop", "panoramas", "-o", "views", "--size", "8", "--format", "npy", "--half"],
    );
    for name in ["a_01.npy", "a_18.npy", "b_01.npy", "b_18.npy"] {
        assert!(scratch.path().join("views").join(name).is_file(), "{name} is missing");
    }
    assert_eq!(std::fs::read_dir(scratch.path().join("views")).unwrap().count(), 36);
}

#[test]
fn refuses_a_picture_that_is_no_panorama() {
    let scratch = tempfile::tempdir().unwrap();
    write_panorama(&scratch.path().join("square.exr"), 32, 32);
    let said = fail(scratch.path(), &["crop", "square.exr", "-o", "views"], 1);
    assert!(said.contains("square.exr") && said.contains("twice as wide as high"), "{said}");
    assert!(!scratch.path().join("views").exists());
    let said = fail(scratch.path(), &["crop", "square.exr", "-o", "views", "--fov", "200"], 1);
    assert!(said.contains("fov") && said.contains("170"), "{said}");
}

#[test]
fn makes_a_bank_and_finds_the_code_of_its_kernels_again() {
    let scratch = tempfile::tempdir().unwrap();
    write_psf(&scratch.path().join("psf.exr"), 5.0);
    let said = succeed(
        scratch.path(),
        &[
            "codes",
            "psf.exr",
            "-o",
            "bank.safetensors",
            "--angles=-6:6:3",
            "--dim",
            "3",
            "--npy",
            "published",
        ],
    );
    assert!(said.contains("5 kernels of 31 × 31, codes of 3 numbers"), "{said}");
    let bank = io::read_bank(&scratch.path().join("bank.safetensors")).unwrap();
    assert_eq!(bank.angles_deg.as_deref(), Some(&[-6.0, -3.0, 0.0, 3.0, 6.0][..]));

    let said = succeed(
        scratch.path(),
        &["codes", "--project", "bank.safetensors", "published/bank_psf_2.npy", "-o", "code.npy"],
    );
    assert!(said.contains("nearest   r-03, 0.000 % away"), "{said}");
    let found = io::read_array(&scratch.path().join("code.npy")).unwrap();
    let expected = io::read_array(&scratch.path().join("published/bank_code_2.npy")).unwrap();
    let largest = expected.iter().fold(0f64, |m, v| m.max(v.abs()));
    assert!(
        found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-5 * largest),
        "{found} for {expected}"
    );
}

#[test]
fn takes_several_psfs_as_the_set() {
    let scratch = tempfile::tempdir().unwrap();
    for (name, arm) in [("a.exr", 2.0), ("b.exr", 4.0), ("c.exr", 8.0)] {
        write_psf(&scratch.path().join(name), arm);
    }
    succeed(scratch.path(), &["codes", "a.exr", "b.exr", "c.exr", "-o", "bank.safetensors", "--dim", "2"]);
    let bank = io::read_bank(&scratch.path().join("bank.safetensors")).unwrap();
    assert_eq!((bank.len(), bank.angles_deg.is_none()), (3, true));
    let said =
        fail(scratch.path(), &["codes", "a.exr", "b.exr", "-o", "x.safetensors", "--angles", "0,3"], 1);
    assert!(said.contains("--angles"), "{said}");
    let said = fail(scratch.path(), &["codes", "a.exr", "b.exr", "c.exr", "-o", "x.safetensors"], 1);
    assert!(said.contains("allow 1 to 2"), "{said}");
    assert!(!scratch.path().join("x.safetensors").exists());
}

#[test]
fn warns_of_a_psf_that_the_bank_cannot_describe() {
    let scratch = tempfile::tempdir().unwrap();
    write_psf(&scratch.path().join("psf.exr"), 6.0);
    write_psf(&scratch.path().join("other.exr"), 1.0);
    succeed(scratch.path(), &["codes", "psf.exr", "-o", "bank.safetensors"]);
    let output = udc(scratch.path(), &["codes", "--project", "bank.safetensors", "other.exr"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && stderr.contains("cannot describe other.exr"), "{stderr}");
    let output = udc(scratch.path(), &["codes", "--project", "bank.safetensors", "psf.exr"]);
    assert!(output.stderr.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn explains_angles_that_make_no_set() {
    let scratch = tempfile::tempdir().unwrap();
    write_psf(&scratch.path().join("psf.exr"), 6.0);
    let said = fail(scratch.path(), &["codes", "psf.exr", "-o", "bank.safetensors", "--angles=-12:12"], 2);
    assert!(said.contains("start:stop:step"), "{said}");
    let said = fail(scratch.path(), &["codes", "psf.exr", "-o", "bank.exr"], 1);
    assert!(said.contains("*.safetensors"), "{said}");
}

/// The bytes of a bank must not depend on the number of threads.
#[test]
fn makes_the_same_bank_on_one_thread_and_on_two() {
    let scratch = tempfile::tempdir().unwrap();
    let energy = Array3::from_shape_fn((3, 200, 201), |(c, y, x)| ((c + y * 13 + x * 7) % 31) as f32);
    let psf = Psf::from_energy(energy).unwrap();
    assert_eq!(psf.planes().len_of(Axis(1)), 200);
    io::write_psf(&scratch.path().join("psf.exr"), &psf, &WriteOptions::default()).unwrap();
    for threads in ["1", "2"] {
        succeed(
            scratch.path(),
            &["codes", "psf.exr", "--threads", threads, "-o", &format!("bank-{threads}.safetensors")],
        );
    }
    let bytes = |threads| std::fs::read(scratch.path().join(format!("bank-{threads}.safetensors"))).unwrap();
    assert_eq!(bytes(1), bytes(2));
}

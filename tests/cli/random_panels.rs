//! The command line: panels drawn at random, and PSFs with a measurement's errors.

use std::fs;

use tempfile::tempdir;
use udc::io::{read_provenance, read_psf};
use udc::psf::{DisplayConfig, random_display};

use crate::common::{fail, succeed};

#[test]
fn a_random_panel_is_kept_and_simulates_to_the_same_psf() {
    let folder = tempdir().unwrap();
    let random = ["psf", "--random", "3", "--size", "33", "-o", "a.exr", "--display-out", "panel.toml"];
    let said = succeed(folder.path(), &random);
    assert!(said.contains("a.exr: PSF of 33 × 33") && said.contains("panel.toml"), "{said}");
    succeed(folder.path(), &["psf", "--display", "panel.toml", "-o", "b.exr"]);
    let psf = |name: &str| read_psf(&folder.path().join(name)).unwrap();
    assert_eq!(psf("a.exr"), psf("b.exr"));
    let mut origin = read_provenance(&folder.path().join("a.exr")).unwrap().unwrap().config;
    assert_eq!(origin.as_object_mut().unwrap().remove("random"), Some(3.into()));
    let mut expected = random_display(3);
    expected.sensor.size_px = 33;
    assert_eq!(serde_json::from_value::<DisplayConfig>(origin).unwrap(), expected);
}

#[test]
fn a_psf_is_given_the_errors_of_a_measurement() {
    let folder = tempdir().unwrap();
    succeed(folder.path(), &["psf", "--random", "3", "--size", "33", "-o", "true.npy"]);
    let with = |name: &str, flags: &[&str]| {
        succeed(folder.path(), &[&["psf", "--from", "true.npy", "-o", name], flags].concat());
        read_psf(&folder.path().join(name)).unwrap()
    };
    let flags = ["--turn", "-0.3", "--scale=-0.005", "--defocus", "0.4", "--noise", "1e-4", "--reach", "25"];
    let measured = with("a.exr", &flags);
    assert_eq!(measured.height(), 25);
    assert_eq!(measured, with("b.exr", &flags));
    assert_ne!(measured, with("c.exr", &[&flags[..], &["--seed", "1"]].concat()));
    let origin = read_provenance(&folder.path().join("a.exr")).unwrap().unwrap().config;
    assert_eq!(origin["from"], "true.npy");
    assert_eq!(origin["errors"]["turn-deg"], -0.3);
}

#[test]
fn refuses_two_sources_of_a_psf_and_flags_of_another() {
    let folder = tempdir().unwrap();
    fs::write(folder.path().join("panel.toml"), "[sensor]\nsize-px = 9\n").unwrap();
    for (args, said) in [
        (&["psf", "--display", "panel.toml", "--random", "3", "-o", "a.exr"][..], "cannot be used with"),
        (&["psf", "-o", "a.exr"], "--random"),
        (&["psf", "--randon", "3", "-o", "a.exr"], "--random"),
        (&["psf", "--display", "panel.toml", "--display-out", "b.toml", "-o", "a.exr"], "--display"),
        (&["psf", "--from", "panel.npy", "-o", "a.exr"], "--turn"),
        (&["psf", "--random", "3", "--recenter", "-o", "a.exr"], "--from"),
    ] {
        let message = fail(folder.path(), args, 2);
        assert!(message.contains(said), "{args:?}: {message}");
    }
    let message = fail(folder.path(), &["psf", "--random", "3", "--noise", "2", "-o", "a.exr"], 1);
    assert!(message.contains("noise") && !folder.path().join("a.exr").exists(), "{message}");
}

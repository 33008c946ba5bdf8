//! What `udc restore` tells of a PSF that is not its capture's.

use std::path::Path;

use ndarray::s;
use udc::core::psf::Psf;
use udc::io::{self, WriteOptions};

use super::common::{succeed, udc};

#[test]
fn a_psf_whose_colours_are_exchanged_is_told_of() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let panel = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/display/pentile.toml");
    succeed(folder, &["psf", "--display", panel.to_str().unwrap(), "--size", "65", "-o", "psf.exr"]);
    succeed(
        folder,
        &["scenes", "-o", "scenes", "--count", "1", "--seed", "3", "--size", "256", "--margin", "40"],
    );
    let synth = ["synth", "scenes", "--psf", "psf.exr", "--noise", "sensor", "--split", "test", "-o", "data"];
    succeed(folder, &synth);
    let capture = "data/degraded/r+00/indoor-s3-00000.exr";
    let psf = io::read_psf(&folder.join("psf.exr")).unwrap();
    let exchanged = Psf::from_energy(psf.planes().slice(s![..;-1, .., ..]).to_owned()).unwrap();
    io::write_psf(&folder.join("exchanged.exr"), &exchanged, &WriteOptions::default()).unwrap();

    let restored = |psf: &str| {
        let flags = ["restore", capture, "--psf", psf, "--method", "wiener", "-o", "out.exr", "--overwrite"];
        let output = udc(folder, &flags);
        assert!(output.status.success());
        let events = udc(folder, &[&flags[..], &["--json"]].concat()).stdout;
        (String::from_utf8(output.stderr).unwrap(), String::from_utf8(events).unwrap())
    };
    let (said, events) = restored("psf.exr");
    assert!(!said.contains("does not look like") && events.contains("\"unlike\":null"), "{said}{events}");
    let (said, events) = restored("exchanged.exr");
    assert!(said.contains("the capture does not look like one behind this PSF: "), "{said}");
    assert!(events.contains("\"looks-like\":"), "{events}");
}

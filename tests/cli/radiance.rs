//! What the header of a Radiance HDR file says of its light.

use std::path::Path;

use udc::core::image::Linear;
use udc::core::primaries::Primaries;
use udc::io;

use super::common::{fail, succeed};

/// Two pixels of light 0.5 in each channel, as they are stored.
fn write(path: &Path, lines: &str) {
    let header = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n{lines}\n-Y 1 +X 2\n");
    let pixel = [128, 128, 128, 128];
    std::fs::write(path, [header.as_bytes(), &pixel, &pixel].concat()).unwrap();
}

#[test]
fn light_is_the_pixels_divided_by_what_they_were_multiplied_by() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write(&folder.join("plain.hdr"), "");
    write(&folder.join("exposed.hdr"), "EXPOSURE=4\nEXPOSURE=0.5\nCOLORCORR=1 2 4\n");
    let light = |name: &str| {
        succeed(folder, &["convert", name, "a.exr", "--overwrite"]);
        let image = io::read_image::<Linear>(&folder.join("a.exr")).unwrap();
        [0, 1, 2].map(|channel| image.planes()[[channel, 0, 1]])
    };
    assert_eq!(light("plain.hdr"), [0.5; 3]);
    assert_eq!(light("exposed.hdr"), [0.25, 0.125, 0.0625]);
    let said = succeed(folder, &["info", "exposed.hdr"]);
    assert!(said.contains("EXPOSURE line: 4") && said.contains("COLORCORR line: 1 2 4"), "{said}");
    // What is written has no such lines, and the same light.
    succeed(folder, &["convert", "exposed.hdr", "again.hdr"]);
    assert_eq!(light("again.hdr"), [0.25, 0.125, 0.0625]);
}

#[test]
fn other_primaries_are_kept_and_damaged_lines_named() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write(&folder.join("wide.hdr"), "PRIMARIES=0.708 0.292 0.17 0.797 0.131 0.046 0.3127 0.329\n");
    succeed(folder, &["convert", "wide.hdr", "wide.exr"]);
    let info = io::read_capture_info(&folder.join("wide.exr")).unwrap().unwrap();
    assert!(info.primaries.unwrap().is_near(&Primaries::BT2020));
    assert!(succeed(folder, &["info", "wide.hdr"]).contains("BT.2020"));
    // As many panoramas say that they do not tell them.
    write(&folder.join("untold.hdr"), "PRIMARIES=0 0 0 0 0 0 0 0\n");
    succeed(folder, &["convert", "untold.hdr", "untold.exr"]);
    assert!(
        io::read_capture_info(&folder.join("untold.exr"))
            .unwrap()
            .is_none_or(|info| info.primaries.is_none())
    );
    for line in ["EXPOSURE=bright", "EXPOSURE=0", "COLORCORR=1 2", "PRIMARIES=1 2 3"] {
        write(&folder.join("damaged.hdr"), &format!("{line}\n"));
        let said = fail(folder, &["convert", "damaged.hdr", "b.exr"], 1);
        let (key, _) = line.split_once('=').unwrap();
        assert!(said.contains("damaged.hdr") && said.contains(key), "{line}: {said}");
    }
}

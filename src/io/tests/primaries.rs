//! The primaries of files, found without their pixels as reading these finds them.

use super::*;
use crate::core::capture::CaptureInfo;
use crate::core::primaries::{ColorSpace, Primaries};

fn check(path: &Path, expected: Primaries) {
    let found = read_primaries(path).unwrap().unwrap();
    assert!(found.is_near(&expected), "{}: {found:?}", path.display());
    let read = read_pixels(path).unwrap().capture.and_then(|capture| capture.primaries);
    assert_eq!(read, Some(found), "{}", path.display());
}

#[test]
fn primaries_are_found_by_what_stands_before_the_pixels() {
    let folder = tempfile::tempdir().unwrap();
    let planes = Array3::from_elem((3, 8, 8), 0.5);
    for name in ["a.png", "a.jpg", "a.tif"] {
        let path = folder.path().join(name);
        let options = PixelOptions { color_space: Some(ColorSpace::DisplayP3), ..PixelOptions::default() };
        write_pixels(&path, &Pixels::of_planes(planes.clone()), options).unwrap();
        check(&path, Primaries::DISPLAY_P3);
    }
    let path = folder.path().join("a.exr");
    let capture = Some(CaptureInfo::of_primaries(Primaries::BT2020));
    let image = LinearImage::from_planes(planes).unwrap();
    write_image(&path, &image, &WriteOptions { capture, ..WriteOptions::default() }).unwrap();
    check(&path, Primaries::BT2020);
    let path = folder.path().join("a.hdr");
    let header = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nPRIMARIES=0.708 0.292 0.17 0.797 0.131 0.046 0.3127 0.329\n\n-Y 1 +X 1\n";
    std::fs::write(&path, [header.as_bytes(), &[128, 128, 128, 129]].concat()).unwrap();
    check(&path, Primaries::BT2020);
}

#[test]
fn files_that_say_nothing_have_no_primaries() {
    let folder = tempfile::tempdir().unwrap();
    let image = LinearImage::from_planes(Array3::from_elem((3, 8, 8), 0.5)).unwrap();
    for name in ["a.exr", "a.npy", "a.hdr"] {
        let path = folder.path().join(name);
        write_image(&path, &image, &WriteOptions::default()).unwrap();
        assert_eq!(read_primaries(&path).unwrap(), None, "{name}");
    }
    assert!(read_primaries(&folder.path().join("absent.exr")).is_err());
}

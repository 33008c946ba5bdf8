//! Files of every format, from this program and from others, whole and damaged.

mod bank;
mod big_tiff;
mod damage;
mod exr;
mod fixtures;
mod layers;
mod outputs;
mod primaries;
mod size;

use std::path::Path;

use ndarray::{Array3, Axis};

use super::read::decode_image;
use super::*;
use crate::core::error::Result;
use crate::core::image::{Image, Linear, LinearImage, ToneMapped, ToneMappedImage};
use crate::core::provenance::Provenance;

/// Values of many magnitudes, none of them special.
fn scene(height: usize, width: usize) -> LinearImage {
    let planes = Array3::from_shape_fn((3, height, width), |(c, y, x)| {
        let i = (c * height + y) * width + x;
        ((i * 7919) % 1013) as f32 * ((i % 23) as f32 - 12.0).exp2()
    });
    LinearImage::from_planes(planes).unwrap()
}

#[test]
fn float_formats_return_an_image_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    for (height, width) in [(1, 1), (7, 5), (37, 130), (1100, 3)] {
        let image = scene(height, width);
        for name in ["a.exr", "a.npy"] {
            let path = folder.path().join(name);
            write_image(&path, &image, &WriteOptions { overwrite: true, ..Default::default() }).unwrap();
            assert_eq!(read_image::<Linear>(&path).unwrap(), image, "{name} of {height} × {width}");
        }
    }
}

/// Half floats have 11 significant bits and, below 2⁻¹⁴, steps of 2⁻²⁴.
#[test]
fn half_formats_round_to_eleven_bits() {
    let folder = tempfile::tempdir().unwrap();
    let image = scene(37, 130).map_values::<Linear>(|v| v / 64.0);
    for name in ["a.exr", "a.npy"] {
        let path = folder.path().join(name);
        write_image(&path, &image, &WriteOptions { half: true, ..Default::default() }).unwrap();
        let read = read_image::<Linear>(&path).unwrap();
        for (a, b) in image.as_slice().iter().zip(read.as_slice()) {
            assert!((a - b).abs() <= (a * 2f32.powi(-11)).max(2f32.powi(-25)), "{name}: {a} became {b}");
        }
    }
}

/// The shared exponent gives 8 bits to the largest channel of a pixel.
#[test]
fn radiance_rounds_to_eight_bits_of_the_brightest_channel() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.hdr");
    let image = scene(20, 30);
    write_image(&path, &image, &WriteOptions::default()).unwrap();
    let read = read_image::<Linear>(&path).unwrap();
    for ((c, y, x), value) in image.planes().indexed_iter() {
        let brightest = (0..3).map(|c| image.planes()[[c, y, x]]).fold(0.0, f32::max);
        let found = read.planes()[[c, y, x]];
        assert!((found - value).abs() <= brightest / 128.0, "{value} became {found}");
    }
}

#[test]
fn refuses_an_image_of_the_other_domain() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    write_image(&path, &scene(3, 4), &WriteOptions::default()).unwrap();
    let message = read_image::<ToneMapped>(&path).unwrap_err().to_string();
    assert!(message.contains("holds linear values") && message.contains("`udc tonemap`"), "{message}");
}

#[test]
fn refuses_values_that_are_not_finite() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    write_pixels(&path, &Pixels::of_planes(Array3::from_elem((3, 4, 4), f32::NAN)), PixelOptions::default())
        .unwrap();
    assert!(read_image::<Linear>(&path).unwrap_err().to_string().contains("NaN"));
    assert!(read_psf(&path).is_err());
}

#[test]
fn integer_formats_round_to_their_step() {
    let folder = tempfile::tempdir().unwrap();
    let planes = Array3::from_shape_fn((3, 9, 11), |(c, y, x)| (c * 99 + y * 11 + x) as f32 / 296.0);
    let image = ToneMappedImage::from_planes(planes).unwrap();
    for name in ["a.png", "a.tif"] {
        let path = folder.path().join(name);
        write_image(&path, &image, &WriteOptions::default()).unwrap();
        let (read, _) = read_image_told::<ToneMapped>(&path, Some(DomainTag::ToneMapped)).unwrap();
        for (a, b) in image.as_slice().iter().zip(read.as_slice()) {
            assert!((a - b).abs() <= 0.5 / 65535.0 + f32::EPSILON, "{name}: {a} {b}");
        }
    }
}

#[test]
fn a_file_is_read_by_its_contents_not_by_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let image = scene(5, 6);
    write_image(&path, &image, &WriteOptions::default()).unwrap();
    let renamed = folder.path().join("a.png");
    std::fs::rename(&path, &renamed).unwrap();
    assert_eq!(read_image::<Linear>(&renamed).unwrap(), image);
}

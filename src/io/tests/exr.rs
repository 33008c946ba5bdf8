//! OpenEXR files of unusual layouts, made with the same crate's own writer.

use std::io::Cursor;

use ::exr::math::RoundingMode;
use ::exr::prelude::{
    AnyChannel, AnyChannels, Encoding as ExrEncoding, FlatSamples, Image as ExrImage, ImageAttributes,
    IntegerBounds, Layer, LayerAttributes, Levels, WritableImage,
};

use super::*;
use crate::core::capture::CaptureInfo;
use crate::core::image::LinearImage;
use crate::core::orientation::Orientation;

const SIDE: usize = 20;

/// The value of a channel at full resolution; lower resolutions hold −1.
fn value(channel: usize, i: usize) -> f32 {
    (channel * 1000 + i) as f32
}

fn channels(prefix: &str, mip_maps: bool) -> AnyChannels<Levels<FlatSamples>> {
    let channel = |(index, name): (usize, &str)| {
        let full = FlatSamples::F32((0..SIDE * SIDE).map(|i| value(index, i)).collect());
        let samples = if mip_maps {
            let small = [10, 5, 2, 1].map(|side| FlatSamples::F32(vec![-1.0; side * side]));
            let level_data = std::iter::once(full).chain(small).collect();
            Levels::Mip { rounding_mode: RoundingMode::Down, level_data }
        } else {
            Levels::Singular(full)
        };
        AnyChannel::new(format!("{prefix}{name}").as_str(), samples)
    };
    AnyChannels::sort(["R", "G", "B"].into_iter().enumerate().map(channel).collect())
}

fn file(layers: Vec<(&str, AnyChannels<Levels<FlatSamples>>)>) -> Vec<u8> {
    let window = ImageAttributes::new(IntegerBounds::from_dimensions((SIDE, SIDE)));
    let layers = layers.into_iter().map(|(name, channels)| {
        let encoding = ExrEncoding::FAST_LOSSLESS;
        Layer::new((SIDE, SIDE), LayerAttributes::named(name), encoding, channels)
    });
    let mut file = Cursor::new(Vec::new());
    let image = ExrImage { attributes: window, layer_data: layers.collect::<Vec<_>>().into_iter().collect() };
    let image: ExrImage<::exr::image::Layers<_>> = image;
    image.write().to_buffered(&mut file).unwrap();
    file.into_inner()
}

fn decode(bytes: &[u8]) -> Result<Array3<f32>> {
    decode_image(Path::new("a.exr"), bytes, Format::Exr, None).map(|(pixels, _)| pixels.planes)
}

fn full_resolution() -> Array3<f32> {
    Array3::from_shape_fn((3, SIDE, SIDE), |(c, y, x)| value(c, y * SIDE + x))
}

#[test]
fn mip_maps_give_their_full_resolution() {
    assert_eq!(decode(&file(vec![("a", channels("", true))])).unwrap(), full_resolution());
}

#[test]
fn the_unprefixed_layer_of_several_is_the_image() {
    let mut both = channels("", false);
    both.list.extend(channels("diffuse.", false).list);
    let both = AnyChannels::sort(both.list);
    assert_eq!(decode(&file(vec![("a", both)])).unwrap(), full_resolution());
}

/// Orange light, of which RY and BY are told by the definition of OpenEXR.
#[test]
fn luminance_with_chroma_of_full_size_is_read_in_colour() {
    let rgb = [0.8, 0.4, 0.1];
    let luminance: f32 =
        [0.212_639, 0.715_169, 0.072_192].iter().zip(rgb).map(|(weight, v)| weight * v).sum();
    let values = [
        ("BY", (rgb[2] - luminance) / luminance),
        ("RY", (rgb[0] - luminance) / luminance),
        ("Y", luminance),
    ];
    let channel = |(name, value): (&str, f32)| {
        AnyChannel::new(name, Levels::Singular(FlatSamples::F32(vec![value; SIDE * SIDE])))
    };
    let bytes = file(vec![("a", AnyChannels::sort(values.into_iter().map(channel).collect()))]);
    for name in ["a.exr", "a.exr:Y", "a.exr:a"] {
        let (pixels, _) = decode_image(Path::new(name), &bytes, Format::Exr, None).unwrap();
        assert_eq!(pixels.planes.dim(), (3, SIDE, SIDE), "{name}");
        for (found, expected) in pixels.planes.slice(ndarray::s![.., 3, 4]).iter().zip(rgb) {
            assert!((found - expected).abs() < 1e-4, "{name}: {found} instead of {expected}");
        }
    }
}

#[test]
fn several_coloured_parts_are_refused_by_name() {
    let message = decode(&file(vec![("day", channels("", false)), ("night", channels("", false))]))
        .unwrap_err()
        .to_string();
    assert!(message.contains("day, night"), "{message}");
}

/// The bytes of a file of ours.
fn encode(contents: &Contents<'_>) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    crate::io::exr::Encoder::new(contents, false).unwrap().write(&mut file).unwrap();
    file.into_inner()
}

/// A file of ours with its one `Y` channel declared at half resolution.
#[test]
fn sub_sampled_channels_are_refused_with_a_reason() {
    let grey = Array3::zeros((1, 8, 8));
    let contents = Contents {
        planes: grey.view(),
        domain: None,
        exposure_s: None,
        iso: None,
        provenance: None,
        capture: None,
    };
    let mut bytes = encode(&contents);
    let list = bytes.windows(7).position(|window| window == b"chlist\0").unwrap();
    // The kind is followed by the size (4), the name `Y` and its zero (2), type (4), flags (4), then the steps.
    let steps = list + 7 + 4 + 2 + 4 + 4;
    bytes[steps] = 2;
    bytes[steps + 4] = 2;
    let message = decode(&bytes).unwrap_err().to_string();
    assert!(message.contains("luminance/chroma"), "{message}");
}

#[test]
fn deep_images_are_refused_with_a_reason() {
    let mut bytes = file(vec![("a", channels("", false))]);
    // Of the flags after magic and version, the deep bit instead of the tiled one.
    bytes[5] = 0x08;
    let message = decode(&bytes).unwrap_err().to_string();
    assert!(message.contains("deep"), "{message}");
}

#[test]
fn a_header_that_asks_for_terabytes_is_refused() {
    let mut bytes = file(vec![("a", channels("", false))]);
    let window = bytes.windows(11).position(|window| window == b"dataWindow\0").unwrap();
    // Name, kind `box2i`, size, then the four corners.
    let corners = window + 11 + 6 + 4;
    bytes[corners + 8..corners + 12].copy_from_slice(&900_000_000_i32.to_le_bytes());
    bytes[corners + 12..corners + 16].copy_from_slice(&900_000_000_i32.to_le_bytes());
    let message = decode(&bytes).unwrap_err().to_string();
    assert!(message.contains("limit"), "{message}");
}

#[test]
fn half_floats_refuse_what_would_become_infinite() {
    let folder = tempfile::tempdir().unwrap();
    let image = LinearImage::from_planes(Array3::from_elem((3, 2, 2), 70_000.0)).unwrap();
    for name in ["a.exr", "a.npy"] {
        let path = folder.path().join(name);
        let options = WriteOptions { half: true, ..WriteOptions::default() };
        let message = write_image(&path, &image, &options).unwrap_err().to_string();
        assert!(message.contains("65504") && message.contains("70000"), "{message}");
        assert!(!path.exists());
    }
}

#[test]
fn domain_exposure_provenance_and_capture_travel_with_the_image() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let provenance = Provenance::new("fuse", &serde_json::json!({"input": "Außenaufnahme №1.exr"}));
    let capture = CaptureInfo {
        saturation: Some([1.9, 1.0, 1.6]),
        orientation: Orientation::from_exif(8),
        ..CaptureInfo::default()
    };
    let pixels = Pixels {
        domain: Some(DomainTag::ToneMapped),
        exposure_s: Some(0.03125),
        iso: Some(400.0),
        provenance: Some(provenance),
        capture: Some(capture),
        ..Pixels::of_planes(Array3::zeros((3, 4, 5)))
    };
    write_pixels(&path, &pixels, PixelOptions::default()).unwrap();
    let read = read_pixels(&path).unwrap();
    assert_eq!(
        (read.domain, read.exposure_s, read.iso, &read.provenance, &read.capture),
        (pixels.domain, pixels.exposure_s, pixels.iso, &pixels.provenance, &pixels.capture)
    );
    assert_eq!(
        (read_provenance(&path).unwrap(), read_capture_info(&path).unwrap()),
        (read.provenance, read.capture)
    );
    // Its attributes are in one order, whatever order hash maps have.
    let bytes = std::fs::read(&path).unwrap();
    let overwrite = PixelOptions { overwrite: true, ..PixelOptions::default() };
    for _ in 0..20 {
        write_pixels(&path, &pixels, overwrite).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), bytes);
    }
}

/// A flat image shrinks; random mantissas do not, and reading them must not depend on it.
#[test]
fn compresses_only_what_shrinks() {
    let bytes = |planes: &Array3<f32>| {
        let contents = Contents {
            planes: planes.view(),
            domain: None,
            exposure_s: None,
            iso: None,
            provenance: None,
            capture: None,
        };
        encode(&contents)
    };
    let flat = Array3::from_elem((3, 64, 64), 0.25);
    assert!(bytes(&flat).len() < 64 * 64 * 3);
    let mut rng = crate::core::rng::stream(1, "mantissas");
    let noise = Array3::from_shape_simple_fn((3, 64, 64), || rand::RngExt::random::<f32>(&mut rng));
    let bytes = bytes(&noise);
    assert!(bytes.len() >= 64 * 64 * 3 * 4);
    assert_eq!(decode(&bytes).unwrap(), noise);
}

/// Attributes are kept in hash maps whose order differs from one to the next, blocks are encoded in parallel.
#[test]
fn the_same_image_gives_the_same_bytes_on_any_number_of_threads() {
    let planes = Array3::from_shape_fn((3, 500, 40), |(c, y, x)| ((c + y * x) % 17) as f32);
    let provenance = Provenance::new("synth", &serde_json::json!({"seed": 1}));
    let capture = CaptureInfo { saturation: Some([1.9, 1.0, 1.6]), ..CaptureInfo::default() };
    let contents = Contents {
        planes: planes.view(),
        domain: Some(DomainTag::Linear),
        exposure_s: Some(1.0),
        iso: None,
        provenance: Some(&provenance),
        capture: Some(&capture),
    };
    let on_threads = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| encode(&contents))
    };
    let first = on_threads(1);
    for threads in [1, 2, 3, 4] {
        assert!(on_threads(threads) == first, "{threads} threads");
    }
}

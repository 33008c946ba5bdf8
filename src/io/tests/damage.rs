//! Damages files of every format in many places: each must be read or refused, and never end the program.

use std::io::Cursor;
use std::path::Path;

use ::exr::image::Blocks;
use ::exr::prelude::{
    AnyChannel, AnyChannels, Compression, Encoding as ExrEncoding, FlatSamples, Image as ExrImage, Layer,
    LayerAttributes, LineOrder, Vec2, WritableImage, f16,
};
use ::tiff::encoder::colortype::Gray32Float;
use ::tiff::encoder::{Compression as TiffCompression, TiffEncoder};
use ndarray::Array3;
use rand::RngExt;

use super::*;
use crate::core::rng::{Rng, stream};

const WIDTH: usize = 45;
const HEIGHT: usize = 38;

/// Smooth and rough parts, so that every branch of the compressors is used.
fn sample(i: usize) -> f32 {
    let (y, x) = (i / WIDTH, i % WIDTH);
    if x < 20 {
        0.25
    } else if y < 15 {
        x as f32 * 0.1
    } else {
        ((i * 7919) % 101) as f32 * 0.37
    }
}

fn exr_file(compression: Compression, blocks: Blocks, half: bool) -> Vec<u8> {
    let samples = |offset: usize| {
        let values = (0..WIDTH * HEIGHT).map(|i| sample(i + offset));
        if half {
            FlatSamples::F16(values.map(f16::from_f32).collect())
        } else {
            FlatSamples::F32(values.collect())
        }
    };
    let channels = ["R", "G", "B"].map(|name| AnyChannel::new(name, samples(name.len())));
    let encoding = ExrEncoding { compression, blocks, line_order: LineOrder::Increasing };
    let layer = Layer::new(
        (WIDTH, HEIGHT),
        LayerAttributes::default(),
        encoding,
        AnyChannels::sort(channels.into_iter().collect()),
    );
    let mut file = Cursor::new(Vec::new());
    ExrImage::from_layer(layer).write().to_buffered(&mut file).unwrap();
    file.into_inner()
}

fn files() -> Vec<(String, Format, Vec<u8>)> {
    let mut files = Vec::new();
    for compression in [
        Compression::Uncompressed,
        Compression::RLE,
        Compression::ZIP1,
        Compression::ZIP16,
        Compression::PIZ,
        Compression::PXR24,
        Compression::B44,
        Compression::B44A,
        Compression::DWAA(None),
        Compression::DWAB(None),
    ] {
        for blocks in [Blocks::ScanLines, Blocks::Tiles(Vec2(16, 16))] {
            for half in [false, true] {
                let name = format!("EXR of {compression} in {blocks:?}, half {half}");
                files.push((name, Format::Exr, exr_file(compression, blocks, half)));
            }
        }
    }
    let planes = Array3::from_shape_fn((3, HEIGHT, WIDTH), |(c, y, x)| sample(c + y * WIDTH + x) / 40.0);
    let view = planes.view();
    files.push(("NPY".into(), Format::Npy, npy::encode_image(&view, false).unwrap()));
    for format in [Format::Png, Format::Tiff, Format::Jpeg, Format::Hdr] {
        files.push((
            format.name().into(),
            format,
            raster::encode(&view, format, PixelOptions { clip: true, ..Default::default() }, None).unwrap(),
        ));
    }
    let grey = planes.index_axis(Axis(0), 0).iter().copied().collect::<Vec<_>>();
    for (name, compression) in [("strips", TiffCompression::Uncompressed), ("LZW", TiffCompression::Lzw)] {
        let mut file = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut file).unwrap().with_compression(compression);
        encoder.write_image::<Gray32Float>(WIDTH as u32, HEIGHT as u32, &grey).unwrap();
        files.push((format!("TIFF of grey floats, {name}"), Format::Tiff, file.into_inner()));
        let mut file = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new_big(&mut file).unwrap().with_compression(compression);
        encoder.write_image::<Gray32Float>(WIDTH as u32, HEIGHT as u32, &grey).unwrap();
        files.push((format!("BigTIFF of grey floats, {name}"), Format::Tiff, file.into_inner()));
    }
    files
}

/// Truncated, with flipped bits at the start, with bytes replaced anywhere, with a run of zeros.
fn damaged(bytes: &[u8], name: &str) -> Vec<Vec<u8>> {
    let mut rng = stream(1, name);
    let mut variants: Vec<Vec<u8>> = (0..20).map(|part| bytes[..bytes.len() * part / 20].to_vec()).collect();
    let mut damage = |count: usize, change: &mut dyn FnMut(&mut Vec<u8>, &mut Rng)| {
        for _ in 0..count {
            let mut variant = bytes.to_vec();
            change(&mut variant, &mut rng);
            variants.push(variant);
        }
    };
    damage(120, &mut |variant, rng| {
        let position = rng.random_range(0..variant.len().min(500));
        variant[position] ^= 1 << rng.random_range(0..8);
    });
    damage(120, &mut |variant, rng| {
        for _ in 0..rng.random_range(1..4) {
            let position = rng.random_range(0..variant.len());
            variant[position] = [0, 0xff, 0x80, rng.random()][rng.random_range(0..4)];
        }
    });
    damage(20, &mut |variant, rng| {
        let start = rng.random_range(0..variant.len());
        let end = variant.len().min(start + rng.random_range(1..64));
        variant[start..end].fill(0);
    });
    variants
}

/// No assertion on the damaged files: a change of a sample is no damage that a reader could see. What fails
/// the test is a panic, or an allocation that ends the process.
#[test]
fn damaged_images_are_read_or_refused() {
    let path = Path::new("image");
    for (name, format, bytes) in files() {
        decode_image(path, &bytes, format, None).unwrap_or_else(|error| panic!("{name}: {error}"));
        let refused =
            damaged(&bytes, &name).iter().filter(|v| decode_image(path, v, format, None).is_err()).count();
        assert!(refused >= 10, "{name}: only {refused} damaged files were refused");
    }
}

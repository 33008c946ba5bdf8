//! Raw captures: packed mosaics of every format, digital negatives.

use std::fs;
use std::path::Path;

use exr::prelude::{AnyChannel, AnyChannels, FlatSamples, Image as ExrImage, WritableImage};
use image::{ExtendedColorType, ImageFormat};
use ndarray::{Array3, ArrayD};
use udc::core::bayer::BayerPattern;
use udc::core::image::{Linear, LinearImage};
use udc::core::psf::Psf;
use udc::io::{self, Pixels, WriteOptions, inspect_image, inspect_mosaic};

use super::common::{fail, succeed, udc};
use super::tiff::{Field, Tiff};

/// Height and width of the mosaic, and its levels.
const SIDES: [usize; 2] = [48, 56];
const BLACK: u16 = 64;
const WHITE: u16 = 1023;

/// What the photosite at (y, x) of a GRBG sensor reads.
fn photosite(y: usize, x: usize) -> u16 {
    let colour = [0.7, 1.0, 0.5][BayerPattern::Grbg.channel(y, x)];
    let light = colour * (0.4 + 0.3 * (0.21 * y as f64).sin() * (0.17 * x as f64).cos());
    BLACK + (light * f64::from(WHITE - BLACK)).round() as u16
}

/// A scratch folder with the mosaic as `mosaic.npy`, and a PSF.
fn scratch() -> tempfile::TempDir {
    let scratch = tempfile::tempdir().unwrap();
    let mosaic = ArrayD::from_shape_fn(SIDES.to_vec(), |at| f32::from(photosite(at[0], at[1])) / 65535.0);
    io::write_array(&scratch.path().join("mosaic.npy"), &mosaic, false).unwrap();
    let energy = Array3::from_shape_fn((3, 9, 9), |(_, y, x)| {
        let (dy, dx) = (y as f32 - 4.0, x as f32 - 4.0);
        (-(dy * dy + dx * dx) / 2.0).exp()
    });
    io::write_psf(
        &scratch.path().join("psf.exr"),
        &Psf::from_energy(energy).unwrap(),
        &WriteOptions::default(),
    )
    .unwrap();
    scratch
}

/// Samples of the packed mosaic, the four photosites of a place together.
fn packed() -> Vec<u16> {
    let [height, width] = SIDES;
    let place = |index: usize| (2 * (index / (width / 2)), 2 * (index % (width / 2)));
    let sites = |(y, x)| [photosite(y, x), photosite(y, x + 1), photosite(y + 1, x), photosite(y + 1, x + 1)];
    (0..height * width / 4).flat_map(|index| sites(place(index))).collect()
}

fn write_packed_exr(path: &Path, names: [&str; 4]) {
    let channel = |(site, name): (usize, &str)| {
        let samples = packed().iter().skip(site).step_by(4).map(|v| f32::from(*v) / 65535.0).collect();
        AnyChannel::new(name, FlatSamples::F32(samples))
    };
    let channels = AnyChannels::sort(names.into_iter().enumerate().map(channel).collect());
    let [height, width] = SIDES.map(|side| side / 2);
    ExrImage::from_channels((width, height), channels).write().to_file(path).unwrap();
}

fn write_rgba(path: &Path, samples: &[u16], format: ImageFormat) {
    let bytes: Vec<u8> = samples.iter().flat_map(|v| v.to_ne_bytes()).collect();
    let [height, width] = SIDES.map(|side| u32::try_from(side / 2).unwrap());
    let mut file = std::io::Cursor::new(Vec::new());
    let colour = ExtendedColorType::Rgba16;
    image::write_buffer_with_format(&mut file, &bytes, width, height, colour, format).unwrap();
    fs::write(path, file.into_inner()).unwrap();
}

/// Black and white as shares of 16 bits, which floats are stored in here.
const LEVELS: [&str; 4] = ["--white", "1023/65535", "--black", "64/65535"];
const HOW: [&str; 4] = ["--method", "wiener", "--psf", "psf.exr"];

fn restore(folder: &Path, input: &str, output: &str, more: &[&str]) -> LinearImage {
    succeed(folder, &[&["restore", input, "-o", output][..], &HOW, more].concat());
    io::read_image::<Linear>(&folder.join(output)).unwrap()
}

#[test]
fn a_packed_mosaic_of_every_format_is_the_mosaic() {
    let scratch = scratch();
    let path = |name: &str| scratch.path().join(name);
    write_packed_exr(&path("counted.exr"), ["G1", "R", "B", "G2"]);
    write_packed_exr(&path("rows.exr"), ["Gr", "R", "B", "Gb"]);
    write_packed_exr(&path("rgba.exr"), ["R", "G", "B", "A"]);
    write_rgba(&path("rgba.png"), &packed(), ImageFormat::Png);
    write_rgba(&path("rgba.tif"), &packed(), ImageFormat::Tiff);
    let mut bands = Tiff::new();
    let mut fields = bands.image(1, &packed(), SIDES.map(|side| side / 2));
    // As arrays are stored: grey, and three samples of no meaning beside it.
    fields.push((338, Field::Shorts(vec![0; 3])));
    let first = bands.directory(fields);
    fs::write(path("bands.tif"), bands.finish(first)).unwrap();

    let flags = [&LEVELS[..], &["--bayer", "grbg"]].concat();
    let expected = restore(scratch.path(), "mosaic.npy", "expected.exr", &flags);
    for name in ["counted.exr", "rows.exr", "rgba.exr", "rgba.png", "rgba.tif", "bands.tif"] {
        let found = restore(scratch.path(), name, &format!("{name}.restored.exr"), &flags);
        assert_eq!(found, expected, "{name}");
    }
    let integers = ["--white", "1023", "--black", "64", "--bayer", "grbg"];
    let found = restore(scratch.path(), "rgba.png", "integers.exr", &integers);
    let near = |(a, b): (&f32, &f32)| (a - b).abs() < 1e-5;
    assert!(found.as_slice().iter().zip(expected.as_slice()).all(near));
}

#[test]
fn a_mosaic_of_which_nobody_says_the_colours_is_warned_of() {
    let scratch = scratch();
    let told = ["--white", "1023/65535", "--black", "64/65535", "--bayer", "grbg"];
    for (levels, is_warned) in [(&[][..], true), (&told, false)] {
        let call = ["restore", "mosaic.npy", "--overwrite", "-o", "restored.exr"];
        let output = udc(scratch.path(), &[&call[..], &HOW, levels].concat());
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{said}");
        assert_eq!(
            said.contains("mosaic.npy: its one channel looks like a Bayer mosaic"),
            is_warned,
            "{levels:?}: {said}"
        );
    }
}

#[test]
fn four_channels_without_pattern_and_three_with_one_are_refused() {
    let scratch = scratch();
    write_rgba(&scratch.path().join("rgba.png"), &packed(), ImageFormat::Png);
    let opaque: Vec<u16> =
        packed().chunks(4).flat_map(|site| [site[0], site[1], site[2], u16::MAX]).collect();
    write_rgba(&scratch.path().join("opaque.png"), &opaque, ImageFormat::Png);
    let refused = |input: &str, more: &[&str]| {
        fail(scratch.path(), &[&["restore", input, "-o", "out.exr"][..], &HOW, more].concat(), 1)
    };
    assert!(refused("rgba.png", &["--domain", "linear"]).contains("transparent"));
    for input in ["opaque.png", "psf.exr"] {
        let said = refused(input, &["--bayer", "rggb"]);
        assert!(said.contains("3 channels of colour; leave the pattern out"), "{said}");
    }
    assert!(!scratch.path().join("out.exr").exists());
}

/// Eight masked columns on the left of the mosaic, and a preview before it.
const MASKED: usize = 8;

/// What a test changes in a digital negative.
struct Negative {
    compression: u16,
    seconds: (u32, u32),
    iso: u16,
    /// Added to each photosite of a cell, and to its black level.
    offsets: [u16; 4],
    /// How much of the light is captured.
    share: f64,
    /// What each column adds to the black level, and each row; both to be declared.
    ramps: Option<[u16; 2]>,
}

impl Default for Negative {
    fn default() -> Self {
        Self { compression: 1, seconds: (1, 50), iso: 200, offsets: [0; 4], share: 1.0, ramps: None }
    }
}

/// A digital negative: a preview in its first directory, the mosaic inside of it, the exposure time beside.
fn negative(Negative { compression, seconds, iso, offsets, share, ramps }: Negative) -> Vec<u8> {
    let [height, width] = SIDES;
    let columns = width + MASKED;
    let sample = |index: usize| {
        let (y, x) = (index / columns, index % columns);
        let Some(x) = x.checked_sub(MASKED) else { return 3 };
        let light = f64::from(photosite(y, x) - BLACK) * share;
        let [of_column, of_row] = ramps.unwrap_or_default();
        BLACK + light.round() as u16 + offsets[y % 2 * 2 + x % 2] + of_column * x as u16 + of_row * y as u16
    };
    let samples: Vec<u16> = (0..height * columns).map(sample).collect();
    let mut file = Tiff::new();
    let mut raw = file.image(32803, &samples, [height, columns]);
    raw.retain(|(tag, _)| *tag != 259);
    let (left, bottom, right) = (MASKED as u16, height as u16, columns as u16);
    raw.extend([
        (259, Field::Shorts(vec![compression])),
        (33421, Field::Shorts(vec![2, 2])),
        (33422, Field::Bytes(vec![1, 0, 2, 1])),
        (50713, Field::Shorts(vec![2, 2])),
        (50714, Field::Rationals(offsets.map(|offset| (u32::from(BLACK + offset) * 10, 10)).to_vec())),
        (50717, Field::Longs(vec![u32::from(WHITE)])),
        (50829, Field::Shorts(vec![0, left, bottom, right])),
    ]);
    if let Some([of_column, of_row]) = ramps {
        let ramp = |step: u16, count: usize| (0..count as u32).map(|i| (i * u32::from(step), 1)).collect();
        raw.push((50715, Field::Rationals(ramp(of_column, width))));
        raw.push((50716, Field::Rationals(ramp(of_row, height))));
    }
    let raw = file.directory(raw);
    let exif =
        file.directory(vec![(33434, Field::Rationals(vec![seconds])), (34855, Field::Shorts(vec![iso]))]);
    let mut root = file.image(2, &[9000; 4 * 5 * 3], [4, 5]);
    root.extend([
        (330, Field::Longs(vec![raw])),
        (34665, Field::Longs(vec![exif])),
        (50706, Field::Bytes(vec![1, 4, 0, 0])),
        (50728, Field::Rationals(vec![(1, 2), (1, 1), (5, 8)])),
    ]);
    let root = file.directory(root);
    file.finish(root)
}

fn read_negative(folder: &Path, change: Negative) -> Pixels {
    let path = folder.join("read.dng");
    fs::write(&path, negative(change)).unwrap();
    inspect_image(&path).unwrap().0
}

#[test]
fn a_negative_says_its_pattern_levels_gains_and_time() {
    let scratch = scratch();
    let read = read_negative(scratch.path(), Negative::default());
    assert_eq!(read.planes.dim(), (1, SIDES[0], SIDES[1]));
    assert!(read.planes.indexed_iter().all(|((_, y, x), v)| *v == f32::from(photosite(y, x)) / 65535.0));
    assert_eq!((read.exposure_s, read.iso), (Some(0.02), Some(200.0)));
    let raw = read.raw.unwrap();
    assert_eq!(raw.bayer, Some(BayerPattern::Grbg));
    assert_eq!((raw.black * 65535.0, raw.white * 65535.0), (64.0, 1023.0));
    assert_eq!(raw.white_balance, Some([2.0, 1.0, 1.6]));
    // The declared pattern of a flag is for packed channels only.
    let path = scratch.path().join("read.dng");
    assert_eq!(inspect_mosaic(&path, BayerPattern::Rggb).unwrap().0.planes, read.planes);
}

/// Black levels that differ by photosite are brought to their mean, but for rounding of the scaled light.
#[test]
fn a_negative_has_one_black_level_in_the_end() {
    let scratch = scratch();
    let read = read_negative(scratch.path(), Negative { offsets: [0, 4, 8, 4], ..Negative::default() });
    let raw = read.raw.unwrap();
    assert!((raw.black * 65535.0 - 68.0).abs() < 1e-9, "{}", raw.black);
    for ((_, y, x), value) in read.planes.indexed_iter() {
        let expected = f64::from(photosite(y, x) + 4) / 65535.0;
        assert!((f64::from(*value) - expected).abs() < 5.0 / 65535.0, "{value} at {y}, {x}");
    }
}

/// The same of levels that grow by column and row; light is a share of white above the highest of them everywhere.
#[test]
fn black_levels_of_columns_and_rows_are_taken_off() {
    let scratch = scratch();
    let plain = read_negative(scratch.path(), Negative { share: 0.5, ..Negative::default() });
    let ramps = Some([2, 3]);
    let read = read_negative(scratch.path(), Negative { share: 0.5, ramps, ..Negative::default() });
    let (raw, raw_of_plain) = (read.raw.unwrap(), plain.raw.unwrap());
    let added = 2.0 * (SIDES[1] - 1) as f64 / 2.0 + 3.0 * (SIDES[0] - 1) as f64 / 2.0;
    assert!((raw.black - raw_of_plain.black - added / 65535.0).abs() < 1e-9, "{}", raw.black);
    for ((_, y, x), value) in read.planes.indexed_iter() {
        let darkest = f64::from(BLACK) + 2.0 * (SIDES[1] - 1) as f64 + 3.0 * (SIDES[0] - 1) as f64;
        let light = f64::from(photosite(y, x) - BLACK) * 0.5;
        let share = light.round() / (f64::from(WHITE) - darkest);
        let found = (f64::from(*value) - raw.black) / (raw.white - raw.black);
        assert!((found - share).abs() < 1e-5, "{found} for {share} at {y}, {x}");
    }
}

#[test]
fn a_negative_needs_no_flags_and_flags_override_it() {
    let scratch = scratch();
    fs::write(scratch.path().join("a.dng"), negative(Negative::default())).unwrap();
    let flags = [&LEVELS[..], &["--bayer", "grbg", "--white-balance", "2,1,1.6"]].concat();
    let expected = restore(scratch.path(), "mosaic.npy", "expected.exr", &flags);
    let found = restore(scratch.path(), "a.dng", "found.exr", &[]);
    let worst = |a: &LinearImage, b: &LinearImage| {
        a.as_slice().iter().zip(b.as_slice()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    };
    assert!(worst(&found, &expected) < 1e-6, "{}", worst(&found, &expected));
    let flags = ["--white", "2047", "--black", "32", "--white-balance", "1,1,1"];
    let brighter = restore(scratch.path(), "a.dng", "flags.exr", &flags);
    let other = ["--white", "2047/65535", "--black", "32/65535", "--bayer", "grbg"];
    let expected = restore(scratch.path(), "mosaic.npy", "other.exr", &other);
    assert!(worst(&brighter, &expected) < 1e-6);
    let said = fail(scratch.path(), &["tonemap", "a.dng", "-o", "out.exr"], 1);
    assert!(said.contains("a.dng") && said.contains("raw file"), "{said}");
}

#[test]
fn negatives_are_a_bracket_by_their_own_times_and_sensitivities() {
    let scratch = scratch();
    let folder = scratch.path().join("scene");
    fs::create_dir(&folder).unwrap();
    for (name, seconds, iso, share) in
        [("1", (1, 10), 200, 1.0), ("2", (1, 40), 200, 0.25), ("3", (1, 40), 50, 0.0625)]
    {
        let change = Negative { seconds, iso, share, ..Negative::default() };
        fs::write(folder.join(format!("{name}.dng")), negative(change)).unwrap();
    }
    succeed(scratch.path(), &["fuse", "scene", "-o", "fused.exr"]);
    let single = restore(scratch.path(), "scene/1.dng", "single.exr", &[]);
    let fused = restore(scratch.path(), "fused.exr", "restored.exr", &[]);
    // Nothing is saturated, so that the longest exposure is the image, and its white is one.
    let near = |(a, b): (&f32, &f32)| (a - b).abs() < 1e-5;
    assert!(single.as_slice().iter().zip(fused.as_slice()).all(near));
    // The mean of all shows whether the others are scaled rightly, but for their rounding.
    succeed(scratch.path(), &["fuse", "scene", "--merge", "weighted", "-o", "mean.exr"]);
    let mean = io::read_image::<Linear>(&scratch.path().join("mean.exr")).unwrap();
    let longest = io::read_image::<Linear>(&scratch.path().join("fused.exr")).unwrap();
    assert!(mean.as_slice().iter().zip(longest.as_slice()).all(|(a, b)| (a - b).abs() < 5e-3));
}

#[test]
fn negatives_that_are_not_read_say_why() {
    let scratch = scratch();
    for (compression, why) in [(34892, "uncompressed"), (7, "a marker is missing"), (9, "compression 9")] {
        let file = negative(Negative { compression, ..Negative::default() });
        fs::write(scratch.path().join("a.dng"), file).unwrap();
        let said = fail(scratch.path(), &[&["restore", "a.dng", "-o", "out.exr"][..], &HOW].concat(), 1);
        assert!(said.contains("a.dng") && said.contains(why), "{said}");
    }
    let whole = negative(Negative::default());
    let path = scratch.path().join("damaged.dng");
    for length in (0..whole.len()).step_by(97) {
        fs::write(&path, &whole[..length]).unwrap();
        assert!(inspect_image(&path).is_err(), "{length} of {} bytes", whole.len());
    }
    // One level needs no pattern, and so no sound one where columns and rows add to it.
    let ramped = negative(Negative { ramps: Some([2, 3]), share: 0.5, ..Negative::default() });
    let pattern = [&50713_u16.to_le_bytes()[..], &[3, 0, 2, 0, 0, 0, 2, 0, 2, 0]].concat();
    let place = ramped.windows(pattern.len()).position(|bytes| bytes == pattern).unwrap() + 8;
    let mut without = ramped.clone();
    without[place..place + 4].fill(0);
    fs::write(&path, without).unwrap();
    assert!(inspect_image(&path).is_ok());
    // Whatever a byte is changed to, the file is read or refused.
    for place in (0..400).chain(whole.len() - 500..whole.len()) {
        let mut bytes = whole.clone();
        bytes[place] = bytes[place].wrapping_add(0x7f);
        fs::write(&path, bytes).unwrap();
        let _ = inspect_image(&path);
    }
}

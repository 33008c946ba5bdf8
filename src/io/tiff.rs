//! Reads TIFF files of kinds that the `image` crate does not: grey floats, half floats, and the four bands of a packed mosaic.
//!
//! All may be stored in strips or tiles, in any compression that the `tiff` crate undoes.

mod write;

use std::io::{self, Cursor, ErrorKind, Read, Seek};

use ndarray::Array3;
use tiff::decoder::{BufferLayoutPreference, Decoder, DecodingResult, DecodingSampleType, Limits, ifd};
use tiff::tags::{CompressionMethod, PhotometricInterpretation, Tag};
use tiff::{ColorType, TiffError, TiffResult};

use super::MAX_PIXELS;
use super::directory::{Directory, FILL_ORDER};
use super::planes::gather;
use super::raster::{MAX_DECODER_BYTES, MAX_RATIO, check_declared, from_u8, from_u16};

pub(super) use write::{Samples, encode};

type FileDecoder<'a> = Decoder<Cursor<&'a [u8]>>;

/// The samples of a file, in its own order.
pub(super) struct Bands {
    samples: DecodingResult,
    shape: (usize, usize, usize),
    /// Whether each band is stored for itself, instead of the samples of a pixel together.
    is_planar: bool,
}

/// Bands that `image` does not decode: one of floats, up to four of half floats, or four grey ones where a mosaic may be `packed`
/// in them; none in other files, and in those whose headers are damaged, of which `image` says what is wrong.
///
/// # Errors
/// When the file holds such bands that are damaged or too large, or integers of 32 bits, whose bits `image` takes for
/// floats, or bytes whose lowest bit comes first, which nothing here turns around.
pub(super) fn decode(bytes: &[u8], packed: bool) -> Result<Option<Bands>, String> {
    let Some((mut decoder, color, layout)) = open(bytes) else { return Ok(None) };
    check_order_of_bits(bytes)?;
    let bands = match (color, layout.sample_type) {
        (_, Some(DecodingSampleType::U32 | DecodingSampleType::I32)) if color.bit_depth() == 32 => {
            let reason = "holds 32-bit integers, which are not read; write 16-bit integers or 32-bit floats";
            return Err(reason.to_owned());
        }
        (ColorType::Gray(_), Some(DecodingSampleType::F16 | DecodingSampleType::F32)) => 1,
        (ColorType::RGB(_), Some(DecodingSampleType::F16)) => 3,
        (ColorType::RGBA(_), Some(DecodingSampleType::F16)) => 4,
        (
            ColorType::Multiband { bit_depth: 8 | 16 | 32, num_samples: 4 },
            Some(DecodingSampleType::U8 | DecodingSampleType::U16 | DecodingSampleType::F32),
        ) if packed && is_black_zero(&mut decoder) => 4,
        _ => return Ok(None),
    };
    let damaged = |error: TiffError| format!("cannot be decoded: {error}");
    let (width, height) = decoder.dimensions().map_err(damaged)?;
    let compression = decoder.find_tag_unsigned::<u16>(Tag::Compression).map_err(damaged)?;
    let is_compressed = compression.is_some_and(|method| method != CompressionMethod::None.to_u16());
    let ratio = if is_compressed { MAX_RATIO } else { 1 };
    check_declared([width, height], layout.complete_len as u64, bytes, ratio)?;
    let (chunk_width, chunk_height) = decoder.chunk_dimensions();
    if u64::from(chunk_width) * u64::from(chunk_height) > MAX_PIXELS as u64 {
        return Err(format!(
            "declares tiles of {chunk_width} × {chunk_height} pixels; the limit is {MAX_PIXELS}"
        ));
    }
    let mut limits = Limits::default();
    limits.decoding_buffer_size = layout.complete_len;
    limits.intermediate_buffer_size = usize::try_from(MAX_DECODER_BYTES).unwrap_or(usize::MAX);
    let mut samples = DecodingResult::U8(Vec::new());
    decoder.with_limits(limits).read_image_to_buffer(&mut samples).map_err(damaged)?;
    let shape = (bands, height as usize, width as usize);
    Ok(Some(Bands { samples, shape, is_planar: layout.planes > 1 }))
}

/// The ICC profile of the first image. `image` does not find one that is larger than its picture.
pub(super) fn icc_profile(bytes: &[u8]) -> Option<Vec<u8>> {
    let mut limits = Limits::default();
    // No value of the file is longer than the file.
    limits.decoding_buffer_size = bytes.len().saturating_mul(size_of::<ifd::Value>());
    Decoder::new(Cursor::new(bytes)).ok()?.with_limits(limits).get_tag_u8_vec(Tag::IccProfile).ok()
}

/// Whether a file of `length` bytes holds its first directory, and all strips or tiles that it lists. One of a kind that is not read is
/// not looked into.
///
/// # Errors
/// Those of reading.
pub(super) fn is_whole(file: impl Read + Seek, length: u64) -> io::Result<bool> {
    match end_of_samples(file) {
        Ok(end) => Ok(end.is_some_and(|end| end <= length)),
        Err(TiffError::UnsupportedError(_)) => Ok(true),
        Err(TiffError::IoError(error)) if error.kind() != ErrorKind::UnexpectedEof => Err(error),
        Err(_) => Ok(false),
    }
}

fn end_of_samples(file: impl Read + Seek) -> TiffResult<Option<u64>> {
    let mut decoder = Decoder::new(file)?;
    let is_tiled = decoder.find_tag(Tag::TileOffsets)?.is_some();
    let [places, lengths] = match is_tiled {
        true => [Tag::TileOffsets, Tag::TileByteCounts],
        false => [Tag::StripOffsets, Tag::StripByteCounts],
    };
    let (places, lengths) = (decoder.get_tag_u64_vec(places)?, decoder.get_tag_u64_vec(lengths)?);
    Ok(places.into_iter().zip(lengths).map(|(place, length)| place.saturating_add(length)).max())
}

fn check_order_of_bits(bytes: &[u8]) -> Result<(), String> {
    match Directory::first(bytes).and_then(|root| root.number(FILL_ORDER)) {
        None | Some(1) => Ok(()),
        Some(_) => {
            let reason = "stores the lowest bit of each byte first (FillOrder 2), which is not read; write it again without";
            Err(reason.to_owned())
        }
    }
}

fn open(bytes: &[u8]) -> Option<(FileDecoder<'_>, ColorType, BufferLayoutPreference)> {
    let mut decoder = Decoder::new(Cursor::new(bytes)).ok()?;
    let color = decoder.colortype().ok()?;
    let layout = decoder.image_buffer_layout().ok()?;
    Some((decoder, color, layout))
}

fn is_black_zero(decoder: &mut FileDecoder<'_>) -> bool {
    let found = decoder.find_tag_unsigned::<u16>(Tag::PhotometricInterpretation).ok().flatten();
    found == Some(PhotometricInterpretation::BlackIsZero.to_u16())
}

impl Bands {
    /// The planes with the name of the samples' type; integers are divided by their type's maximum.
    ///
    /// # Panics
    /// For samples of other types than [`decode`] reads.
    pub(super) fn into_planes(self) -> (Array3<f32>, &'static str) {
        let (bands, height, width) = self.shape;
        let strides = if self.is_planar { [height * width, width, 1] } else { [1, width * bands, bands] };
        match &self.samples {
            DecodingResult::U8(samples) => (gather(samples, strides, self.shape, from_u8), "uint8"),
            DecodingResult::U16(samples) => (gather(samples, strides, self.shape, from_u16), "uint16"),
            DecodingResult::F16(samples) => (gather(samples, strides, self.shape, |v| v.to_f32()), "half"),
            DecodingResult::F32(samples) => (gather(samples, strides, self.shape, |v| v), "float"),
            other => unreachable!("bands are read as 8 or 16 bits or floats, not as {other:?}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;
    use tiff::encoder::colortype::Gray32Float;
    use tiff::encoder::{Compression, DeflateLevel, TiffEncoder};

    const HEIGHT: usize = 21;
    const WIDTH: usize = 37;

    fn value(y: usize, x: usize) -> f32 {
        (y * 100 + x) as f32 / 8.0 - 3.0
    }

    fn values() -> Vec<f32> {
        (0..HEIGHT * WIDTH).map(|i| value(i / WIDTH, i % WIDTH)).collect()
    }

    fn compressed(compression: Compression) -> Vec<u8> {
        let mut file = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut file).unwrap().with_compression(compression);
        encoder.write_image::<Gray32Float>(WIDTH as u32, HEIGHT as u32, &values()).unwrap();
        file.into_inner()
    }

    /// Uncompressed tiles of 16 × 16, those at the border filled up with zeros.
    fn tiled(height: usize, width: usize) -> Vec<u8> {
        const SIDE: usize = 16;
        let mut file = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut file).unwrap();
        let mut directory = encoder.image_directory().unwrap();
        let mut offsets = Vec::new();
        for tile in 0..height.div_ceil(SIDE) * width.div_ceil(SIDE) {
            let (top, left) = (tile / width.div_ceil(SIDE) * SIDE, tile % width.div_ceil(SIDE) * SIDE);
            let here = |i: usize| {
                let (y, x) = (top + i / SIDE, left + i % SIDE);
                if y < height && x < width { value(y, x) } else { 0.0 }
            };
            let samples: Vec<f32> = (0..SIDE * SIDE).map(here).collect();
            offsets.push(u32::try_from(directory.write_data(&samples[..]).unwrap()).unwrap());
        }
        let short = |tag, value: usize| (tag, u16::try_from(value).unwrap());
        for (tag, value) in [
            short(Tag::ImageWidth, width),
            short(Tag::ImageLength, height),
            short(Tag::BitsPerSample, 32),
            short(Tag::Compression, 1),
            short(Tag::PhotometricInterpretation, 1),
            short(Tag::SamplesPerPixel, 1),
            short(Tag::TileWidth, SIDE),
            short(Tag::TileLength, SIDE),
            short(Tag::SampleFormat, 3),
        ] {
            directory.write_tag(tag, value).unwrap();
        }
        directory.write_tag(Tag::TileByteCounts, &vec![(SIDE * SIDE * 4) as u32; offsets.len()][..]).unwrap();
        directory.write_tag(Tag::TileOffsets, &offsets[..]).unwrap();
        directory.finish().unwrap();
        file.into_inner()
    }

    fn planes(bytes: &[u8]) -> Array3<f32> {
        let (planes, sample_type) = decode(bytes, false).unwrap().unwrap().into_planes();
        assert_eq!(sample_type, "float");
        planes
    }

    #[test]
    fn grey_floats_are_read_in_strips_and_tiles_and_compressed() {
        let expected = Array3::from_shape_fn((1, HEIGHT, WIDTH), |(_, y, x)| value(y, x));
        let deflate = Compression::Deflate(DeflateLevel::default());
        for (name, bytes) in [
            ("strips", compressed(Compression::Uncompressed)),
            ("LZW", compressed(Compression::Lzw)),
            ("deflate", compressed(deflate)),
            ("tiles", tiled(HEIGHT, WIDTH)),
        ] {
            assert_eq!(planes(&bytes), expected, "{name}");
        }
    }

    /// Without alpha and with it, which is the last plane.
    #[test]
    fn half_floats_are_read() {
        for bands in [1, 3, 4] {
            let half = |i: usize| half::f16::from_f32(i as f32 / 8.0 - 3.0);
            let count = HEIGHT * WIDTH * bands;
            let samples: Vec<u16> = (0..count).map(|i| half(i).to_bits()).collect();
            let mut file = Cursor::new(Vec::new());
            let mut encoder = TiffEncoder::new(&mut file).unwrap();
            let mut directory = encoder.image_directory().unwrap();
            let offset = u32::try_from(directory.write_data(&samples[..]).unwrap()).unwrap();
            directory.write_tag(Tag::ImageWidth, WIDTH as u16).unwrap();
            directory.write_tag(Tag::ImageLength, HEIGHT as u16).unwrap();
            directory.write_tag(Tag::BitsPerSample, &vec![16_u16; bands][..]).unwrap();
            directory.write_tag(Tag::SampleFormat, &vec![3_u16; bands][..]).unwrap();
            directory.write_tag(Tag::Compression, 1_u16).unwrap();
            directory.write_tag(Tag::PhotometricInterpretation, if bands == 1 { 1_u16 } else { 2 }).unwrap();
            directory.write_tag(Tag::SamplesPerPixel, bands as u16).unwrap();
            if bands == 4 {
                directory.write_tag(Tag::ExtraSamples, 2_u16).unwrap();
            }
            directory.write_tag(Tag::RowsPerStrip, HEIGHT as u16).unwrap();
            directory.write_tag(Tag::StripOffsets, offset).unwrap();
            directory.write_tag(Tag::StripByteCounts, 2 * count as u32).unwrap();
            directory.finish().unwrap();
            let (planes, sample_type) = decode(file.get_ref(), false).unwrap().unwrap().into_planes();
            assert_eq!((planes.dim(), sample_type), ((bands, HEIGHT, WIDTH), "half"));
            for ((c, y, x), value) in planes.indexed_iter() {
                assert_eq!(*value, half((y * WIDTH + x) * bands + c).to_f32());
            }
        }
    }

    #[test]
    fn bits_in_the_other_order_are_refused() {
        let mut bytes = tiled(16, 16);
        // The tag of the sample's format becomes that of the order: its value is 3.
        let place = bytes.windows(4).position(|field| field == [0x53, 1, 3, 0]).unwrap();
        bytes[place..place + 2].copy_from_slice(&FILL_ORDER.to_le_bytes());
        assert!(decode(&bytes, false).err().unwrap().contains("FillOrder"));
    }

    /// Every prefix is refused, never believed or a panic.
    #[test]
    fn grey_floats_that_are_cut_off_are_refused() {
        for bytes in
            [compressed(Compression::Uncompressed), compressed(Compression::Lzw), tiled(HEIGHT, WIDTH)]
        {
            for length in 0..bytes.len() {
                // The directory stands at the end, so that without its last bytes there is none.
                assert!(
                    !matches!(decode(&bytes[..length], false), Ok(Some(_))),
                    "{length} of {}",
                    bytes.len()
                );
            }
        }
    }

    /// 1 × 1 pixels compressed to some bytes, declared to be 16384 × 16384 in one strip.
    #[test]
    fn sizes_that_the_file_cannot_hold_are_refused_before_they_are_allocated() {
        let mut file = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut file).unwrap().with_compression(Compression::Lzw);
        encoder.write_image::<Gray32Float>(1, 1, &[1.0]).unwrap();
        let mut bytes = file.into_inner();
        // Width, height and rows of a strip: tag, type of 32 bits, one value.
        for tag in [[0, 1], [1, 1], [22, 1]] {
            let field = [&tag[..], &[4, 0, 1, 0, 0, 0]].concat();
            let place = bytes.windows(field.len()).position(|window| window == field).unwrap();
            bytes[place + 8..place + 12].copy_from_slice(&16384_u32.to_le_bytes());
        }
        let error = decode(&bytes, false).err().unwrap();
        assert!(error.contains("do not fit"), "{error}");
    }

    /// A picture of 16 × 16 pixels in one tile.
    #[test]
    fn tiles_that_are_larger_than_any_image_are_refused() {
        let mut bytes = tiled(16, 16);
        for tag in [[0x42, 1], [0x43, 1]] {
            let field = [&tag[..], &[3, 0, 1, 0, 0, 0]].concat();
            let place = bytes.windows(field.len()).position(|window| window == field).unwrap();
            bytes[place + 8..place + 10].copy_from_slice(&u16::MAX.to_le_bytes());
        }
        let error = decode(&bytes, false).err().unwrap();
        assert!(error.contains("tiles of 65535 × 65535"), "{error}");
    }
}

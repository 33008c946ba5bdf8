//! Reads uncompressed grey TIFF images of 32-bit floats, which the `image` crate does not.
//!
//! The format: byte order, 42, the position of a directory; the directory lists fields (tag, type, count, value or its
//! position), among them the positions and lengths of the strips of rows (TIFF 6.0, sections 2 and 19).

use ndarray::Array3;

use super::MAX_PIXELS;
use super::planes::gather;

const WIDTH: u16 = 256;
const HEIGHT: u16 = 257;
const BITS: u16 = 258;
const COMPRESSION: u16 = 259;
const STRIP_OFFSETS: u16 = 273;
const SAMPLES: u16 = 277;
const STRIP_BYTES: u16 = 279;
const SAMPLE_FORMAT: u16 = 339;
/// The value of [`SAMPLE_FORMAT`] for IEEE floats.
const FLOAT: usize = 3;
/// The value of [`COMPRESSION`] for none.
const UNCOMPRESSED: usize = 1;

/// The planes `[1, height, width]`; `None` for a TIFF file of another kind.
///
/// # Errors
/// When the image is of this kind and compressed, tiled, truncated or too large.
pub(super) fn decode(bytes: &[u8]) -> Option<Result<Array3<f32>, String>> {
    let directory = Directory::parse(bytes)?;
    let is_grey_float = directory.number(BITS) == Some(32)
        && directory.number(SAMPLE_FORMAT) == Some(FLOAT)
        && directory.number(SAMPLES).unwrap_or(1) == 1;
    is_grey_float.then(|| directory.planes())
}

/// The first directory of a file.
struct Directory<'a> {
    bytes: &'a [u8],
    big_endian: bool,
    /// Tag, type, count and the place of the value or of its position.
    fields: Vec<(u16, u16, usize, usize)>,
}

impl<'a> Directory<'a> {
    fn parse(bytes: &'a [u8]) -> Option<Self> {
        let mut directory = Self { bytes, big_endian: bytes.starts_with(b"MM"), fields: Vec::new() };
        let start = directory.u32(4)?;
        let count = usize::from(directory.u16(start)?);
        for index in 0..count {
            let place = start.checked_add(2 + 12 * index)?;
            let field = (
                directory.u16(place)?,
                directory.u16(place.checked_add(2)?)?,
                directory.u32(place.checked_add(4)?)?,
                place.checked_add(8)?,
            );
            directory.fields.push(field);
        }
        Some(directory)
    }

    fn u16(&self, place: usize) -> Option<u16> {
        let bytes = *self.bytes.get(place..)?.first_chunk::<2>()?;
        Some(if self.big_endian { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) })
    }

    fn u32(&self, place: usize) -> Option<usize> {
        let bytes = *self.bytes.get(place..)?.first_chunk::<4>()?;
        let value = if self.big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) };
        usize::try_from(value).ok()
    }

    /// All values of a field of 16- or 32-bit numbers.
    fn numbers(&self, tag: u16) -> Option<Vec<usize>> {
        let &(_, kind, count, place) = self.fields.iter().find(|field| field.0 == tag)?;
        let size: usize = match kind {
            3 => 2,
            4 => 4,
            _ => return None,
        };
        let length = count.checked_mul(size)?;
        let start = if length <= 4 { place } else { self.u32(place)? };
        // Before anything is allocated for them, the values must be there.
        self.bytes.get(start..start.checked_add(length)?)?;
        let value = |index: usize| match size {
            2 => self.u16(start + 2 * index).map(usize::from),
            _ => self.u32(start + 4 * index),
        };
        (0..count).map(value).collect()
    }

    fn number(&self, tag: u16) -> Option<usize> {
        self.numbers(tag)?.first().copied()
    }

    fn planes(&self) -> Result<Array3<f32>, String> {
        let missing = "is damaged: its directory is incomplete";
        let width = self.number(WIDTH).ok_or(missing)?;
        let height = self.number(HEIGHT).ok_or(missing)?;
        let pixels = width.checked_mul(height).filter(|pixels| (1..=MAX_PIXELS).contains(pixels));
        let pixels = pixels
            .ok_or_else(|| format!("declares {width} × {height} pixels; the limit is 1 to {MAX_PIXELS}"))?;
        if self.number(COMPRESSION).unwrap_or(UNCOMPRESSED) != UNCOMPRESSED {
            return Err(
                "is a compressed grey TIFF of floats; write it without compression, or as .exr".into()
            );
        }
        let offsets = self
            .numbers(STRIP_OFFSETS)
            .ok_or("is a tiled grey TIFF of floats; write it in strips, or as .exr")?;
        let lengths = self.numbers(STRIP_BYTES).ok_or(missing)?;
        let needed = pixels * size_of::<f32>();
        let mut data = Vec::new();
        for (&start, length) in offsets.iter().zip(lengths) {
            let end = start.checked_add(length).ok_or(missing)?;
            data.extend_from_slice(self.bytes.get(start..end).ok_or("is truncated inside of a strip")?);
            if data.len() > needed {
                break;
            }
        }
        if data.len() < needed {
            return Err(format!("is truncated: {needed} bytes are needed, found {}", data.len()));
        }
        let convert = if self.big_endian { f32::from_be_bytes } else { f32::from_le_bytes };
        Ok(gather(data.as_chunks::<4>().0, [0, width, 1], (1, height, width), convert))
    }
}

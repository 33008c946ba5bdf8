//! Reads uncompressed grey TIFF images of 32-bit floats, which the `image` crate does not.
//!
//! The directory names the positions and lengths of the strips of rows (TIFF 6.0, sections 2 and 19).

use ndarray::Array3;

use super::MAX_PIXELS;
use super::planes::gather;
use super::tiff_directory::{BITS, COMPRESSION, Directory, FLOAT, HEIGHT, SAMPLE_FORMAT, SAMPLES, WIDTH};

const STRIP_OFFSETS: u16 = 273;
const STRIP_BYTES: u16 = 279;
/// The value of [`COMPRESSION`] for none.
const UNCOMPRESSED: usize = 1;

/// The planes `[1, height, width]`; `None` for a TIFF file of another kind.
///
/// # Errors
/// When the image is of this kind and compressed, tiled, truncated or too large.
pub(super) fn decode(bytes: &[u8]) -> Option<Result<Array3<f32>, String>> {
    let directory = Directory::first(bytes)?;
    let is_grey_float = directory.number(BITS) == Some(32)
        && directory.number(SAMPLE_FORMAT) == Some(FLOAT)
        && directory.number(SAMPLES).unwrap_or(1) == 1;
    is_grey_float.then(|| directory.planes())
}

impl Directory<'_> {
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
            data.extend_from_slice(self.slice(start, length).ok_or("is truncated inside of a strip")?);
            if data.len() > needed {
                break;
            }
        }
        if data.len() < needed {
            return Err(format!("is truncated: {needed} bytes are needed, found {}", data.len()));
        }
        let convert = if self.is_big_endian() { f32::from_be_bytes } else { f32::from_le_bytes };
        Ok(gather(data.as_chunks::<4>().0, [0, width, 1], (1, height, width), convert))
    }
}

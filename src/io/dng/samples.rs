//! The samples of raw images in the ways of storing them that TIFF decoders do not know: compressed as lossless JPEG, or
//! packed without gaps between samples of 10, 12 or 14 bits.

use ndarray::Array3;
use rayon::prelude::*;

use super::lossless_jpeg;
use crate::io::MAX_PIXELS;
use crate::io::directory::{BITS, COMPRESSION, Directory, FILL_ORDER, HEIGHT, SAMPLES, WIDTH};

const STRIP_OFFSETS: u16 = 273;
const ROWS_PER_STRIP: u16 = 278;
const STRIP_LENGTHS: u16 = 279;
const PLANAR: u16 = 284;
const TILE_WIDTH: u16 = 322;
const TILE_HEIGHT: u16 = 323;
const TILE_OFFSETS: u16 = 324;
const TILE_LENGTHS: u16 = 325;

/// The value of [`COMPRESSION`] for JPEG, which raw images are stored in without loss.
const JPEG: usize = 7;

/// Whether the image is stored in such a way.
pub(super) fn are_known(raw: &Directory<'_>) -> bool {
    match raw.number(COMPRESSION).unwrap_or(1) {
        1 => raw.number(BITS).is_some_and(|bits| bits < 16 && bits != 8),
        compression => compression == JPEG,
    }
}

/// The image `[channel, row, column]` in 16 bits.
///
/// # Errors
/// What is damaged, or not read.
pub(super) fn decode(raw: &Directory<'_>) -> Result<Array3<u16>, String> {
    let image = Image::of(raw).ok_or("is damaged: its raw directory is incomplete")?;
    let Image { height, width, channels, .. } = image;
    image.check(raw)?;
    let needed = image.across() * image.down();
    let chunks = (0..needed).into_par_iter().map(|index| image.decode_chunk(index));
    let chunks = chunks.collect::<Result<Vec<_>, String>>()?;
    let mut planes = Array3::zeros((channels, height, width));
    for (index, samples) in chunks.iter().enumerate() {
        let (top, left) = image.place(index);
        let lines = samples.chunks_exact(image.chunk_width * channels);
        for (y, line) in (top..height).zip(lines) {
            for (x, pixel) in (left..width).zip(line.chunks_exact(channels)) {
                for (channel, &value) in pixel.iter().enumerate() {
                    planes[[channel, y, x]] = value;
                }
            }
        }
    }
    Ok(planes)
}

/// An image stored in tiles or strips.
struct Image<'a> {
    height: usize,
    width: usize,
    channels: usize,
    bits: usize,
    is_jpeg: bool,
    /// Tiles are all whole; a last strip may end with the image.
    is_tiled: bool,
    chunk_height: usize,
    chunk_width: usize,
    chunks: Vec<&'a [u8]>,
}

impl<'a> Image<'a> {
    fn of(raw: &Directory<'a>) -> Option<Self> {
        let (height, width) = (raw.number(HEIGHT)?, raw.number(WIDTH)?);
        let is_tiled = raw.number(TILE_WIDTH).is_some();
        let (chunk_height, chunk_width, [offsets, lengths]) = if is_tiled {
            (raw.number(TILE_HEIGHT)?, raw.number(TILE_WIDTH)?, [TILE_OFFSETS, TILE_LENGTHS])
        } else {
            let rows = raw.number(ROWS_PER_STRIP).unwrap_or(height).min(height);
            (rows, width, [STRIP_OFFSETS, STRIP_LENGTHS])
        };
        let (offsets, lengths) = (raw.numbers(offsets)?, raw.numbers(lengths)?);
        let chunks = offsets.into_iter().zip(lengths).map(|(offset, length)| raw.slice(offset, length));
        Some(Self {
            height,
            width,
            channels: raw.number(SAMPLES).unwrap_or(1),
            bits: raw.number(BITS)?,
            is_jpeg: raw.number(COMPRESSION) == Some(JPEG),
            is_tiled,
            chunk_height,
            chunk_width,
            chunks: chunks.collect::<Option<_>>()?,
        })
    }

    /// Refuses what is not read, and sizes that the file cannot hold.
    fn check(&self, raw: &Directory<'_>) -> Result<(), String> {
        let Self { height, width, channels, bits, .. } = *self;
        if !(1..=16).contains(&bits) {
            return Err(format!("is a DNG of {bits} bits a sample, which is not read; write it with 16"));
        }
        let is_packed_otherwise = !self.is_jpeg && raw.number(FILL_ORDER).is_some_and(|order| order != 1);
        if is_packed_otherwise || raw.number(PLANAR).is_some_and(|planar| planar != 1 && channels > 1) {
            return Err("is a DNG of an order of samples that is not read; write it uncompressed".to_owned());
        }
        let [area, chunk_area] = [(height, width), (self.chunk_height, self.chunk_width)]
            .map(|(rows, columns)| rows.checked_mul(columns).filter(|area| (1..=MAX_PIXELS).contains(area)));
        if area.zip(chunk_area).is_none() || self.chunks.len() < self.across() * self.down() {
            return Err(format!("is damaged: {height} × {width} × {channels} samples are not in its tiles"));
        }
        // Each sample takes a bit at least, and no two tiles the same.
        let rows = if self.is_tiled { self.down() * self.chunk_height } else { height };
        let (decoded, length) = (rows * (self.across() * self.chunk_width) * channels, raw.file_len());
        if decoded > length.saturating_mul(8) {
            return Err(format!(
                "is truncated or damaged: {height} × {width} pixels do not fit in its {length} bytes"
            ));
        }
        Ok(())
    }

    fn across(&self) -> usize {
        self.width.div_ceil(self.chunk_width.max(1))
    }

    fn down(&self) -> usize {
        self.height.div_ceil(self.chunk_height.max(1))
    }

    /// The first row and column of a tile or strip.
    fn place(&self, index: usize) -> (usize, usize) {
        (index / self.across() * self.chunk_height, index % self.across() * self.chunk_width)
    }

    /// The samples of a tile or strip, [`Self::chunk_width`] pixels to the line, as many lines as the image has there.
    fn decode_chunk(&self, index: usize) -> Result<Vec<u16>, String> {
        let per_line = self.chunk_width * self.channels;
        let lines = self.chunk_height.min(self.height - self.place(index).0);
        let chunk = self.chunks[index];
        let samples = if self.is_jpeg {
            let samples = lossless_jpeg::decode(chunk, self.chunk_height * per_line).map_err(|reason| {
                format!("is a DNG whose compressed raw image is damaged or not read: {reason}")
            })?;
            // Some writers store tiles as images of another shape, line after line.
            let is_whole = samples.per_line == per_line || samples.values.len() % per_line == 0;
            if is_whole { samples.values } else { Vec::new() }
        } else {
            unpack(chunk, per_line, lines, self.bits)
        };
        if samples.len() < lines * per_line {
            return Err(format!(
                "is truncated or damaged: a tile or strip has not its {per_line} × {lines} samples"
            ));
        }
        Ok(samples)
    }
}

/// Takes samples of `bits` apart, the highest bit first; each line begins with a byte of its own. Lines that are not all
/// there are left out.
fn unpack(bytes: &[u8], per_line: usize, lines: usize, bits: usize) -> Vec<u16> {
    let line_bytes = (per_line * bits).div_ceil(8);
    let mask = u16::MAX >> (16 - bits);
    let mut samples = Vec::new();
    for line in bytes.chunks_exact(line_bytes).take(lines) {
        let (mut ahead, mut count) = (0_u32, 0);
        let mut bytes = line.iter();
        samples.extend((0..per_line).map(|_| {
            while count < bits {
                ahead = ahead << 8 | u32::from(bytes.next().copied().unwrap_or(0));
                count += 8;
            }
            count -= bits;
            ((ahead >> count) & 0xffff) as u16 & mask
        }));
    }
    samples
}

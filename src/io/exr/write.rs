//! Encodes planes as a scan-line OpenEXR file, the same bytes for any number of threads.

use std::io::{self, Seek, Write};

use ::exr::block::chunk::{Chunk, CompressedBlock};
use ::exr::block::writer::{ChunkWriter, ChunksWriter};
use ::exr::block::{BlockIndex, UncompressedBlock};
use ::exr::compression::Compression;
use ::exr::math::Vec2;
use ::exr::meta::attribute::{AttributeValue, ChannelDescription, LineOrder, SampleType, Text};
use ::exr::meta::header::{Header, ImageAttributes, LayerAttributes};
use ::exr::meta::{BlockDescription, MetaData};
use half::f16;
use ndarray::{ArrayView3, Axis, concatenate, s};
use rayon::prelude::*;

use super::chromaticities::attribute_of;
use super::{CAPTURE_ATTRIBUTE, DOMAIN_ATTRIBUTE, PROVENANCE_ATTRIBUTE, WAVE};
use crate::io::Contents;
use crate::io::npy::check_half;

/// Windows that are compressed on trial, and the most rows (those of a block) and columns of each: deflating takes long.
const SAMPLES: usize = 4;
const SAMPLE_ROWS: usize = 16;
const SAMPLE_COLUMNS: usize = 128;
/// Compression must save this share to be worth its time: computed floats hardly shrink, and deflating them takes
/// twenty times longer than writing them.
const WORTHWHILE_SAVING: f64 = 0.2;

/// One grey (`Y`) or three colour planes, checked, with how they will be stored.
pub(in crate::io) struct Encoder<'a> {
    header: Header,
    planes: ArrayView3<'a, f32>,
}

impl<'a> Encoder<'a> {
    /// Checks the planes and chooses their compression.
    pub(in crate::io) fn new(contents: &Contents<'a>, half: bool) -> Result<Self, String> {
        if half {
            check_half(&contents.planes)?;
        }
        let mut header = header_of(contents, half)?;
        if !compresses_well(contents, half)? {
            header = with_compression(header, Compression::Uncompressed);
        }
        Ok(Self { header, planes: contents.planes })
    }

    /// Writes the file, a few blocks at a time.
    pub(in crate::io) fn write(self, file: impl Write + Seek) -> io::Result<()> {
        ::exr::block::write(file, [self.header].into_iter().collect(), true, |meta, writer| {
            write_blocks(&meta, writer, &self.planes)
        })
        .map_err(|error| match error {
            ::exr::error::Error::Io(error) => error,
            other => io::Error::other(cannot_encode(other)),
        })
    }
}

#[expect(clippy::needless_pass_by_value, reason = "an adapter for `map_err`")]
fn cannot_encode(error: ::exr::error::Error) -> String {
    format!("cannot be encoded: {error}")
}

fn header_of(contents: &Contents<'_>, half: bool) -> Result<Header, String> {
    let (channels, height, width) = contents.planes.dim();
    let names = match channels {
        1 => &["Y"][..],
        3 => &["B", "G", "R"][..],
        _ => return Err(format!("OpenEXR images have 1 or 3 channels here, not {channels}; write .npy")),
    };
    let sample_type = if half { SampleType::F16 } else { SampleType::F32 };
    let channels = names.iter().map(|name| ChannelDescription::named(*name, sample_type)).collect();
    let header = Header::new(Text::from(""), (width, height), channels);
    let mut header = with_compression(header, Compression::ZIP16);
    header.own_attributes = layer_attributes(contents);
    header.shared_attributes = image_attributes(contents, width, height);
    Ok(header)
}

fn with_compression(header: Header, compression: Compression) -> Header {
    header.with_encoding(compression, BlockDescription::ScanLines, LineOrder::Increasing)
}

/// Whether a few windows along the image's diagonal shrink enough.
fn compresses_well(contents: &Contents<'_>, half: bool) -> Result<bool, String> {
    let (_, height, width) = contents.planes.dim();
    let (rows, columns) = (height.min(SAMPLE_ROWS), width.min(SAMPLE_COLUMNS));
    let windows: Vec<_> = (0..SAMPLES)
        .map(|k| (k * (height - rows) / (SAMPLES - 1), k * (width - columns) / (SAMPLES - 1)))
        .map(|(top, left)| contents.planes.slice(s![.., top..top + rows, left..left + columns]))
        .collect();
    let planes = concatenate(Axis(1), &windows).map_err(|error| error.to_string())?;
    let sample = Contents { planes: planes.view(), ..*contents };
    let headers = [header_of(&sample, half)?];
    let sizes = ::exr::block::enumerate_ordered_header_block_indices(&headers)
        .collect::<Vec<_>>()
        .into_par_iter()
        .map(|(_, index)| {
            let block = block_of(index, &headers[0], &sample.planes);
            let before = block.data.len();
            Ok((before, compressed_length(&block.compress_to_chunk(&headers)?)))
        })
        .collect::<::exr::error::Result<Vec<_>>>()
        .map_err(cannot_encode)?;
    let (before, after) = sizes.iter().fold((0, 0), |sum, size| (sum.0 + size.0, sum.1 + size.1));
    Ok(after as f64 <= (1.0 - WORTHWHILE_SAVING) * before as f64)
}

fn compressed_length(chunk: &Chunk) -> usize {
    match &chunk.compressed_block {
        CompressedBlock::ScanLine(block) => block.compressed_pixels_le.len(),
        other => unreachable!("scan-line headers make scan-line blocks, not {other:?}"),
    }
}

fn layer_attributes(contents: &Contents<'_>) -> LayerAttributes {
    #[expect(clippy::cast_possible_truncation, reason = "the attributes are 32-bit floats")]
    let [exposure, iso_speed] =
        [contents.exposure_s, contents.iso].map(|value| value.map(|value| value as f32));
    let mut attributes = LayerAttributes { exposure, iso_speed, ..LayerAttributes::default() };
    if let Some(domain) = contents.domain {
        attributes
            .other
            .insert(Text::from(DOMAIN_ATTRIBUTE), AttributeValue::Text(Text::from(domain.name())));
    }
    attributes
}

/// Puts the provenance and the capture among the image's attributes and the domain among the layer's.
fn image_attributes(contents: &Contents<'_>, width: usize, height: usize) -> ImageAttributes {
    let mut attributes = ImageAttributes::with_size((width, height));
    attributes.chromaticities =
        contents.capture.and_then(|capture| capture.primaries).map(|primaries| attribute_of(&primaries));
    let text = |json: String| AttributeValue::Text(Text::from_bytes_unchecked(json.bytes().collect()));
    let provenance = contents.provenance.map(|provenance| (PROVENANCE_ATTRIBUTE, text(provenance.to_json())));
    let capture = contents.capture.map(|capture| (CAPTURE_ATTRIBUTE, text(capture.to_json())));
    let entries: Vec<_> = [capture, provenance].into_iter().flatten().collect();
    // The crate writes the entries of a hash map as they come, which is random: maps are made until one is in order.
    loop {
        attributes.other = entries.iter().map(|(name, value)| (Text::from(*name), value.clone())).collect();
        if attributes.other.keys().map(Text::bytes).is_sorted() {
            return attributes;
        }
    }
}

fn write_blocks(
    meta: &MetaData,
    writer: &mut ChunkWriter<impl Write + Seek>,
    planes: &ArrayView3<'_, f32>,
) -> ::exr::error::Result<()> {
    let indices: Vec<(usize, BlockIndex)> = meta.enumerate_ordered_header_block_indices().collect();
    for wave in indices.chunks(WAVE) {
        let chunks = wave
            .par_iter()
            .map(|(_, index)| block_of(*index, &meta.headers[0], planes).compress_to_chunk(&meta.headers))
            .collect::<::exr::error::Result<Vec<Chunk>>>()?;
        for ((position, _), chunk) in wave.iter().zip(chunks) {
            writer.write_chunk(*position, chunk)?;
        }
    }
    Ok(())
}

/// Lays out a block: line by line, in each the channels in alphabetical order, which is B, G, R.
fn block_of(index: BlockIndex, header: &Header, planes: &ArrayView3<'_, f32>) -> UncompressedBlock {
    let channels = &header.channels;
    let Vec2(left, top) = index.pixel_position;
    let Vec2(width, height) = index.pixel_size;
    let mut data = Vec::with_capacity(width * height * channels.bytes_per_pixel);
    for y in top..top + height {
        for channel in (0..planes.dim().0).rev() {
            let line = planes.slice(s![channel, y, left..left + width]);
            if channels.list[0].sample_type == SampleType::F16 {
                line.iter().for_each(|v| data.extend_from_slice(&f16::from_f32(*v).to_ne_bytes()));
            } else {
                line.iter().for_each(|v| data.extend_from_slice(&v.to_ne_bytes()));
            }
        }
    }
    UncompressedBlock { index, data }
}

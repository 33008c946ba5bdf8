//! Reads and writes OpenEXR images: channels by name, data placed in the display window.
//!
//! Blocks are decoded and encoded on the shared thread pool, a wave at a time, so that beside the file and the
//! planes only a few blocks are in memory.

mod layers;
mod limits;
mod write;

use std::collections::HashSet;
use std::io::Cursor;
use std::path::Path;

use ::exr::block::UncompressedBlock;
use ::exr::block::chunk::Chunk;
use ::exr::math::Vec2;
use ::exr::meta::MetaData;
use ::exr::meta::attribute::{AttributeValue, SampleType, Text};
use ::exr::meta::header::Header;
use half::f16;
use ndarray::{Array3, s};
use rayon::prelude::*;

use super::format::{Encoding, Format};
use super::{DomainTag, Pixels};
use crate::core::error::{Error, Result};
use layers::{Layer, choose_layer};

pub(super) use write::encode;

/// The attribute that says the domain of an image.
const DOMAIN_ATTRIBUTE: &str = "udc:domain";
/// The attribute that holds the provenance as JSON.
const PROVENANCE_ATTRIBUTE: &str = "udc:provenance";

/// Number of blocks that are decoded at once.
const WAVE: usize = 64;

/// Decodes the one RGB or grey layer of a file.
pub(super) fn decode(path: &Path, bytes: &[u8]) -> Result<(Pixels, Encoding)> {
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false)
        .map_err(|error| Error::format(path, format!("is no readable OpenEXR file: {error}")))?;
    limits::check(path, &meta, bytes.len())?;
    let layer = choose_layer(&meta).map_err(|reason| Error::format(path, reason))?;
    let planes =
        decode_layer(bytes, &layer).map_err(|error| Error::format(path, format!("is damaged: {error}")))?;
    let header = &meta.headers[layer.header];
    let planes = place_in_display_window(planes, header).map_err(|reason| Error::format(path, reason))?;
    let sample_type = match header.channels.list[layer.channels[0]].sample_type {
        SampleType::F16 => "half",
        SampleType::F32 => "float",
        SampleType::U32 => "uint32",
    };
    let pixels = Pixels {
        planes,
        domain: text_attribute(header, DOMAIN_ATTRIBUTE).and_then(|name| DomainTag::from_name(&name)),
        exposure_s: exposure_of(header),
        provenance: text_attribute(header, PROVENANCE_ATTRIBUTE)
            .and_then(|json| serde_json::from_str(&json).ok()),
    };
    Ok((pixels, Encoding { format: Format::Exr, sample_type: sample_type.to_owned() }))
}

fn text_attribute(header: &Header, name: &str) -> Option<String> {
    match attribute(header, name)? {
        AttributeValue::Text(text) => Some(text_to_string(text)),
        _ => None,
    }
}

/// UTF-8 text; the crate's own conversion takes each byte for a character.
fn text_to_string(text: &Text) -> String {
    String::from_utf8_lossy(text.bytes()).into_owned()
}

fn attribute<'a>(header: &'a Header, name: &str) -> Option<&'a AttributeValue> {
    let name = Text::new_or_none(name)?;
    header.own_attributes.other.get(&name).or_else(|| header.shared_attributes.other.get(&name))
}

fn exposure_of(header: &Header) -> Option<f64> {
    let standard = header.own_attributes.exposure.map(f64::from);
    let exposure = standard.or_else(|| match attribute(header, "ExposureTime")? {
        AttributeValue::F32(seconds) => Some(f64::from(*seconds)),
        AttributeValue::F64(seconds) => Some(*seconds),
        AttributeValue::Rational((numerator, denominator)) => {
            Some(f64::from(*numerator) / f64::from(*denominator))
        }
        AttributeValue::Text(text) => text_to_string(text).trim().parse().ok(),
        _ => None,
    });
    exposure.filter(|seconds| seconds.is_finite() && *seconds > 0.0)
}

/// Decodes the full-resolution blocks of one layer to planes of its data window.
fn decode_layer(bytes: &[u8], layer: &Layer) -> ::exr::error::Result<Array3<f32>> {
    let reader = ::exr::block::read(Cursor::new(bytes), false)?;
    let mut chunks = reader
        .filter_chunks(false, |_, _, block| block.layer == layer.header && block.level == Vec2(0, 0))?;
    let meta = ::exr::block::reader::ChunksReader::meta_data(&chunks).clone();
    let Vec2(width, height) = meta.headers[layer.header].layer_size;
    let mut planes = Array3::zeros((layer.channels.len(), height, width));
    let mut seen = HashSet::new();
    let mut covered = 0;
    loop {
        let wave = chunks.by_ref().take(WAVE).collect::<::exr::error::Result<Vec<Chunk>>>()?;
        if wave.is_empty() {
            break;
        }
        let blocks = wave
            .into_par_iter()
            .map(|chunk| UncompressedBlock::decompress_chunk(chunk, &meta, false))
            .collect::<::exr::error::Result<Vec<_>>>()?;
        for block in &blocks {
            copy_block(block, &meta.headers[layer.header], layer, &mut planes)?;
            if seen.insert(block.index.pixel_position) {
                covered += block.index.pixel_size.area();
            }
        }
    }
    if covered != width * height {
        return Err(::exr::error::Error::Invalid("some blocks are missing".into()));
    }
    Ok(planes)
}

fn copy_block(
    block: &UncompressedBlock,
    header: &Header,
    layer: &Layer,
    planes: &mut Array3<f32>,
) -> ::exr::error::Result<()> {
    let Vec2(left, top) = block.index.pixel_position;
    let Vec2(width, height) = block.index.pixel_size;
    let damaged = || ::exr::error::Error::Invalid("a block lies outside of the image".into());
    let (_, rows, columns) = planes.dim();
    if block.index.layer != layer.header
        || block.index.level != Vec2(0, 0)
        || left + width > columns
        || top + height > rows
    {
        return Err(damaged());
    }
    let line_bytes = header.channels.bytes_per_pixel * width;
    for (plane, &channel) in layer.channels.iter().enumerate() {
        let before: usize =
            header.channels.list[..channel].iter().map(|c| c.sample_type.bytes_per_sample()).sum();
        let sample_type = header.channels.list[channel].sample_type;
        for row in 0..height {
            let start = row * line_bytes + before * width;
            let line =
                block.data.get(start..start + width * sample_type.bytes_per_sample()).ok_or_else(damaged)?;
            let mut target = planes.slice_mut(s![plane, top + row, left..left + width]);
            let target = target.as_slice_mut().expect("rows of planes are contiguous");
            read_samples(line, sample_type, target);
        }
    }
    Ok(())
}

/// Converts one line of native-endian samples.
#[expect(clippy::cast_precision_loss, reason = "images are 32-bit floats")]
fn read_samples(line: &[u8], sample_type: SampleType, target: &mut [f32]) {
    match sample_type {
        SampleType::F16 => {
            for (value, bytes) in target.iter_mut().zip(line.as_chunks::<2>().0) {
                *value = f16::from_ne_bytes(*bytes).to_f32();
            }
        }
        SampleType::F32 => {
            for (value, bytes) in target.iter_mut().zip(line.as_chunks::<4>().0) {
                *value = f32::from_ne_bytes(*bytes);
            }
        }
        SampleType::U32 => {
            for (value, bytes) in target.iter_mut().zip(line.as_chunks::<4>().0) {
                *value = u32::from_ne_bytes(*bytes) as f32;
            }
        }
    }
}

/// Cuts or extends the data window to the display window; pixels outside of the data are black, as the format
/// defines.
fn place_in_display_window(planes: Array3<f32>, header: &Header) -> Result<Array3<f32>, String> {
    let display = header.shared_attributes.display_window;
    let data = header.data_window();
    if display == data {
        return Ok(planes);
    }
    let Vec2(dx, dy) = data.position - display.position;
    let rows = Overlap::of(dy, data.size.height(), display.size.height());
    let columns = Overlap::of(dx, data.size.width(), display.size.width());
    let (Some(rows), Some(columns)) = (rows, columns) else {
        return Err("has its data window outside of its display window: nothing would be visible".into());
    };
    let mut placed = Array3::zeros((planes.dim().0, display.size.height(), display.size.width()));
    let source = planes.slice(s![
        ..,
        rows.source..rows.source + rows.length,
        columns.source..columns.source + columns.length
    ]);
    placed
        .slice_mut(s![
            ..,
            rows.target..rows.target + rows.length,
            columns.target..columns.target + columns.length
        ])
        .assign(&source);
    Ok(placed)
}

/// The part that two intervals share, as seen from the start of each.
struct Overlap {
    source: usize,
    target: usize,
    length: usize,
}

impl Overlap {
    /// The overlap of `[offset, offset + size)` with `[0, window)`.
    fn of(offset: i32, size: usize, window: usize) -> Option<Self> {
        let shift = usize::try_from(offset.unsigned_abs()).ok()?;
        let (source, target) = if offset < 0 { (shift, 0) } else { (0, shift) };
        let length = size.checked_sub(source)?.min(window.checked_sub(target)?);
        (length > 0).then_some(Self { source, target, length })
    }
}

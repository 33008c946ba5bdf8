//! Reads the blocks of one OpenEXR layer: finds them in the file, decodes them in parallel, copies them to planes.
//!
//! The blocks are cut out of the file here, not by the crate's reader, which would allocate whatever length a
//! damaged block declares.

use std::collections::HashSet;

use ::exr::block::UncompressedBlock;
use ::exr::block::chunk::{
    Chunk, CompressedBlock, CompressedScanLineBlock, CompressedTileBlock, TileCoordinates,
};
use ::exr::compression::Compression;
use ::exr::math::Vec2;
use ::exr::meta::attribute::SampleType;
use ::exr::meta::header::Header;
use ::exr::meta::{BlockDescription, MetaData};
use half::f16;
use ndarray::parallel::prelude::*;
use ndarray::{Array3, ArrayViewMut2, Axis, s};

use super::WAVE;
use super::layers::Layer;
use super::limits::max_ratio;
use crate::io::guard::guarded;

/// The places of the uncompressed lengths among the 11 numbers that a DWA block starts with: unknown, run-length
/// coded, raw, coefficients, means.
const UNCOMPRESSED_COUNTERS: [usize; 5] = [1, 6, 7, 8, 9];

/// What the blocks of a layer hold.
pub(super) struct Decoded {
    /// Its planes over the data window.
    pub(super) planes: Array3<f32>,
    /// How many pixels its alpha does not call opaque.
    pub(super) transparent: usize,
}

/// An alpha that differs from 1 by no more is opaque: half floats round.
const OPAQUE: f32 = 1e-3;

/// Decodes the full-resolution blocks of a layer to planes of its data window.
///
/// `tables_start` is where the header ends and the tables of block positions start.
pub(super) fn decode_layer(
    bytes: &[u8],
    tables_start: usize,
    meta: &MetaData,
    layer: &Layer,
) -> Result<Decoded, String> {
    let header = &meta.headers[layer.header];
    let Vec2(width, height) = header.layer_size;
    let offsets = block_offsets(bytes, tables_start, meta, layer.header)?;
    let mut planes = Array3::zeros((layer.channels.len(), height, width));
    let mut seen = HashSet::new();
    let (mut covered, mut transparent) = (0, 0);
    for wave in offsets.chunks(WAVE) {
        let blocks = wave
            .par_iter()
            .map(|&offset| guarded(|| decode_block(bytes, offset, meta, layer.header)))
            .collect::<Result<Vec<Option<UncompressedBlock>>, String>>()?;
        let blocks: Vec<UncompressedBlock> = blocks.into_iter().flatten().collect();
        for block in &blocks {
            check_place(block, header)?;
            if seen.insert(block.index.pixel_position) {
                covered += block.index.pixel_size.area();
            }
        }
        if let Some(alpha) = layer.alpha {
            transparent +=
                blocks.par_iter().map(|block| transparent_pixels(block, header, alpha)).sum::<usize>();
        }
        planes.axis_iter_mut(Axis(0)).into_par_iter().zip(&layer.channels).for_each(
            |(mut plane, channel)| {
                blocks.iter().for_each(|block| copy_channel(block, header, *channel, &mut plane));
            },
        );
    }
    if covered == width * height {
        Ok(Decoded { planes, transparent })
    } else {
        Err("is damaged: some of its blocks are missing".into())
    }
}

/// The positions of the blocks of part `part`, from the tables that follow the header.
fn block_offsets(
    bytes: &[u8],
    tables_start: usize,
    meta: &MetaData,
    part: usize,
) -> Result<Vec<usize>, String> {
    let entries_before: usize = meta.headers[..part].iter().map(|header| header.chunk_count).sum();
    let start = tables_start + entries_before * size_of::<u64>();
    let end = start + meta.headers[part].chunk_count * size_of::<u64>();
    let table = bytes.get(start..end).ok_or("is truncated inside of its table of blocks")?;
    let entries = table.as_chunks::<8>().0.iter().map(|entry| usize::try_from(u64::from_le_bytes(*entry)));
    entries
        .collect::<Result<_, _>>()
        .map_err(|_| "is damaged: a block lies beyond the end of the file".into())
}

/// Cuts out and decodes one block; `None` for a block of a lower resolution.
fn decode_block(
    bytes: &[u8],
    offset: usize,
    meta: &MetaData,
    part: usize,
) -> Result<Option<UncompressedBlock>, String> {
    let mut rest = bytes.get(offset..).ok_or("is truncated: a block lies beyond the end of the file")?;
    if meta.requirements.is_multilayer() && usize::try_from(take_i32(&mut rest)?) != Ok(part) {
        return Err("is damaged: a block belongs to another part".into());
    }
    let header = &meta.headers[part];
    let compressed_block = match header.blocks {
        BlockDescription::ScanLines => {
            let y_coordinate = take_i32(&mut rest)?;
            CompressedBlock::ScanLine(CompressedScanLineBlock {
                y_coordinate,
                compressed_pixels_le: take_data(&mut rest)?,
            })
        }
        BlockDescription::Tiles(_) => {
            let tile_index = Vec2(take_index(&mut rest)?, take_index(&mut rest)?);
            let level_index = Vec2(take_index(&mut rest)?, take_index(&mut rest)?);
            if level_index != Vec2(0, 0) {
                return Ok(None);
            }
            let coordinates = TileCoordinates { tile_index, level_index };
            CompressedBlock::Tile(CompressedTileBlock {
                coordinates,
                compressed_pixels_le: take_data(&mut rest)?,
            })
        }
    };
    check_declared_lengths(&compressed_block, header)
        .and_then(|()| {
            let chunk = Chunk { layer_index: part, compressed_block };
            UncompressedBlock::decompress_chunk(chunk, meta, false)
        })
        .map(Some)
        .map_err(|error| format!("is damaged: {error}"))
}

fn take_i32(rest: &mut &[u8]) -> Result<i32, String> {
    let (value, after) = rest.split_first_chunk::<4>().ok_or("is truncated at a block")?;
    *rest = after;
    Ok(i32::from_le_bytes(*value))
}

fn take_index(rest: &mut &[u8]) -> Result<usize, String> {
    usize::try_from(take_i32(rest)?).map_err(|_| "is damaged: a tile has a negative index".into())
}

fn take_data(rest: &mut &[u8]) -> Result<Vec<u8>, String> {
    let length = take_index(rest)?;
    let data = rest.get(..length).ok_or("is truncated inside of a block")?;
    Ok(data.to_vec())
}

/// Refuses a block that is too short for its pixels, and a DWA block whose own header declares sections larger
/// than its pixels can need: the crate would allocate either unseen.
fn check_declared_lengths(block: &CompressedBlock, header: &Header) -> ::exr::error::Result<()> {
    let data = match block {
        CompressedBlock::ScanLine(block) => &block.compressed_pixels_le,
        CompressedBlock::Tile(block) => &block.compressed_pixels_le,
        _ => return Ok(()),
    };
    let area = header.get_absolute_block_pixel_coordinates(header.get_block_data_indices(block)?)?.size;
    let damaged = |reason: &'static str| Err(::exr::error::Error::Invalid(reason.into()));
    let needed = area.area() * header.channels.bytes_per_pixel;
    if needed > data.len().saturating_mul(max_ratio(header.compression)) {
        return damaged("a block is too short for its pixels");
    }
    let is_dwa = matches!(header.compression, Compression::DWAA(_) | Compression::DWAB(_));
    if !is_dwa || data.len() == needed {
        return Ok(());
    }
    // Whole 8 × 8 blocks of coefficients, each no larger than a sample; run-length coding at most doubles what
    // it cannot shorten.
    let samples = area.width().next_multiple_of(8) * area.height().next_multiple_of(8);
    let limit = 2 * samples * header.channels.bytes_per_pixel;
    let counters = data.as_chunks::<8>().0;
    let mut declared = UNCOMPRESSED_COUNTERS.iter().filter_map(|&index| counters.get(index));
    if declared.any(|counter| u64::from_le_bytes(*counter) > limit as u64) {
        return damaged("a block declares more data than it has pixels");
    }
    Ok(())
}

/// Refuses a block that lies outside of the image, or has more or less data than its pixels.
fn check_place(block: &UncompressedBlock, header: &Header) -> Result<(), String> {
    let (Vec2(left, top), Vec2(width, height)) = (block.index.pixel_position, block.index.pixel_size);
    let Vec2(columns, rows) = header.layer_size;
    let bytes = header.channels.bytes_per_pixel * width * height;
    if left + width > columns || top + height > rows || block.data.len() != bytes {
        return Err("is damaged: a block lies outside of the image".into());
    }
    Ok(())
}

/// Copies one channel of a block to its place in a plane.
fn copy_channel(
    block: &UncompressedBlock,
    header: &Header,
    channel: usize,
    plane: &mut ArrayViewMut2<'_, f32>,
) {
    let (Vec2(left, top), Vec2(width, height)) = (block.index.pixel_position, block.index.pixel_size);
    for row in 0..height {
        let mut target = plane.slice_mut(s![top + row, left..left + width]);
        let target = target.as_slice_mut().expect("rows of planes are contiguous");
        convert_line((block, header), channel, row, target);
    }
}

/// How many pixels of a block the channel `alpha` does not call opaque.
fn transparent_pixels(block: &UncompressedBlock, header: &Header, alpha: usize) -> usize {
    let Vec2(width, height) = block.index.pixel_size;
    let mut line = vec![0.0; width];
    let of_row = |row: usize| {
        convert_line((block, header), alpha, row, &mut line);
        line.iter().filter(|&&alpha| (alpha - 1.0).abs() > OPAQUE || alpha.is_nan()).count()
    };
    (0..height).map(of_row).sum()
}

/// Converts a row of one channel of a block.
fn convert_line(
    (block, header): (&UncompressedBlock, &Header),
    channel: usize,
    row: usize,
    target: &mut [f32],
) {
    let width = block.index.pixel_size.width();
    let list = &header.channels.list;
    let before: usize = list[..channel].iter().map(|other| other.sample_type.bytes_per_sample()).sum();
    let sample_type = list[channel].sample_type;
    let start = (row * header.channels.bytes_per_pixel + before) * width;
    let line = &block.data[start..start + width * sample_type.bytes_per_sample()];
    convert(line, sample_type, target);
}

/// Converts one line of native-endian samples.
fn convert(line: &[u8], sample_type: SampleType, target: &mut [f32]) {
    match sample_type {
        SampleType::F16 => convert_each(line, target, |bytes| f16::from_ne_bytes(bytes).to_f32()),
        SampleType::F32 => convert_each(line, target, f32::from_ne_bytes),
        SampleType::U32 => convert_each(line, target, |bytes| u32::from_ne_bytes(bytes) as f32),
    }
}

fn convert_each<const N: usize>(line: &[u8], target: &mut [f32], convert: impl Fn([u8; N]) -> f32) {
    for (value, bytes) in target.iter_mut().zip(line.as_chunks::<N>().0) {
        *value = convert(*bytes);
    }
}

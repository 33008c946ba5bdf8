//! Refuses damaged OpenEXR headers before anything is allocated for the image that they declare.

use std::path::Path;

use ::exr::compression::Compression;
use ::exr::math::Vec2;
use ::exr::meta::MetaData;
use ::exr::meta::header::Header;

use crate::core::error::{Error, Result};
use crate::io::MAX_PIXELS;

/// Bytes of image per byte of file that no lossless method reaches: deflate ends at 1032.
const MAX_RATIO: usize = 1100;
/// The same for the lossy DWA methods: two numbers for 64 half samples, then deflate.
const MAX_RATIO_LOSSY: usize = MAX_RATIO * 32;
/// Fewest bytes of a block in the file: its entry in the offset table, position, length, one byte of data.
const MIN_BLOCK_BYTES: usize = 8 + 4 + 4 + 1;
/// How much larger than the data a display window may be, in pixels.
const MAX_DISPLAY_RATIO: usize = 64;
/// The most channels that are believed.
const MAX_CHANNELS: usize = 1024;

/// Checks that the file can hold what its headers declare, and that it is of a kind that is read.
pub(super) fn check(path: &Path, meta: &MetaData, file_bytes: usize) -> Result<()> {
    let unsupported = |reason: &str| Err(Error::Unsupported(format!("{}: {reason}", path.display())));
    if meta.requirements.has_deep_data || meta.headers.iter().any(|header| header.deep) {
        return unsupported("deep images are not read; flatten it first");
    }
    let mut channels = meta.headers.iter().flat_map(|header| &header.channels.list);
    if channels.any(|channel| channel.sampling != Vec2(1, 1)) {
        return unsupported(
            "images with sub-sampled channels (luminance/chroma) are not read; convert it to RGB first",
        );
    }
    let methods = meta.headers.iter().map(|header| header.compression);
    for method in methods {
        if matches!(method, Compression::HTJ2K32 | Compression::HTJ2K256) {
            return unsupported("HTJ2K compression is not read; store it with ZIP compression");
        }
    }
    check_sizes(meta, file_bytes).map_err(|reason| Error::format(path, reason))
}

fn check_sizes(meta: &MetaData, file_bytes: usize) -> Result<(), String> {
    if meta.headers.is_empty() {
        return Err("has no image in it".into());
    }
    for header in &meta.headers {
        check_size(header, file_bytes)?;
    }
    let blocks = meta.headers.iter().fold(0_usize, |sum, header| sum.saturating_add(header.chunk_count));
    if blocks.saturating_mul(MIN_BLOCK_BYTES) > file_bytes {
        return Err(format!("is truncated or damaged: {blocks} blocks do not fit in its {file_bytes} bytes"));
    }
    Ok(())
}

fn check_size(header: &Header, file_bytes: usize) -> Result<(), String> {
    let Vec2(width, height) = header.layer_size;
    let display = header.shared_attributes.display_window.size;
    let pixels = width.saturating_mul(height);
    let visible = display.width().saturating_mul(display.height());
    if pixels == 0 || visible == 0 {
        return Err("is empty: its data or display window has no pixel".into());
    }
    if pixels > MAX_PIXELS || visible > MAX_PIXELS {
        return Err(format!(
            "declares {width} × {height} pixels, more than the limit of {MAX_PIXELS}; it is damaged"
        ));
    }
    if visible > pixels.saturating_mul(MAX_DISPLAY_RATIO) {
        return Err("has a display window far larger than its data; it is damaged".into());
    }
    if header.channels.list.len() > MAX_CHANNELS {
        return Err(format!("declares {} channels; it is damaged", header.channels.list.len()));
    }
    let bytes = pixels.saturating_mul(header.channels.bytes_per_pixel);
    if bytes > file_bytes.saturating_mul(max_ratio(header.compression)) {
        return Err(format!(
            "is truncated or damaged: {width} × {height} pixels do not fit in its {file_bytes} bytes"
        ));
    }
    Ok(())
}

/// Bytes of image that one byte of file can hold at most.
pub(super) fn max_ratio(compression: Compression) -> usize {
    match compression {
        Compression::DWAA(_) | Compression::DWAB(_) => MAX_RATIO_LOSSY,
        _ => MAX_RATIO,
    }
}

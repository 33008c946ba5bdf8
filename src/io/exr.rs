//! Reads and writes OpenEXR images: channels by name, data placed in the display window, numbers as they are
//! (unlike in other formats, integers are not scaled).
//!
//! Blocks are decoded and encoded on the shared thread pool, a wave at a time, so that beside the file and the
//! planes only a few blocks are in memory.

mod blocks;
mod chromaticities;
mod groups;
mod layers;
mod limits;
mod tables;
mod window;
mod write;

use std::io::Cursor;
use std::path::Path;

use ::exr::math::Vec2;
use ::exr::meta::MetaData;
use ::exr::meta::attribute::{AttributeValue, SampleType, Text};
use ::exr::meta::header::Header;

use super::format::{Encoding, Format};
use super::guard::guarded;
use super::layer::locate;
use super::pixels::doubt_of_shape;
use super::{DomainTag, Pixels};
use crate::core::bayer::BayerPattern;
use crate::core::capture::CaptureInfo;
use crate::core::error::{Error, Result};
use crate::core::provenance::Provenance;

pub use groups::ImageLayer;
pub(super) use tables::{BlockTable, block_table_of_head};
pub(super) use write::Encoder;

/// The attribute that says the domain of an image.
const DOMAIN_ATTRIBUTE: &str = "udc:domain";
/// The attribute that holds the provenance as JSON.
const PROVENANCE_ATTRIBUTE: &str = "udc:provenance";

/// The attribute that holds what is known of the capture as JSON.
const CAPTURE_ATTRIBUTE: &str = "udc:capture";

/// Number of blocks that are decoded or encoded at once: enough for any number of threads.
const WAVE: usize = 64;

/// Decodes the layer of a file that its path names, else its one RGB or grey layer, or, with a pattern, its packed mosaic.
pub(super) fn decode(path: &Path, bytes: &[u8], packed: Option<BayerPattern>) -> Result<(Pixels, Encoding)> {
    let damaged = |reason: String| Error::format(path, reason);
    let (meta, header_end) = read_meta(bytes).map_err(damaged)?;
    limits::check(path, &meta, bytes.len())?;
    let layer = layers::choose_layer(&meta, packed, locate(path).1).map_err(damaged)?;
    let blocks::Decoded { mut planes, transparent } =
        blocks::decode_layer(bytes, header_end, &meta, &layer).map_err(damaged)?;
    let header = &meta.headers[layer.header];
    if layer.is_chroma {
        chromaticities::rgb_of_chroma(&mut planes, header);
    }
    let doubts = doubts_of(header).into_iter().chain(doubt_of_alpha(transparent, header)).collect();
    let sample_type = match header.channels.list[layer.channels[0]].sample_type {
        SampleType::F16 => "half",
        SampleType::F32 => "float",
        SampleType::U32 => "uint32",
    };
    let planes = window::place_in_display_window(planes, header).map_err(damaged)?;
    let pixels = Pixels {
        domain: text_attribute(header, DOMAIN_ATTRIBUTE).and_then(|name| DomainTag::from_name(&name)),
        exposure_s: exposure_of(header),
        iso: header.own_attributes.iso_speed.map(f64::from).filter(is_positive),
        provenance: text_attribute(header, PROVENANCE_ATTRIBUTE)
            .and_then(|json| serde_json::from_str(&json).ok()),
        capture: capture_of(header).map_err(damaged)?,
        without_data: window::pixels_without_data(header),
        doubts,
        ..Pixels::of_planes(planes)
    };
    Ok((pixels, Encoding { format: Format::Exr, sample_type: sample_type.to_owned() }))
}

/// What the header says and is not heeded.
fn doubts_of(header: &Header) -> Vec<String> {
    let aspect = f64::from(header.shared_attributes.pixel_aspect);
    chromaticities::doubt(header).into_iter().chain(doubt_of_shape(aspect, "pixelAspectRatio")).collect()
}

/// What to tell of an alpha that does not call so many pixels opaque: light that is premultiplied by it, as OpenEXR has it.
fn doubt_of_alpha(transparent: usize, header: &Header) -> Option<String> {
    let pixels = header.layer_size.area();
    (transparent > 0).then(|| {
        format!(
            "its alpha is not 1 at {transparent} of {pixels} pixels and is not read: their light is taken as it is, as if it stood \
             before darkness; put the image over what is behind it, or remove the channel A"
        )
    })
}

/// The provenance that the header at the start of `bytes` carries, if they are the start of an EXR file.
pub(super) fn provenance_of_head(path: &Path, bytes: &[u8]) -> Option<Provenance> {
    let (meta, _) = read_meta(bytes).ok()?;
    let json = text_attribute(header_of_image(path, &meta)?, PROVENANCE_ATTRIBUTE)?;
    serde_json::from_str(&json).ok()
}

/// What the header at the start of `bytes` says of the capture, if they are the start of an EXR file.
pub(super) fn capture_of_head(path: &Path, bytes: &[u8]) -> Result<Option<CaptureInfo>, String> {
    let Ok((meta, _)) = read_meta(bytes) else { return Ok(None) };
    header_of_image(path, &meta).map_or(Ok(None), capture_of)
}

/// The header of the part that is read, else the first.
fn header_of_image<'a>(path: &Path, meta: &'a MetaData) -> Option<&'a Header> {
    let chosen = layers::choose_layer(meta, None, locate(path).1);
    meta.headers.get(chosen.map_or(0, |layer| layer.header))
}

/// What can be read of the file that starts with `bytes`; nothing of one that is no EXR or damaged.
pub(super) fn layers_of_head(bytes: &[u8]) -> Vec<ImageLayer> {
    read_meta(bytes).map_or(Vec::new(), |(meta, _)| groups::list(&meta))
}

fn capture_of(header: &Header) -> Result<Option<CaptureInfo>, String> {
    let json = text_attribute(header, CAPTURE_ATTRIBUTE);
    let info = json.map(|json| CaptureInfo::from_json(&json)).transpose().map_err(|reason| {
        format!("has a damaged attribute {CAPTURE_ATTRIBUTE}: {reason}; restore the capture again")
    })?;
    Ok(chromaticities::with_primaries(info, header))
}

/// The height and width of the image in a file that starts with `bytes`, and its domain; `None` where reading the file
/// would be an error.
pub(super) fn size_of_head(
    path: &Path,
    bytes: &[u8],
    file_bytes: u64,
) -> Option<([usize; 2], Option<DomainTag>)> {
    let (meta, _) = read_meta(bytes).ok()?;
    limits::check(path, &meta, usize::try_from(file_bytes).ok()?).ok()?;
    let header = &meta.headers[layers::choose_layer(&meta, None, locate(path).1).ok()?.header];
    let Vec2(width, height) = header.shared_attributes.display_window.size;
    let domain = text_attribute(header, DOMAIN_ATTRIBUTE).and_then(|name| DomainTag::from_name(&name));
    Some(([height, width], domain))
}

/// The headers of all parts, and where they end.
fn read_meta(bytes: &[u8]) -> Result<(MetaData, usize), String> {
    let mut file = Cursor::new(bytes);
    let meta = guarded(|| {
        MetaData::read_from_buffered(&mut file, false)
            .map_err(|error| format!("is damaged or no OpenEXR image: {error}"))
    })?;
    let end = usize::try_from(file.position()).expect("the position is inside of the file in memory");
    Ok((meta, end))
}

fn text_attribute(header: &Header, name: &str) -> Option<String> {
    match attribute(header, name)? {
        AttributeValue::Text(text) => Some(utf8(text)),
        _ => None,
    }
}

/// UTF-8 text; the crate's own conversion takes each byte for a character.
fn utf8(text: &Text) -> String {
    String::from_utf8_lossy(text.bytes()).into_owned()
}

fn attribute<'a>(header: &'a Header, name: &str) -> Option<&'a AttributeValue> {
    let name = Text::new_or_none(name)?;
    header.own_attributes.other.get(&name).or_else(|| header.shared_attributes.other.get(&name))
}

/// The exposure time in seconds: the standard attribute, or the one that some converters write.
fn exposure_of(header: &Header) -> Option<f64> {
    let standard = header.own_attributes.exposure.map(f64::from);
    let exposure = standard.or_else(|| match attribute(header, "ExposureTime")? {
        AttributeValue::F32(seconds) => Some(f64::from(*seconds)),
        AttributeValue::F64(seconds) => Some(*seconds),
        AttributeValue::Rational((numerator, denominator)) => {
            Some(f64::from(*numerator) / f64::from(*denominator))
        }
        AttributeValue::Text(text) => utf8(text).trim().parse().ok(),
        _ => None,
    });
    exposure.filter(is_positive)
}

fn is_positive(value: &f64) -> bool {
    value.is_finite() && *value > 0.0
}

//! Reads and writes PNG, JPEG, TIFF and Radiance HDR as planes of floats.

mod encode;
mod gain_map;

use std::io::Cursor;
use std::path::Path;

use image::{ColorType, DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use ndarray::Array3;

use super::directory::Directory;
use super::exif::Said;
use super::format::{Encoding, Format};
use super::guard::guarded;
use super::planes::from_interleaved;
use super::{ColorTag, MAX_PIXELS, Pixels, color_tags, jpeg, radiance, tiff};
use crate::core::capture::CaptureInfo;
use crate::core::error::{Error, Result};
use crate::core::primaries::Primaries;

/// The most memory a decoder may take beside the image: a frame of [`MAX_PIXELS`] at 16 bits.
pub(super) const MAX_DECODER_BYTES: u64 = MAX_PIXELS as u64 * 8;

/// Bytes of image per byte of file that PNG and TIFF do not reach: LZW ends near 2730, deflate at 1032.
pub(super) const MAX_RATIO: u64 = 4096;

pub(super) use encode::encode;
pub use gain_map::GAIN_OFFSET;
pub(super) use gain_map::attach;

/// What a decoder found, before it becomes planes.
enum Decoded {
    Image(DynamicImage),
    Bands(tiff::Bands),
}

/// Decodes an image; grey stays one plane, integers are divided by their type's maximum. A fourth channel is kept if it is
/// `packed` with the others.
pub(super) fn decode(path: &Path, bytes: &[u8], format: Format, packed: bool) -> Result<(Pixels, Encoding)> {
    if format == Format::Jpeg && !jpeg::is_whole(bytes) {
        return Err(Error::format(path, "is truncated or damaged: the end of the image is missing"));
    }
    let damaged = |reason| Error::format(path, reason);
    let header =
        (format == Format::Hdr).then(|| radiance::Header::read(bytes)).transpose().map_err(damaged)?;
    let (decoded, Beside { profile, said }) =
        guarded(|| decode_samples(bytes, format, packed)).map_err(damaged)?;
    let (mut planes, sample_type) = match decoded {
        Decoded::Bands(bands) => {
            let (planes, sample_type) = bands.into_planes();
            (without_alpha(planes, packed).map_err(damaged)?, sample_type)
        }
        Decoded::Image(image) => {
            let sample_type = match image.color() {
                ColorType::L8 | ColorType::La8 | ColorType::Rgb8 | ColorType::Rgba8 => "uint8",
                ColorType::L16 | ColorType::La16 | ColorType::Rgb16 | ColorType::Rgba16 => "uint16",
                _ => "float",
            };
            (to_planes(&image, packed).map_err(damaged)?, sample_type)
        }
    };
    if format == Format::Png {
        color_tags::widen_range(bytes, &mut planes, if sample_type == "uint16" { 16 } else { 8 });
    }
    let mut color_tags = color_tags_of(bytes, format, profile);
    let mut primaries = color_tags::other_primaries(&color_tags);
    if let Some(header) = header {
        header.undo(&mut planes).map_err(damaged)?;
        (color_tags, primaries) = (header.tags, header.primaries);
    }
    let is_integer = sample_type.starts_with("uint");
    let (exposure_s, iso) = said.exif.as_ref().map_or((None, None), |exif| (exif.exposure_s, exif.iso));
    let Said { exif, orientation } = said;
    let coding_error = (format == Format::Jpeg).then(|| jpeg::quantisation_error(bytes)).flatten();
    let info = CaptureInfo { exif, orientation, primaries, coding_error, ..CaptureInfo::default() };
    let capture = (info != CaptureInfo::default()).then_some(info);
    let pixels = Pixels { is_integer, color_tags, capture, exposure_s, iso, ..Pixels::of_planes(planes) };
    Ok((pixels, Encoding { format, sample_type: sample_type.to_owned() }))
}

/// What a file says of its colours, whose ICC profile is `profile`.
fn color_tags_of(bytes: &[u8], format: Format, profile: Option<Vec<u8>>) -> Vec<ColorTag> {
    let is_png = format == Format::Png;
    let mut tags = if is_png { color_tags::of_png(bytes) } else { Vec::new() };
    let place = if is_png { "iCCP chunk" } else { "ICC profile" };
    tags.extend(profile.map(|profile| color_tags::of_profile(place, &profile)));
    tags
}

/// The primaries that a file says, where they are others than those of sRGB; what is damaged says none. But for TIFF, the start of
/// the file is enough, as far as it holds what stands before the pixels.
pub(super) fn primaries_of(bytes: &[u8], format: Format) -> Option<Primaries> {
    if format == Format::Hdr {
        return radiance::Header::read(bytes).ok()?.primaries;
    }
    let of_decoder = || {
        let reader = ImageReader::with_format(Cursor::new(bytes), image_format(format));
        let mut decoder = reader.into_decoder().map_err(|error| error.to_string())?;
        Ok(decoder.icc_profile().ok().flatten())
    };
    let profile = match format {
        Format::Tiff => {
            let moved = with_page_first(bytes).ok().flatten();
            tiff::icc_profile(moved.as_deref().unwrap_or(bytes))
        }
        _ => guarded(of_decoder).ok().flatten(),
    };
    color_tags::other_primaries(&color_tags_of(bytes, format, profile))
}

/// What stands in a file beside its picture; what of it is damaged says nothing, the picture may still be whole.
struct Beside {
    /// The ICC profile that is embedded.
    profile: Option<Vec<u8>>,
    /// What its EXIF says.
    said: Said,
}

fn decode_samples(bytes: &[u8], format: Format, packed: bool) -> Result<(Decoded, Beside), String> {
    if format == Format::Tiff {
        return decode_tiff(bytes, packed);
    }
    let (image, beside) = decode_dynamic(bytes, format)?;
    Ok((Decoded::Image(image), beside))
}

/// Decodes the page of a TIFF file.
fn decode_tiff(bytes: &[u8], packed: bool) -> Result<(Decoded, Beside), String> {
    let moved = with_page_first(bytes)?;
    let said = |file: &[u8]| Directory::first(file).map_or_else(Said::default, |root| Said::of(&root));
    let said = moved.as_deref().map(said).unwrap_or_default().or(said(bytes));
    let bytes = moved.as_deref().unwrap_or(bytes);
    let beside = Beside { profile: tiff::icc_profile(bytes), said };
    Ok(match tiff::decode(bytes, packed)? {
        Some(bands) => (Decoded::Bands(bands), beside),
        None => (Decoded::Image(decode_dynamic(bytes, Format::Tiff)?.0), beside),
    })
}

/// A TIFF file with its page first, where its first directory is a preview; decoders read the first. None where that is the page, or
/// there are only previews.
///
/// # Errors
/// Where the file has several pages.
fn with_page_first(bytes: &[u8]) -> Result<Option<Vec<u8>>, String> {
    let Some(root) = Directory::first(bytes) else { return Ok(None) };
    match &root.pages()[..] {
        [page] if !page.is(&root) => Ok(page.as_first()),
        [] | [_] => Ok(None),
        pages => Err(format!(
            "holds {} pages, and which is meant is not said: save that page as a file of its own",
            pages.len()
        )),
    }
}

fn decode_dynamic(bytes: &[u8], format: Format) -> Result<(DynamicImage, Beside), String> {
    let mut limits = Limits::default();
    limits.max_alloc = Some(MAX_DECODER_BYTES);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), image_format(format));
    reader.limits(limits);
    let damaged = |error: image::ImageError| format!("cannot be decoded: {error}");
    let mut decoder = reader.into_decoder().map_err(damaged)?;
    let (width, height) = decoder.dimensions();
    let ratio = if matches!(format, Format::Png | Format::Tiff) { MAX_RATIO } else { u64::MAX };
    check_declared([width, height], decoder.total_bytes(), bytes, ratio)?;
    let profile = decoder.icc_profile().ok().flatten();
    let exif = decoder.exif_metadata().ok().flatten();
    let said = exif.map_or_else(Said::default, |block| Said::of_block(&block));
    Ok((DynamicImage::from_decoder(decoder).map_err(damaged)?, Beside { profile, said }))
}

/// Refuses an image of `image_bytes`, before anything is allocated for it, of no pixels or too many, or of more than `ratio`
/// times the bytes of its `file`.
pub(super) fn check_declared(
    [width, height]: [u32; 2],
    image_bytes: u64,
    file: &[u8],
    ratio: u64,
) -> Result<(), String> {
    let pixels = u64::from(width) * u64::from(height);
    if pixels == 0 || pixels > MAX_PIXELS as u64 {
        return Err(format!("declares {width} × {height} pixels; the limit is 1 to {MAX_PIXELS}"));
    }
    let length = file.len();
    if image_bytes > (length as u64).saturating_mul(ratio) {
        return Err(format!(
            "is truncated or damaged: {width} × {height} pixels do not fit in its {length} bytes"
        ));
    }
    Ok(())
}

/// The height and width of the image in a PNG, JPEG or Radiance HDR file that starts with `bytes`; `None` where its
/// header is damaged or goes on.
pub(super) fn size_of_head(bytes: &[u8], format: Format) -> Option<[usize; 2]> {
    let dimensions = || {
        let reader = ImageReader::with_format(Cursor::new(bytes), image_format(format));
        reader.into_decoder().map(|decoder| decoder.dimensions()).map_err(|error| error.to_string())
    };
    let (width, height) = guarded(dimensions).ok()?;
    let size = [usize::try_from(height).ok()?, usize::try_from(width).ok()?];
    (1..=MAX_PIXELS).contains(&size[0].checked_mul(size[1])?).then_some(size)
}

fn image_format(format: Format) -> ImageFormat {
    match format {
        Format::Png => ImageFormat::Png,
        Format::Jpeg => ImageFormat::Jpeg,
        Format::Tiff => ImageFormat::Tiff,
        Format::Hdr => ImageFormat::Hdr,
        Format::Exr | Format::Npy => unreachable!("decoded by their own modules"),
    }
}

fn to_planes(image: &DynamicImage, packed: bool) -> Result<Array3<f32>, String> {
    let shape = (usize::from(image.color().channel_count()), image.height() as usize, image.width() as usize);
    let planes = match image {
        DynamicImage::ImageLuma8(i) => from_interleaved(i.as_raw(), shape, from_u8),
        DynamicImage::ImageLumaA8(i) => from_interleaved(i.as_raw(), shape, from_u8),
        DynamicImage::ImageRgb8(i) => from_interleaved(i.as_raw(), shape, from_u8),
        DynamicImage::ImageRgba8(i) => from_interleaved(i.as_raw(), shape, from_u8),
        DynamicImage::ImageLuma16(i) => from_interleaved(i.as_raw(), shape, from_u16),
        DynamicImage::ImageLumaA16(i) => from_interleaved(i.as_raw(), shape, from_u16),
        DynamicImage::ImageRgb16(i) => from_interleaved(i.as_raw(), shape, from_u16),
        DynamicImage::ImageRgba16(i) => from_interleaved(i.as_raw(), shape, from_u16),
        DynamicImage::ImageRgb32F(i) => from_interleaved(i.as_raw(), shape, |v| v),
        DynamicImage::ImageRgba32F(i) => from_interleaved(i.as_raw(), shape, |v| v),
        other => return Err(format!("has colours of type {:?}, which is not read", other.color())),
    };
    without_alpha(planes, packed)
}

/// Planes without their alpha, which four `packed` ones do not have.
fn without_alpha(planes: Array3<f32>, packed: bool) -> Result<Array3<f32>, String> {
    if packed && planes.dim().0 == 4 { Ok(planes) } else { drop_alpha(planes) }
}

pub(super) fn from_u8(value: u8) -> f32 {
    f32::from(value) / f32::from(u8::MAX)
}

pub(super) fn from_u16(value: u16) -> f32 {
    f32::from(value) / f32::from(u16::MAX)
}

/// Removes an opaque alpha channel; the colour of transparent pixels is not defined.
fn drop_alpha(planes: Array3<f32>) -> Result<Array3<f32>, String> {
    let (channels, height, width) = planes.dim();
    if channels != 2 && channels != 4 {
        return Ok(planes);
    }
    let (mut samples, _) = planes.into_raw_vec_and_offset();
    let colours = (channels - 1) * height * width;
    if samples[colours..].iter().any(|&alpha| alpha < 1.0) {
        return Err("has transparent pixels; flatten it onto a background first".into());
    }
    samples.truncate(colours);
    Array3::from_shape_vec((channels - 1, height, width), samples).map_err(|error| error.to_string())
}

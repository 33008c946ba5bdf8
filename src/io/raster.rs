//! Reads and writes PNG, JPEG, TIFF and Radiance HDR as planes of floats.

use std::io::Cursor;
use std::path::Path;

use image::codecs::hdr::HdrEncoder;
use image::codecs::jpeg::JpegEncoder;
use image::{
    ColorType, DynamicImage, ExtendedColorType, ImageDecoder, ImageFormat, ImageReader, Limits, Rgb,
};
use ndarray::{Array3, ArrayView3};

use super::format::{Encoding, Format};
use super::guard::guarded;
use super::planes::{from_interleaved, to_interleaved};
use super::{MAX_PIXELS, PixelOptions, Pixels, color_tags, jpeg, tiff};
use crate::core::error::{Error, Result};

/// The most memory a decoder may take beside the image: a frame of [`MAX_PIXELS`] at 16 bits.
pub(super) const MAX_DECODER_BYTES: u64 = MAX_PIXELS as u64 * 8;

/// Bytes of image per byte of file that PNG and TIFF do not reach: LZW ends near 2730, deflate at 1032.
pub(super) const MAX_RATIO: u64 = 4096;

/// Beyond this the files grow and the pictures do not get better to the eye.
const JPEG_QUALITY: u8 = 95;

/// The brightest value of Radiance HDR: a mantissa of 255/256 and an exponent of 127.
const HDR_MAX: f32 = 255.0 / 256.0 * (1u128 << 127) as f32;

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
    let (decoded, profile) = guarded(|| decode_samples(bytes, format, packed)).map_err(damaged)?;
    let (planes, sample_type) = match decoded {
        Decoded::Bands(bands) => bands.into_planes(),
        Decoded::Image(image) => {
            let sample_type = match image.color() {
                ColorType::L8 | ColorType::La8 | ColorType::Rgb8 | ColorType::Rgba8 => "uint8",
                ColorType::L16 | ColorType::La16 | ColorType::Rgb16 | ColorType::Rgba16 => "uint16",
                _ => "float",
            };
            (to_planes(&image, packed).map_err(damaged)?, sample_type)
        }
    };
    let is_png = format == Format::Png;
    let mut color_tags = if is_png { color_tags::of_png(bytes) } else { Vec::new() };
    let place = if is_png { "iCCP chunk" } else { "ICC profile" };
    color_tags.extend(profile.map(|profile| color_tags::of_profile(place, &profile)));
    let is_integer = sample_type.starts_with("uint");
    let pixels = Pixels { is_integer, color_tags, ..Pixels::of_planes(planes) };
    Ok((pixels, Encoding { format, sample_type: sample_type.to_owned() }))
}

/// The samples with the ICC profile that is embedded.
fn decode_samples(bytes: &[u8], format: Format, packed: bool) -> Result<(Decoded, Option<Vec<u8>>), String> {
    if format == Format::Tiff {
        let profile = tiff::icc_profile(bytes);
        return Ok(match tiff::decode(bytes, packed)? {
            Some(bands) => (Decoded::Bands(bands), profile),
            None => (Decoded::Image(decode_dynamic(bytes, format)?.0), profile),
        });
    }
    let (image, profile) = decode_dynamic(bytes, format)?;
    Ok((Decoded::Image(image), profile))
}

/// The image with the ICC profile that is embedded.
fn decode_dynamic(bytes: &[u8], format: Format) -> Result<(DynamicImage, Option<Vec<u8>>), String> {
    let mut limits = Limits::default();
    limits.max_alloc = Some(MAX_DECODER_BYTES);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), image_format(format));
    reader.limits(limits);
    let damaged = |error: image::ImageError| format!("cannot be decoded: {error}");
    let mut decoder = reader.into_decoder().map_err(damaged)?;
    let (width, height) = decoder.dimensions();
    let ratio = if matches!(format, Format::Png | Format::Tiff) { MAX_RATIO } else { u64::MAX };
    check_declared([width, height], decoder.total_bytes(), bytes, ratio)?;
    // A profile that is damaged says nothing; the picture may still be whole.
    let profile = decoder.icc_profile().ok().flatten();
    Ok((DynamicImage::from_decoder(decoder).map_err(damaged)?, profile))
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

/// Encodes planes: 16 bits in PNG and TIFF unless 8 are wanted, 8 bits in JPEG, shared-exponent floats in Radiance
/// HDR.
pub(super) fn encode(
    planes: &ArrayView3<'_, f32>,
    format: Format,
    options: PixelOptions,
) -> Result<Vec<u8>, String> {
    let channels = planes.dim().0;
    if channels != 1 && channels != 3 {
        return Err(format!("{} cannot hold {channels} channels; write .npy", format.name()));
    }
    check_values(planes, format, options)?;
    if format == Format::Hdr {
        encode_hdr(planes)
    } else {
        encode_integers(planes, format, options.eight_bit)
    }
}

/// Refuses values that the format would change beyond rounding, unless they may be clipped.
fn check_values(planes: &ArrayView3<'_, f32>, format: Format, options: PixelOptions) -> Result<(), String> {
    let name = format.name();
    if let Some(((c, y, x), value)) = planes.indexed_iter().find(|(_, value)| !value.is_finite()) {
        return Err(format!(
            "{name} cannot hold {value}, found at row {y}, column {x}, channel {c}; replace such values, or write .exr \
             or .npy"
        ));
    }
    let min = planes.iter().copied().fold(f32::INFINITY, f32::min);
    let max = planes.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    if min < 0.0 && !(options.clip || options.clip_negative) {
        return Err(format!(
            "{name} holds no negative values and the image goes down to {min}; write .exr or .npy, or clip it with \
             `udc convert --clip`"
        ));
    }
    match format {
        _ if options.clip => Ok(()),
        Format::Hdr if max > HDR_MAX => Err(format!(
            "{name} ends at {HDR_MAX:.3e} and the image reaches {max:.3e}; write .exr or .npy, or clip it with `udc \
             convert --clip`"
        )),
        Format::Hdr => Ok(()),
        _ if max > 1.0 => Err(format!(
            "{name} holds values up to 1 and the image reaches {max}; tone map it first (`udc tonemap`), write .exr, \
             .hdr or .npy, or clip it with `udc convert --clip`"
        )),
        _ => Ok(()),
    }
}

fn encode_integers(planes: &ArrayView3<'_, f32>, format: Format, eight_bit: bool) -> Result<Vec<u8>, String> {
    let (channels, height, width) = planes.dim();
    let grey = channels == 1;
    let (samples, colour) = if eight_bit || format == Format::Jpeg {
        let samples = to_interleaved(planes, |v| [to_u8(v)]);
        (samples, if grey { ExtendedColorType::L8 } else { ExtendedColorType::Rgb8 })
    } else {
        let samples = to_interleaved(planes, |v| to_u16(v).to_ne_bytes());
        (samples, if grey { ExtendedColorType::L16 } else { ExtendedColorType::Rgb16 })
    };
    let (width, height) = sides(width, height)?;
    let mut file = Cursor::new(Vec::new());
    let encoded = match format {
        Format::Jpeg => {
            JpegEncoder::new_with_quality(&mut file, JPEG_QUALITY).encode(&samples, width, height, colour)
        }
        _ => {
            image::write_buffer_with_format(&mut file, &samples, width, height, colour, image_format(format))
        }
    };
    encoded.map_err(|error| error.to_string())?;
    Ok(file.into_inner())
}

fn encode_hdr(planes: &ArrayView3<'_, f32>) -> Result<Vec<u8>, String> {
    let (channels, height, width) = planes.dim();
    let value = |c: usize, y, x| planes[[c.min(channels - 1), y, x]].clamp(0.0, HDR_MAX);
    let pixels: Vec<Rgb<f32>> = (0..height * width)
        .map(|i| Rgb(to_shared_exponent([0, 1, 2].map(|c| value(c, i / width, i % width)))))
        .collect();
    let mut bytes = Vec::new();
    HdrEncoder::new(&mut bytes).encode(&pixels, width, height).map_err(|error| error.to_string())?;
    Ok(bytes)
}

/// Rounds a pixel to what Radiance HDR holds, three mantissas of 8 bits and an exponent; the encoder alone cuts off.
fn to_shared_exponent(pixel: [f32; 3]) -> [f32; 3] {
    let brightest = f64::from(pixel.into_iter().fold(0.0, f32::max));
    // Below this the format holds zero.
    if brightest < f64::from(f32::MIN_POSITIVE) {
        return pixel;
    }
    let exponent = brightest.log2().floor() + 1.0;
    #[expect(clippy::cast_possible_truncation, reason = "eight bits times a power of two")]
    let rounded = |step: f64| pixel.map(|value| ((f64::from(value) / step).round() * step) as f32);
    let step = (exponent - 8.0).exp2();
    let is_full = (brightest / step).round() > 255.0;
    rounded(if is_full { 2.0 * step } else { step }).map(|value| value.min(HDR_MAX))
}

fn sides(width: usize, height: usize) -> Result<(u32, u32), String> {
    match (u32::try_from(width), u32::try_from(height)) {
        (Ok(width), Ok(height)) => Ok((width, height)),
        _ => Err(format!("{width} × {height} pixels are too many")),
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the type's range")]
fn to_u8(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * f32::from(u8::MAX)).round() as u8
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the type's range")]
fn to_u16(value: f32) -> u16 {
    (value.clamp(0.0, 1.0) * f32::from(u16::MAX)).round() as u16
}

//! Writes planes of floats as PNG, JPEG, TIFF and Radiance HDR.

use image::codecs::hdr::HdrEncoder;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::error::UnsupportedError;
use image::{ExtendedColorType, ImageEncoder, Rgb};
use ndarray::ArrayView3;

use crate::core::exif::Exif;
use crate::core::primaries::ColorSpace;
use crate::io::exif::{self, Picture};
use crate::io::format::Format;
use crate::io::planes::to_interleaved;
use crate::io::tiff::{self, Samples};
use crate::io::{PixelOptions, icc};

/// Beyond this the files grow and the pictures do not get better to the eye.
const JPEG_QUALITY: u8 = 95;

/// The brightest value of Radiance HDR: a mantissa of 255/256 and an exponent of 127.
const HDR_MAX: f32 = 255.0 / 256.0 * (1u128 << 127) as f32;

/// Encodes planes: 16 bits in PNG and TIFF unless 8 are wanted, 8 bits in JPEG, shared-exponent floats in Radiance
/// HDR. Pictures carry the profile of their colours, where these are told, and what their camera says.
pub(in crate::io) fn encode(
    planes: &ArrayView3<'_, f32>,
    format: Format,
    options: PixelOptions,
    exif: Option<&Exif>,
) -> Result<Vec<u8>, String> {
    let channels = planes.dim().0;
    if channels != 1 && channels != 3 {
        return Err(format!("{} cannot hold {channels} channels; write .npy", format.name()));
    }
    check_values(planes, format, options)?;
    if format == Format::Hdr { encode_hdr(planes) } else { encode_integers(planes, format, options, exif) }
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

/// What stands in a picture beside its samples.
#[derive(Default)]
struct Beside {
    profile: Vec<u8>,
    exif: Vec<u8>,
}

impl Beside {
    fn of(picture: Picture, options: PixelOptions, exif: Option<&Exif>) -> Self {
        let profile = options.color_space.map(icc::profile_of).unwrap_or_default();
        let exif = exif.map(|said| exif::encode(said, picture)).unwrap_or_default();
        Self { profile, exif }
    }

    /// Hands what there is to an encoder, which leaves out what is empty.
    fn set(self, encoder: &mut impl ImageEncoder) -> Result<(), String> {
        let refused = |error: UnsupportedError| error.to_string();
        if !self.profile.is_empty() {
            encoder.set_icc_profile(self.profile).map_err(refused)?;
        }
        if !self.exif.is_empty() {
            encoder.set_exif_metadata(self.exif).map_err(refused)?;
        }
        Ok(())
    }
}

fn encode_integers(
    planes: &ArrayView3<'_, f32>,
    format: Format,
    options: PixelOptions,
    exif: Option<&Exif>,
) -> Result<Vec<u8>, String> {
    let (channels, height, width) = planes.dim();
    let grey = channels == 1;
    let (width, height) = sides(width, height)?;
    let is_srgb = options.color_space.is_none_or(|space| space == ColorSpace::Srgb);
    let picture = Picture { width, height, is_srgb };
    let eight_bit = options.eight_bit || format == Format::Jpeg;
    if format == Format::Tiff {
        let samples = match eight_bit {
            true => Samples::Bytes(to_interleaved(planes, |v| [to_u8(v)])),
            false => {
                let bytes = to_interleaved(planes, |v| to_u16(v).to_ne_bytes());
                Samples::Words(
                    bytes.as_chunks::<2>().0.iter().map(|word| u16::from_ne_bytes(*word)).collect(),
                )
            }
        };
        return tiff::encode(&samples, channels, picture, options.color_space, exif);
    }
    let (samples, colour) = if eight_bit {
        let samples = to_interleaved(planes, |v| [to_u8(v)]);
        (samples, if grey { ExtendedColorType::L8 } else { ExtendedColorType::Rgb8 })
    } else {
        let samples = to_interleaved(planes, |v| to_u16(v).to_ne_bytes());
        (samples, if grey { ExtendedColorType::L16 } else { ExtendedColorType::Rgb16 })
    };
    let beside = Beside::of(picture, options, exif);
    let mut file = Vec::new();
    let encoded = if format == Format::Jpeg {
        let mut encoder = JpegEncoder::new_with_quality(&mut file, JPEG_QUALITY);
        beside.set(&mut encoder)?;
        encoder.write_image(&samples, width, height, colour)
    } else {
        let mut encoder = PngEncoder::new(&mut file);
        beside.set(&mut encoder)?;
        encoder.write_image(&samples, width, height, colour)
    };
    encoded.map_err(|error| error.to_string())?;
    Ok(file)
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

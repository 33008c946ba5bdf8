//! Writes images in every format, each whole or not at all.

use std::io::{self, Cursor};
use std::path::Path;

use half::f16;
use ndarray::{ArrayView2, ArrayView3};

use super::format::Format;
use super::half_sides::beside_levels;
use super::{DomainTag, Pixels, WriteSeek, check_output, exr, npy, raster, write_atomically};
use crate::core::capture::CaptureInfo;
use crate::core::error::{Error, Result};
use crate::core::exif::Exif;
use crate::core::image::{Domain, Image, ToneMapped};
use crate::core::primaries::ColorSpace;
use crate::core::provenance::Provenance;

/// How an image is written.
#[derive(Clone, Debug, Default)]
pub struct WriteOptions {
    /// Half floats instead of floats, in formats that have both.
    pub half: bool,
    /// Whether an existing file may be replaced.
    pub overwrite: bool,
    /// What to say about the file's origin, in formats that can carry it.
    pub provenance: Option<Provenance>,
    /// What to say about the capture that the image was made of, in formats that can carry it.
    pub capture: Option<CaptureInfo>,
}

/// Writes an image in the format of the path's extension.
///
/// Integer formats clip tone-mapped values to `[0, 1]`; linear values above one are refused there. Negative ones, which
/// noise around black leaves, become zero there and in Radiance HDR.
///
/// # Errors
/// [`Error::Io`] when the file cannot be written or exists; [`Error::Unsupported`] when the format cannot hold
/// the values.
pub fn write_image<D: Domain>(path: &Path, image: &Image<D>, options: &WriteOptions) -> Result<()> {
    let (contents, options) = contents_of_image(image, options);
    write_contents(path, &contents, options)
}

/// The file that [`write_image`] writes, which no folder has yet; the path is for its extension and for errors.
///
/// # Errors
/// [`Error::Unsupported`] when the format cannot hold the values.
pub fn encode_image<D: Domain>(path: &Path, image: &Image<D>, options: &WriteOptions) -> Result<Vec<u8>> {
    let (contents, options) = contents_of_image(image, options);
    let mut bytes = Vec::new();
    encode(path, &contents, options, |encode| {
        encode(&mut Cursor::new(&mut bytes)).map_err(|source| Error::io("write", path, source))
    })?;
    Ok(bytes)
}

fn contents_of_image<'a, D: Domain>(
    image: &'a Image<D>,
    options: &'a WriteOptions,
) -> (Contents<'a>, PixelOptions) {
    let contents = Contents {
        planes: image.planes(),
        domain: DomainTag::from_name(D::NAME),
        exposure_s: None,
        iso: None,
        provenance: options.provenance.as_ref(),
        capture: options.capture.as_ref(),
    };
    let clip = D::NAME == ToneMapped::NAME;
    let WriteOptions { half, overwrite, .. } = *options;
    (contents, PixelOptions { half, overwrite, clip, clip_negative: true, ..PixelOptions::default() })
}

/// How pixels of any meaning are written.
#[derive(Clone, Copy, Debug, Default)]
pub struct PixelOptions {
    /// Half floats instead of floats, in formats that have both.
    pub half: bool,
    /// Whether an existing file may be replaced.
    pub overwrite: bool,
    /// Whether values outside of a format's range may be clipped.
    pub clip: bool,
    /// Whether negative values may be clipped, in formats that have none.
    pub clip_negative: bool,
    /// 8 bits instead of 16, in formats that have both.
    pub eight_bit: bool,
    /// The colours of a picture for viewing, whose profile is embedded in PNG, JPEG and TIFF.
    pub color_space: Option<ColorSpace>,
}

/// Writes pixels, with what is known of them, in the format of the path's extension.
///
/// # Errors
/// As [`write_image`].
pub fn write_pixels(path: &Path, pixels: &Pixels, options: PixelOptions) -> Result<()> {
    write_contents(path, &contents_of(pixels), options)
}

fn contents_of(pixels: &Pixels) -> Contents<'_> {
    Contents {
        planes: pixels.planes.view(),
        domain: pixels.domain,
        exposure_s: pixels.exposure_s,
        iso: pixels.iso,
        provenance: pixels.provenance.as_ref(),
        capture: pixels.capture.as_ref(),
    }
}

/// Writes a JPEG picture for viewing as [`write_pixels`] does, with the stops by which displays with headroom show each of its
/// pixels brighter.
///
/// # Equation
/// Of linear light l of the picture and its gain g: `l_HDR = (l + o)·2^g − o` with o = [`GAIN_OFFSET`](super::GAIN_OFFSET).
///
/// # Shapes
/// `gains` is `[height, width]`.
///
/// # Errors
/// As [`write_image`]; [`Error::Unsupported`] for files of other formats.
pub fn write_with_gains(
    path: &Path,
    pixels: &Pixels,
    gains: ArrayView2<'_, f32>,
    options: PixelOptions,
) -> Result<()> {
    let format = Format::of_extension(path)?;
    if format != Format::Jpeg {
        let reason = format!("gains for HDR displays are written in JPEG, and {} is none", path.display());
        return Err(Error::Unsupported(reason));
    }
    check_output(path, options.overwrite)?;
    let contents = contents_of(pixels);
    let picture = raster::encode(&contents.planes, format, options, exif_of(&contents));
    let bytes = picture.and_then(|picture| raster::attach(picture, gains));
    let bytes = bytes.map_err(|reason| Error::format(path, reason))?;
    write_atomically(path, options.overwrite, |file| file.write_all(&bytes))
}

/// What an encoder is given: pixels that belong to somebody else.
pub(super) struct Contents<'a> {
    pub(super) planes: ArrayView3<'a, f32>,
    pub(super) domain: Option<DomainTag>,
    pub(super) exposure_s: Option<f64>,
    pub(super) iso: Option<f64>,
    pub(super) provenance: Option<&'a Provenance>,
    pub(super) capture: Option<&'a CaptureInfo>,
}

fn write_contents(path: &Path, contents: &Contents<'_>, options: PixelOptions) -> Result<()> {
    Format::of_extension(path)?;
    check_output(path, options.overwrite)?;
    encode(path, contents, options, |encode| write_atomically(path, options.overwrite, encode))
}

/// What writes an image to a file.
type Encode<'a> = &'a mut dyn FnMut(&mut dyn WriteSeek) -> io::Result<()>;

/// Encodes an image for whom `write` gives what it is written to.
fn encode(
    path: &Path,
    contents: &Contents<'_>,
    options: PixelOptions,
    write: impl FnOnce(Encode<'_>) -> Result<()>,
) -> Result<()> {
    let format = Format::of_extension(path)?;
    check_light(path, format, contents.domain)?;
    let largest = f32::from(f16::MAX);
    let is_half = options.half && matches!(format, Format::Exr | Format::Npy);
    if let Some(planes) = is_half.then(|| beside_levels(contents)).flatten() {
        return encode(path, &Contents { planes: planes.view(), ..*contents }, options, write);
    }
    if is_half && options.clip && contents.planes.iter().any(|value| value.abs() > largest) {
        let planes = contents.planes.mapv(|value| value.clamp(-largest, largest));
        let clipped = Contents { planes: planes.view(), ..*contents };
        return encode(path, &clipped, PixelOptions { clip: false, ..options }, write);
    }
    let encoded = match format {
        Format::Exr => {
            let encoder = exr::Encoder::new(contents, options.half);
            let mut encoder = Some(encoder.map_err(|reason| Error::format(path, reason))?);
            return write(&mut |file| encoder.take().expect("an image is written once").write(file));
        }
        Format::Npy => npy::encode_image(&contents.planes, options.half),
        _ => raster::encode(&contents.planes, format, options, exif_of(contents)),
    };
    let bytes = encoded.map_err(|reason| Error::format(path, reason))?;
    write(&mut |file| file.write_all(&bytes))
}

/// Refuses pictures for viewing where they would be taken for light, in Radiance HDR and NumPy arrays, before the work.
///
/// # Errors
/// [`Error::Unsupported`] for such a file; [`Error::Format`] for one of no format that is written.
pub fn check_display(path: &Path) -> Result<()> {
    let format = Format::of_extension(path)?;
    check_light(path, format, Some(DomainTag::Display))?;
    if format != Format::Npy {
        return Ok(());
    }
    Err(Error::Unsupported(format!(
        "{} would hold values of a display, and a .npy cannot say so: it is read as linear light; write .png, .jpg, .tif or \
         .exr",
        path.display()
    )))
}

/// Refuses other values than light in Radiance HDR, whose values are light by definition: whoever reads them takes them for that.
pub(super) fn check_light(path: &Path, format: Format, domain: Option<DomainTag>) -> Result<()> {
    let (what, instead) = match domain {
        Some(DomainTag::ToneMapped) => {
            ("tone-mapped values", "write linear light, or .exr, .tif, .png or .npy")
        }
        Some(DomainTag::Display) => ("values of a display", "write .png, .jpg, .tif or .exr"),
        Some(DomainTag::Linear | DomainTag::Srgb) | None => return Ok(()),
    };
    if format != Format::Hdr {
        return Ok(());
    }
    let path = path.display();
    Err(Error::Unsupported(format!(
        "{path} would hold {what}, and those of Radiance HDR are linear light: {instead}"
    )))
}

/// What a picture for viewing says of its camera; light is no such picture.
fn exif_of<'a>(contents: &Contents<'a>) -> Option<&'a Exif> {
    contents.capture?.exif.as_ref().filter(|_| contents.domain == Some(DomainTag::Display))
}

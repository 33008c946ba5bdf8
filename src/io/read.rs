//! Reads images of every format: as they are stored, or as one of a domain.

use std::path::Path;

use ndarray::{Array3, ArrayView2, Axis, concatenate};

use super::format::{self, Encoding, Format};
use super::layer::locate;
use super::{DomainTag, HEAD_BYTES, ImageLayer, Pixels, dng, exr, npy, plain, raster};
use crate::core::bayer::BayerPattern;
use crate::core::capture::CaptureInfo;
use crate::core::error::{Error, Result};
use crate::core::image::{Domain, Image, Linear};
use crate::core::primaries::Primaries;
use crate::core::provenance::Provenance;

/// Reads an image file of any supported format; of an EXR, `file.exr:layer` reads one of its layers.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read, [`Error::Format`] when it is damaged or no image,
/// [`Error::Unsupported`] when it is an image of a kind that is not read.
pub fn read_pixels(path: &Path) -> Result<Pixels> {
    inspect_image(path).map(|(pixels, _)| pixels)
}

/// Reads an image file together with how it is stored.
///
/// # Errors
/// As [`read_pixels`].
pub fn inspect_image(path: &Path) -> Result<(Pixels, Encoding)> {
    let (format, bytes) = format::read_recognised(path)?;
    decode_image(path, &bytes, format, None)
}

/// Reads a picture of a sensor with how it is stored: four channels are a packed mosaic, not colours with an alpha.
///
/// The planes are the pattern's photosites in reading order. In OpenEXR the channels R, G1, G2, B (greens in reading
/// order) or R, Gr, Gb, B (greens in the rows of red and of blue) are found by name; R, G, B, A and the four channels of
/// other formats are the photosites in this order. An alpha that is opaque everywhere is no photosite.
///
/// # Errors
/// As [`read_pixels`].
pub fn inspect_mosaic(path: &Path, pattern: BayerPattern) -> Result<(Pixels, Encoding)> {
    let (format, bytes) = format::read_recognised(path)?;
    let (mut pixels, encoding) = decode_image(path, &bytes, format, Some(pattern))?;
    let is_opaque = |alpha: ArrayView2<'_, f32>| alpha.iter().all(|a| (a - 1.0).abs() < f32::EPSILON);
    let planes = &mut pixels.planes;
    if format != Format::Npy && planes.dim().0 == 4 && is_opaque(planes.index_axis(Axis(0), 3)) {
        planes.remove_index(Axis(0), 3);
    }
    Ok((pixels, encoding))
}

/// Reads the provenance of an image file without its pixels; formats other than EXR carry none.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read. A damaged file has no provenance: reading it says more.
pub fn read_provenance(path: &Path) -> Result<Option<Provenance>> {
    let head = plain::read_head(path, HEAD_BYTES)?;
    Ok(exr::provenance_of_head(path, &head))
}

/// Reads what an image file says of its capture, without its pixels; formats other than EXR carry nothing.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when what it says is damaged.
pub fn read_capture_info(path: &Path) -> Result<Option<CaptureInfo>> {
    let head = plain::read_head(path, HEAD_BYTES)?;
    exr::capture_of_head(path, &head).map_err(|reason| Error::format(path, reason))
}

/// Reads the primaries that an image file says, where they are others than those of sRGB, without its pixels. What of it is damaged
/// says none: reading the file says more.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when what it says of its capture is damaged.
pub fn read_primaries(path: &Path) -> Result<Option<Primaries>> {
    let head = plain::read_head(path, HEAD_BYTES)?;
    Ok(match Format::of_contents(&head) {
        Some(Format::Exr) => read_capture_info(path)?.and_then(|info| info.primaries),
        // Its directories may be anywhere.
        Some(format @ Format::Tiff) => raster::primaries_of(&plain::read_bytes(locate(path).0)?, format),
        Some(format @ (Format::Png | Format::Jpeg | Format::Hdr)) => raster::primaries_of(&head, format),
        Some(Format::Npy) | None => None,
    })
}

/// Lists what can be read of an image file of several layers or parts, which is an EXR: nothing of another, nor of one that
/// is damaged.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read.
pub fn read_layers(path: &Path) -> Result<Vec<ImageLayer>> {
    let head = plain::read_head(path, HEAD_BYTES)?;
    Ok(exr::layers_of_head(&head))
}

pub(super) fn decode_image(
    path: &Path,
    bytes: &[u8],
    format: Format,
    packed: Option<BayerPattern>,
) -> Result<(Pixels, Encoding)> {
    if let (file, Some(layer)) = locate(path)
        && format != Format::Exr
    {
        let reason = format!("is a {} file, which has no layers: leave out `:{layer}`", format.name());
        return Err(Error::format(file, reason));
    }
    match format {
        Format::Exr => exr::decode(path, bytes, packed),
        Format::Npy => npy::decode_image(path, bytes),
        Format::Tiff if dng::is_dng(bytes) => dng::decode(path, bytes),
        Format::Png | Format::Jpeg | Format::Tiff | Format::Hdr => {
            raster::decode(path, bytes, format, packed.is_some())
        }
    }
}

/// Reads an image of domain `D`; a grey file becomes three equal channels.
///
/// # Errors
/// As [`read_pixels`]; [`Error::Format`] when the file declares the other domain, holds packed Bayer data,
/// or holds values that are not finite.
pub fn read_image<D: Domain>(path: &Path) -> Result<Image<D>> {
    image_of(path, read_pixels(path)?)
}

/// As [`read_image`], of a file that may not say its domain: the user told it. Says what in the file contradicts that.
///
/// # Errors
/// As [`read_image`] and [`Pixels::tell`].
pub fn read_image_told<D: Domain>(
    path: &Path,
    told: Option<DomainTag>,
) -> Result<(Image<D>, Option<String>)> {
    let mut pixels = read_pixels(path)?;
    let contradiction = pixels.tell(path, told)?;
    if D::NAME == Linear::NAME {
        pixels.check_told_light(path)?;
    }
    Ok((image_of(path, pixels)?, contradiction))
}

/// Takes the pixels that were read from `path` for an image of domain `D`.
///
/// # Errors
/// As [`read_image`], but for those of reading.
pub fn image_of<D: Domain>(path: &Path, pixels: Pixels) -> Result<Image<D>> {
    check_domain(path, pixels.domain, D::NAME)?;
    check_cooked(path, &pixels)?;
    pixels.check_told(path)?;
    let planes = to_rgb(path, pixels.planes)?;
    Image::from_planes(planes).map_err(|error| Error::format(path, error.to_string()))
}

pub(super) fn check_domain(path: &Path, declared: Option<DomainTag>, needed: &str) -> Result<()> {
    let Some(tag) = declared.filter(|tag| tag.name() != needed) else { return Ok(()) };
    let found = tag.name();
    let advice = match tag {
        DomainTag::Linear => "convert the file with `udc tonemap`".to_owned(),
        DomainTag::ToneMapped => "convert the file with `udc tonemap --inverse`".to_owned(),
        DomainTag::Display | DomainTag::Srgb => format!(
            "use the image as it was before `udc finish`, or pass `--domain {needed}` to a command that has it to take \
             the values for that"
        ),
    };
    Err(Error::format(path, format!("holds {found} values where {needed} ones are needed; {advice}")))
}

pub(super) fn check_cooked(path: &Path, pixels: &Pixels) -> Result<()> {
    match pixels.raw {
        None => Ok(()),
        Some(_) => Err(Error::format(
            path,
            "is a camera's raw file; `udc fuse` and `udc restore` read it, other commands read what they write",
        )),
    }
}

/// Takes planes for the channels of a picture: three as they are, a grey one three times.
///
/// # Errors
/// [`Error::Format`] for any other number of channels; `path` is the file that they were read from.
pub fn to_rgb(path: &Path, planes: Array3<f32>) -> Result<Array3<f32>> {
    match planes.dim().0 {
        3 => Ok(planes),
        1 => {
            let grey = planes.view();
            concatenate(Axis(0), &[grey, grey, grey]).map_err(|error| Error::format(path, error.to_string()))
        }
        channels => Err(Error::format(
            path,
            format!(
                "has {channels} channels, as packed Bayer data; an RGB or grey image is needed (or --bayer, in a command \
                 that has it)"
            ),
        )),
    }
}

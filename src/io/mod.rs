//! The only opener of files: images, PSFs, kernel banks; whole files only, never half of one.
//!
//! Files are recognised by their contents when they are read and by their extension when they are written.
//! Sizes that a header declares are checked against the file's length and [`MAX_PIXELS`] before anything is
//! allocated for them.

mod array;
mod atomic;
mod bank;
mod color_tags;
mod container;
mod describe;
mod dng;
mod exr;
mod field;
mod folder;
mod format;
mod grey_tiff;
mod guard;
mod icc;
mod inputs;
mod jpeg;
mod npy;
mod plain;
mod planes;
mod psf;
mod raster;
mod shared_input;
mod size;
mod tell;
mod tiff_directory;

use std::path::Path;

use half::f16;
use ndarray::{Array3, ArrayView2, ArrayView3, Axis, concatenate};
use serde::Serialize;

use crate::core::bayer::BayerPattern;
use crate::core::camera_color::CameraColor;
use crate::core::capture::CaptureInfo;
use crate::core::error::{Error, Result};
use crate::core::image::{Domain, Image, Linear, ToneMapped};
use crate::core::orientation::Orientation;
use crate::core::provenance::Provenance;

pub use array::{read_array, write_array};
pub use atomic::{WriteSeek, check_output, remove_unfinished, write_atomically};
pub use bank::{
    bank_sha256, bank_sha256_of, encode_bank, is_bank_of_sha256, read_bank, read_bank_codes, write_bank,
    write_published_bank,
};
pub use color_tags::ColorTag;
pub use container::{TensorData, write_safetensors};
pub use describe::{
    ArrayDescription, BankDescription, Description, ImageDescription, ModelDescription, PsfChannel,
    PsfDescription, Statistics, describe, describe_psf,
};
pub use field::{inspect_psf_field, read_field, read_psf_field, write_psf_field};
pub use folder::{AppendFile, LineLog, create_folder, lock_folder, publish_folder, remove, try_lock_folder};
pub use format::{Encoding, Format};
pub use inputs::{expand_inputs, is_hidden};
pub use plain::{list_folder, read_bytes, read_code, read_text, sha256_of_file};
pub use psf::{PsfFaults, PsfMove, PsfOptions, PsfReading, inspect_psf, read_psf, show_shift, write_psf};
pub use shared_input::SharedInput;
pub use size::read_image_size;

/// The largest number of pixels an image may have: 16384 × 16384, four times the largest panorama in use.
pub const MAX_PIXELS: usize = 1 << 28;

/// Enough for the headers of an image with its provenance.
const HEAD_BYTES: u64 = 1 << 18;

/// What the numbers of a file mean, where the file says so.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DomainTag {
    /// Linear irradiance.
    Linear,
    /// After the tone mapping φ.
    ToneMapped,
    /// For viewing, as `udc finish` makes them: no light can be computed from these.
    Display,
    /// Linear light in `[0, 1]`, encoded by the curve of sRGB, as pictures of most cameras and programs are. Only the user
    /// says it: such values are decoded when they are read, and no file of this domain is written.
    Srgb,
}

impl DomainTag {
    /// The name written to files; `--domain` accepts those of light, linear or tone-mapped.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => Linear::NAME,
            Self::ToneMapped => ToneMapped::NAME,
            Self::Display => "display",
            Self::Srgb => "srgb",
        }
    }

    /// The tag of a name in a file; `None` for a name that is not a domain's.
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Linear, Self::ToneMapped, Self::Display].into_iter().find(|tag| tag.name() == name)
    }
}

/// The contents of an image file before their meaning is decided.
///
/// # Shapes
/// `planes` is `[channels, height, width]` with 1, 3 or (packed Bayer) 4 channels; integer formats are
/// divided by their type's maximum.
#[derive(Clone, Debug)]
pub struct Pixels {
    /// The values.
    pub planes: Array3<f32>,
    /// The domain that the file declares.
    pub domain: Option<DomainTag>,
    /// The exposure time that the file declares, in seconds.
    pub exposure_s: Option<f64>,
    /// The sensitivity (ISO) that the file declares: values grow with it as with the exposure time.
    pub iso: Option<f64>,
    /// The provenance that the file carries.
    pub provenance: Option<Provenance>,
    /// What a camera's raw file says of its values.
    pub raw: Option<RawMetadata>,
    /// Whether the samples are integers of 8 or 16 bits: unless the file says more, only the user knows what they mean.
    pub is_integer: bool,
    /// What the file says of its colours, which changes no value.
    pub color_tags: Vec<ColorTag>,
    /// What the file says of the capture that it was made of.
    pub capture: Option<CaptureInfo>,
}

/// A correction that a raw file asks for and that was not made.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct IgnoredOpcode {
    /// The name of the opcode in the specification, or its number.
    pub name: String,
    /// Whether the file allows that it is left out.
    pub optional: bool,
}

/// What a camera's raw file says of its values; levels are in the units of the planes.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RawMetadata {
    /// The colours of the mosaic; none for three full planes.
    pub bayer: Option<BayerPattern>,
    /// The value of a dark photosite.
    pub black: f64,
    /// The value of a full photosite.
    pub white: f64,
    /// Gains of red, green and blue that make grey grey.
    pub white_balance: Option<[f64; 3]>,
    /// The camera's colours.
    pub color: Option<CameraColor>,
    /// How the picture lies on the sensor, as the planes do.
    pub orientation: Orientation,
    /// By how many stops the camera wants the capture brightened.
    pub baseline_exposure_ev: Option<f64>,
    /// Corrections of the lens that the planes have.
    pub corrections: Vec<String>,
    /// Those that they have not.
    pub ignored: Vec<IgnoredOpcode>,
}

impl Pixels {
    /// Takes planes over that a file says nothing about.
    pub fn of_planes(planes: Array3<f32>) -> Self {
        Self {
            planes,
            domain: None,
            exposure_s: None,
            iso: None,
            provenance: None,
            raw: None,
            is_integer: false,
            color_tags: Vec::new(),
            capture: None,
        }
    }
}

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

/// Reads an image file of any supported format.
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
    Ok(exr::provenance_of_head(&head))
}

/// Reads what an image file says of its capture, without its pixels; formats other than EXR carry nothing.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when what it says is damaged.
pub fn read_capture_info(path: &Path) -> Result<Option<CaptureInfo>> {
    let head = plain::read_head(path, HEAD_BYTES)?;
    exr::capture_of_head(&head).map_err(|reason| Error::format(path, reason))
}

fn decode_image(
    path: &Path,
    bytes: &[u8],
    format: Format,
    packed: Option<BayerPattern>,
) -> Result<(Pixels, Encoding)> {
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

/// Writes an image in the format of the path's extension.
///
/// Integer formats clip tone-mapped values to `[0, 1]`; linear values above one are refused there. Negative ones, which
/// noise around black leaves, become zero there and in Radiance HDR.
///
/// # Errors
/// [`Error::Io`] when the file cannot be written or exists; [`Error::Unsupported`] when the format cannot hold
/// the values.
pub fn write_image<D: Domain>(path: &Path, image: &Image<D>, options: &WriteOptions) -> Result<()> {
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
    let options = PixelOptions { half, overwrite, clip, clip_negative: true, eight_bit: false };
    write_contents(path, &contents, options)
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
}

/// Writes pixels, with what is known of them, in the format of the path's extension.
///
/// # Errors
/// As [`write_image`].
pub fn write_pixels(path: &Path, pixels: &Pixels, options: PixelOptions) -> Result<()> {
    let contents = Contents {
        planes: pixels.planes.view(),
        domain: pixels.domain,
        exposure_s: pixels.exposure_s,
        iso: pixels.iso,
        provenance: pixels.provenance.as_ref(),
        capture: pixels.capture.as_ref(),
    };
    write_contents(path, &contents, options)
}

/// What an encoder is given: pixels that belong to somebody else.
struct Contents<'a> {
    planes: ArrayView3<'a, f32>,
    domain: Option<DomainTag>,
    exposure_s: Option<f64>,
    iso: Option<f64>,
    provenance: Option<&'a Provenance>,
    capture: Option<&'a CaptureInfo>,
}

fn write_contents(path: &Path, contents: &Contents<'_>, options: PixelOptions) -> Result<()> {
    let format = Format::of_extension(path)?;
    check_output(path, options.overwrite)?;
    let largest = f32::from(f16::MAX);
    let is_clipped_half = options.half && options.clip && matches!(format, Format::Exr | Format::Npy);
    if is_clipped_half && contents.planes.iter().any(|value| value.abs() > largest) {
        let planes = contents.planes.mapv(|value| value.clamp(-largest, largest));
        let clipped = Contents { planes: planes.view(), ..*contents };
        return write_contents(path, &clipped, PixelOptions { clip: false, ..options });
    }
    let encoded = match format {
        Format::Exr => {
            let encoder = exr::Encoder::new(contents, options.half);
            let encoder = encoder.map_err(|reason| Error::format(path, reason))?;
            return write_atomically(path, options.overwrite, |file| encoder.write(file));
        }
        Format::Npy => npy::encode_image(&contents.planes, options.half),
        _ => raster::encode(&contents.planes, format, options),
    };
    let bytes = encoded.map_err(|reason| Error::format(path, reason))?;
    write_atomically(path, options.overwrite, |file| file.write_all(&bytes))
}

fn check_domain(path: &Path, declared: Option<DomainTag>, needed: &str) -> Result<()> {
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

fn check_cooked(path: &Path, pixels: &Pixels) -> Result<()> {
    match pixels.raw {
        None => Ok(()),
        Some(_) => Err(Error::format(
            path,
            "is a camera's raw file; `udc fuse` and `udc restore` read it, other commands read what they write",
        )),
    }
}

fn to_rgb(path: &Path, planes: Array3<f32>) -> Result<Array3<f32>> {
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

#[cfg(test)]
mod tests;

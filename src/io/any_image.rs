//! Images in either domain of light: read as what the file or the user says they are, written as what is asked for.

use std::path::Path;

use super::{DomainTag, Format, Pixels, WriteOptions, image_of, read_pixels, write_image};
use crate::core::capture::CaptureInfo;
use crate::core::error::{Error, Result};
use crate::core::image::{Linear, LinearImage, ToneMapped, ToneMappedImage};
use crate::core::tone::ToneCurve;

/// An image in one of the two domains.
#[derive(Clone, Debug, PartialEq)]
pub enum AnyImage {
    /// Linear irradiance.
    Linear(LinearImage),
    /// An image after the tone mapping φ.
    ToneMapped(ToneMappedImage),
}

/// An image with what was found in its file.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageReading {
    /// The image.
    pub image: AnyImage,
    /// What is known of the capture, where the file says it.
    pub info: Option<CaptureInfo>,
    /// What the file says of its colours against what the user says.
    pub contradiction: Option<String>,
}

/// Reads an image as what the user `told`, or as what the file says, or as linear; integers must be told.
///
/// # Errors
/// As [`read_pixels`], [`image_of`] and [`Pixels::tell`].
pub fn inspect_any_image(path: &Path, told: Option<DomainTag>) -> Result<ImageReading> {
    any_image_of(path, read_pixels(path)?, told)
}

/// Takes the pixels that were read from `path` for an image, as [`inspect_any_image`] does.
///
/// # Errors
/// As [`image_of`] and [`Pixels::tell`].
pub fn any_image_of(path: &Path, mut pixels: Pixels, told: Option<DomainTag>) -> Result<ImageReading> {
    let contradiction = pixels.tell(path, told)?;
    let info = pixels.capture.take();
    let image = match pixels.domain {
        Some(DomainTag::ToneMapped) => AnyImage::ToneMapped(image_of::<ToneMapped>(path, pixels)?),
        Some(DomainTag::Linear | DomainTag::Display | DomainTag::Srgb) | None => {
            AnyImage::Linear(image_of::<Linear>(path, pixels)?)
        }
    };
    Ok(ImageReading { image, info, contradiction })
}

impl AnyImage {
    /// The domain of its values: linear or tone-mapped.
    pub fn domain(&self) -> DomainTag {
        match self {
            Self::Linear(_) => DomainTag::Linear,
            Self::ToneMapped(_) => DomainTag::ToneMapped,
        }
    }

    /// Height and width.
    pub fn size(&self) -> [usize; 2] {
        match self {
            Self::Linear(image) => [image.height(), image.width()],
            Self::ToneMapped(image) => [image.height(), image.width()],
        }
    }

    /// The image as linear light, in its own memory.
    pub fn into_linear(self, curve: ToneCurve) -> LinearImage {
        match self {
            Self::Linear(image) => image,
            Self::ToneMapped(image) => curve.inverse_tone_map_in_place(image),
        }
    }

    /// The image after the tone mapping, in its own memory.
    pub fn into_tone_mapped(self, curve: ToneCurve) -> ToneMappedImage {
        match self {
            Self::Linear(image) => curve.tone_map_in_place(image),
            Self::ToneMapped(image) => image,
        }
    }

    /// Writes the image in `domain`: tone-mapped where that is asked for, else linear.
    ///
    /// # Errors
    /// As [`write_image`].
    pub fn write(
        self,
        path: &Path,
        domain: DomainTag,
        curve: ToneCurve,
        options: &WriteOptions,
    ) -> Result<()> {
        match domain {
            DomainTag::ToneMapped => write_image(path, &self.into_tone_mapped(curve), options),
            DomainTag::Linear | DomainTag::Display | DomainTag::Srgb => {
                write_image(path, &self.into_linear(curve), options)
            }
        }
    }
}

/// Refuses linear light in a file of integers, before the work.
///
/// # Errors
/// [`Error::Unsupported`] for such a file; [`Error::Format`] for one of no format that is written.
pub fn check_output_domain(path: &Path, domain: DomainTag) -> Result<()> {
    let holds_floats = matches!(Format::of_extension(path)?, Format::Exr | Format::Npy | Format::Hdr);
    if domain == DomainTag::Linear && !holds_floats {
        return Err(Error::Unsupported(format!(
            "{} cannot hold linear light above one: add --output-domain tone-mapped, or write .exr or .npy",
            path.display()
        )));
    }
    Ok(())
}

//! Images of either domain: read as what the file or the user says they are, written as what is asked for.

use std::path::Path;

use anyhow::{Result, bail};

use udc::core::image::{Linear, LinearImage, ToneMapped, ToneMappedImage};
use udc::core::io::{
    DomainTag, Encoding, Format, Pixels, WriteOptions, image_of, inspect_image, write_image,
};
use udc::core::tone::ToneCurve;

use super::domain::DomainArg;

/// An image in one of the two domains.
pub(crate) enum AnyImage {
    Linear(LinearImage),
    ToneMapped(ToneMappedImage),
}

impl AnyImage {
    /// Reads an image as `domain`, or as what the file says, or as linear; integers must be told.
    pub(crate) fn read(path: &Path, domain: Option<DomainArg>) -> Result<Self> {
        let (pixels, encoding) = inspect_image(path)?;
        Self::of(path, pixels, &encoding, domain)
    }

    /// Takes what was read for an image, as [`read`](Self::read) does.
    pub(crate) fn of(
        path: &Path,
        mut pixels: Pixels,
        encoding: &Encoding,
        domain: Option<DomainArg>,
    ) -> Result<Self> {
        let domain = domain.map(DomainTag::from);
        if domain.is_some() && pixels.domain == Some(DomainTag::Display) {
            pixels.domain = domain;
        }
        match domain.or(pixels.domain) {
            None if must_be_told(&pixels, encoding) => bail!(domain_needed(path)),
            Some(DomainTag::ToneMapped) => Ok(Self::ToneMapped(image_of::<ToneMapped>(path, pixels)?)),
            Some(DomainTag::Linear | DomainTag::Display) | None => {
                Ok(Self::Linear(image_of::<Linear>(path, pixels)?))
            }
        }
    }

    pub(crate) fn domain(&self) -> DomainArg {
        match self {
            Self::Linear(_) => DomainArg::Linear,
            Self::ToneMapped(_) => DomainArg::ToneMapped,
        }
    }

    pub(crate) fn into_linear(self, curve: ToneCurve) -> LinearImage {
        match self {
            Self::Linear(image) => image,
            Self::ToneMapped(image) => curve.inverse_tone_map_in_place(image),
        }
    }

    pub(crate) fn into_tone_mapped(self, curve: ToneCurve) -> ToneMappedImage {
        match self {
            Self::Linear(image) => curve.tone_map_in_place(image),
            Self::ToneMapped(image) => image,
        }
    }

    /// Writes it in `domain`.
    pub(crate) fn write(
        self,
        path: &Path,
        domain: DomainArg,
        curve: ToneCurve,
        options: &WriteOptions,
    ) -> Result<()> {
        match domain {
            DomainArg::Linear => write_image(path, &self.into_linear(curve), options)?,
            DomainArg::ToneMapped => write_image(path, &self.into_tone_mapped(curve), options)?,
        }
        Ok(())
    }
}

/// Whether an image may as well be linear as tone-mapped: integers that are no camera's raw ones.
pub(crate) fn must_be_told(pixels: &Pixels, encoding: &Encoding) -> bool {
    pixels.domain.is_none()
        && pixels.raw.is_none()
        && matches!(encoding.format, Format::Png | Format::Jpeg | Format::Tiff)
        && encoding.sample_type.starts_with("uint")
}

/// What to say of such an image.
pub(crate) fn domain_needed(path: &Path) -> String {
    format!(
        "{} does not say whether its values are linear or tone-mapped: add --domain linear or --domain tone-mapped",
        path.display()
    )
}

/// Refuses linear light in a file of integers, before the work.
pub(crate) fn check_domain_of_output(path: &Path, domain: DomainArg) -> Result<()> {
    let holds_floats = matches!(Format::of_extension(path)?, Format::Exr | Format::Npy | Format::Hdr);
    if domain == DomainArg::Linear && !holds_floats {
        bail!(
            "{} cannot hold linear light above one: add --output-domain tone-mapped, or write .exr or .npy",
            path.display()
        );
    }
    Ok(())
}

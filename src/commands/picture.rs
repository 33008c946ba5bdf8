//! Images of either domain: read as what the file or the user says they are, written as what is asked for.

use std::path::Path;

use anyhow::{Result, bail};

use udc::core::capture::CaptureInfo;
use udc::core::image::{Linear, LinearImage, ToneMapped, ToneMappedImage};
use udc::core::tone::ToneCurve;
use udc::io::{DomainTag, Format, Pixels, WriteOptions, image_of, read_pixels, write_image};

use super::Session;
use super::domain::{DomainArg, OutputDomainArg};

/// An image in one of the two domains.
pub(crate) enum AnyImage {
    Linear(LinearImage),
    ToneMapped(ToneMappedImage),
}

impl AnyImage {
    /// Reads an image as `domain`, or as what the file says, or as linear, with what is known of its capture; integers must
    /// be told. Warns of what the file says against it.
    pub(crate) fn read(
        path: &Path,
        domain: Option<DomainArg>,
        session: &Session,
    ) -> Result<(Self, Option<CaptureInfo>)> {
        Self::of(path, read_pixels(path)?, domain, session)
    }

    /// Takes what was read for an image, as [`read`](Self::read) does.
    pub(crate) fn of(
        path: &Path,
        mut pixels: Pixels,
        domain: Option<DomainArg>,
        session: &Session,
    ) -> Result<(Self, Option<CaptureInfo>)> {
        if let Some(contradiction) = pixels.tell(path, domain.map(DomainTag::from))? {
            session.warn(contradiction);
        }
        let info = pixels.capture.take();
        let image = match pixels.domain {
            Some(DomainTag::ToneMapped) => Self::ToneMapped(image_of::<ToneMapped>(path, pixels)?),
            Some(DomainTag::Linear | DomainTag::Display | DomainTag::Srgb) | None => {
                Self::Linear(image_of::<Linear>(path, pixels)?)
            }
        };
        Ok((image, info))
    }

    pub(crate) fn domain(&self) -> OutputDomainArg {
        match self {
            Self::Linear(_) => OutputDomainArg::Linear,
            Self::ToneMapped(_) => OutputDomainArg::ToneMapped,
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
        domain: OutputDomainArg,
        curve: ToneCurve,
        options: &WriteOptions,
    ) -> Result<()> {
        match domain {
            OutputDomainArg::Linear => write_image(path, &self.into_linear(curve), options)?,
            OutputDomainArg::ToneMapped => write_image(path, &self.into_tone_mapped(curve), options)?,
        }
        Ok(())
    }
}

/// Refuses linear light in a file of integers, before the work.
pub(crate) fn check_domain_of_output(path: &Path, domain: OutputDomainArg) -> Result<()> {
    let holds_floats = matches!(Format::of_extension(path)?, Format::Exr | Format::Npy | Format::Hdr);
    if domain == OutputDomainArg::Linear && !holds_floats {
        bail!(
            "{} cannot hold linear light above one: add --output-domain tone-mapped, or write .exr or .npy",
            path.display()
        );
    }
    Ok(())
}

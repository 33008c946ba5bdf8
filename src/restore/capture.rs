//! What a restoration is given and what it gives: an image, and what is known of its capture.

use std::path::Path;

use super::FoundAngle;
use crate::core::capture::CaptureInfo;
use crate::core::error::Result;
use crate::core::image::{LinearImage, ToneMappedImage};
use crate::core::tone::ToneCurve;
use crate::finish::{Photograph, photograph};
use crate::io::{AnyImage, DomainTag, WriteOptions, inspect_any_image};

/// A capture: its light, and what is known of it beside.
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    /// The image.
    pub image: AnyImage,
    /// What is known of the capture, where it is.
    pub info: Option<CaptureInfo>,
}

/// A capture that was restored.
#[derive(Clone, Debug, PartialEq)]
pub struct Restored {
    /// The image.
    pub image: AnyImage,
    /// What is known of the capture.
    pub info: Option<CaptureInfo>,
    /// The panel's angle, where it was searched in the capture.
    pub angle: Option<FoundAngle>,
    /// φ∘C, by which the image changes between the domains.
    pub curve: ToneCurve,
}

impl Capture {
    /// Reads a capture that is an image of light, as what the user `told`, or as what the file says, or as linear; raw files
    /// are developed by [`crate::capture`]. Says what in the file contradicts what was told.
    ///
    /// # Errors
    /// As [`inspect_any_image`].
    pub fn read(path: &Path, told: Option<DomainTag>) -> Result<(Self, Option<String>)> {
        let reading = inspect_any_image(path, told)?;
        Ok((Self { image: reading.image, info: reading.info }, reading.contradiction))
    }
}

impl From<LinearImage> for Capture {
    fn from(image: LinearImage) -> Self {
        Self { image: AnyImage::Linear(image), info: None }
    }
}

impl From<ToneMappedImage> for Capture {
    fn from(image: ToneMappedImage) -> Self {
        Self { image: AnyImage::ToneMapped(image), info: None }
    }
}

impl Restored {
    /// Writes the image, with what is known of the capture, in a domain of light.
    ///
    /// # Errors
    /// As [`AnyImage::write`].
    pub fn write(self, path: &Path, domain: DomainTag, options: &WriteOptions) -> Result<()> {
        let options = WriteOptions { capture: self.info, ..options.clone() };
        self.image.write(path, domain, self.curve, &options)
    }

    /// The image as linear irradiance.
    pub fn into_linear(self) -> LinearImage {
        self.image.into_linear(self.curve)
    }

    /// The image after the tone mapping.
    pub fn into_tone_mapped(self) -> ToneMappedImage {
        self.image.into_tone_mapped(self.curve)
    }

    /// Develops the image to a photograph, as [`photograph`] does: put upright, in the colours of its camera, with an
    /// exposure that is chosen from it.
    ///
    /// # Errors
    /// Those of [`photograph`].
    pub fn into_photograph(self) -> Result<Photograph> {
        let (curve, info) = (self.curve, self.info.unwrap_or_default());
        photograph(self.image.into_linear(curve), &info, curve.x_max)
    }
}

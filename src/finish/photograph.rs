//! Makes a photograph of light without a word from the user: the exposure is chosen from the picture.

use std::path::Path;

use ndarray::{Array2, Array3};

use super::{Curve, FinishConfig, Look, Style, finish_with_gains};
use crate::core::capture::CaptureInfo;
use crate::core::error::Result;
use crate::core::exif::Exif;
use crate::core::image::LinearImage;
use crate::core::primaries::{ColorSpace, Primaries};
use crate::io::{DomainTag, PixelOptions, Pixels, WriteOptions, write_pixels, write_with_gains};

/// A picture that is ready, with the look that it took over.
#[derive(Clone, Debug, PartialEq)]
pub struct Photograph {
    /// Display values in `[0, 1]`, `[3, height, width]`.
    pub planes: Array3<f32>,
    /// The look.
    pub look: Look,
    /// The curve, as it was chosen or given.
    pub curve: Curve,
    /// The colours that its red, green and blue are.
    pub color_space: ColorSpace,
    /// Whether it was finished for 8 bits, in formats that have 16 as well.
    pub eight_bit: bool,
    /// The stops by which displays with headroom may show each pixel brighter, `[height, width]`, where they were asked for.
    pub gains: Option<Array2<f32>>,
    /// What the camera says of it.
    pub exif: Option<Exif>,
}

/// Finishes light as [`finish`](super::finish) does, with the look that is known of its capture and a curve that is chosen from it; an
/// exposure that is chosen needs no clip beside. `ceiling` is the light at which captures of unknown levels clip.
///
/// # Errors
/// Those of [`finish`](super::finish).
pub fn photograph(image: LinearImage, info: &CaptureInfo, ceiling: f32) -> Result<Photograph> {
    let look = Look::of_capture(info);
    let config = Style::default().config_of(&image, &look, true, ceiling);
    Ok(Photograph { exif: info.exif.clone(), ..Photograph::of(image, look, &config)? })
}

impl Photograph {
    /// Finishes light with settings that are chosen.
    pub(super) fn of(image: LinearImage, look: Look, config: &FinishConfig) -> Result<Self> {
        let (planes, gains) = finish_with_gains(image, &look, config)?;
        let FinishConfig { curve, color_space, eight_bit, .. } = *config;
        Ok(Self { planes, look, curve, color_space, eight_bit, gains, exif: None })
    }

    /// Writes the picture in the format of the path's extension, with the bits that it was finished for, the profile of its
    /// colours and what its camera says of it, but for how it lay: it is upright.
    ///
    /// # Errors
    /// As [`write_pixels`], or as [`write_with_gains`] where there are gains.
    pub fn write(self, path: &Path, options: &WriteOptions) -> Result<()> {
        let (domain, provenance) = (Some(DomainTag::Display), options.provenance.clone());
        let primaries = Some(self.color_space.primaries()).filter(|found| *found != Primaries::SRGB);
        let info = CaptureInfo { exif: self.exif, primaries, ..CaptureInfo::default() };
        let capture = (info != CaptureInfo::default()).then_some(info);
        let pixels = Pixels { domain, provenance, capture, ..Pixels::of_planes(self.planes) };
        let (overwrite, eight_bit, color_space) = (options.overwrite, self.eight_bit, Some(self.color_space));
        let options =
            PixelOptions { overwrite, clip: true, eight_bit, color_space, ..PixelOptions::default() };
        match self.gains {
            Some(gains) => write_with_gains(path, &pixels, gains.view(), options),
            None => write_pixels(path, &pixels, options),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::orientation::Orientation;
    use crate::finish::{automatic_curve, finish};

    fn light() -> LinearImage {
        let planes = Array3::from_shape_fn((3, 20, 30), |(c, y, x)| ((c + 2) * (y * 30 + x)) as f32 / 900.0);
        LinearImage::from_planes(planes).unwrap()
    }

    #[test]
    fn takes_the_look_of_its_capture_and_chooses_the_exposure() {
        let info = CaptureInfo {
            saturation: Some([2.0, 1.5, 1.8]),
            orientation: Orientation::from_exif(6),
            baseline_exposure_ev: Some(0.5),
            ..CaptureInfo::default()
        };
        let shown = photograph(light(), &info, 500.0).unwrap();
        assert_eq!(shown.planes.dim(), (3, 30, 20));
        assert_eq!(shown.look.saturation, info.saturation);
        assert_eq!(shown.curve, automatic_curve(&light(), &shown.look, 500.0));
        let config = Style::default().config_of(&light(), &shown.look, true, 500.0);
        assert_eq!(shown.planes, finish(light(), &shown.look, &config).unwrap());
    }
}

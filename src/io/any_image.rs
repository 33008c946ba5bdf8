//! Images in either domain of light: read as what the file or the user says they are, written as what is asked for.

use std::path::Path;

use super::write::check_light;
use super::{DomainTag, Format, Pixels, WriteOptions, image_of, read_pixels, write_image};
use crate::core::capture::CaptureInfo;
use crate::core::error::{Error, Result};
use crate::core::image::{Linear, LinearImage, ToneMapped, ToneMappedImage};
use crate::core::provenance::Provenance;
use crate::core::tone::{ToneCurve, ToneFlags};

/// An image in one of the two domains.
#[derive(Clone, Debug, PartialEq)]
pub enum AnyImage {
    /// Linear irradiance.
    Linear(LinearImage),
    /// An image after the tone mapping φ, and the curve that it was mapped by, where that is known.
    ToneMapped(ToneMappedImage, Option<ToneCurve>),
}

/// An image with what was found in its file.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageReading {
    /// The image.
    pub image: AnyImage,
    /// What is known of the capture, where the file says it.
    pub info: Option<CaptureInfo>,
    /// The curve that the file's origin says, by which its light was or is to be mapped, where it says one; but for what the user
    /// says of it.
    pub tone: Option<ToneCurve>,
    /// What the file says of its colours and its tone curve against what the user says.
    pub contradictions: Vec<String>,
}

/// Reads an image as what the user `told`, or as what the file says, or as linear; integers must be told. Of the tone curve of a
/// tone-mapped image, what the user says stands above what the file says.
///
/// # Errors
/// As [`read_pixels`], [`image_of`], [`Pixels::tell`] and [`ToneFlags::over`].
pub fn inspect_any_image(path: &Path, told: Option<DomainTag>, tone: ToneFlags) -> Result<ImageReading> {
    let pixels = read_pixels(path)?;
    let darkness = pixels.describe_darkness(path);
    let mut reading = any_image_of(path, pixels, told, tone)?;
    reading.contradictions.splice(0..0, darkness);
    Ok(reading)
}

/// Takes the pixels that were read from `path` for an image, as [`inspect_any_image`] does, but that it leaves
/// [`Pixels::describe_darkness`] to the caller.
///
/// # Errors
/// As [`image_of`], [`Pixels::tell`] and [`ToneFlags::over`].
pub fn any_image_of(
    path: &Path,
    mut pixels: Pixels,
    told: Option<DomainTag>,
    tone: ToneFlags,
) -> Result<ImageReading> {
    pixels.without_data = 0;
    let mut contradictions: Vec<String> = pixels.tell(path, told)?.into_iter().collect();
    contradictions.extend(pixels.describe_low_bits(path, told));
    let info = pixels.capture.take();
    let own = pixels.provenance.as_ref().and_then(Provenance::tone_curve);
    let image = match pixels.domain {
        Some(DomainTag::ToneMapped) => {
            contradictions.extend(own.and_then(|own| tone.contradiction(path, own)));
            let curve = own.map(|own| tone.over(own)).transpose()?;
            AnyImage::ToneMapped(image_of::<ToneMapped>(path, pixels)?, curve)
        }
        Some(DomainTag::Linear | DomainTag::Display | DomainTag::Srgb) | None => {
            AnyImage::Linear(image_of::<Linear>(path, pixels)?)
        }
    };
    let tone = own.map(|own| tone.over(own)).transpose()?;
    Ok(ImageReading { image, info, tone, contradictions })
}

impl AnyImage {
    /// The domain of its values: linear or tone-mapped.
    pub fn domain(&self) -> DomainTag {
        match self {
            Self::Linear(_) => DomainTag::Linear,
            Self::ToneMapped(..) => DomainTag::ToneMapped,
        }
    }

    /// Height and width.
    pub fn size(&self) -> [usize; 2] {
        match self {
            Self::Linear(image) => [image.height(), image.width()],
            Self::ToneMapped(image, _) => [image.height(), image.width()],
        }
    }

    /// The curve that its values were tone-mapped by, where that is known.
    pub fn curve(&self) -> Option<ToneCurve> {
        match self {
            Self::Linear(_) => None,
            Self::ToneMapped(_, curve) => *curve,
        }
    }

    /// The image as linear light, in its own memory: by its own curve, or by `curve` where that is not known.
    pub fn into_linear(self, curve: ToneCurve) -> LinearImage {
        match self {
            Self::Linear(image) => image,
            Self::ToneMapped(image, own) => own.unwrap_or(curve).inverse_tone_map_in_place(image),
        }
    }

    /// The image after the tone mapping by `curve`, in its own memory; values that are tone-mapped so, or by an unknown curve, stay
    /// as they are.
    #[expect(clippy::float_cmp, reason = "another α is one by a bit")]
    pub fn into_tone_mapped(self, curve: ToneCurve) -> ToneMappedImage {
        match self {
            Self::Linear(image) => curve.tone_map_in_place(image),
            Self::ToneMapped(image, own) => {
                match own.filter(|own| own.alpha != curve.alpha || own.x_max > curve.x_max) {
                    Some(own) => curve.tone_map_in_place(own.inverse_tone_map_in_place(image)),
                    None => image,
                }
            }
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

/// Refuses linear light in a file of integers and tone-mapped values in Radiance HDR, before the work.
///
/// # Errors
/// [`Error::Unsupported`] for such a file; [`Error::Format`] for one of no format that is written.
pub fn check_output_domain(path: &Path, domain: DomainTag) -> Result<()> {
    let format = Format::of_extension(path)?;
    check_light(path, format, Some(domain))?;
    let holds_floats = format.holds_light();
    if domain == DomainTag::Linear && !holds_floats {
        return Err(Error::Unsupported(format!(
            "{} cannot hold linear light above one: add --output-domain tone-mapped, or write .exr or .npy",
            path.display()
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::WriteOptions;
    use ndarray::Array3;
    use serde_json::json;

    const OWN: ToneCurve = ToneCurve { alpha: 0.1, x_max: 16.0 };

    fn written(folder: &Path, provenance: Option<Provenance>) -> std::path::PathBuf {
        let light = LinearImage::from_planes(Array3::from_elem((3, 2, 2), 2.0)).unwrap();
        let path = folder.join("a.exr");
        let options = WriteOptions { provenance, overwrite: true, ..WriteOptions::default() };
        write_image(&path, &OWN.tone_map(&light), &options).unwrap();
        path
    }

    #[test]
    fn light_comes_back_by_the_curve_that_the_file_says() {
        let folder = tempfile::tempdir().unwrap();
        let path = written(folder.path(), Some(Provenance::new("tonemap", &json!({ "tone": OWN }))));
        let read = |tone| inspect_any_image(&path, None, tone).unwrap();
        let light = |image: AnyImage| image.into_linear(ToneCurve::default()).max();
        let reading = read(ToneFlags::default());
        assert_eq!((reading.image.curve(), reading.contradictions.len()), (Some(OWN), 0));
        assert!((light(reading.image.clone()) / 2.0 - 1.0).abs() < 1e-5);
        let mapped = reading.image.clone().into_tone_mapped(ToneCurve::default()).max();
        assert!((mapped / ToneCurve::default().compress(2.0) - 1.0).abs() < 1e-5, "{mapped}");
        // In no other place of memory, and to no other bit.
        let larger = ToneCurve { x_max: 500.0, ..OWN };
        assert_eq!(reading.image.into_tone_mapped(larger).max(), OWN.compress(2.0));
        let told = read(ToneFlags { alpha: Some(0.2), x_max: None });
        assert!(told.contradictions[0].contains("alpha 0.1"), "{:?}", told.contradictions);
        assert!((light(told.image) / 4.0 - 1.0).abs() < 1e-5);
    }

    #[test]
    fn a_file_that_says_no_curve_has_that_of_the_reader() {
        let folder = tempfile::tempdir().unwrap();
        let reading = inspect_any_image(&written(folder.path(), None), None, ToneFlags::default()).unwrap();
        assert_eq!(reading.image.curve(), None);
        assert!((reading.image.into_linear(OWN).max() / 2.0 - 1.0).abs() < 1e-5);
    }

    #[test]
    fn integers_of_ten_bits_in_words_of_sixteen_are_told() {
        let planes = Array3::from_elem((3, 4, 4), 1023.0 / 65535.0);
        let said = |is_integer| {
            let pixels = Pixels { is_integer, ..Pixels::of_planes(planes.clone()) };
            let told = Some(DomainTag::Linear);
            any_image_of(Path::new("a.png"), pixels, told, ToneFlags::default()).unwrap().contradictions
        };
        assert!(said(true)[0].contains("1023 of 65535, as of 10 bits"), "{:?}", said(true));
        assert_eq!(said(false), [""; 0]);
    }
}

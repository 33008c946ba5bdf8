//! What a restoration is given and what it gives: an image, and what is known of its capture.

use std::path::{Path, PathBuf};

use super::deconvolution::{DoubtedNoise, NOISE_FREE};
use super::empty_lines::EmptyLines;
use super::floor::Floor;
use super::{Contradiction, FoundAngle, Lamp, LampOutside, LateralColour, PoseEstimate, Unlike};
use crate::capture::{Developed, Pictures, SCENE_BRACKET, Told, names_of};
use crate::core::capture::CaptureInfo;
use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, LinearImage, ToneMappedImage};
use crate::core::progress::Progress;
use crate::core::provenance::Provenance;
use crate::core::tone::ToneCurve;
use crate::finish::{Photograph, photograph};
use crate::io::{AnyImage, DomainTag, ImageReading, WriteOptions, any_image_of, read_pixels};

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
    /// φ∘C, by which the image changes between the domains, and was mapped if it is tone-mapped.
    pub curve: ToneCurve,
    /// The α that suits the units of the capture and was computed with, where it is another than the curve's.
    pub alpha: Option<f32>,
    /// The standard deviation of the noise of `log(capture + α)` in each channel where it is of middling brightness, as it was told or
    /// estimated by a restoration that asks for it.
    pub relative_noise: Option<[f32; CHANNELS]>,
    /// The lamps whose light was measured by their flare, brightest first.
    pub lamps: Vec<Lamp>,
    /// The lamps outside of the frame whose flare was taken away, the most visible first.
    pub lamps_outside: Vec<LampOutside>,
    /// What saturates each channel, where that was found in the capture; none of a channel that it does not show saturated.
    pub levels: Option<[Option<f32>; CHANNELS]>,
    /// What seems to saturate channels by the capture's brightest pixels, where the method took a level that these do not reach.
    pub doubted_levels: Option<[Option<f32>; CHANNELS]>,
    /// Rows and columns of the capture that hold nothing, where it has such.
    pub empty_lines: Option<EmptyLines>,
    /// Light that all of it has in all colours, where it has such.
    pub floor: Option<Floor>,
    /// Noise that was told of the capture and can't be its own.
    pub doubted_noise: Option<DoubtedNoise>,
    /// How the PSF contradicts the capture, where it does so by much.
    pub contradiction: Option<Contradiction>,
    /// What the capture looks like more than like one behind the PSF, where it does.
    pub unlike: Option<Unlike>,
    /// By how much the PSF was moved, where the flare of the capture tells it.
    pub pose: Option<PoseEstimate>,
    /// How far the lens draws red and blue from green, where that was seen.
    pub lateral_colour: Option<LateralColour>,
    /// Whether it is grey and was restored with the PSF of grey light.
    pub through_grey: bool,
    /// Height and width of the windows that it was restored in, where a device had no memory for larger ones.
    pub smaller_windows: Option<[usize; 2]>,
}

/// A capture as its files were read.
#[derive(Debug)]
pub struct CaptureReading {
    /// What the user should look at in the files.
    pub warnings: Vec<String>,
    light: Light,
}

#[derive(Debug)]
enum Light {
    /// An image.
    Image(Box<Capture>),
    /// Raw pictures, of which the image is to be made, and the names of their files.
    Pictures(Box<Pictures>, String),
}

/// The brightest light of a capture: its square is far below the largest number of 32 bits still.
const BRIGHTEST: f32 = 1e18;

/// Refuses light that no number could be computed with, and what is no light.
fn check_brightness(file: &Path, image: &AnyImage) -> Result<()> {
    match image {
        AnyImage::Linear(image) if image.max() < 0.0 => Err(Error::format(
            file,
            format!(
                "holds no light: all of its values are negative, {} at most; a black level above the picture's was taken away, or the sign \
                 is wrong",
                image.max()
            ),
        )),
        AnyImage::Linear(image) if image.max() > BRIGHTEST => Err(Error::format(
            file,
            format!(
                "holds light of {:e}, more than {BRIGHTEST:e}: replace such pixels by light of the scene's range before using it",
                image.max()
            ),
        )),
        _ => Ok(()),
    }
}

impl Capture {
    /// Reads a capture from one file, an image of light or a raw picture, with what the user should look at.
    ///
    /// # Errors
    /// As [`CaptureReading::of_file`] and [`CaptureReading::develop`].
    pub fn open(file: &Path, told: &Told, progress: &Progress) -> Result<(Self, Vec<String>)> {
        let mut reading = CaptureReading::of_file(file, told, progress)?;
        let mut warnings = std::mem::take(&mut reading.warnings);
        let (capture, of_fusion) = reading.develop()?;
        warnings.extend(of_fusion);
        Ok((capture, warnings))
    }
}

impl CaptureReading {
    /// Reads a capture of one exposure: an image of light, unless the file or what is told of it is raw.
    ///
    /// # Errors
    /// As [`any_image_of`] and [`Pictures::read`].
    pub fn of_file(file: &Path, told: &Told, progress: &Progress) -> Result<Self> {
        if !told.is_raw() {
            let pixels = read_pixels(file)?;
            if pixels.raw.is_none() {
                let once_more = told_restored(file, pixels.provenance.as_ref());
                let mut warnings: Vec<String> = pixels
                    .describe_darkness(file)
                    .into_iter()
                    .chain(pixels.describe_mosaic(file))
                    .chain(once_more)
                    .collect();
                let ImageReading { image, info, contradictions, .. } =
                    any_image_of(file, pixels, told.domain, told.tone)?;
                check_brightness(file, &image)?;
                let light = Light::Image(Box::new(Capture { image, info }));
                warnings.extend(contradictions);
                return Ok(Self { warnings, light });
            }
        }
        // A picture alone needs no time.
        let told = Told { default_times: Some(SCENE_BRACKET), ..told.clone() };
        Self::of_bracket(&[file.to_owned()], &told, progress)
    }

    /// Reads a capture of several exposures.
    ///
    /// # Errors
    /// As [`Pictures::read`].
    pub fn of_bracket(files: &[PathBuf], told: &Told, progress: &Progress) -> Result<Self> {
        let name = names_of(files);
        if told.domain == Some(DomainTag::ToneMapped) {
            let reason =
                format!("{name}: raw pictures are linear, and --domain says tone-mapped; leave it out");
            return Err(Error::Unsupported(reason));
        }
        let mut pictures = Pictures::read(files, told, progress)?;
        let warnings = std::mem::take(&mut pictures.warnings);
        Ok(Self { warnings, light: Light::Pictures(Box::new(pictures), name) })
    }

    /// Whether the image is yet to be made of raw pictures.
    pub fn is_raw(&self) -> bool {
        matches!(self.light, Light::Pictures(..))
    }

    /// Makes the image of raw pictures; says what the user should look at in it.
    ///
    /// # Errors
    /// As [`Pictures::develop`].
    pub fn develop(self) -> Result<(Capture, Vec<String>)> {
        match self.light {
            Light::Image(capture) => Ok((*capture, Vec::new())),
            Light::Pictures(pictures, name) => {
                let Developed { fused, info, warnings, .. } = pictures.develop()?;
                let warnings = warnings.into_iter().map(|warning| format!("{name}: {warning}")).collect();
                Ok((Capture { image: AnyImage::Linear(fused.image), info: Some(info) }, warnings))
            }
        }
    }
}

/// What to tell of a file that is no capture but what was made of one.
fn told_restored(file: &Path, provenance: Option<&Provenance>) -> Option<String> {
    provenance.filter(|made| made.command == "restore").map(|_| {
        format!(
            "{}: it was restored before, so that its blur is not that of the PSF any more: restore the capture itself",
            file.display()
        )
    })
}

/// The levels of those channels that have one, in words.
fn in_words(levels: [Option<f32>; CHANNELS]) -> String {
    let levels: Vec<(f32, &str)> = levels
        .into_iter()
        .zip(["red", "green", "blue"])
        .filter_map(|(level, name)| Some((level?, name)))
        .collect();
    match levels[..] {
        [(red, _), (green, _), (blue, _)]
            if red.total_cmp(&green).is_eq() && green.total_cmp(&blue).is_eq() =>
        {
            format!("{red} in all colours")
        }
        _ => levels.iter().map(|(level, name)| format!("{level} in {name}")).collect::<Vec<_>>().join(", "),
    }
}

impl From<LinearImage> for Capture {
    fn from(image: LinearImage) -> Self {
        Self { image: AnyImage::Linear(image), info: None }
    }
}

impl From<ToneMappedImage> for Capture {
    fn from(image: ToneMappedImage) -> Self {
        Self { image: AnyImage::ToneMapped(image, None), info: None }
    }
}

impl Restored {
    /// A restored image of whose capture nothing was found.
    pub(super) fn new(image: AnyImage, info: Option<CaptureInfo>, curve: ToneCurve) -> Self {
        Self {
            image,
            // What is restored was not coded.
            info: info.map(|info| CaptureInfo { coding_error: None, ..info }),
            angle: None,
            curve,
            alpha: None,
            lamps: Vec::new(),
            lamps_outside: Vec::new(),
            levels: None,
            doubted_levels: None,
            empty_lines: None,
            floor: None,
            doubted_noise: None,
            contradiction: None,
            unlike: None,
            pose: None,
            lateral_colour: None,
            through_grey: false,
            relative_noise: None,
            smaller_windows: None,
        }
    }

    /// The same, computed with this α.
    pub(super) fn with_alpha(self, alpha: f32) -> Self {
        let is_other = alpha.total_cmp(&self.curve.alpha).is_ne();
        Self { alpha: is_other.then_some(alpha), ..self }
    }

    /// What to tell of the capture's noise, where a restoration asks for it.
    pub fn describe_noise(&self) -> Option<String> {
        let relative = self.relative_noise?;
        if relative.iter().all(|sigma| *sigma <= NOISE_FREE) {
            return Some("no noise".to_owned());
        }
        let [red, green, blue] = relative.map(|sigma| 100.0 * sigma);
        Some(format!(
            "noise of {red:.2}, {green:.2} and {blue:.2} % of light + α in red, green and blue, in middling brightness"
        ))
    }

    /// What to tell of the levels that were found in the capture.
    pub fn describe_levels(&self) -> Option<String> {
        let levels = in_words(self.levels?);
        Some(format!("saturates at {levels}, as its brightest pixels show; --x-max says otherwise"))
    }

    /// What to tell where the capture's brightest pixels seem to be clipped and the method took them for light as it is.
    pub fn doubt(&self) -> Option<String> {
        let doubted = self.doubted_levels?;
        Some(format!(
            "the brightest pixels end at {}, as of a sensor that clips there, and are taken for light as it is; if they are \
             clipped, tell the x-max: {}",
            in_words(doubted),
            doubted.into_iter().flatten().fold(0.0, f32::max)
        ))
    }

    /// What to tell where the PSF can't be that of the capture: what it looks like instead, or that no scene explains it. Beside lines that
    /// hold nothing, none does.
    pub fn doubt_psf(&self) -> Option<String> {
        if self.empty_lines.is_some() {
            return None;
        }
        let unlike = self.unlike.map(|unlike| unlike.to_string());
        unlike.or_else(|| self.contradiction.map(|contradiction| contradiction.to_string()))
    }

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

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    #[test]
    fn what_is_no_light_is_refused() {
        let image = |value: f32| {
            AnyImage::Linear(LinearImage::from_planes(Array3::from_elem((CHANNELS, 4, 5), value)).unwrap())
        };
        let check = |value: f32| check_brightness(Path::new("capture.exr"), &image(value));
        assert!(check(0.0).is_ok() && check(0.5).is_ok());
        let message = check(-0.5).unwrap_err().to_string();
        assert!(message.contains("capture.exr") && message.contains("-0.5 at most"), "{message}");
        assert!(check(1e19).unwrap_err().to_string().contains("1e19"));
    }

    #[test]
    fn what_a_jpeg_made_wrong_is_not_said_of_what_is_restored() {
        let info = CaptureInfo {
            saturation: Some([1.0; CHANNELS]),
            coding_error: Some([0.01; CHANNELS]),
            ..CaptureInfo::default()
        };
        let image = LinearImage::from_planes(Array3::zeros((CHANNELS, 4, 5))).unwrap();
        let restored = Restored::new(AnyImage::Linear(image), Some(info.clone()), ToneCurve::default());
        assert_eq!(restored.info, Some(CaptureInfo { coding_error: None, ..info }));
    }
}

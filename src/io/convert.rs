//! Converts an image from one file format to another, with what its values are known to be.

use std::path::Path;

use serde_json::json;

use super::lost::{what_is_lost_of_display, what_is_lost_of_light, what_is_lost_of_mapping};
use super::{DomainTag, Format, PixelOptions, Pixels, read_pixels, write_pixels};
use crate::core::capture::CaptureInfo;
use crate::core::error::{Error, Result};
use crate::core::image::CHANNELS;
use crate::core::provenance::Provenance;

/// How an image is converted.
#[derive(Clone, Copy, Debug, Default)]
pub struct Conversion {
    /// What the user says that the values are.
    pub domain: Option<DomainTag>,
    /// Whether half floats are written, in formats that have them.
    pub half: bool,
    /// Whether values that the output cannot hold are clipped.
    pub clip: bool,
    /// Whether an existing output is replaced.
    pub overwrite: bool,
}

/// An image as it will be written.
#[derive(Clone, Debug)]
pub struct ConvertedImage {
    /// Its pixels, with what is known of them.
    pub pixels: Pixels,
    /// What the file says of its colours against what the user says.
    pub contradiction: Option<String>,
    /// Whether neither the file nor the user says the domain, and the output says linear.
    pub is_assumed_linear: bool,
}

impl Conversion {
    /// Reads an image for an output of a format, which must be told what the file's values are where it would hide it.
    ///
    /// # Errors
    /// Those of [`read_pixels`], [`Pixels::tell`] and [`Pixels::check_told`]; [`Error::Unsupported`] when the file declares
    /// another domain than the user says.
    pub fn read(&self, input: &Path, output: &Path) -> Result<ConvertedImage> {
        let mut pixels = read_pixels(input).map_err(|error| error.while_doing(doing(input)))?;
        if let (Some(declared), Some(wanted)) = (pixels.domain, self.domain)
            && declared != wanted
        {
            return Err(Error::Unsupported(format!(
                "{} declares {} values: --domain {} would only rename them; use `udc tonemap` to change them",
                input.display(),
                declared.name(),
                wanted.name()
            )));
        }
        let contradiction = pixels.tell(input, self.domain)?;
        if holds_floats(output) {
            pixels.check_told(input)?;
        }
        let must_say = Format::of_extension(output).is_ok_and(|format| format == Format::Exr);
        let is_assumed_linear = pixels.domain.is_none() && must_say;
        if is_assumed_linear {
            pixels.domain = Some(DomainTag::Linear);
        }
        if self.clip && !holds_floats(output) && pixels.domain == Some(DomainTag::Linear) {
            pixels.capture = pixels.capture.map(|info| info.cut_at(1.0));
        }
        let source = pixels.provenance.take();
        let config = json!({
            "input": input.display().to_string(), "half": self.half, "clip": self.clip, "source": source,
            "domain": self.domain.map(DomainTag::name),
        });
        pixels.provenance = Some(Provenance::new("convert", &config));
        Ok(ConvertedImage { pixels, contradiction, is_assumed_linear })
    }

    /// Writes what was [`read`](Self::read) of `input`. What is made for viewing is always clipped.
    ///
    /// # Errors
    /// Those of [`write_pixels`].
    pub fn write(&self, input: &Path, output: &Path, image: &ConvertedImage) -> Result<()> {
        let is_for_viewing = matches!(image.pixels.domain, Some(DomainTag::ToneMapped | DomainTag::Display));
        let options = PixelOptions {
            half: self.half,
            overwrite: self.overwrite,
            clip: self.clip || is_for_viewing,
            ..PixelOptions::default()
        };
        write_pixels(output, &image.pixels, options).map_err(|error| error.while_doing(doing(input)))
    }
}

impl ConvertedImage {
    /// What the output cannot say of its values: that they are linear light, how they are tone-mapped, or that they are those of a
    /// display.
    pub fn mapping_beyond(&self, output: &Path) -> Option<String> {
        match self.pixels.domain? {
            DomainTag::ToneMapped => {
                let curve = self.pixels.provenance.as_ref().and_then(Provenance::tone_curve);
                what_is_lost_of_mapping(output, curve.unwrap_or_default())
            }
            DomainTag::Display => what_is_lost_of_display(output),
            DomainTag::Linear => what_is_lost_of_light(output),
            DomainTag::Srgb => None,
        }
    }

    /// What is known of the capture and does not follow from the output itself: linear integers that reach 1 clip there
    /// wherever they are read.
    pub fn capture_beyond(&self, output: &Path) -> Option<CaptureInfo> {
        let mut info = self.pixels.capture.clone()?;
        let is_implied = !holds_floats(output) && self.pixels.domain == Some(DomainTag::Linear);
        let is_one = |levels: &[f32; CHANNELS]| levels.iter().all(|level| (level - 1.0).abs() < f32::EPSILON);
        info.saturation = info.saturation.filter(|levels| !(is_implied && is_one(levels)));
        Some(info)
    }
}

fn doing(input: &Path) -> String {
    format!("converting {}", input.display())
}

/// Whether a file no longer shows that its values were integers, which are asked for their domain.
fn holds_floats(file: &Path) -> bool {
    Format::of_extension(file).is_ok_and(Format::holds_light)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    #[test]
    fn linear_integers_need_not_say_that_they_clip_at_one() {
        let clipping_at = |level: f32| {
            let capture = Some(CaptureInfo { saturation: Some([level; CHANNELS]), ..CaptureInfo::default() });
            let planes = Array3::from_elem((3, 2, 2), 0.5);
            let pixels = Pixels { domain: Some(DomainTag::Linear), capture, ..Pixels::of_planes(planes) };
            ConvertedImage { pixels, contradiction: None, is_assumed_linear: false }
        };
        let kept = |level, name: &str| clipping_at(level).capture_beyond(Path::new(name)).unwrap().saturation;
        assert_eq!(kept(1.0, "a.png"), None);
        assert_eq!(kept(0.9, "a.png"), Some([0.9; CHANNELS]));
        assert_eq!(kept(1.0, "a.npy"), Some([1.0; CHANNELS]));
        let lost = |name: &str| clipping_at(1.0).mapping_beyond(Path::new(name));
        assert!(lost("a.jpg").unwrap().contains("--domain linear") && lost("a.npy").is_none());
    }

    #[test]
    fn a_domain_that_the_file_denies_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (input, output) = (folder.path().join("a.exr"), folder.path().join("b.exr"));
        let pixels =
            Pixels { domain: Some(DomainTag::Linear), ..Pixels::of_planes(Array3::zeros((3, 2, 2))) };
        write_pixels(&input, &pixels, PixelOptions::default()).unwrap();
        let told = Conversion { domain: Some(DomainTag::ToneMapped), ..Conversion::default() };
        let refusal = told.read(&input, &output).unwrap_err().to_string();
        assert!(refusal.contains("declares linear values"), "{refusal}");
        let read = Conversion::default().read(&input, &output).unwrap();
        assert!(!read.is_assumed_linear && read.pixels.provenance.is_some());
    }
}

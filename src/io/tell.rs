//! Takes the user's word for what the values of a file are, where the file does not say it itself.

use std::path::Path;

use super::{DomainTag, Pixels};
use crate::core::color::srgb_decode;
use crate::core::error::{Error, Result};
use crate::core::image::CHANNELS;
use crate::core::saturation::saturated_from;

/// Tone-mapped values up to this are white by a network that overshoots, or with noise: images that the published evaluation
/// measures reach 1.053.
const OVERSHOOT: f32 = 1.1;

impl Pixels {
    /// Whether only the user knows what the values are: integers that are no camera's raw ones, of a file that does not
    /// say its domain. A picture of 8 or 16 bits may be linear, tone-mapped or, as most are, encoded as sRGB; what its
    /// colour tags say is no answer, since programs write them into whatever they save.
    pub fn must_be_told(&self) -> bool {
        self.is_integer && self.domain.is_none() && self.raw.is_none()
    }

    /// Refuses values of which nobody has said what they are.
    ///
    /// # Errors
    /// [`Error::Format`] that asks for it.
    pub fn check_told(&self, path: &Path) -> Result<()> {
        self.check_told_by(path, "--domain linear, --domain tone-mapped or --domain srgb")
    }

    /// As [`check_told`](Self::check_told), where linear light is needed.
    ///
    /// # Errors
    /// [`Error::Format`] that asks for it.
    pub fn check_told_light(&self, path: &Path) -> Result<()> {
        let flags =
            "--domain linear or --domain srgb (a tone-mapped one becomes linear by `udc tonemap --inverse`)";
        self.check_told_by(path, flags)
    }

    /// As [`check_told`](Self::check_told), of a file that is told by these flags.
    pub(super) fn check_told_by(&self, path: &Path, flags: &str) -> Result<()> {
        if !self.must_be_told() {
            return Ok(());
        }
        let tags: Vec<String> = self.color_tags.iter().map(ToString::to_string).collect();
        let found = if tags.is_empty() {
            String::new()
        } else {
            format!(" (it has {}, which is no answer)", tags.join("; "))
        };
        let reason = format!(
            "does not say whether its values are linear, tone-mapped or sRGB{found}: add {flags}, or give an .exr that `udc \
             convert --domain …` made of it"
        );
        Err(Error::format(path, reason))
    }

    /// Takes the user's word for the domain; values of sRGB are decoded to linear light in `[0, 1]`. What is then linear and
    /// was sRGB clips at 1, which [`capture`](Self::capture) says unless the file says more; so do linear integers of which
    /// one is that bright: white of 10 or 12 bits in words of 16 is less.
    ///
    /// Returns what is to be warned of, whether or not the user says anything: the [doubts](Self::all_doubts) of the file,
    /// which are told once, and what its colour tags say against the user's word; they change nothing. A file made for
    /// viewing may be told anew.
    ///
    /// # Errors
    /// [`Error::Format`] when the file declares another domain, or is told to be sRGB and holds values outside of `[0, 1]`, or to
    /// be tone-mapped, which it does not say itself, and holds values clearly above 1.
    pub fn tell(&mut self, path: &Path, told: Option<DomainTag>) -> Result<Option<String>> {
        let mut warnings = self.take_doubts(path);
        warnings.extend(told.map_or(Ok(None), |told| self.take_for(path, told))?);
        Ok((!warnings.is_empty()).then(|| warnings.join("; ")))
    }

    /// Takes the values for `told`; returns what the file's colour tags say against it.
    fn take_for(&mut self, path: &Path, told: DomainTag) -> Result<Option<String>> {
        if self.raw.is_some() && told == DomainTag::Srgb {
            return Err(Error::format(
                path,
                "is a camera's raw file, which is linear: leave --domain srgb out",
            ));
        }
        if self.raw.is_none() && self.domain != Some(DomainTag::Display) {
            check_told_domain(path, self.domain, told)?;
        }
        let declared = self.domain.replace(told);
        if let (true, Some(info)) = (told != DomainTag::Srgb, &mut self.capture) {
            // It is told of values that are decoded.
            info.coding_error = None;
        }
        match told {
            DomainTag::Srgb => self.decode_srgb(path)?,
            DomainTag::ToneMapped if declared != Some(told) => self.check_tone_mapped(path)?,
            DomainTag::ToneMapped | DomainTag::Linear | DomainTag::Display => {}
        }
        let reaches_white = || self.planes.iter().any(|value| *value >= saturated_from(1.0));
        let is_linear_integer = told == DomainTag::Linear && self.is_integer && self.raw.is_none();
        if told == DomainTag::Srgb || (is_linear_integer && reaches_white()) {
            self.capture.get_or_insert_default().saturation.get_or_insert([1.0; CHANNELS]);
        }
        let floats = (told == DomainTag::Srgb && !self.is_integer)
            .then(|| "it holds floats, which are linear light as a rule".to_owned());
        let found =
            self.contradictions(told).into_iter().chain(floats).reduce(|a, b| format!("{a}, and {b}"));
        Ok(found.map(|found| {
            let done =
                if told == DomainTag::Srgb { "decoded by the curve of sRGB" } else { "taken as they are" };
            let (path, told) = (path.display(), told.name());
            format!("{path}: {found}; as --domain {told} has it, the values are {done}")
        }))
    }

    /// What the file's colour tags say against values of `domain`.
    pub fn contradictions(&self, domain: DomainTag) -> Option<String> {
        let found: Vec<String> = self.color_tags.iter().filter_map(|tag| tag.contradiction(domain)).collect();
        (!found.is_empty()).then(|| found.join(", and "))
    }

    /// Refuses values that φ never gives, and that its inverse would all take for the brightest light.
    fn check_tone_mapped(&self, path: &Path) -> Result<()> {
        let above = self.planes.iter().copied().filter(|value| value.is_finite() && *value > OVERSHOOT);
        let Some(largest) = above.max_by(f32::total_cmp) else { return Ok(()) };
        let reason = format!(
            "holds {largest}, and tone-mapped values are below 1: it is linear light (--domain linear, where a command has \
             it) or something else"
        );
        Err(Error::format(path, reason))
    }

    fn decode_srgb(&mut self, path: &Path) -> Result<()> {
        if let Some(outside) = self.planes.iter().find(|value| !(0.0..=1.0).contains(*value)) {
            let reason = format!(
                "holds {outside}, and sRGB goes from 0 to 1: it is linear (--domain linear) or something else"
            );
            return Err(Error::format(path, reason));
        }
        #[expect(clippy::cast_possible_truncation, reason = "images are f32")]
        self.planes.par_mapv_inplace(|value| srgb_decode(f64::from(value)) as f32);
        self.domain = Some(DomainTag::Linear);
        Ok(())
    }
}

/// Refuses a file that says another domain than the user.
fn check_told_domain(path: &Path, declared: Option<DomainTag>, told: DomainTag) -> Result<()> {
    let Some(tag) = declared.filter(|tag| *tag != told) else { return Ok(()) };
    let (found, told) = (tag.name(), told.name());
    let else_by = match tag {
        DomainTag::ToneMapped => ", or make linear light of the file by `udc tonemap --inverse`",
        DomainTag::Linear if told == DomainTag::ToneMapped.name() => {
            ", or tone-map the file by `udc tonemap` (without --inverse)"
        }
        _ => "",
    };
    let reason = format!(
        "holds {found} values where {told} ones are needed, as the file itself says: leave out the flag that says {told} \
         (as --domain or --psf-domain){else_by}"
    );
    Err(Error::format(path, reason))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::capture::CaptureInfo;
    use ndarray::Array3;

    fn told(is_integer: bool, domain: DomainTag, capture: Option<CaptureInfo>) -> Option<[f32; 3]> {
        told_of(1.0, is_integer, domain, capture)
    }

    fn told_of(
        brightest: f32,
        is_integer: bool,
        domain: DomainTag,
        capture: Option<CaptureInfo>,
    ) -> Option<[f32; 3]> {
        let mut planes = Array3::from_elem((3, 2, 2), 0.01);
        planes[[1, 0, 1]] = brightest;
        let mut pixels = Pixels { is_integer, capture, ..Pixels::of_planes(planes) };
        pixels.tell(Path::new("a.png"), Some(domain)).unwrap();
        pixels.capture.and_then(|capture| capture.saturation)
    }

    #[test]
    fn srgb_and_integers_that_are_light_clip_at_one() {
        assert_eq!(told(true, DomainTag::Srgb, None), Some([1.0; 3]));
        assert_eq!(told(false, DomainTag::Srgb, None), Some([1.0; 3]));
        assert_eq!(told(true, DomainTag::Linear, None), Some([1.0; 3]));
        assert_eq!(told(false, DomainTag::Linear, None), None, "floats may hold any light");
        assert_eq!(told(true, DomainTag::ToneMapped, None), None, "1 is no light there");
        let said = CaptureInfo { saturation: Some([1.9, 1.0, 1.6]), ..CaptureInfo::default() };
        assert_eq!(told(false, DomainTag::Srgb, Some(said)), Some([1.9, 1.0, 1.6]));
    }

    #[test]
    fn values_that_no_tone_mapping_gives_are_refused() {
        let tell = |brightest: f32| {
            let mut pixels = Pixels::of_planes(Array3::from_elem((3, 2, 2), brightest));
            pixels.tell(Path::new("a.npy"), Some(DomainTag::ToneMapped)).map(|_| ())
        };
        tell(1.09).unwrap();
        let said = tell(1.5).unwrap_err().to_string();
        assert!(said.contains("holds 1.5, and tone-mapped values are below 1"), "{said}");
        // What a network that learned little wrote says itself what it is.
        let declared = Some(DomainTag::ToneMapped);
        let mut pixels = Pixels { domain: declared, ..Pixels::of_planes(Array3::from_elem((3, 2, 2), 1.5)) };
        pixels.tell(Path::new("a.exr"), declared).unwrap();
    }

    #[test]
    fn what_a_file_leaves_in_doubt_is_told_once_and_without_a_domain_too() {
        let planes = Array3::from_elem((3, 2, 2), 0.5);
        let doubts = vec!["its pixels are not square".to_owned()];
        let mut pixels = Pixels { without_data: 1, doubts, ..Pixels::of_planes(planes) };
        let said = pixels.tell(Path::new("a.exr"), None).unwrap().unwrap();
        assert!(
            said.contains("1 of 4 pixels hold no data")
                && said.ends_with("; a.exr: its pixels are not square"),
            "{said}"
        );
        assert_eq!(pixels.tell(Path::new("a.exr"), Some(DomainTag::Linear)).unwrap(), None);
    }

    /// 12 bits in a word of 16: who takes 65535 for white finds no lamp.
    #[test]
    fn integers_that_do_not_reach_the_top_clip_nobody_knows_where() {
        let white = 4095.0 / 65535.0;
        assert_eq!(told_of(white, true, DomainTag::Linear, None), None);
        assert_eq!(told_of(white, true, DomainTag::Srgb, None), Some([1.0; 3]));
    }
}

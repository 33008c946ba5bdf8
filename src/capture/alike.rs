//! Refuses pictures of one bracket that say different things of their values.

use std::path::Path;

use super::told::Told;
use crate::core::capture::CaptureInfo;
use crate::core::error::{Error, Result};
use crate::core::image::CHANNELS;
use crate::core::orientation::Orientation;
use crate::core::primaries::Primaries;
use crate::io::RawMetadata;

/// What a file says of its values: as a camera's raw one, or of the capture that it is.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Said<'a> {
    pub(super) raw: Option<&'a RawMetadata>,
    pub(super) capture: Option<&'a CaptureInfo>,
}

impl Said<'_> {
    fn orientation(&self) -> Orientation {
        let of_capture = || self.capture.and_then(|capture| capture.orientation);
        self.raw.map(|raw| raw.orientation).or_else(of_capture).unwrap_or_default()
    }

    fn primaries(&self) -> Option<Primaries> {
        self.capture.and_then(|capture| capture.primaries)
    }
}

/// Refuses a raw file of other levels or colours than the first, unless the user gives them.
pub(super) fn check_levels(
    file: &Path,
    told: &Told,
    first: Option<&RawMetadata>,
    this: Option<&RawMetadata>,
) -> Result<()> {
    let untold = |raw: &RawMetadata| {
        let levels = &told.levels;
        let white = levels.white.is_none().then_some(raw.white);
        let black = levels.black.is_none().then_some(raw.black);
        (white, black, if levels.bayer.is_some() { None } else { raw.bayer })
    };
    if first.map(untold) == this.map(untold) {
        return Ok(());
    }
    Err(Error::Unsupported(format!(
        "{} says another black or white level or mosaic than the first picture; give --black, --white and --bayer",
        file.display()
    )))
}

/// Refuses a picture whose red, green and blue are others than the first's, that saturates elsewhere, or that is to be turned otherwise,
/// which matters to all but a point source. Returns what is to be said of other gains, which the first picture's stand for.
pub(super) fn check_scene(
    file: &Path,
    told: &Told,
    first: Said<'_>,
    this: Said<'_>,
) -> Result<Option<String>> {
    let file = file.display();
    if !Primaries::are_same(first.primaries(), this.primaries()) {
        return Err(Error::Unsupported(format!(
            "{file} has another red, green and blue than the first picture: give pictures of one colour space"
        )));
    }
    if !told.demosaic_linear && first.orientation() != this.orientation() {
        return Err(Error::Unsupported(format!(
            "{file} says that it lies otherwise than the first picture ({} and {} as EXIF counts): if they lie alike on the \
             sensor, write one orientation into all, else take the bracket again",
            this.orientation().exif(),
            first.orientation().exif()
        )));
    }
    let level = |said: &Said<'_>, channel: usize| {
        said.capture.and_then(|capture| capture.saturation).map_or(1.0, |levels| levels[channel])
    };
    let is_far = |channel| (level(&first, channel) / level(&this, channel) - 1.0).abs() > SAME_LEVEL;
    if told.levels.white.is_none() && (0..CHANNELS).any(is_far) {
        return Err(Error::Unsupported(format!(
            "{file} says that it saturates at another light than the first picture: develop them alike, or give --white for all"
        )));
    }
    let gains = |said: &Said<'_>| {
        let of_raw =
            said.raw.and_then(|raw| raw.white_balance).filter(|_| told.levels.white_balance.is_none());
        of_raw.or_else(|| said.capture.and_then(|capture| capture.white_balance))
    };
    let is_other = |(a, b): (&f64, &f64)| (a / b - 1.0).abs() > SAME_GAIN;
    let differs = match (gains(&first), gains(&this)) {
        (Some(first), Some(this)) => first.iter().zip(&this).any(is_other),
        (first, this) => first.is_some() != this.is_some(),
    };
    Ok(differs.then(|| {
        format!(
            "{file} says another white balance than the first picture, whose gains are taken for all; give --white-balance R,G,B \
             for others"
        )
    }))
}

/// Levels and gains that differ by less, as a share, are the same but for rounding.
const SAME_LEVEL: f32 = 1e-3;
const SAME_GAIN: f64 = 1e-3;

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(told: &Told, first: &RawMetadata, this: &RawMetadata) -> Result<Option<String>> {
        let said = |raw| Said { raw: Some(raw), capture: None };
        check_scene(Path::new("b.dng"), told, said(first), said(this))
    }

    #[test]
    fn other_gains_are_told_unless_the_user_gives_them() {
        let gains = |red| RawMetadata { white_balance: Some([red, 1.0, 1.6]), ..RawMetadata::default() };
        let mut told = Told::default();
        assert_eq!(scene(&told, &gains(2.0), &gains(2.0)).unwrap(), None);
        assert!(
            scene(&told, &gains(2.0), &gains(1.25))
                .unwrap()
                .unwrap()
                .contains("b.dng says another white balance")
        );
        assert!(scene(&told, &gains(2.0), &RawMetadata::default()).unwrap().is_some());
        told.levels.white_balance = Some([1.0; 3]);
        assert_eq!(scene(&told, &gains(2.0), &gains(1.25)).unwrap(), None);
    }

    #[test]
    fn pictures_that_lie_otherwise_are_refused_unless_they_are_of_a_point_source() {
        let lies = |exif| RawMetadata {
            orientation: Orientation::from_exif(exif).unwrap(),
            ..RawMetadata::default()
        };
        let mut told = Told::default();
        assert!(scene(&told, &lies(6), &lies(6)).is_ok());
        let said = scene(&told, &lies(1), &lies(6)).unwrap_err().to_string();
        assert!(said.contains("b.dng") && said.contains("6 and 1"), "{said}");
        told.demosaic_linear = true;
        assert!(scene(&told, &lies(1), &lies(6)).is_ok());
    }

    #[test]
    fn pictures_of_other_primaries_are_refused() {
        let of = |primaries| CaptureInfo { primaries, ..CaptureInfo::default() };
        let check = |first: &CaptureInfo, this: &CaptureInfo| {
            let said = |capture| Said { raw: None, capture: Some(capture) };
            check_scene(Path::new("b.exr"), &Told::default(), said(first), said(this))
        };
        let (p3, bt2020, none) = (of(Some(Primaries::DISPLAY_P3)), of(Some(Primaries::BT2020)), of(None));
        assert!(check(&p3, &p3).is_ok() && check(&none, &none).is_ok());
        assert!(check(&p3, &bt2020).is_err() && check(&none, &p3).is_err() && check(&p3, &none).is_err());
    }
}

//! Tells whether two image files can be compared: of one red, green and blue, and to be turned alike.

use std::path::Path;

use crate::core::error::{Error, Result};
use crate::core::orientation::Orientation;
use crate::core::primaries::Primaries;
use crate::io::{Format, Pixels};

/// What a file says of its colours, and of how it lies.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Appearance {
    /// The primaries, where they are others than those of sRGB.
    pub primaries: Option<Primaries>,
    /// Whether the file says its primaries, be it those of sRGB.
    pub says_primaries: bool,
    /// How the picture lies.
    pub orientation: Orientation,
    /// Whether files of its format say how they lie.
    pub says_orientation: bool,
}

impl Appearance {
    /// What is said by a file of `format` with these pixels.
    pub(super) fn of(pixels: &Pixels, format: Format) -> Self {
        let capture = pixels.capture.clone().unwrap_or_default();
        let is_camera = capture.color.is_some();
        let is_tagged = pixels.color_tags.iter().any(|tag| tag.says_primaries());
        let says_primaries = format == Format::Exr || capture.primaries.is_some() || is_tagged;
        Self {
            primaries: capture.primaries,
            says_primaries: says_primaries && !is_camera,
            orientation: capture.orientation.unwrap_or_default(),
            says_orientation: !matches!(format, Format::Npy | Format::Hdr),
        }
    }
}

/// Checks that two files can be compared pixel by pixel. Says what to warn of where one of them does not say what the other does.
///
/// # Errors
/// [`Error::Unsupported`] naming both where they say different primaries, or are to be turned differently.
pub(super) fn check_alike(one: (&Path, Appearance), other: (&Path, Appearance)) -> Result<Option<String>> {
    let warnings = [check_primaries(one, other)?, check_orientation(one, other)?];
    let warnings: Vec<String> = warnings.into_iter().flatten().collect();
    Ok((!warnings.is_empty()).then(|| warnings.join("; ")))
}

fn check_primaries((one, a): (&Path, Appearance), (other, b): (&Path, Appearance)) -> Result<Option<String>> {
    let (one, other) = (one.display(), other.display());
    if Primaries::are_same(a.primaries, b.primaries) {
        return Ok(None);
    }
    let [of_one, of_other] = [a.primaries, b.primaries].map(Primaries::name_of);
    let assumed = |silent, speaking, of: String| {
        format!(
            "{silent} does not say its red, green and blue, and is taken for an image of {of}, as {speaking}"
        )
    };
    match (a.says_primaries, b.says_primaries) {
        (true, true) => Err(Error::Unsupported(format!(
            "{one} is of {of_one}, and {other} of {of_other}: images of two colour spaces cannot be compared; convert one of them"
        ))),
        (false, _) => Ok(Some(assumed(one, other, of_other))),
        (true, false) => Ok(Some(assumed(other, one, of_one))),
    }
}

fn check_orientation(
    (one, a): (&Path, Appearance),
    (other, b): (&Path, Appearance),
) -> Result<Option<String>> {
    if a.orientation == b.orientation {
        return Ok(None);
    }
    let describe = |(path, orientation): (&Path, Orientation)| {
        format!("{} is {orientation} (orientation {})", path.display(), orientation.exif())
    };
    let assumed = |silent: &Path, speaking| {
        let speaking = describe(speaking);
        format!(
            "{} cannot say how it lies, and is compared as if it lay as its partner: {speaking}",
            silent.display()
        )
    };
    let (one, other) = ((one, a.orientation), (other, b.orientation));
    match (a.says_orientation, b.says_orientation) {
        (true, true) => Err(Error::Unsupported(format!(
            "{}, and {}: what lies differently cannot be compared; store both upright, or, if their pixels do lie alike, write the one \
             orientation into both",
            describe(one),
            describe(other)
        ))),
        (false, _) => Ok(Some(assumed(one.0, other))),
        (true, false) => Ok(Some(assumed(other.0, one))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SAYS_ALL: Appearance = Appearance {
        primaries: None,
        says_primaries: true,
        orientation: Orientation::ALL[0],
        says_orientation: true,
    };

    fn check(one: Appearance, other: Appearance) -> Result<Option<String>, String> {
        let (a, b) = (Path::new("r/a.exr"), Path::new("gt/a.exr"));
        check_alike((a, one), (b, other)).map_err(|error| error.to_string())
    }

    #[test]
    fn images_of_two_colour_spaces_are_refused_and_those_that_say_none_are_warned_of() {
        let wide = Appearance { primaries: Some(Primaries::BT2020), ..SAYS_ALL };
        assert_eq!((check(wide, wide), check(SAYS_ALL, SAYS_ALL)), (Ok(None), Ok(None)));
        let said = check(SAYS_ALL, wide).unwrap_err();
        assert!(said.contains("r/a.exr is of sRGB primaries, and gt/a.exr of BT.2020 primaries"), "{said}");
        let silent = Appearance { says_primaries: false, ..SAYS_ALL };
        assert_eq!(check(silent, SAYS_ALL), Ok(None));
        let said = check(wide, silent).unwrap().unwrap();
        assert!(said.starts_with("gt/a.exr does not say") && said.contains("BT.2020"), "{said}");
    }

    #[test]
    fn images_that_lie_differently_are_refused_with_how_each_is_to_be_turned() {
        let turned = Appearance { orientation: Orientation::ALL[5], ..SAYS_ALL };
        assert_eq!(check(turned, turned), Ok(None));
        let said = check(turned, SAYS_ALL).unwrap_err();
        assert!(
            said.contains(
                "r/a.exr is to be turned right (orientation 6), and gt/a.exr is upright (orientation 1)"
            ),
            "{said}"
        );
        let silent = Appearance { says_orientation: false, ..SAYS_ALL };
        assert!(check(silent, turned).unwrap().unwrap().starts_with("r/a.exr cannot say how it lies"));
    }
}

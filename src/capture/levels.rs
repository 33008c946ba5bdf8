//! Decides what the numbers of a picture stand for, of what the user says and what the file says.
//!
//! Three tables of cases, one after another: which [`Kind`] of picture it is, in which [`Unit`] the user gives levels, and
//! what [`Levels`] the picture has. A row is one arm of a `match`, and one line of its test.

use std::path::Path;

use super::told::ToldLevels;
use crate::core::bayer::BayerPattern;
use crate::io::{Encoding, Pixels, RawMetadata};

/// What a file says of its samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Samples {
    /// Whether it is a camera's raw file, with levels of its own.
    pub(super) is_camera_raw: bool,
    /// Whether they are integers of three colours.
    pub(super) is_integer_rgb: bool,
    /// By what integers of 8 or 16 bits were divided; OpenEXR's are kept as they are.
    pub(super) largest: Option<f64>,
}

impl Samples {
    pub(super) fn of(pixels: &Pixels, encoding: &Encoding) -> Self {
        Self {
            is_camera_raw: pixels.raw.is_some(),
            is_integer_rgb: pixels.is_integer && pixels.planes.dim().0 == 3,
            largest: match encoding.sample_type.as_str() {
                "uint8" => Some(f64::from(u8::MAX)),
                "uint16" => Some(f64::from(u16::MAX)),
                _ => None,
            },
        }
    }
}

/// What kind of picture a file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// A camera's raw file, which says its levels.
    CameraRaw,
    /// Raw by the user's word.
    DeclaredRaw,
    /// Light, or a picture for the screen, as its domain says.
    Picture,
}

impl Kind {
    /// Decides by the file and by what the user says of levels, colours and dark frames, `is_told_raw` if anything.
    ///
    /// Three channels of integers are a picture for the screen unless more than 8 bits with a white level of their own say
    /// that they are demosaicked.
    ///
    /// | camera's raw file | told raw | RGB integers, no mosaic | white told, not 8 bits | kind |
    /// |---|---|---|---|---|
    /// | yes | – | – | – | camera's raw |
    /// | no | no | – | – | picture |
    /// | no | yes | no | – | declared raw |
    /// | no | yes | yes | yes | declared raw |
    /// | no | yes | yes | no | picture |
    pub(super) fn of(samples: Samples, told: &ToldLevels, is_told_raw: bool) -> Self {
        let looks_finished = samples.is_integer_rgb && told.bayer.is_none();
        let is_demosaicked = told.white.is_some() && samples.largest != Some(f64::from(u8::MAX));
        match (samples.is_camera_raw, is_told_raw, looks_finished, is_demosaicked) {
            (true, ..) => Self::CameraRaw,
            (false, false, ..) => Self::Picture,
            (false, true, false, _) => Self::DeclaredRaw,
            (false, true, true, true) => Self::DeclaredRaw,
            (false, true, true, false) => Self::Picture,
        }
    }
}

/// The unit of the levels that the user gives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Unit {
    /// That of the planes: shares of the largest integer, or floats as they are.
    Planes,
    /// The file's own integers, up to this one.
    Integers(f64),
}

impl Unit {
    /// Decides by the white that the user gives and by what the file says.
    ///
    /// | white told | camera's raw file | samples | unit |
    /// |---|---|---|---|
    /// | above 1 | – | integers up to N | integers up to N |
    /// | above 1 | – | floats | planes |
    /// | up to 1 | – | – | planes |
    /// | no | yes | integers up to N | integers up to N |
    /// | no | yes | floats | planes |
    /// | no | no | – | planes |
    pub(super) fn of(white: Option<f64>, samples: Samples) -> Self {
        match (Self::is_of_integers(white, samples.is_camera_raw), samples.largest) {
            (true, Some(largest)) => Self::Integers(largest),
            (true, None) | (false, _) => Self::Planes,
        }
    }

    /// Whether levels are the file's own integers, where it has any.
    pub(super) fn is_of_integers(white: Option<f64>, is_camera_raw: bool) -> bool {
        match (white, is_camera_raw) {
            (Some(white), _) => white > 1.0,
            (None, is_camera_raw) => is_camera_raw,
        }
    }

    /// A level in the unit of the planes.
    fn in_planes(self, level: f64) -> f64 {
        match self {
            Self::Planes => level,
            Self::Integers(largest) => level / largest,
        }
    }
}

/// Where the gains of a white balance are from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Balance {
    /// The user or the file says them, or nobody needs to.
    Said,
    /// A camera's raw file says nothing; its colours tell those of daylight.
    Daylight,
    /// A camera's raw file says neither; light stays in the camera's own colours.
    Unknown,
}

/// What the values of pictures stand for, in the units of their planes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Levels {
    pub(super) white: f64,
    pub(super) black: f64,
    /// The colours of the mosaic.
    pub(super) bayer: Option<BayerPattern>,
    /// Gains of red, green and blue.
    pub(super) white_balance: [f64; 3],
    pub(super) balance: Balance,
}

/// Chromaticity (x, y) of daylight, D65 as sRGB has it.
const DAYLIGHT: [f64; 2] = [0.3127, 0.3290];

impl Levels {
    /// Decides each level by the first who says it: the user, the camera's raw file, the rule for all others.
    ///
    /// | | told | else, of a camera's raw file | else |
    /// |---|---|---|---|
    /// | white | in the unit | its own | 1 |
    /// | black | in the unit | its own | 0 |
    /// | mosaic | as told | its own | none |
    /// | gains | as told | its own; else those of daylight; else 1, 1, 1 | 1, 1, 1 |
    pub(super) fn of(told: &ToldLevels, unit: Unit, raw: Option<&RawMetadata>) -> Self {
        let level = |told: Option<f64>, own: Option<f64>, otherwise: f64| match (told, own) {
            (Some(told), _) => unit.in_planes(told),
            (None, Some(own)) => own,
            (None, None) => otherwise,
        };
        let daylight = |raw: &RawMetadata| raw.color.as_ref().and_then(|color| color.gains_of(DAYLIGHT));
        let (white_balance, balance) = match (told.white_balance, raw) {
            (Some(gains), _) => (gains, Balance::Said),
            (None, None) => ([1.0; 3], Balance::Said),
            (None, Some(raw)) => match (raw.white_balance, daylight(raw)) {
                (Some(gains), _) => (gains, Balance::Said),
                (None, Some(gains)) => (gains, Balance::Daylight),
                (None, None) => ([1.0; 3], Balance::Unknown),
            },
        };
        Self {
            white: level(told.white, raw.map(|raw| raw.white), 1.0),
            black: level(told.black, raw.map(|raw| raw.black), 0.0),
            bayer: told.bayer.or(raw.and_then(|raw| raw.bayer)),
            white_balance,
            balance,
        }
    }

    /// What the user is to be told of a mosaic that the raw file has otherwise, of pictures of which `file` is the first.
    pub(super) fn doubt(&self, file: &Path, raw: Option<&RawMetadata>) -> Option<String> {
        let own = raw?.bayer.filter(|own| self.bayer != Some(*own))?;
        Some(format!(
            "{} says that its mosaic is {}; as --bayer has it, {} is taken: leave --bayer out if the colours come out wrong",
            file.display(),
            format!("{own:?}").to_uppercase(),
            format!("{:?}", self.bayer?).to_uppercase()
        ))
    }

    /// What the user is to be told of the gains, of pictures of which `file` is the first.
    pub(super) fn warning(&self, file: &Path) -> Option<String> {
        let file = file.display();
        let [red, green, blue] = self.white_balance;
        match self.balance {
            Balance::Said => None,
            Balance::Daylight => Some(format!(
                "{file} says no white balance; taken as under daylight (D65), {red:.3},{green:.3},{blue:.3}: give \
                 --white-balance R,G,B for another light"
            )),
            Balance::Unknown => Some(format!(
                "{file} says no white balance; light stays in the camera's own colours: give --white-balance R,G,B"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::camera_color::{CalibratedLight, CameraColor};

    const NOTHING: ToldLevels = ToldLevels { white: None, black: None, bayer: None, white_balance: None };
    const FLOATS: Samples = Samples { is_camera_raw: false, is_integer_rgb: false, largest: None };
    const BYTES: Samples = Samples { is_integer_rgb: true, largest: Some(255.0), ..FLOATS };
    const WORDS: Samples = Samples { is_integer_rgb: true, largest: Some(65535.0), ..FLOATS };
    const MOSAIC: Samples = Samples { largest: Some(65535.0), ..FLOATS };
    const CAMERA: Samples = Samples { is_camera_raw: true, ..MOSAIC };

    fn white(white: f64) -> ToldLevels {
        ToldLevels { white: Some(white), ..NOTHING }
    }

    #[test]
    fn each_kind_of_picture_has_its_row() {
        let bayer = ToldLevels { bayer: Some(BayerPattern::Rggb), ..NOTHING };
        for (samples, told, is_told_raw, kind) in [
            (CAMERA, NOTHING, false, Kind::CameraRaw),
            (CAMERA, white(1023.0), true, Kind::CameraRaw),
            (FLOATS, NOTHING, false, Kind::Picture),
            (WORDS, NOTHING, false, Kind::Picture),
            (FLOATS, NOTHING, true, Kind::DeclaredRaw),
            (MOSAIC, NOTHING, true, Kind::DeclaredRaw),
            (BYTES, bayer, true, Kind::DeclaredRaw),
            (WORDS, white(1023.0), true, Kind::DeclaredRaw),
            (WORDS, NOTHING, true, Kind::Picture),
            (BYTES, white(200.0), true, Kind::Picture),
        ] {
            assert_eq!(Kind::of(samples, &told, is_told_raw), kind, "{samples:?} {told:?} {is_told_raw}");
        }
    }

    #[test]
    fn each_unit_of_levels_has_its_row() {
        let float_camera = Samples { largest: None, ..CAMERA };
        for (white, samples, unit) in [
            (Some(1023.0), MOSAIC, Unit::Integers(65535.0)),
            (Some(200.0), BYTES, Unit::Integers(255.0)),
            (Some(1023.0), FLOATS, Unit::Planes),
            (Some(1.0), MOSAIC, Unit::Planes),
            (Some(0.5), CAMERA, Unit::Planes),
            (None, CAMERA, Unit::Integers(65535.0)),
            (None, float_camera, Unit::Planes),
            (None, MOSAIC, Unit::Planes),
            (None, FLOATS, Unit::Planes),
        ] {
            assert_eq!(Unit::of(white, samples), unit, "{white:?} {samples:?}");
        }
    }

    #[test]
    fn each_level_is_that_of_the_first_who_says_it() {
        let own = RawMetadata {
            white: 0.25,
            black: 0.01,
            bayer: Some(BayerPattern::Bggr),
            white_balance: Some([2.0, 1.0, 1.5]),
            ..RawMetadata::default()
        };
        let told = ToldLevels {
            white: Some(1023.0),
            black: Some(64.0),
            bayer: Some(BayerPattern::Rggb),
            white_balance: Some([1.9, 1.0, 1.6]),
        };
        let unit = Unit::Integers(65535.0);
        let expected = Levels {
            white: 1023.0 / 65535.0,
            black: 64.0 / 65535.0,
            bayer: told.bayer,
            white_balance: [1.9, 1.0, 1.6],
            balance: Balance::Said,
        };
        assert_eq!(Levels::of(&told, unit, Some(&own)), expected);
        assert_eq!(Levels::of(&told, unit, None), expected);
        let in_planes = Levels { white: 1023.0, black: 64.0, ..expected };
        assert_eq!(Levels::of(&told, Unit::Planes, None), in_planes);

        let of_file =
            Levels { white: 0.25, black: 0.01, bayer: own.bayer, white_balance: [2.0, 1.0, 1.5], ..expected };
        assert_eq!(Levels::of(&NOTHING, unit, Some(&own)), of_file);
        let said = Levels::of(&told, unit, Some(&own)).doubt(Path::new("a.dng"), Some(&own)).unwrap();
        assert!(said.contains("its mosaic is BGGR; as --bayer has it, RGGB is taken"), "{said}");
        assert_eq!(of_file.doubt(Path::new("a.dng"), Some(&own)), None);
        let of_rule = Levels { white: 1.0, black: 0.0, bayer: None, white_balance: [1.0; 3], ..expected };
        assert_eq!(Levels::of(&NOTHING, Unit::Planes, None), of_rule);
    }

    /// XYZ of daylight are x/y, 1, (1 − x − y)/y, and so are the colours of a camera that sees XYZ.
    #[test]
    fn a_camera_that_says_no_gains_has_those_of_daylight_if_it_says_its_colours() {
        let silent = RawMetadata { white: 1.0, ..RawMetadata::default() };
        let unknown = Levels::of(&NOTHING, Unit::Planes, Some(&silent));
        assert_eq!((unknown.white_balance, unknown.balance), ([1.0; 3], Balance::Unknown));
        assert!(unknown.warning(Path::new("a.dng")).unwrap().contains("camera's own colours"));

        let color = CameraColor { lights: vec![CalibratedLight::default()], analog_balance: [1.0; 3] };
        let of_colors = RawMetadata { color: Some(color), ..silent };
        let daylight = Levels::of(&NOTHING, Unit::Planes, Some(&of_colors));
        let [x, y] = DAYLIGHT;
        for (gain, expected) in daylight.white_balance.into_iter().zip([y / x, 1.0, y / (1.0 - x - y)]) {
            assert!((gain - expected).abs() < 1e-12, "{gain} instead of {expected}");
        }
        assert_eq!(daylight.balance, Balance::Daylight);
        assert!(daylight.warning(Path::new("a.dng")).unwrap().contains("daylight"));
    }
}

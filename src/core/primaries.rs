//! Says which colours the red, green and blue of an image are, and turns those of one into those of another.

use serde::{Deserialize, Serialize};

use super::matrix3::{Matrix3, apply, diagonal, inverse, product};

/// Chromaticities (x, y): D50 as the profile connection space has it, and D65 as sRGB (IEC 61966-2-1) has it.
pub(super) const D50: [f64; 2] = [0.3457, 0.3585];
pub(super) const D65: [f64; 2] = [0.3127, 0.3290];

/// XYZ to the responses of the Bradford transform (Lam 1985), in which lights are adapted to each other.
const BRADFORD: Matrix3 = [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]];

/// How far coordinates may lie apart and count as the same: files round to three or four digits.
const SAME: f64 = 2e-3;

/// The red, green and blue of an image, and its white, as chromaticities (x, y).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Primaries {
    /// Red.
    pub red: [f64; 2],
    /// Green.
    pub green: [f64; 2],
    /// Blue.
    pub blue: [f64; 2],
    /// The light that equal red, green and blue make.
    pub white: [f64; 2],
}

impl Primaries {
    /// sRGB (IEC 61966-2-1) and ITU-R BT.709.
    pub const SRGB: Self = Self { red: [0.64, 0.33], green: [0.30, 0.60], blue: [0.15, 0.06], white: D65 };

    /// Display P3: those of SMPTE RP 431-2 with the white of sRGB.
    pub const DISPLAY_P3: Self =
        Self { red: [0.68, 0.32], green: [0.265, 0.69], blue: [0.15, 0.06], white: D65 };

    /// ITU-R BT.2020.
    pub const BT2020: Self =
        Self { red: [0.708, 0.292], green: [0.170, 0.797], blue: [0.131, 0.046], white: D65 };

    /// Linear values to XYZ: the primaries, scaled so that they add up to the white; none of what are no primaries.
    ///
    /// Primaries may have no luminance, as two of XYZ itself have none.
    pub fn to_xyz(&self) -> Option<Matrix3> {
        let [red, green, blue] = [self.red, self.green, self.blue].map(|[x, y]| [x, y, 1.0 - x - y]);
        let primaries = [0, 1, 2].map(|i| [red[i], green[i], blue[i]]);
        let matrix = product(&primaries, &diagonal(apply(&inverse(&primaries)?, xyz_of(self.white))));
        matrix.iter().flatten().all(|value| value.is_finite()).then_some(matrix)
    }

    /// The matrix from linear values of these primaries to those of others; whites are adapted by linear Bradford, so that
    /// grey stays grey.
    pub fn matrix_to(&self, other: &Self) -> Option<Matrix3> {
        let adapted = product(&adaptation(xyz_of(self.white), xyz_of(other.white))?, &self.to_xyz()?);
        Some(product(&inverse(&other.to_xyz()?)?, &adapted))
    }

    /// Whether images of the two are the same, but for the rounding of files.
    pub fn is_near(&self, other: &Self) -> bool {
        let all = |primaries: &Self| [primaries.red, primaries.green, primaries.blue, primaries.white];
        let pairs = all(self).into_iter().flatten().zip(all(other).into_iter().flatten());
        pairs.into_iter().all(|(a, b)| (a - b).abs() <= SAME)
    }

    /// Whether two images are of the same primaries, which are those of sRGB where none are said.
    pub fn are_same(one: Option<Self>, other: Option<Self>) -> bool {
        one.unwrap_or(Self::SRGB).is_near(&other.unwrap_or(Self::SRGB))
    }

    /// How to call the primaries of an image in messages: those of sRGB where none are said.
    pub fn name_of(said: Option<Self>) -> String {
        let primaries = said.unwrap_or(Self::SRGB);
        let Self { red, green, blue, white } = primaries;
        let place = |[x, y]: [f64; 2]| format!("({x:.4}, {y:.4})");
        match primaries.name() {
            Some(name) => format!("{name} primaries"),
            None => {
                let [red, green, blue, white] = [red, green, blue, white].map(place);
                format!("primaries {red}, {green}, {blue} and white {white}")
            }
        }
    }

    /// The name of the primaries, where they are well known.
    pub fn name(&self) -> Option<&'static str> {
        // SMPTE ST 2065-1 and Academy S-2014-004; Adobe RGB (1998).
        const ACES_WHITE: [f64; 2] = [0.32168, 0.33767];
        let known = [
            ("sRGB", Self::SRGB),
            ("Display P3", Self::DISPLAY_P3),
            ("BT.2020", Self::BT2020),
            ("Adobe RGB", Self { green: [0.21, 0.71], ..Self::SRGB }),
            (
                "ACES AP0",
                Self { red: [0.7347, 0.2653], green: [0.0, 1.0], blue: [0.0001, -0.077], white: ACES_WHITE },
            ),
            (
                "ACES AP1",
                Self { red: [0.713, 0.293], green: [0.165, 0.83], blue: [0.128, 0.044], white: ACES_WHITE },
            ),
        ];
        known.into_iter().find(|(_, primaries)| self.is_near(primaries)).map(|(name, _)| name)
    }

    /// The primaries whose XYZ, adapted to D50 as ICC profiles have them, are these; their white is D65.
    pub fn of_profile(colorants: [[f64; 3]; 3]) -> Option<Self> {
        let to_d65 = adaptation(PROFILE_WHITE, xyz_of(D65))?;
        let [red, green, blue] = colorants.map(|xyz| chromaticity(apply(&to_d65, xyz)));
        let primaries = Self { red: red?, green: green?, blue: blue?, white: D65 };
        primaries.matrix_to(&Self::SRGB).map(|_| primaries)
    }
}

/// X, Y, Z of the white of ICC profiles (ICC.1:2022, 7.2.16).
pub const PROFILE_WHITE: [f64; 3] = [0.9642, 1.0, 0.8249];

/// The colours that pictures for displays are written in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ColorSpace {
    /// sRGB (IEC 61966-2-1), which any display shows.
    #[default]
    Srgb,
    /// Display P3: more saturated red and green, the curve of sRGB.
    DisplayP3,
}

impl ColorSpace {
    /// Its red, green, blue and white.
    pub fn primaries(self) -> Primaries {
        match self {
            Self::Srgb => Primaries::SRGB,
            Self::DisplayP3 => Primaries::DISPLAY_P3,
        }
    }

    /// Its usual name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Srgb => "sRGB",
            Self::DisplayP3 => "Display P3",
        }
    }
}

/// X, Y, Z of a chromaticity, Y being 1.
pub(super) fn xyz_of([x, y]: [f64; 2]) -> [f64; 3] {
    [x / y, 1.0, (1.0 - x - y) / y]
}

fn chromaticity([x, y, z]: [f64; 3]) -> Option<[f64; 2]> {
    let sum = x + y + z;
    (sum.is_finite() && sum > 0.0).then(|| [x / sum, y / sum])
}

/// The matrix by which XYZ under one white become those under another.
pub fn adaptation(from: [f64; 3], to: [f64; 3]) -> Option<Matrix3> {
    let [from, to] = [from, to].map(|white| apply(&BRADFORD, white));
    let gains = diagonal([0, 1, 2].map(|i| to[i] / from[i]));
    Some(product(&inverse(&BRADFORD)?, &product(&gains, &BRADFORD)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_near(found: &Matrix3, expected: &Matrix3, tolerance: f64) {
        for (found, expected) in found.iter().flatten().zip(expected.iter().flatten()) {
            assert!((found - expected).abs() < tolerance, "{found} instead of {expected}");
        }
    }

    /// The matrix as Apple and the CSS Color specification (level 4, section 10.3) have it, to four digits.
    #[test]
    fn display_p3_becomes_srgb_as_in_css() {
        let expected = [[1.2249, -0.2249, 0.0], [-0.0420, 1.0420, 0.0], [-0.0197, -0.0786, 1.0983]];
        assert_near(&Primaries::DISPLAY_P3.matrix_to(&Primaries::SRGB).unwrap(), &expected, 1e-4);
    }

    /// The matrix of the Academy's transforms (`ACEScg` to sRGB with Bradford), as OpenColorIO's configurations have it.
    #[test]
    fn aces_becomes_srgb_with_its_white_adapted() {
        let aces = Primaries {
            red: [0.713, 0.293],
            green: [0.165, 0.83],
            blue: [0.128, 0.044],
            white: [0.32168, 0.33767],
        };
        let expected = [[1.7050, -0.6217, -0.0833], [-0.1302, 1.1408, -0.0106], [-0.0240, -0.1290, 1.1530]];
        assert_near(&aces.matrix_to(&Primaries::SRGB).unwrap(), &expected, 2e-3);
        assert_eq!(aces.name(), Some("ACES AP1"));
    }

    /// The colorants of Display P3 in Apple's own profile.
    #[test]
    fn primaries_return_from_the_colorants_of_a_profile() {
        let colorants = [[0.5151, 0.2412, -0.0011], [0.2920, 0.6922, 0.0419], [0.1571, 0.0666, 0.7841]];
        let found = Primaries::of_profile(colorants).unwrap();
        assert!(found.is_near(&Primaries::DISPLAY_P3), "{found:?}");
        assert_eq!(Primaries::of_profile([[0.0; 3]; 3]), None);
    }

    #[test]
    fn xyz_itself_is_an_image_of_primaries() {
        let xyz =
            Primaries { red: [1.0, 0.0], green: [0.0, 1.0], blue: [0.0, 0.0], white: [1.0 / 3.0, 1.0 / 3.0] };
        assert_near(&xyz.to_xyz().unwrap(), &crate::core::matrix3::IDENTITY, 1e-12);
    }

    #[test]
    fn what_are_no_primaries_have_no_matrix() {
        let same = Primaries { green: [0.64, 0.33], ..Primaries::SRGB };
        let broken = Primaries { white: [0.3, 0.0], ..Primaries::SRGB };
        let absent = Primaries { red: [f64::NAN; 2], ..Primaries::SRGB };
        for primaries in [same, broken, absent] {
            assert_eq!(primaries.matrix_to(&Primaries::SRGB), None, "{primaries:?}");
        }
    }
}

//! Turns display values into CIE L*a*b* codes of 8 bits and back.
//!
//! A code is `L·255/100`, `a + 128`, `b + 128` (D65 white, sRGB primaries and curve). Programs that work on 8-bit L*a*b*
//! compute it with whole numbers; [`LabCodes`] rounds where they do (light to 11 bits, the cube root to 15), because
//! another rounding of a or b shows as a step of colour in the result.

use crate::core::color::{srgb_decode, srgb_encode};
use crate::core::matrix3::{Matrix3, inverse};
use crate::core::primaries::ColorSpace;

/// X, Y, Z of linear red, green, blue, relative to the white point.
const RGB_TO_XYZ: [[f64; 3]; 3] = [
    [0.412_453 / WHITE[0], 0.357_580 / WHITE[0], 0.180_423 / WHITE[0]],
    [0.212_671, 0.715_160, 0.072_169],
    [0.019_334 / WHITE[2], 0.119_193 / WHITE[2], 0.950_227 / WHITE[2]],
];
/// The inverse of [`RGB_TO_XYZ`].
const XYZ_TO_RGB: [[f64; 3]; 3] = [
    [3.240_479 * WHITE[0], -1.537_150, -0.498_535 * WHITE[2]],
    [-0.969_256 * WHITE[0], 1.875_991, 0.041_556 * WHITE[2]],
    [0.055_648 * WHITE[0], -0.204_043, 1.057_311 * WHITE[2]],
];
/// D65, the sum of each row of the primaries.
const WHITE: [f64; 3] = [0.950_456, 1.0, 1.088_754];

/// The matrices of red, green and blue and of X, Y, Z relative to white, for the colours of a display.
pub(super) struct LabSpace {
    to_xyz: Matrix3,
    from_xyz: Matrix3,
}

impl LabSpace {
    /// Those of sRGB are the rounded ones of programs that work on codes.
    pub(super) fn of(space: ColorSpace) -> Self {
        let srgb = Self { to_xyz: RGB_TO_XYZ, from_xyz: XYZ_TO_RGB };
        if space == ColorSpace::Srgb {
            return srgb;
        }
        let relative = |matrix: Matrix3| matrix.map(|row| row.map(|value| value / row.iter().sum::<f64>()));
        let to_xyz = space.primaries().to_xyz().map(relative);
        let both = to_xyz.and_then(|to_xyz| Some(Self { to_xyz, from_xyz: inverse(&to_xyz)? }));
        both.unwrap_or(srgb)
    }
}

/// Codes per unit of L*.
const CODES_PER_L: f64 = 255.0 / 100.0;
/// The code of a* = 0 and b* = 0.
const NEUTRAL: f64 = 128.0;

/// Below this the cube root is continued by a line (CIE 15, in the rounded form `7.787·t + 16/116`).
const LINE_BELOW: f64 = 0.008_856;
const LINE_SLOPE: f64 = 7.787;
const LINE_START: f64 = 16.0 / 116.0;
/// L* per unit of Y on the line.
const DARK_SLOPE: f64 = 903.3;

fn lab_function(t: f64) -> f64 {
    if t > LINE_BELOW { t.cbrt() } else { LINE_SLOPE * t + LINE_START }
}

fn inverse_lab_function(f: f64) -> f64 {
    if f > 6.0 / 29.0 { f.powi(3) } else { (f - LINE_START) / LINE_SLOPE }
}

fn multiply(matrix: &[[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// The L*a*b* codes, unrounded, of display values in `[0, 1]`.
pub(super) fn rgb_to_lab(space: &LabSpace, rgb: [f64; 3]) -> [f64; 3] {
    let [x, y, z] = multiply(&space.to_xyz, rgb.map(srgb_decode));
    let [fx, fy, fz] = [x, y, z].map(lab_function);
    let lightness = if y > LINE_BELOW { 116.0 * fy - 16.0 } else { DARK_SLOPE * y };
    [lightness * CODES_PER_L, 500.0 * (fx - fy) + NEUTRAL, 200.0 * (fy - fz) + NEUTRAL]
}

/// The display values, clipped to `[0, 1]`, of L*a*b* codes.
pub(super) fn lab_to_rgb(space: &LabSpace, [lightness, a, b]: [f64; 3]) -> [f64; 3] {
    let l = lightness / CODES_PER_L;
    let (y, fy) = if l > LINE_BELOW * DARK_SLOPE {
        let fy = (l + 16.0) / 116.0;
        (fy.powi(3), fy)
    } else {
        (l / DARK_SLOPE, LINE_SLOPE * l / DARK_SLOPE + LINE_START)
    };
    let x = inverse_lab_function(fy + (a - NEUTRAL) / 500.0);
    let z = inverse_lab_function(fy - (b - NEUTRAL) / 200.0);
    multiply(&space.from_xyz, [x, y, z]).map(srgb_encode)
}

/// Steps of linear light per 8-bit code.
const LIGHT_STEPS: f64 = 255.0 * 8.0;
/// X, Y and Z may exceed white by their coefficients' rounding; half as much again is beyond any doubt.
const CUBE_ROOTS: u16 = 256 * 8 * 3 / 2;
const COEFFICIENT_BITS: u32 = 12;
const ROOT_BITS: u32 = 15;
const ROOT_ONE: i32 = 1 << ROOT_BITS;

/// 8-bit display values to 8-bit L*a*b* codes, in whole numbers.
pub(super) struct LabCodes {
    /// Linear light of each display code.
    light: Vec<i32>,
    /// The function f of each step of light.
    root: Vec<i32>,
    /// [`RGB_TO_XYZ`].
    coefficients: [[i32; 3]; 3],
}

impl LabCodes {
    pub(super) fn new() -> Self {
        let light = (0..=u8::MAX).map(|code| rounded(LIGHT_STEPS * srgb_decode(f64::from(code) / 255.0)));
        let root =
            (0..CUBE_ROOTS).map(|i| rounded(f64::from(ROOT_ONE) * lab_function(f64::from(i) / LIGHT_STEPS)));
        let one = f64::from(1 << COEFFICIENT_BITS);
        let coefficients = RGB_TO_XYZ.map(|row| row.map(|value| rounded(value * one)));
        Self { light: light.collect(), root: root.collect(), coefficients }
    }

    /// The codes of one pixel.
    pub(super) fn encode(&self, rgb: [u8; 3]) -> [f64; 3] {
        let light = rgb.map(|code| self.light[usize::from(code)]);
        let [fx, fy, fz] = self.coefficients.map(|row| {
            let sum: i32 = row.iter().zip(light).map(|(c, v)| c * v).sum();
            let step = usize::try_from(shift_rounded(sum, COEFFICIENT_BITS)).unwrap_or(0);
            self.root[step.min(self.root.len() - 1)]
        });
        // 116·f − 16 in codes: 295.8 and 40.8, the slope rounded to a whole number.
        let lightness = 296 * fy - (16 * 255 * ROOT_ONE + 50) / 100;
        let neutral = 128 * ROOT_ONE;
        [lightness, 500 * (fx - fy) + neutral, 200 * (fy - fz) + neutral]
            .map(|value| f64::from(shift_rounded(value, ROOT_BITS).clamp(0, 255)))
    }
}

#[expect(clippy::cast_possible_truncation, reason = "a table's value, far inside of the range")]
fn rounded(value: f64) -> i32 {
    value.round() as i32
}

fn shift_rounded(value: i32, bits: u32) -> i32 {
    (value + (1 << (bits - 1))) >> bits
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixels() -> impl Iterator<Item = [u8; 3]> {
        (0..=255u8).step_by(15).flat_map(|r| {
            (0..=255u8).step_by(15).flat_map(move |g| (0..=255u8).step_by(15).map(move |b| [r, g, b]))
        })
    }

    #[test]
    fn knows_the_corners_of_the_cube() {
        // CIE L*a*b* of sRGB white, black and red (D65): (100, 0, 0), (0, 0, 0), (53.24, 80.09, 67.20).
        let codes = LabCodes::new();
        assert_eq!(codes.encode([255, 255, 255]), [255.0, 128.0, 128.0]);
        assert_eq!(codes.encode([0, 0, 0]), [0.0, 128.0, 128.0]);
        let [l, a, b] = rgb_to_lab(&LabSpace::of(ColorSpace::Srgb), [1.0, 0.0, 0.0]);
        assert!((l / CODES_PER_L - 53.24).abs() < 0.02, "{l}");
        assert!((a - NEUTRAL - 80.09).abs() < 0.05 && (b - NEUTRAL - 67.20).abs() < 0.05, "{a} {b}");
        assert_eq!(codes.encode([255, 0, 0]), [136.0, 208.0, 195.0]);
    }

    /// The light of a dark code has a rounding of up to half a step of 8 per code, which the cube root stretches most
    /// at the dark end.
    #[test]
    fn whole_numbers_follow_the_formula() {
        let codes = LabCodes::new();
        for rgb in pixels() {
            let exact = rgb_to_lab(&LabSpace::of(ColorSpace::Srgb), rgb.map(|code| f64::from(code) / 255.0));
            for (found, exact) in codes.encode(rgb).iter().zip(exact) {
                assert!((found - exact).abs() < 3.5, "{rgb:?}: {found} instead of {exact}");
            }
        }
    }

    /// The published matrices are inverse to six digits; the cube root's slope and that of the sRGB curve are largest
    /// in the dark, where a display value moves by some ten of these.
    #[test]
    fn decoding_is_the_inverse_of_encoding() {
        for space in [ColorSpace::Srgb, ColorSpace::DisplayP3] {
            let lab = LabSpace::of(space);
            for rgb in pixels() {
                let rgb = rgb.map(|code| f64::from(code) / 255.0);
                for (found, expected) in lab_to_rgb(&lab, rgb_to_lab(&lab, rgb)).iter().zip(rgb) {
                    assert!(
                        (found - expected).abs() < 1e-4,
                        "{space:?} {rgb:?}: {found} instead of {expected}"
                    );
                }
            }
        }
    }

    /// L* of green, 100 and no colour of white: Y of the green of Display P3 is 0.6917 (SMPTE EG 432-1).
    #[test]
    fn the_lightness_of_a_colour_is_that_of_its_space() {
        let lab = LabSpace::of(ColorSpace::DisplayP3);
        let [l, ..] = rgb_to_lab(&lab, [0.0, 1.0, 0.0]);
        assert!((l / CODES_PER_L - (116.0 * 0.6917_f64.cbrt() - 16.0)).abs() < 0.02, "{l}");
        for (found, expected) in rgb_to_lab(&lab, [1.0; 3]).iter().zip([255.0, NEUTRAL, NEUTRAL]) {
            assert!((found - expected).abs() < 1e-9, "{found}");
        }
    }
}

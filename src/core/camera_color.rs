//! Turns what a digital negative says of its camera's colours into the matrix from white-balanced camera colours to
//! linear sRGB.

use serde::{Deserialize, Serialize};

use super::matrix3::{IDENTITY, Matrix3, apply, between, diagonal, inverse, product};
use super::primaries::{D50, D65, Primaries, adaptation, xyz_of};

/// The colours of a camera under one or two lights, as a digital negative gives them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub struct CameraColor {
    /// One light, or two.
    pub lights: Vec<CalibratedLight>,
    /// Gains that the camera applied before it stored the photosites.
    pub analog_balance: [f64; 3],
}

/// The colours of a camera under one light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub struct CalibratedLight {
    /// The light, as EXIF numbers light sources: 17 is standard light A, 21 is D65.
    pub illuminant: u16,
    /// XYZ to the colours of a reference camera of this model.
    pub color_matrix: Matrix3,
    /// White-balanced camera colours to XYZ under D50, where the file has it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub forward_matrix: Option<Matrix3>,
    /// The reference camera's colours to this camera's.
    pub calibration: Matrix3,
}

/// Matrices that amplify colours more than this describe no camera.
const LARGEST_COEFFICIENT: f64 = 1e3;

/// Rounds of looking for the white's chromaticity, which the matrices depend on; a handful suffices.
const WHITE_ROUNDS: usize = 30;

impl CameraColor {
    /// The matrix from white-balanced camera colours to linear sRGB, for the gains that balanced them.
    ///
    /// # Equation
    /// DNG 1.7, chapter 6, "Mapping Camera Color Space to CIE XYZ Space". With the neutral n = 1/gains: its chromaticity
    /// and correlated temperature T by fixed point, the matrices of the two lights mixed in 1/T, `CM` (color matrix),
    /// `CC` (camera calibration), `FM` (forward matrix, scaled so that it maps (1, 1, 1) to D50), `AB` (analog balance).
    /// With a forward matrix XYZ under D50 are `FM·D·(AB·CC)⁻¹·camera`, `D = diag((AB·CC)⁻¹·n)⁻¹`; else XYZ under the
    /// white are `(AB·CC·CM)⁻¹·camera`. Linear Bradford adaptation leads to D65 and sRGB; camera = n · balanced. At last
    /// each row is divided by its sum, which rounding and the fixed point leave near one: grey stays grey.
    ///
    /// None where the matrices do not describe a camera: without inverse, or of a white without light.
    pub fn matrix(&self, gains: [f64; 3]) -> Option<Matrix3> {
        let neutral = gains.map(|gain| 1.0 / gain);
        let white = self.white_of(neutral)?;
        let mixed = self.at(temperature_k(white))?;
        let to_camera = product(&diagonal(self.analog_balance), &mixed.calibration);
        let (to_xyz, light) = match &mixed.forward_matrix {
            Some(forward) => {
                let from_camera = inverse(&to_camera)?;
                let reference = apply(&from_camera, neutral);
                let balance = diagonal(reference.map(|value| 1.0 / value));
                (product(&normalised(forward)?, &product(&balance, &from_camera)), D50)
            }
            None => (inverse(&product(&to_camera, &mixed.color_matrix))?, white),
        };
        let to_srgb = inverse(&Primaries::SRGB.to_xyz()?)?;
        let matrix = product(
            &product(&to_srgb, &adaptation(xyz_of(light), xyz_of(D65))?),
            &product(&to_xyz, &diagonal(neutral)),
        );
        let sums = matrix.map(|row| row.iter().sum::<f64>());
        let is_sound = sums.iter().all(|sum| sum.is_finite() && *sum > 0.0);
        let rows = [0, 1, 2].map(|i| matrix[i].map(|value| value / sums[i]));
        (is_sound && rows.iter().flatten().all(|value| value.abs() <= LARGEST_COEFFICIENT)).then_some(rows)
    }

    /// The correlated colour temperature of the light that the gains make neutral, in kelvin.
    pub fn temperature_k(&self, gains: [f64; 3]) -> Option<f64> {
        self.white_of(gains.map(|gain| 1.0 / gain)).map(temperature_k)
    }

    /// The gains, 1 for green, that make light of a chromaticity (x, y) neutral.
    pub fn gains_of(&self, white: [f64; 2]) -> Option<[f64; 3]> {
        let neutral = apply(&self.xyz_to_camera(white)?, xyz_of(white));
        let is_light = neutral.iter().all(|value| value.is_finite() && *value > 0.0);
        is_light.then(|| neutral.map(|value| neutral[1] / value))
    }

    /// The chromaticity of the light that the camera records as `neutral`.
    fn white_of(&self, neutral: [f64; 3]) -> Option<[f64; 2]> {
        let mut white = D50;
        for _ in 0..WHITE_ROUNDS {
            let xyz = apply(&inverse(&self.xyz_to_camera(white)?)?, neutral);
            let sum: f64 = xyz.iter().sum();
            let next = [xyz[0] / sum, xyz[1] / sum];
            if !next.iter().all(|value| value.is_finite() && *value > 0.0) {
                return None;
            }
            let moved = (next[0] - white[0]).abs() + (next[1] - white[1]).abs();
            white = next;
            if moved < 1e-9 {
                break;
            }
        }
        Some(white)
    }

    fn xyz_to_camera(&self, white: [f64; 2]) -> Option<Matrix3> {
        let mixed = self.at(temperature_k(white))?;
        Some(product(&diagonal(self.analog_balance), &product(&mixed.calibration, &mixed.color_matrix)))
    }

    /// The matrices under a light of this temperature: mixed in its inverse between those of the two lights.
    fn at(&self, temperature: f64) -> Option<CalibratedLight> {
        let first = self.lights.first()?;
        let Some(second) = self.lights.get(1) else { return Some(first.clone()) };
        let mireds = [first, second].map(|light| 1.0 / temperature_of(light.illuminant));
        let share = (1.0 / temperature - mireds[0]) / (mireds[1] - mireds[0]);
        let share = if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 };
        let forward_matrix = match (&first.forward_matrix, &second.forward_matrix) {
            (Some(a), Some(b)) => Some(between(a, b, share)),
            (one, other) => one.or(*other),
        };
        Some(CalibratedLight {
            illuminant: first.illuminant,
            color_matrix: between(&first.color_matrix, &second.color_matrix, share),
            forward_matrix,
            calibration: between(&first.calibration, &second.calibration, share),
        })
    }
}

impl Default for CalibratedLight {
    /// D65 and a camera whose colours are XYZ.
    fn default() -> Self {
        Self { illuminant: 21, color_matrix: IDENTITY, forward_matrix: None, calibration: IDENTITY }
    }
}

/// The temperature that stands for a light of EXIF, in kelvin; 5000 for unknown ones.
///
/// Those of the fluorescent lamps are the middles of the ranges that EXIF gives.
fn temperature_of(illuminant: u16) -> f64 {
    match illuminant {
        3 | 17 => 2850.0,
        24 => 3200.0,
        1 | 4 | 9 | 18 | 20 => 5500.0,
        10 | 19 | 21 => 6500.0,
        11 | 22 => 7500.0,
        12 => 6400.0,
        2 | 14 => 4200.0,
        15 => 3450.0,
        16 => 2925.0,
        _ => 5000.0,
    }
}

/// Scales the rows of a forward matrix so that it maps (1, 1, 1) to D50.
fn normalised(forward: &Matrix3) -> Option<Matrix3> {
    let sums = forward.map(|row| row.iter().sum::<f64>());
    let white = xyz_of(D50);
    let rows = [0, 1, 2].map(|i| forward[i].map(|value| value * white[i] / sums[i]));
    sums.iter().all(|sum| *sum > 0.0).then_some(rows)
}

/// The correlated colour temperature of a chromaticity (x, y), in kelvin.
///
/// # Equation
/// Robertson's isotemperature lines ("Computation of correlated color temperature and distribution temperature", 1968):
/// in the CIE 1960 diagram, the place between the two lines on whose sides the point lies, by the distances to them,
/// linear in the reciprocal temperature.
fn temperature_k([x, y]: [f64; 2]) -> f64 {
    let below = -2.0 * x + 12.0 * y + 3.0;
    let (u, v) = (4.0 * x / below, 6.0 * y / below);
    // Positive while the point lies beyond the line towards lower temperatures.
    let distance = |line: [f64; 4]| ((v - line[2]) - line[3] * (u - line[1])) / line[3].hypot(1.0);
    let last = ISOTEMPERATURE_LINES.len() - 1;
    let index = (1..last).find(|&i| distance(ISOTEMPERATURE_LINES[i]) <= 0.0).unwrap_or(last);
    let [before, after] = [ISOTEMPERATURE_LINES[index - 1], ISOTEMPERATURE_LINES[index]];
    let (first, second) = (distance(before).max(0.0), (-distance(after)).max(0.0));
    let share = if first + second > 0.0 { first / (first + second) } else { 0.0 };
    1e6 / (before[0] + share * (after[0] - before[0])).max(1.0)
}

/// Reciprocal megakelvins, u, v and slope of each line (Wyszecki and Stiles, "Color Science", 2nd edition, table 1(3.11);
/// u at 325 as corrected since).
const ISOTEMPERATURE_LINES: [[f64; 4]; 31] = [
    [0.0, 0.18006, 0.26352, -0.24341],
    [10.0, 0.18066, 0.26589, -0.25479],
    [20.0, 0.18133, 0.26846, -0.26876],
    [30.0, 0.18208, 0.27119, -0.28539],
    [40.0, 0.18293, 0.27407, -0.30470],
    [50.0, 0.18388, 0.27709, -0.32675],
    [60.0, 0.18494, 0.28021, -0.35156],
    [70.0, 0.18611, 0.28342, -0.37915],
    [80.0, 0.18740, 0.28668, -0.40955],
    [90.0, 0.18880, 0.28997, -0.44278],
    [100.0, 0.19032, 0.29326, -0.47888],
    [125.0, 0.19462, 0.30141, -0.58204],
    [150.0, 0.19962, 0.30921, -0.70471],
    [175.0, 0.20525, 0.31647, -0.84901],
    [200.0, 0.21142, 0.32312, -1.0182],
    [225.0, 0.21807, 0.32909, -1.2168],
    [250.0, 0.22511, 0.33439, -1.4512],
    [275.0, 0.23247, 0.33904, -1.7298],
    [300.0, 0.24010, 0.34308, -2.0637],
    [325.0, 0.24792, 0.34655, -2.4681],
    [350.0, 0.25591, 0.34951, -2.9641],
    [375.0, 0.26400, 0.35200, -3.5814],
    [400.0, 0.27218, 0.35407, -4.3633],
    [425.0, 0.28039, 0.35577, -5.3762],
    [450.0, 0.28863, 0.35714, -6.7262],
    [475.0, 0.29685, 0.35823, -8.5955],
    [500.0, 0.30505, 0.35907, -11.324],
    [525.0, 0.31320, 0.35968, -15.628],
    [550.0, 0.32129, 0.36011, -23.325],
    [575.0, 0.32931, 0.36038, -40.770],
    [600.0, 0.33724, 0.36051, -116.45],
];

#[cfg(test)]
mod tests {
    use super::*;

    /// The matrices of the Canon EOS 5D Mark II, as Adobe publishes them for standard light A and D65.
    fn canon(with_forward: bool) -> CameraColor {
        let forward = [[0.8924, -0.1041, 0.1760], [0.4351, 0.6621, -0.0972], [0.0505, -0.1562, 0.9308]];
        let light = |illuminant, color_matrix| CalibratedLight {
            illuminant,
            color_matrix,
            forward_matrix: with_forward.then_some(forward),
            ..CalibratedLight::default()
        };
        let warm = [[0.5309, -0.0229, -0.0336], [-0.6241, 1.3265, 0.3337], [-0.0817, 0.1215, 0.6664]];
        let cold = [[0.4716, 0.0603, -0.0830], [-0.7798, 1.5474, 0.2480], [-0.1496, 0.1937, 0.6651]];
        CameraColor { lights: vec![light(17, warm), light(21, cold)], analog_balance: [1.0; 3] }
    }

    fn assert_near(found: &Matrix3, expected: &Matrix3, tolerance: f64) {
        for (found, expected) in found.iter().flatten().zip(expected.iter().flatten()) {
            assert!((found - expected).abs() < tolerance, "{found} instead of {expected}");
        }
    }

    /// Correlated temperatures as CIE 15 gives them; Robertson's method is good to a few kelvin there.
    #[test]
    fn known_lights_have_their_temperatures() {
        for (white, kelvin) in [(D65, 6504.0), ([0.447_57, 0.407_45], 2856.0), (D50, 5003.0)] {
            assert!((temperature_k(white) - kelvin).abs() < 6.0, "{} for {kelvin}", temperature_k(white));
        }
        assert!(temperature_k([0.2, 0.2]).is_finite() && temperature_k([0.9, 0.05]).is_finite());
    }

    /// The matrix that dcraw computes for this camera under D65, by another way: the product of the color matrix and
    /// sRGB's XYZ, each row divided by its sum, inverted; its matrix of sRGB is rounded to six digits.
    #[test]
    fn under_d65_the_matrix_is_that_of_dcraw() {
        let expected = [[2.0682, -1.3203, 0.2522], [-0.0382, 1.3655, -0.3273], [0.0357, -0.3788, 1.3431]];
        let gains = canon(false).gains_of(D65).unwrap();
        for (found, expected) in gains.into_iter().zip([2.5737, 1.0, 1.3876]) {
            assert!((found - expected).abs() < 1e-3, "{found} instead of {expected}");
        }
        assert_near(&canon(false).matrix(gains).unwrap(), &expected, 1e-3);
        assert_near(&canon(true).matrix(gains).unwrap(), &expected, 1e-3);
    }

    /// Expected by a script of its own: Krystek's Planckian locus (1985) searched for the nearest temperature, equations
    /// solved by elimination, Lindbloom's published matrices of Bradford D50 → D65 and of sRGB. The temperatures of the two
    /// methods differ by some ten kelvin, of a way of 300 mired; that and their roundings move entries by less than 0.002.
    #[test]
    fn matrices_under_other_lights_are_those_of_another_program() {
        let cold = [[2.0985, -1.2906, 0.1920], [-0.0390, 1.3799, -0.3409], [0.0473, -0.3862, 1.3390]];
        let warm = [[2.0819, -1.1513, 0.0694], [-0.0592, 1.3256, -0.2663], [0.0970, -0.5123, 1.4152]];
        for (gains, expected, kelvin) in [([2.1, 1.0, 1.5], cold, 4920.0), ([1.6, 1.0, 2.3], warm, 3310.0)] {
            assert_near(&canon(false).matrix(gains).unwrap(), &expected, 2e-3);
            let forward = [[2.0677, -1.3197, 0.2520], [-0.0381, 1.3655, -0.3274], [0.0355, -0.3787, 1.3431]];
            assert_near(&canon(true).matrix(gains).unwrap(), &forward, 1e-3);
            let found = canon(false).temperature_k(gains).unwrap();
            assert!((found - kelvin).abs() < 20.0, "{found} instead of {kelvin}");
        }
    }

    #[test]
    fn grey_stays_grey_whatever_the_gains() {
        for with_forward in [false, true] {
            for gains in [[1.0; 3], [2.0, 1.0, 1.4], [1.2, 1.0, 3.5]] {
                let grey = apply(&canon(with_forward).matrix(gains).unwrap(), [1.0; 3]);
                assert!(grey.iter().all(|value| (value - 1.0).abs() < 1e-12), "{grey:?}");
            }
        }
    }

    /// Gains of the camera's own are in its colours, so that balance and calibration change what the same gains mean, and
    /// nothing where the gains follow them.
    #[test]
    fn analog_balance_and_calibration_belong_to_the_camera() {
        let plain = canon(false);
        let expected = plain.matrix([2.0, 1.0, 1.5]).unwrap();
        let mut other = plain.clone();
        other.analog_balance = [1.25, 1.0, 0.8];
        for light in &mut other.lights {
            light.calibration = diagonal([0.9, 1.0, 1.1]);
        }
        let gains = [2.0 / (1.25 * 0.9), 1.0, 1.5 / (0.8 * 1.1)];
        assert_near(&other.matrix(gains).unwrap(), &expected, 1e-9);
    }

    #[test]
    fn matrices_that_describe_no_camera_give_none() {
        let broken = |color_matrix| CameraColor {
            lights: vec![CalibratedLight { color_matrix, ..CalibratedLight::default() }],
            analog_balance: [1.0; 3],
        };
        assert_eq!(broken([[0.0; 3]; 3]).matrix([1.0; 3]), None);
        assert_eq!(broken(diagonal([1.0, -1.0, 1.0])).matrix([1.0; 3]), None);
        assert_eq!(broken([[f64::NAN; 3]; 3]).matrix([1.0; 3]), None);
        assert_eq!(CameraColor { lights: vec![], analog_balance: [1.0; 3] }.matrix([1.0; 3]), None);
    }
}

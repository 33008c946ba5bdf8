//! What a digital negative says of its camera's colours: matrices, the lights that they are for, the white of the scene.

use crate::core::camera_color::{CalibratedLight, CameraColor};
use crate::core::matrix3::{IDENTITY, Matrix3};
use crate::io::directory::Directory;

const COLOR_MATRICES: [u16; 2] = [50721, 50722];
const CALIBRATIONS: [u16; 2] = [50723, 50724];
/// The light, calibration, colour and forward matrix that DNG 1.6 added.
const THIRD_LIGHT: [u16; 4] = [52529, 52530, 52531, 52532];
const ANALOG_BALANCE: u16 = 50727;
const AS_SHOT_NEUTRAL: u16 = 50728;
const AS_SHOT_WHITE: u16 = 50729;
const ILLUMINANTS: [u16; 2] = [50778, 50779];
const SIGNATURE_OF_CALIBRATION: u16 = 50931;
const SIGNATURE_OF_PROFILE: u16 = 50932;
const FORWARD_MATRICES: [u16; 2] = [50964, 50965];

/// The raw image's directory, where fields of colour may stand, and the file's first, where they should.
pub(super) struct Fields<'a>(pub(super) &'a Directory<'a>, pub(super) &'a Directory<'a>);

impl Fields<'_> {
    fn reals<const N: usize>(&self, tag: u16) -> Option<[f64; N]> {
        let values = self.0.reals(tag).or_else(|| self.1.reals(tag))?;
        let values: [f64; N] = values.try_into().ok()?;
        values.iter().all(|value| value.is_finite()).then_some(values)
    }

    fn matrix(&self, tag: u16) -> Option<Matrix3> {
        let values = self.reals::<9>(tag)?;
        Some([0, 1, 2].map(|row| [values[3 * row], values[3 * row + 1], values[3 * row + 2]]))
    }

    /// What to tell of a third light that the camera was calibrated for.
    pub(super) fn doubt_of_third_light(&self) -> Option<String> {
        let is_said = |tag: &u16| self.0.reals(*tag).is_some() || self.1.reals(*tag).is_some();
        THIRD_LIGHT.iter().any(is_said).then(|| {
            "its camera is calibrated for three lights (CalibrationIlluminant3), of which the first two are read: colours under the third \
             may be off; say them with a colour matrix (`udc finish --ccm`)"
                .to_owned()
        })
    }

    /// The camera's colours; none where the file has no matrix of three colours.
    pub(super) fn color(&self) -> Option<CameraColor> {
        let text = |tag| self.0.bytes_of(tag).or_else(|| self.1.bytes_of(tag)).unwrap_or_default();
        // Calibrations are for the profile that was made with them.
        let is_calibrated = text(SIGNATURE_OF_CALIBRATION) == text(SIGNATURE_OF_PROFILE);
        let light = |index: usize| {
            let illuminant = self.0.number(ILLUMINANTS[index]).or_else(|| self.1.number(ILLUMINANTS[index]));
            let calibration = self.matrix(CALIBRATIONS[index]).filter(|_| is_calibrated);
            Some(CalibratedLight {
                illuminant: illuminant.and_then(|number| u16::try_from(number).ok()).unwrap_or(0),
                color_matrix: self.matrix(COLOR_MATRICES[index])?,
                forward_matrix: self.matrix(FORWARD_MATRICES[index]),
                calibration: calibration.unwrap_or(IDENTITY),
            })
        };
        let lights: Vec<CalibratedLight> = [0, 1].into_iter().filter_map(light).collect();
        let analog_balance = self.positive(ANALOG_BALANCE).unwrap_or([1.0; 3]);
        (!lights.is_empty()).then_some(CameraColor { lights, analog_balance })
    }

    /// Gains that make neutral colours grey, 1 for green.
    pub(super) fn gains(&self, color: Option<&CameraColor>) -> Option<[f64; 3]> {
        let of_neutral =
            self.positive(AS_SHOT_NEUTRAL).map(|neutral| neutral.map(|value| neutral[1] / value));
        of_neutral.or_else(|| color?.gains_of(self.positive(AS_SHOT_WHITE)?))
    }

    fn positive<const N: usize>(&self, tag: u16) -> Option<[f64; N]> {
        self.reals(tag).filter(|values| values.iter().all(|value| *value > 0.0))
    }
}

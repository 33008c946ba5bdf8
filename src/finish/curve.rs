//! Turns linear light into display values.

use serde::Serialize;

use super::exposure::MIDDLE_GREY;
use crate::core::color::{srgb_decode, srgb_encode};

/// The exponent's inverse of the published pictures.
const GAMMA: f32 = 2.8;

/// The light that the published pictures show as white.
const GAMMA_WHITE: f32 = 6.0;

/// Where the fit of [`Curve::Aces`] reaches 1: the root of `0.08·x² − 0.56·x − 0.14`.
const ACES_WHITE: f32 = 7.241_655;

/// A transfer curve, from light in `[0, ∞)` to display values in `[0, 1]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Curve {
    /// `(min(x, max) / max)^(1/gamma)`.
    Gamma {
        /// The exponent's inverse.
        gamma: f32,
        /// The light that is shown as white.
        max: f32,
    },
    /// The sRGB curve of `min(x / max, 1)`.
    Srgb {
        /// The light that is shown as white.
        max: f32,
    },
    /// A filmic curve with a soft shoulder, then the sRGB curve.
    ///
    /// # Equation
    /// `f(x) = x·(2.51·x + 0.03) / (x·(2.43·x + 0.59) + 0.14)` of `x = light / max`, the rational fit to the ACES reference
    /// transform by Narkowicz (2015).
    Aces {
        /// The light that is mapped to f(1) ≈ 0.8.
        max: f32,
    },
    /// Middle grey where it is told, white where it is told, a shoulder in between; then the sRGB curve.
    ///
    /// # Equation
    /// `f(x) = x·(1 + x/w²)/(1 + x)` of `x = s·light/grey`, `w = s·white/grey` (Reinhard et al., "Photographic tone
    /// reproduction for digital images", 2002, Eq. 4), with s such that f of grey is 0.18: `s = (0.18 − (grey/white)²)/0.82`.
    /// Where grey is 0.18·white, f is linear.
    Photographic {
        /// The light that is shown as middle grey, at most 0.18 of white.
        grey: f32,
        /// The light that is shown as white.
        white: f32,
    },
    /// Light as it is, clipped to `[0, 1]`.
    None,
}

/// A curve of which the light that is shown as white is chosen beforehand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CurveKind {
    /// [`Curve::Gamma`].
    #[default]
    Gamma,
    /// [`Curve::Srgb`].
    Srgb,
    /// [`Curve::Aces`].
    Aces,
    /// [`Curve::None`].
    None,
}

impl Default for Curve {
    /// As the published pictures are shown.
    fn default() -> Self {
        Self::Gamma { gamma: GAMMA, max: GAMMA_WHITE }
    }
}

impl Curve {
    /// A curve of a kind, its settings given or the usual ones: those of the default, and white at 1 for the other kinds.
    ///
    /// # Errors
    /// What is wrong, when a setting is given that the kind does not have.
    pub fn of_kind(kind: CurveKind, gamma: Option<f32>, max: Option<f32>) -> Result<Self, &'static str> {
        let white = max.unwrap_or(1.0);
        match (kind, gamma, max) {
            (CurveKind::Gamma, ..) => {
                Ok(Self::Gamma { gamma: gamma.unwrap_or(GAMMA), max: max.unwrap_or(GAMMA_WHITE) })
            }
            (CurveKind::None, _, Some(_)) => Err("--curve none has no --max: light stays as it is"),
            (_, Some(_), _) => Err("--gamma belongs to --curve gamma"),
            (CurveKind::Srgb, ..) => Ok(Self::Srgb { max: white }),
            (CurveKind::Aces, ..) => Ok(Self::Aces { max: white }),
            (CurveKind::None, ..) => Ok(Self::None),
        }
    }

    /// Maps one value.
    pub fn apply(self, light: f32) -> f32 {
        let light = light.max(0.0);
        #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
        match self {
            Self::Gamma { gamma, max } => (light.min(max) / max).powf(1.0 / gamma),
            Self::Srgb { .. } | Self::Aces { .. } | Self::Photographic { .. } => {
                srgb_encode(self.shown_light(light)) as f32
            }
            Self::None => light.min(1.0),
        }
    }

    /// The linear light, in `[0, 1]`, that a display of the curve of sRGB shows of it.
    pub(super) fn shown_light(self, light: f32) -> f64 {
        let light = light.max(0.0);
        match self {
            Self::Gamma { .. } | Self::None => srgb_decode(f64::from(self.apply(light))),
            Self::Srgb { max } => f64::from(light / max).min(1.0),
            Self::Aces { max } => {
                // Beyond this the fit is flat, and its squares would overflow.
                let x = (light / max).min(1e6);
                f64::from(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)).min(1.0)
            }
            Self::Photographic { grey, white } => photographic(light, grey, white),
        }
    }

    /// The light of the display that there would be without shoulder and limit: as in the dark, where the curve is straight.
    /// Curves without such a part are taken for sRGB's.
    pub(super) fn exposed(self, light: f32) -> f64 {
        let light = f64::from(light.max(0.0));
        match self {
            Self::Photographic { grey, white } => slope(grey, white) * light,
            Self::Gamma { .. } | Self::Srgb { .. } | Self::Aces { .. } | Self::None => {
                light / f64::from(self.white())
            }
        }
    }

    /// The light from which on all is shown as white.
    pub(super) fn white(self) -> f32 {
        match self {
            Self::Gamma { max, .. } | Self::Srgb { max } => max,
            Self::Aces { max } => ACES_WHITE * max,
            Self::Photographic { white, .. } => white,
            Self::None => 1.0,
        }
    }
}

fn photographic(light: f32, grey: f32, white: f32) -> f64 {
    if light >= white {
        return 1.0;
    }
    let slope = slope(grey, white);
    let (x, w) = (slope * f64::from(light), slope * f64::from(white));
    x * (1.0 + x / (w * w)) / (1.0 + x)
}

/// s/grey of [`Curve::Photographic`].
fn slope(grey: f32, white: f32) -> f64 {
    let [grey, white] = [grey, white].map(f64::from);
    (MIDDLE_GREY - (grey / white).powi(2)) / (1.0 - MIDDLE_GREY) / grey
}

#[cfg(test)]
mod tests {
    use super::*;

    const CURVES: [Curve; 6] = [
        Curve::Gamma { gamma: 2.8, max: 6.0 },
        Curve::Srgb { max: 1.0 },
        Curve::Aces { max: 1.0 },
        Curve::Photographic { grey: 0.18, white: 1.0 },
        Curve::Photographic { grey: 0.1, white: 9.0 },
        Curve::None,
    ];

    #[test]
    fn a_kind_has_its_own_settings_only() {
        assert_eq!(Curve::of_kind(CurveKind::default(), None, None), Ok(Curve::default()));
        let gamma = Curve::of_kind(CurveKind::Gamma, Some(2.2), Some(4.0));
        assert_eq!(gamma, Ok(Curve::Gamma { gamma: 2.2, max: 4.0 }));
        assert_eq!(Curve::of_kind(CurveKind::Srgb, None, None), Ok(Curve::Srgb { max: 1.0 }));
        assert_eq!(Curve::of_kind(CurveKind::Aces, None, Some(2.0)), Ok(Curve::Aces { max: 2.0 }));
        assert!(Curve::of_kind(CurveKind::Aces, Some(2.2), None).unwrap_err().contains("--gamma"));
        assert!(Curve::of_kind(CurveKind::None, Some(2.2), Some(2.0)).unwrap_err().contains("--max"));
    }

    #[test]
    fn curves_rise_from_black_to_white() {
        for curve in CURVES {
            assert!(curve.apply(-1.0) < 1e-6 && (curve.apply(1e30) - 1.0).abs() < 1e-6, "{curve:?}");
            let values: Vec<f32> = (0..400).map(|i| curve.apply(i as f32 / 40.0)).collect();
            assert!(values.windows(2).all(|pair| pair[0] <= pair[1]), "{curve:?}");
            let white = curve.white();
            assert!(curve.apply(white) > 0.999_99 && curve.apply(0.98 * white) < 1.0, "{curve:?}");
        }
    }

    #[test]
    fn grey_is_shown_as_middle_grey_and_white_as_white() {
        for (grey, white) in [(0.18, 1.0), (0.02, 1.0), (0.3, 400.0)] {
            let curve = Curve::Photographic { grey, white };
            let middle = srgb_encode(0.18) as f32;
            assert!((curve.apply(grey) - middle).abs() < 1e-6, "{grey} {white}: {}", curve.apply(grey));
            assert!((curve.apply(white * 0.999_999) - 1.0).abs() < 1e-4 && curve.apply(white) == 1.0);
        }
        // Where grey is 0.18 of white, it is the sRGB curve.
        let linear = Curve::Photographic { grey: 0.36, white: 2.0 };
        for light in [0.01, 0.5, 1.7] {
            assert!((linear.apply(light) - Curve::Srgb { max: 2.0 }.apply(light)).abs() < 1e-6);
        }
    }

    #[test]
    fn gamma_shows_its_maximum_as_white() {
        let curve = Curve::Gamma { gamma: 2.0, max: 4.0 };
        assert!((curve.apply(1.0) - 0.5).abs() < 1e-6);
        assert_eq!(curve.apply(4.0), 1.0);
    }
}
